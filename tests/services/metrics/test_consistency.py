"""NEES in straight flight and in turns: from stored messages to what is asked, for known and unknown numbers."""

from typing import Any, get_args

import numpy as np
import pytest

from cogradar.services.errors import BadInput
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.recording import take
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.runs.in_process import play
from cogradar.services.web.schemas import ConsistencyRow, Flights
from cogradar.shared.protocol.messages import Plan, RunStart, Truth
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scoring.errors import FLIGHTS
from cogradar.shared.wire.codec import decode

DWELLS = 24
FLOWN = ((6.0, 12.0, 2.0), (12.0, 14.0, 0.5), (15.0, 20.0, -5.0))  # from and to, s; g
TURNS = f"world.targets.1.turns=[{', '.join(f'{{from_s = {a}, to_s = {b}, g = {g}}}' for a, b, g in FLOWN)}]"
WORDS = ("radar.fidelity=best-range", "world.motion.sigma_s_km_s2=0", TURNS)
UNKNOWN = 'radar.tracks="unknown"'
G = 9.80665e-3


@pytest.fixture(scope="module", params=[(), (UNKNOWN,)], ids=["known", "unknown"])
def store(request: pytest.FixtureRequest) -> Store:
    found = in_memory()
    play(RunStart.of(load("smoke", [*WORDS, *request.param]), Strategy.POWER_AWARE, 1, DWELLS), store=found)
    return found


def _messages(store: Store, kind: type[Any]) -> list[Any]:
    rows = store.read("SELECT payload FROM message WHERE topic = ? ORDER BY k", [kind.__name__.lower()])
    return [decode(row["payload"]) for row in rows]


def _expected(store: Store) -> list[tuple[int, int, float, float, float, float]]:
    """Dwell, target, acceleration in g (NaN: unknown), NEES of state, position, velocity; of targets with a track."""
    truths, plans = dict[int, Any](), dict[tuple[int, int], Any]()
    for truth in _messages(store, Truth):
        truths[truth.t] = truth.states
    for plan in _messages(store, Plan):
        plans[plan.k, plan.target + 1] = plan
    found = []
    for row in answer(store, "tracks", {}):
        if row["track"] is None:
            continue
        plan, state = plans[row["k"], row["track"]], truths[row["t"]][row["target"] - 1]
        before = truths.get(row["t"] - 1)
        change = np.nan if before is None else np.linalg.norm(state[1::2] - before[row["target"] - 1, 1::2]) / G
        error = plan.estimate - state
        parts = [
            error[kept] @ np.linalg.inv(plan.covariance[np.ix_(kept, kept)]) @ error[kept]
            for kept in ([0, 1, 2, 3], [0, 2], [1, 3])
        ]
        found.append((row["t"], row["target"], float(change), *parts))
    return found


@pytest.mark.parametrize("asked", [{}, {"target": "1"}, {"dwells": "7:18"}])
def test_rows_are_the_means_of_the_tracks_that_follow(asked: dict[str, str], store: Store) -> None:
    first, last = map(int, asked.get("dwells", f"1:{DWELLS}").split(":"))
    own = [e for e in _expected(store) if first <= e[0] <= last and str(e[1]) == asked.get("target", str(e[1]))]
    ends = {
        "all": (-np.inf, np.inf),
        "straight": (0.0, 0.1),
        "0.1-1 g": (0.1, 1.0),
        "1-3 g": (1.0, 3.0),
        "over 3 g": (3.0, np.inf),
    }
    rows = answer(store, "consistency", asked)
    assert [row["flight"] for row in rows] == list(ends)
    for row in rows:
        low, high = ends[row["flight"]]
        flown = np.array([e[3:] for e in own if row["flight"] == "all" or low <= e[2] < high]).reshape(-1, 3)
        assert row["n"] == len(flown) > 0
        for name, mean in zip(("nees", "nees_position", "nees_velocity"), flown.mean(axis=0), strict=True):
            assert row[name] == pytest.approx(mean, rel=1e-6)
        assert row["beyond_99"] == np.mean(flown[:, 0] > 13.2767)
        assert (row["first_dwell"], row["last_dwell"], row["runs"]) == (first, last, 1)
        ConsistencyRow.model_validate(row)


def test_a_campaign_s_store_says_the_same(store: Store) -> None:
    (row,) = store.read("SELECT run FROM run")
    kept, recording = in_memory(), take(store, row["run"])
    assert recording is not None
    kept.journal.add_recording(recording, 1)
    assert answer(kept, "consistency", {}) == answer(store, "consistency", {})
    assert answer(store, "consistency", {"offset": "1", "limit": "2"}) == answer(store, "consistency", {})[1:3]


def test_a_target_that_never_turns_has_no_row_of_turns(store: Store) -> None:
    of_turns = answer(store, "consistency", {"target": "2"})[2:]
    assert [(row["n"], row["nees"], row["beyond_99"]) for row in of_turns] == 3 * [(0, None, None)]


def test_the_description_names_the_flights() -> None:
    assert get_args(Flights) == tuple(flight.name for flight in FLIGHTS)


def test_without_truth_nobody_knows(store: Store) -> None:
    scenario = load("smoke", ["radar.fidelity=best-range"]).model_copy(update={"world": None})
    store = in_memory()
    store.journal.add_run(RunStart.of(scenario, Strategy.UNIFORM, 1, 5))
    with pytest.raises(BadInput, match="no truth to compare with, so consistency is unknown"):
        answer(store, "consistency", {"run": "all"})
