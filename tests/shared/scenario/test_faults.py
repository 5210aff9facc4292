"""What is wrong with a document, in one line, whatever it is."""

import copy
import re
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from cogradar.shared.scenario.faults import MAX_EXPLAINED, explain, listed, printable
from cogradar.shared.scenario.files import ScenarioError, load, parse


class Leg(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)
    length: Annotated[float, Field(gt=0, le=2)]
    shoe: Annotated[str, Field(max_length=4, pattern="^[a-z]+$", description="a word of up to 4 letters")] = "clog"


class Animal(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    kind: Literal["cat", "dog"]
    legs: Annotated[list[Leg], Field(min_length=2, max_length=3)]
    age: Annotated[int, Field(ge=0, lt=100)] = 1
    tame: bool = True

    @field_validator("age")
    @classmethod
    def _not_13(cls, age: int) -> int:
        if age == 13:
            raise ValueError("must not be 13")
        return age


LEGS = [{"length": 1.0}, {"length": 1.5}]
CAT: dict[str, Any] = {"kind": "cat", "legs": LEGS}


def _explained(document: Any) -> str:
    with pytest.raises(ValidationError) as caught:
        Animal.model_validate(document)
    return explain(caught.value, Animal)


@pytest.mark.parametrize(
    ("document", "expected"),
    [
        ({"legs": LEGS}, "kind: missing, must be one of cat, dog"),
        (CAT | {"kind": "cow"}, "kind = 'cow': must be one of cat, dog"),
        (CAT | {"age": -1}, "age = -1: must be an integer >= 0 and < 100"),
        (CAT | {"age": "old"}, "age = 'old': must be an integer >= 0 and < 100"),
        (CAT | {"age": 13}, "age = 13: must not be 13"),
        (CAT | {"age": 10**5000}, "age = (too large to show): must be an integer >= 0 and < 100"),
        (CAT | {"tame": 1}, "tame = 1: must be true or false"),
        (CAT | {"legs": 4}, "legs = 4: must be a list at least 2 long and at most 3 long"),
        (CAT | {"legs": [1, 2]}, "legs #1 = 1: must be a table (and 1 more)"),
        (CAT | {"legs": [LEGS[0], {}]}, "legs #2, length: missing, must be a number > 0 and <= 2"),
        (CAT | {"legs": [LEGS[0], {"length": float("nan")}]}, "legs #2, length = nan: must be a number > 0 and <= 2"),
        (
            CAT | {"legs": [LEGS[0], {"length": 1.0, "shoe": "x" * 500}]},
            f"legs #2, shoe = '{'x' * 27}...{'x' * 28}': must be a word of up to 4 letters",
        ),
        (
            CAT | {"legs": [LEGS[0], {"feet": 1.0}]},
            "legs #2, feet = 1.0: unknown key, must be one of length, shoe",
        ),
        ({"kind": "cat", "legs": LEGS, 3: 4}, "keys must be strings, not 3"),
        (CAT | {"a\nb\x1b[31m": 1}, "a?b?[31m = 1: unknown key, must be one of kind, legs, age, tame"),
    ],
)
def test_the_first_error_is_one_line_with_key_value_and_what_is_allowed(document: Any, expected: str) -> None:
    text = _explained(document)
    if "feet" in expected:
        expected += " (and 1 more)"  # it is missing as well
    assert text == expected


@pytest.mark.parametrize("n_wrong", [1, MAX_EXPLAINED, MAX_EXPLAINED + 1, MAX_EXPLAINED + 2, 500])
def test_all_errors_have_a_line_each_until_there_are_too_many(n_wrong: int) -> None:
    with pytest.raises(ScenarioError) as caught:
        parse(load("smoke").model_dump() | {f"key{i}": i for i in range(n_wrong)}, source="x.toml")
    lines = caught.value.faults
    shown = n_wrong if n_wrong <= MAX_EXPLAINED + 1 else MAX_EXPLAINED  # "and 1 more" is as long as the one
    known = "unknown key, must be one of name, title, dwells, radar, world, site"
    assert lines[:shown] == tuple(f"x.toml: key{i} = {i}: {known}" for i in range(shown))
    assert lines[shown:] == ((f"and {n_wrong - shown} more",) if n_wrong > shown else ())


def test_every_fault_has_its_line_in_the_order_of_the_file(tmp_path: Path) -> None:
    """Also behind the first target that is wrong, and behind a file that cannot be read."""
    file = tmp_path / "bad.toml"
    file.write_text("""
extends = "paper"
naem = "x"
[[world.targets]]
state = [60.0, 0.2, 7.5, 0.1]
bogus = 1
turns = [{ from_s = 1.0, to_s = 2.0, g = 90 }, { from_s = 3.0 }, { from_s = 5.0, to_s = 6.0, omega = 1 }]
[[world.targets]]
trajectory = "nowhere.csv"
colour = "red"
[[world.targets]]
state = "x"
[radar]
blub = 3
[radar.array]
n_tx = 0
""")
    with pytest.raises(ScenarioError) as caught:
        load(str(file), ["radar.array.n_rx=0", "dwells=0"])
    said = [key for line in caught.value.faults for key in re.findall("^(?:--set |[^:]*: )([^:=]*[^ :=])", line)]
    assert said == [
        "naem",
        "world.targets #1, bogus",
        "world.targets #1, turns #1, g",
        "world.targets #1, turns #2, to_s",
        "world.targets #1, turns #3, omega",
        "world.targets #2, trajectory",
        "world.targets #2, colour",
        "world.targets #3, state",
        "radar.blub",
        "radar.array.n_tx",
        "radar.array.n_rx",
        "dwells",
    ]


def test_of_many_targets_twenty_faults_are_explained_and_the_others_counted(tmp_path: Path) -> None:
    """Of a file. Of a message the first entry alone, which takes no time."""
    targets = [{"state": [-1.0, 0.0, float(i), 0.0]} for i in range(100)]
    document = load("smoke").model_dump()
    document["world"]["targets"] = targets
    with pytest.raises(ScenarioError) as caught:
        parse(document, source="a message")
    assert all("targets #1," in fault or "tracks" in fault for fault in caught.value.faults)
    file = tmp_path / "x.toml"
    file.write_text('extends = "smoke"\n' + "".join(f"[[world.targets]]\nstate = {one['state']}\n" for one in targets))
    with pytest.raises(ScenarioError) as caught:
        load(str(file))
    assert [f"targets #{i}, state" in caught.value.faults[i - 1] for i in range(1, 21)] == 20 * [True]
    assert caught.value.faults[20:] == ("and 80 more",)


@pytest.mark.parametrize(
    ("key", "meant"),
    [
        ("lgs", " (did you mean legs?)"),  # in the same table
        ("x", ""),
    ],
)
def test_an_unknown_key_may_be_a_misspelt_one(key: str, meant: str) -> None:
    assert _explained(CAT | {key: 1}) == f"{key} = 1: unknown key{meant}, must be one of kind, legs, age, tame"


@pytest.mark.parametrize("document", [3, [], None, "cat"])
def test_a_document_that_is_no_table_says_so(document: Any) -> None:
    assert _explained(document) == "must be a table"


def test_a_list_never_ends_with_one_more() -> None:
    assert [listed(["a", "b", "c", "d"][:n], 2) for n in range(5)] == ["", "a", "a, b", "a, b, c", "a, b and 2 more"]


def test_printable_keeps_what_a_terminal_shows_as_it_is() -> None:
    assert printable("Größe [red] 5 km") == "Größe [red] 5 km"
    assert printable("a\nb\tc\x1b[2J\u202e") == "a?b?c?[2J?"


DOCUMENT = load("smoke").model_dump(mode="json")
VALUES: st.SearchStrategy[Any] = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20) | st.dates(),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


def _paths(value: Any) -> list[tuple[Any, ...]]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path for key, inner in items for path in ((key,), *((key, *rest) for rest in _paths(inner)))]


def _refusal(document: dict[str, Any]) -> str | None:
    try:
        parse(document, source="x.toml")
    except ScenarioError as error:
        return str(error)
    return None


@given(path=st.sampled_from(_paths(DOCUMENT)), value=VALUES, name=st.none() | st.text(max_size=8))
def test_whatever_stands_in_a_scenario_is_accepted_or_explained(
    path: tuple[Any, ...], value: Any, name: str | None
) -> None:
    """Any value at any place, or an entry more: never another exception, always one line that begins with its file."""
    document = copy.deepcopy(DOCUMENT)
    place: Any = document
    for part in path[:-1]:
        place = place[part]
    place[path[-1] if name is None or isinstance(place, list) else name] = value
    text = _refusal(document)
    assert text is None or (text.startswith("x.toml: ") and text.isprintable() and len(text) < 500)
