"""To refuse a message or a scenario takes a bounded number of steps, whatever is in it.

Steps are calls of functions, Python's and the libraries': a million take a fifth of a second. No clock is read.
"""

import copy
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgpack
import pytest
from hypothesis import HealthCheck, given, settings, target
from hypothesis import strategies as st

from cogradar.shared.protocol.messages import SCHEMA, RunStart
from cogradar.shared.scenario.document import MAX_FILE_BYTES, ScenarioError
from cogradar.shared.scenario.faults import MAX_EXPLAINED
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.codec import MAX_BYTES, MAX_LISTS, BadMessage, decode, encode, split

START = RunStart.of(load("smoke"), Strategy.POWER_AWARE, 1, None)
BODY: dict[str, Any] = msgpack.unpackb(encode(START))["body"]
TARGET: dict[str, Any] = BODY["scenario"]["world"]["targets"][0]
MOST_OF_MESSAGE, MOST_OF_FILE = 2 * MAX_LISTS + 50_000, 1_200_000


def _steps(work: Callable[[], object]) -> int:
    """Calls while something is done that is to be refused."""
    n = 0

    def count(*_: object) -> None:
        nonlocal n
        n += 1

    before = sys.getprofile()
    sys.setprofile(count)
    try:
        work()
    except (BadMessage, ScenarioError):
        pass
    finally:
        sys.setprofile(before)
    return n // 2  # a call and its return


def _message(**world: object) -> bytes:
    body = copy.deepcopy(BODY)
    body["scenario"]["world"].update(world)
    return _envelope(body)


def _envelope(body: object) -> bytes:
    packed: bytes = msgpack.packb({"v": SCHEMA, "topic": "runstart", "body": body})
    return packed


def _keys(n: int) -> dict[str, int]:
    return {f"key_{i}": 0 for i in range(n)}


MESSAGES: dict[str, Callable[[], bytes]] = {
    "keys of the body": lambda: _envelope(BODY | _keys(60_000)),
    "keys of a table": lambda: _message(**_keys(60_000)),
    "keys of all tables": lambda: _envelope(
        BODY | {"scenario": {name: _keys(100) for name in ("radar", "world", "site")}}
    ),
    "keys of all targets": lambda: _message(targets=[TARGET | _keys(100)] * 900),
    "wrong values": lambda: _message(targets=[{key: [] for key in TARGET} for _ in range(1000)]),
    "missing values": lambda: _message(targets=[{}] * 1000),
    "too many targets": lambda: _message(targets=[{}] * 4_000_000),
    "nested lists": lambda: _message(targets=[[[]] * 1000] * 4000),
    "wrong rows": lambda: _message(targets=[TARGET | {"state": None, "trajectory": [["a", "b", "c"]] * 90_000}]),
    "a long key": lambda: _message(**{"k" * 4_000_000: 0}),
    "a long name": lambda: _envelope(BODY | {"run": "\u0416" * 2_000_000}),
    "arrays": lambda: msgpack.packb([msgpack.ExtType(1, b"i4\x01\0\0\0\0")] * 90_000),
    "a lot": lambda: msgpack.packb([[[None]]] * 90_000),
}
FILES: dict[str, Callable[[], str]] = {
    "keys": lambda: "".join(f"k{i:x}=1\n" for i in range(19_000)),
    "more keys": lambda: "".join(f"k{i:x}=1\n" for i in range(60_000)),
    "keys of a table": lambda: 'extends="smoke"\n[radar]\n' + "".join(f"k{i:x}=1\n" for i in range(19_000)),
    "keys of a target": lambda: "[[world.targets]]\n" + "".join(f"k{i:x}=1\n" for i in range(19_000)),
    "numbers": lambda: "k=[" + "1," * 399_000 + "]",
    "lists": lambda: "k=[" + "[]," * 119_000 + "]",
    "parts of a key": lambda: "[a" + ".a" * 100_000 + "]",
    "tables": lambda: "[[a]]\n" * 19_000,
    "too long": lambda: "#" * (MAX_FILE_BYTES + 1),
}


@pytest.mark.parametrize("name", MESSAGES)
def test_a_message_is_refused_in_few_steps(name: str) -> None:
    payload = MESSAGES[name]()
    assert len(payload) <= MAX_BYTES
    with pytest.raises(BadMessage) as caught:
        decode(payload)
    assert len(str(caught.value)) <= 200
    assert _steps(lambda: decode(payload)) < MOST_OF_MESSAGE
    assert _steps(lambda: split(payload)) < MOST_OF_MESSAGE


@pytest.mark.parametrize("name", FILES)
def test_a_file_is_refused_in_few_steps(name: str, tmp_path: Path) -> None:
    path = tmp_path / "other.toml"
    path.write_text(FILES[name](), encoding="utf-8")
    with pytest.raises(ScenarioError) as caught:
        load(str(path))
    assert len(caught.value.faults) <= MAX_EXPLAINED + 1
    assert sum(map(len, caught.value.faults)) < 20_000
    most = MOST_OF_FILE + OF_A_VALUE * (path.read_text(encoding="utf-8").count(",") if name in ROWS else 0)
    assert _steps(lambda: load(str(path))) < most


ROWS, OF_A_VALUE = ("numbers", "lists"), 30  # which only rows of trajectories are allowed so many of

_SCALARS = st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text(max_size=5)
_VALUES = st.recursive(
    _SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=8,
)
_PLACES = [
    (),
    *((key,) for key in BODY["scenario"]),
    *((table, key) for table in ("radar", "world") for key in BODY["scenario"][table]),
    *(("world", "targets", 0, key) for key in TARGET),
]


def _inflated(place: tuple[Any, ...], value: object, n: int, *, as_keys: bool) -> bytes:
    """A start with n copies of a value at a place: as a list, or as keys."""
    body = copy.deepcopy(BODY)
    inner: Any = body["scenario"]
    for key in place[:-1]:
        inner = inner[key]
    many = {f"{i:x}": value for i in range(n)} if as_keys else [value] * n
    if place:
        inner[place[-1]] = inner[place[-1]] | many if as_keys and isinstance(inner[place[-1]], dict) else many
    else:
        body["scenario"] = many
    return _envelope(body)


@pytest.mark.nightly
@settings(max_examples=3000, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.sampled_from(_PLACES), _VALUES, st.sampled_from([1, 100, 1000, 20_000, 100_000]), st.booleans())
def test_no_start_is_dear_to_refuse(place: tuple[Any, ...], value: object, n: int, as_keys: bool) -> None:
    payload = _inflated(place, value, n, as_keys=as_keys)
    if len(payload) <= MAX_BYTES:
        steps = _steps(lambda: decode(payload))
        target(steps)
        assert steps < MOST_OF_MESSAGE
