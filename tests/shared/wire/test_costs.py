"""Any message and any scenario is read or refused within a bounded time of the processor, whatever is in it.

The time is that of this thread, on a machine on which a million turns of an empty loop take LOOP_S. Where they take
longer, because others work there, too, so may all else; MARGIN is for what this leaves out, memory and its caches.
"""

import copy
import math
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings, target
from hypothesis import strategies as st

from cogradar.shared.protocol.messages import SCHEMA, RunStart, Scan, Waveform
from cogradar.shared.protocol.roster import BIRTH, EXPECTED, Roster, announced_roster
from cogradar.shared.protocol.topics import TOPICS
from cogradar.shared.scenario.document import MAX_FILE_BYTES, MAX_TEXT, ScenarioError
from cogradar.shared.scenario.faults import MAX_EXPLAINED
from cogradar.shared.scenario.files import load, parse
from cogradar.shared.scenario.limits import MAX_CELLS, MAX_ROWS, MAX_TARGETS, MAX_TRACKS, MAX_TURNS
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.trajectories.csv_files import trajectory
from cogradar.shared.signal.array import angle_bin
from cogradar.shared.wire.codec import MAX_BYTES, BadMessage, decode, encode, split
from tests.samples import sample

MESSAGE_S, FILE_S, SCENARIO_S = 0.05, 0.05, 0.2
LOOP_S, LOOPS, TRIES, MARGIN = 0.015, 1_000_000, 3, 2.0
START = RunStart.of(load("smoke"), Strategy.POWER_AWARE, 1, None)
BODY: dict[str, Any] = msgpack.unpackb(encode(START))["body"]
TARGET: dict[str, Any] = BODY["scenario"]["world"]["targets"][0]
TURN = {"g": 1.0, "rate_deg_s": None, "speed_km_s": None}


def _cpu_s(work: Callable[[], object], enough_s: float = MESSAGE_S) -> float:
    """Time of the processor for something that is read or refused, as on the machine of LOOP_S; the best of some tries,
    of which no more are made than show that it is less than `enough_s`.
    """
    best_s = math.inf
    for _ in range(TRIES):
        best_s = min(best_s, _once_s(work) / max(1.0, _once_s(_loop) / LOOP_S) / MARGIN)
        if best_s < enough_s:
            break
    return best_s


def _loop() -> None:
    for _ in range(LOOPS):
        pass


def _once_s(work: Callable[[], object]) -> float:
    began = time.thread_time()
    with suppress(BadMessage, ScenarioError):
        work()
    return time.thread_time() - began


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
    "keys of all targets": lambda: _message(targets=[TARGET | _keys(100)] * (MAX_TARGETS - 100)),
    "wrong values": lambda: _message(targets=[{key: [] for key in TARGET} for _ in range(MAX_TARGETS)]),
    "missing values": lambda: _message(targets=[{}] * MAX_TARGETS),
    "too many targets": lambda: _message(targets=[{}] * 4_000_000),
    "nested lists": lambda: _message(targets=[[[]] * 1000] * 4000),
    "wrong rows": lambda: _message(targets=[TARGET | {"state": None, "trajectory": [["a", "b", "c"]] * 90_000}]),
    "a long key": lambda: _message(**{"k" * 4_000_000: 0}),
    "a long name": lambda: _envelope(BODY | {"run": "\u0416" * 2_000_000}),
    "arrays": lambda: msgpack.packb([msgpack.ExtType(1, b"i4\x01\0\0\0\0")] * 90_000),
    "a lot": lambda: msgpack.packb([[[None]]] * 90_000),
}


def _whole(targets: list[dict[str, Any]]) -> bytes:
    """A valid start with these targets, of which the first is there at the start."""
    document = copy.deepcopy(BODY["scenario"])
    document["world"]["targets"], document["radar"]["tracks"] = targets, 1
    return encode(START.model_copy(update={"scenario": parse(document, "here").model_dump()}))


def _rows(n: int) -> list[list[float]]:
    return [[i / 8, 40.0 + 1e-4 * i, 1.23456] for i in range(n)]


def _turns(n: int) -> list[dict[str, Any]]:
    return [{"from_s": 2.0 * i, "to_s": 2.0 * i + 1.0} | TURN for i in range(n)]


def _roster() -> Roster:
    """As many tracks as there may be."""
    rng, n = np.random.default_rng(1), MAX_TRACKS
    one = np.ones(n, np.int32)
    ids, expected = np.arange(n, dtype=np.int32), rng.uniform(0.1, 0.5, (n, EXPECTED))
    births = rng.uniform(0.1, 0.5, (n, BIRTH))
    return announced_roster(n).model_copy(
        update={"ids": ids, "confirmed": one, "born_k": one, "expected": expected, "births": births}
    )


def _looks() -> dict[str, Any]:
    """The looks of all tracks, as waveforms and scans have them."""
    nus = np.linspace(-0.5, 0.5, MAX_TRACKS * MAX_CELLS).reshape(MAX_TRACKS, MAX_CELLS)
    return {"beams": angle_bin(nus, 100).astype(np.int32), "gates": np.tile([10.0, 20.0], (MAX_TRACKS, 1)), "nus": nus}


def _waveform() -> bytes:
    looks, n_tx = _looks(), 160  # more antennas are refused with so many tracks
    factor = np.ones((n_tx, MAX_TRACKS * MAX_CELLS), np.complex64)
    sent = {"factor": factor, "shares": np.ones(looks["beams"].shape), "late": np.zeros(MAX_TRACKS, np.int32)}
    return encode(sample(Waveform).model_copy(update=looks | sent | {"roster": _roster()}))


def _scan() -> bytes:
    looks = _looks()
    rows = np.ones(MAX_TRACKS * MAX_CELLS)
    names = ("statistic", "sigma_hat", "signature_power", "limits", "ranges_km", "nu_sigmas")
    nus = looks.pop("nus")
    measured: dict[str, Any] = dict.fromkeys(names, rows)
    measured |= {"bins": looks["beams"].ravel(), "alpha_hat": rows.astype(np.complex64), "nus": nus.ravel()}
    measured |= {"nu_hats": nus.ravel(), "beam_nus": nus, "roster": _roster()}
    return encode(sample(Scan).model_copy(update=looks | measured))


VALID: dict[str, Callable[[], bytes]] = {
    "a waveform": _waveform,
    "a scan": _scan,
    "rows": lambda: _whole([TARGET | {"state": None, "trajectory": _rows(MAX_ROWS)}]),
    "targets and turns": lambda: _whole(
        [TARGET]
        + [TARGET | {"born_s": 5.0, "turns": _turns(1000)}] * (MAX_TURNS // 1000)
        + [TARGET | {"born_s": 5.0}] * (MAX_TARGETS - 1 - MAX_TURNS // 1000)
    ),
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
    "keys of tables": lambda: "".join(f"[t{i}]\nk=1\n" for i in range(7000)),
    "lines": lambda: "\n" * MAX_FILE_BYTES,
    "remarks": lambda: "#\n" * 19_000 + "k=1",
    "spaces": lambda: " " * (MAX_TEXT - 10) + "k=1",
    "a long string": lambda: 'k="' + "x" * (MAX_TEXT - 10) + '"',
    "escapes": lambda: 'k="' + "\\n" * 4000 + '"',
    "escapes in lines": lambda: 'k="""' + "\\\n   " * 4000 + '"""',
    "a long key": lambda: "k" * (MAX_TEXT - 10) + "=1",
    "rows of lists": lambda: "[a]\ntrajectory = [[" + "[]," * 100_000 + "[]]]\n",
    "rows of numbers": lambda: "[a]\ntrajectory = [[" + "1," * 400_000 + "1]]\n",
    "rows of wrong numbers": lambda: "[a]\ntrajectory = [" + "[+1,.5,1]," * 10_000 + "[1]]\n",
    "many rows": lambda: "[a]\n" + "trajectory = [[1,2,3],[2,2,3]]\n" * 2000,
    "all at once": lambda: "".join(f"[t{i}]\nk=[1,1,1]\n" for i in range(3900)) + "k=1\n" * 9000 + " " * 400_000,
    "too long": lambda: "#" * (MAX_FILE_BYTES + 1),
}


@pytest.mark.parametrize("name", MESSAGES)
def test_a_message_is_refused_soon(name: str) -> None:
    payload = MESSAGES[name]()
    assert len(payload) <= MAX_BYTES
    with pytest.raises(BadMessage) as caught:
        decode(payload)
    assert len(str(caught.value)) <= 200
    assert _cpu_s(lambda: decode(payload)) < MESSAGE_S
    assert _cpu_s(lambda: split(payload)) < MESSAGE_S


@pytest.mark.parametrize("name", VALID)
def test_the_largest_messages_are_read_soon(name: str) -> None:
    payload = VALID[name]()
    assert encode(decode(payload)) == payload
    assert _cpu_s(lambda: decode(payload)) < MESSAGE_S


@pytest.mark.parametrize("name", FILES)
def test_a_scenario_is_refused_soon(name: str, tmp_path: Path) -> None:
    path = tmp_path / "other.toml"
    path.write_text(FILES[name](), encoding="utf-8")
    with pytest.raises(ScenarioError) as caught:
        load(str(path))
    assert len(caught.value.faults) <= MAX_EXPLAINED + 1
    assert sum(map(len, caught.value.faults)) < 20_000
    assert _cpu_s(lambda: load(str(path)), SCENARIO_S) < SCENARIO_S


def test_the_largest_sky_is_read_soon(tmp_path: Path) -> None:
    """Its rows in the scenario, as `cogradar sky` writes them, or in a file beside it."""
    text = "\n".join(",".join(map(str, row)) for row in _rows(MAX_ROWS))
    (tmp_path / "flown.csv").write_text(f"t_s,x_km,y_km\n{text}\n", encoding="utf-8")
    assert _cpu_s(lambda: trajectory(tmp_path / "flown.csv", MAX_ROWS)) < FILE_S
    for name, rows in (("beside", '"flown.csv"'), ("within", str(_rows(MAX_ROWS)))):
        path = tmp_path / f"{name}.toml"
        path.write_text(f'extends = "smoke"\nradar.tracks = 1\n[[world.targets]]\ntrajectory = {rows}\n')
        (flown,) = load(str(path)).simulated.targets
        assert flown.trajectory is not None
        assert flown.trajectory.tolist() == _rows(MAX_ROWS)
        assert _cpu_s(lambda path=path: load(str(path)), SCENARIO_S) < SCENARIO_S  # type: ignore[misc]


@pytest.mark.parametrize(
    "end", ["x\n", "1,2\n", "1,2,1e999\n", f"{'9' * 5000},1,1\n", "\n" * 90_000 + "x"], ids=range(5)
)
def test_a_trajectory_that_is_wrong_at_its_end_is_refused_soon(end: str, tmp_path: Path) -> None:
    path = tmp_path / "flown.csv"
    path.write_text("t_s,x_km,y_km\n" + "".join(f"{i},1,1\n" for i in range(90_000)) + end, encoding="utf-8")
    with pytest.raises(ScenarioError):
        trajectory(path, MAX_ROWS)
    assert _cpu_s(lambda: trajectory(path, MAX_ROWS), SCENARIO_S) < SCENARIO_S


_SCALARS = st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text(max_size=5)
_VALUES = st.recursive(
    _SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=8,
)
BODIES = {topic.name: msgpack.unpackb(encode(sample(topic.message)))["body"] for topic in TOPICS}


def _paths(value: Any) -> Iterator[tuple[Any, ...]]:
    """Keys to all that is within a body."""
    for key, inner in value.items() if isinstance(value, dict) else enumerate(value if isinstance(value, list) else ()):
        yield (key,)
        yield from ((key, *rest) for rest in _paths(inner))


PLACES = [(name, place) for name, body in (BODIES | {"runstart": BODY}).items() for place in _paths(body)]


def _inflated(name: str, place: tuple[Any, ...], value: object, n: int, *, as_keys: bool) -> bytes:
    """A message with n copies of a value at a place: as a list, or as keys."""
    body: Any = copy.deepcopy(BODY if name == "runstart" else BODIES[name])
    inner = body
    for key in place[:-1]:
        inner = inner[key]
    many = {f"{i:x}": value for i in range(n)} if as_keys else [value] * n
    inner[place[-1]] = inner[place[-1]] | many if as_keys and isinstance(inner[place[-1]], dict) else many
    packed: bytes = msgpack.packb({"v": SCHEMA, "topic": name, "body": body})
    return packed


def _is_soon(place: tuple[str, tuple[Any, ...]], value: object, n: int, as_keys: bool) -> None:
    payload = _inflated(*place, value, n, as_keys=as_keys)
    if len(payload) <= MAX_BYTES:
        cpu_s = _cpu_s(lambda: decode(payload))
        target(cpu_s)
        assert cpu_s < MESSAGE_S


_DRAWN = (st.sampled_from(PLACES), _VALUES, st.sampled_from([1, 100, 1000, 20_000, 100_000]), st.booleans())
_QUIETLY = settings(deadline=None, suppress_health_check=list(HealthCheck), phases=set(Phase) - {Phase.shrink})


@settings(_QUIETLY, max_examples=30)
@given(*_DRAWN)
def test_no_message_is_dear(place: tuple[str, tuple[Any, ...]], value: object, n: int, as_keys: bool) -> None:
    _is_soon(place, value, n, as_keys)


@pytest.mark.nightly
@settings(_QUIETLY, max_examples=3000)
@given(*_DRAWN)
def test_no_message_is_dear_of_many(place: tuple[str, tuple[Any, ...]], value: object, n: int, as_keys: bool) -> None:
    _is_soon(place, value, n, as_keys)
