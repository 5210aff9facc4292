"""The grid of a sweep: what is typed, and the scenarios that it makes."""

import pytest

from services.errors import BadInput
from services.sweeps.grid import Axis, axis, variants
from shared.scenario.files import ScenarioError, load


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("radar.array.n_tx=16, 32,64", ("16", "32", "64")),
        ("radar.fidelity=paper,robust", ("paper", "robust")),
        ("title='a,b',\"c\"", ("'a,b'", '"c"')),
        ("world.targets.2.state=[60.0, 0.2, 7.5, 0.1],[70, 0, 7, 0]", ("[60.0, 0.2, 7.5, 0.1]", "[70, 0, 7, 0]")),
        ("a.b={x = 1, y = [2, 3]},4", ("{x = 1, y = [2, 3]}", "4")),
    ],
)
def test_values_are_parted_by_commas_that_are_not_their_own(text: str, values: tuple[str, ...]) -> None:
    assert axis(text) == Axis(text.partition("=")[0], values)


@pytest.mark.parametrize("text", ["radar.array.n_tx", "=1,2", "radar.array.n_tx=", "radar.array.n_tx=1,,2", "a=1,1"])
def test_what_is_no_axis_is_one_line(text: str) -> None:
    with pytest.raises(BadInput, match=r"^--over "):
        axis(text)


def test_every_combination_is_a_scenario_with_a_name_of_its_own() -> None:
    grid = variants("smoke", ["radar.array.n_rx=8"], [axis("radar.array.n_tx=8,16"), axis("dwells=20,30,40")])
    assert [variant.values for variant in grid] == [(n, t) for n in ("8", "16") for t in ("20", "30", "40")]
    assert [variant.scenario.name for variant in grid] == [f"smoke-{i}" for i in range(1, 7)]
    assert [(variant.scenario.radar.array.n_tx, variant.scenario.dwells) for variant in grid][3] == (16, 20)
    assert {variant.scenario.radar.array.n_rx for variant in grid} == {8}
    assert grid[0].scenario.world == load("smoke").world
    assert grid[3].scenario.title == "radar.array.n_tx = 16, dwells = 20"  # what report and figures say of it


def test_a_long_name_leaves_room_for_the_number() -> None:
    (variant,) = variants("smoke", ["name=a-name-of-20-letters"], [axis("dwells=20")])
    assert variant.scenario.name == "a-name-of-20-le-1"


@pytest.mark.parametrize(
    ("over", "why"),
    [
        ([], "given 0 times"),
        (["dwells=20", "seed=1", "title=x"], "given 3 times"),
        (["dwells=20", "dwells=30"], "each key once"),
        (["name=a,b"], "name: not a setting"),
        (["title=a,b"], "title: not a setting"),
        (["dwells=" + ",".join(map(str, range(1, 1002)))], "at most 1000"),
    ],
)
def test_a_grid_that_cannot_be_is_refused(over: list[str], why: str) -> None:
    with pytest.raises(BadInput, match=why):
        variants("smoke", (), [axis(text) for text in over])


def test_a_value_that_cannot_be_is_named() -> None:
    with pytest.raises(ScenarioError, match=r"^--over radar\.array\.n_tx=1: must be an integer >= 2"):
        variants("smoke", (), [axis("radar.array.n_tx=16,1")])
