"""A whole run whose radar is not told how many targets there are: from the journal to scores, and played again."""

from collections import defaultdict
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest

from cogradar.services.analysis.replay import CORES, Replay, replay
from cogradar.services.analysis.stored_run import StoredRun
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.runs import in_process
from cogradar.services.runs.run import Result
from cogradar.shared.protocol.messages import Plan, Scan, Truth
from cogradar.shared.wire.codec import decode
from tests.oracles import stone_soup
from tests.skies import BORN_S, GONE_S, sky_start

DWELLS = 40
Messages = dict[tuple[str, int, int], Any]  # by topic, dwell k, and track from 0 of a plan


@pytest.fixture(scope="module")
def played() -> Iterator[tuple[Store, Result]]:
    store = in_memory()
    yield store, in_process.play(sky_start(dwells=DWELLS), store=store)
    store.close()


@pytest.fixture(scope="module")
def messages(played: tuple[Store, Result]) -> Messages:
    stored = [decode(row["payload"]) for row in played[0].read("SELECT payload FROM message")]
    return {
        (type(m).__name__, m.k, m.target if isinstance(m, Plan) else 0): m
        for m in stored
        if isinstance(m, Plan | Scan | Truth)
    }


def _confirmed(messages: Messages) -> list[Plan]:
    plans = [message for message in messages.values() if isinstance(message, Plan)]
    return [plan for plan in plans if plan.confirmed and plan.status == "tracking"]


def test_its_targets_come_are_followed_and_go(played: tuple[Store, Result]) -> None:
    stays, goes, comes = played[1].as_json()["targets"]
    assert [(one["born_t"], one["gone_t"]) for one in (stays, goes, comes)] == [
        *((1, None), (1, GONE_S + 1), (BORN_S, None)),
    ]
    for one in (stays, goes, comes):
        assert one["born_t"] < one["confirmed_t"] < one["born_t"] + 10
        assert one["p_d"] > 0.8
        assert one["position_rmse_km"] < 1.0
        assert (one["lost"], one["outage_longest"]) == (False, pytest.approx(0, abs=2))
    assert played[1].run["tracks"] is None


def test_each_row_is_of_a_confirmed_track_near_its_target(played: tuple[Store, Result], messages: Messages) -> None:
    rows = answer(played[0], "tracks", {})
    assert len(rows) == 3 * DWELLS
    for row in (row for row in rows if row["track"] is not None):
        plan, scan = messages["Plan", row["k"], row["track"] - 1], messages["Scan", row["k"], 0]
        assert plan.confirmed
        assert row["x_hat"] == plan.estimate[0]
        assert np.hypot(row["x"] - row["x_hat"], row["y"] - row["y_hat"]) < 5.0
        place = scan.roster.ids.tolist().index(plan.target)
        assert [bin_ for bin_, _ in row["cells"]] == scan.beams[place][scan.beams[place] >= 0].tolist()
    shown = {(row["k"], row["track"] - 1) for row in rows if row["track"] is not None}
    assert shown <= {(plan.k, plan.target) for plan in _confirmed(messages)}
    # Two beams sweep 16 bins in 8 dwells: each target has a track within a sweep and a dwell.
    there = [DWELLS, int(GONE_S), DWELLS - int(BORN_S)]
    assert len(shown) >= sum(dwells - 9 for dwells in there) > DWELLS


def test_its_figures_are_those_of_stone_soup(played: tuple[Store, Result], messages: Messages) -> None:
    """Of confirmed tracks; all targets are near enough to count from their first dwell on."""
    tracks, truths = defaultdict[int, dict[int, Any]](dict), defaultdict[int, dict[int, Any]](dict)
    for plan in _confirmed(messages):
        tracks[plan.target][plan.t] = plan.estimate
    for truth in (message for message in messages.values() if isinstance(message, Truth)):
        for target in np.flatnonzero(truth.bins >= 0).tolist():
            truths[target][truth.t] = truth.states[target]
    theirs, rows = stone_soup.metrics(tracks, truths), answer(played[0], "pictures", {})
    for name in ("localisation", "missed", "false", "ospa"):
        assert [row[f"{name}_km2"] for row in rows] == pytest.approx(getattr(theirs, name), abs=1e-6)
    for name in ("completeness", "ambiguity", "spuriousness"):
        assert played[1].picture[name] == pytest.approx(getattr(theirs, name), abs=1e-6)


@pytest.mark.parametrize("to", CORES)
def test_it_replays_clean(to: str, played: tuple[Store, Result], messages: Messages) -> None:
    plans = sum(isinstance(message, Plan) for message in messages.values())
    outcome = replay(StoredRun(partial(answer, played[0])), to)
    assert outcome == Replay(agreed=plans if to == "planner" else DWELLS)
