"""Runs in which nobody tells the radar how many targets there are."""

from collections import defaultdict
from collections.abc import Iterable
from itertools import dropwhile

import numpy as np
import pytest
from scipy.stats import poisson

from cogradar.services.planner.core import PlannerCore
from cogradar.services.runs import in_process
from cogradar.shared.protocol.events import Membership
from cogradar.shared.protocol.messages import Message, Plan, RunEnd, RunStart, Truth
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.runner import Flush
from tests.services.loop import checkpoint, plans, play, scans, waveforms
from tests.skies import BORN_S, GONE_S, sky_start

DWELLS = 45


@pytest.fixture(scope="module")
def said() -> list[Message]:
    return play(sky_start(dwells=DWELLS))


def _by_track(said: list[Message]) -> dict[int, list[Plan]]:
    found = defaultdict[int, list[Plan]](list)
    for plan in plans(said):
        found[plan.target].append(plan)
    return found


def _followed(said: list[Message], track: list[Plan]) -> set[int]:
    """Targets within 2 km of a track's estimates."""
    truths = {truth.k: truth for truth in said if isinstance(truth, Truth)}
    found = set[int]()
    for plan in track:
        truth = truths[plan.k]
        off = truth.states[:, [0, 2]] - plan.estimate[[0, 2]]
        found |= set(np.flatnonzero((np.hypot(*off.T) < 2.0) & (truth.bins >= 0)).tolist())
    return found


def test_time_goes_on_from_the_first_dwell(said: list[Message]) -> None:
    assert [scan.t for scan in scans(said)] == list(range(1, DWELLS + 1))
    assert [end.status for end in said if isinstance(end, RunEnd)] == ["complete"]


def test_who_is_there_who_comes_and_who_goes(said: list[Message]) -> None:
    tracks = {m: list(dropwhile(lambda plan: not plan.confirmed, track)) for m, track in _by_track(said).items()}
    tracks = {m: track for m, track in tracks.items() if track}  # from when they were confirmed
    follows = {m: _followed(said, track) for m, track in tracks.items()}
    assert sorted(map(sorted, follows.values())) == [[0], [1], [2]]
    first, gone, came = (tracks[next(m for m, of in follows.items() if of == {target})] for target in range(3))
    assert first[-1].k == DWELLS - 1
    assert gone[-1].status == "ended"
    assert GONE_S < gone[-1].k < GONE_S + 25
    assert BORN_S <= came[0].k < BORN_S + 12


def test_a_track_has_a_plan_in_each_dwell_of_its_life_and_none_after(said: list[Message]) -> None:
    rosters = {scan.k: scan.roster for scan in scans(said)}
    for m, track in _by_track(said).items():
        life = [k for k, roster in rosters.items() if roster is not None and m in roster.ids]
        assert [plan.k for plan in track] == life
        assert life == list(range(life[0], life[-1] + 1))
        assert [plan.status for plan in track[:-1]] == ["tracking"] * (len(life) - 1)


def test_all_power_is_used_and_the_search_always_has_some(said: list[Message]) -> None:
    for sent in waveforms(said):
        assert float(np.sum(np.abs(sent.factor) ** 2)) == pytest.approx(1.0, rel=1e-5)
        assert sent.roster is not None
        assert sent.roster.search_share >= 0.1


def test_tracks_do_not_depend_on_who_follows_them(said: list[Message]) -> None:
    """Three planners that come and go: together they say what one says."""
    start, names = sky_start(dwells=DWELLS), ("a", "b", "c")
    workers = {name: PlannerCore(name) for name in names}
    answers = dict[tuple[int, int], Plan]()

    def take(found: Iterable[Message | Flush]) -> None:
        for one in found:
            if isinstance(one, Plan):
                assert answers.setdefault((one.k, one.target), one) == one

    for core in workers.values():
        take(core.handle(Membership("planner", names)))
        take(core.handle(checkpoint(start)))
    for scan in scans(said):
        if scan.k == 12:  # one leaves, the others take over in mid-life of tracks
            del workers["a"]
            for core in workers.values():
                take(core.handle(Membership("planner", ("b", "c"))))
        for core in workers.values():
            take(core.handle(scan))
    assert answers == {(plan.k, plan.target): plan for plan in plans(said)}


@pytest.mark.parametrize("strategy", [Strategy.ORTHOGONAL, Strategy.UNIFORM])
def test_other_strategies_find_targets_too(strategy: Strategy) -> None:
    said = play(sky_start(dwells=20, strategy=strategy))
    confirmed = [track for track in _by_track(said).values() if any(plan.confirmed for plan in track)]
    assert {target for track in confirmed for target in _followed(said, track)} >= {0, 1}


def test_a_search_in_all_directions_leaves_the_tracks_their_beams() -> None:
    said = play(sky_start("radar.search.pattern=isotropic", "radar.search.share=0.5", dwells=20))
    confirmed = [track for track in _by_track(said).values() if any(plan.confirmed for plan in track)]
    assert {target for track in confirmed for target in _followed(said, track)} >= {0, 1}
    assert any((sent.beams >= 0).any() and sent.isotropic == pytest.approx(0.5) for sent in waveforms(said))


@pytest.mark.nightly
def test_without_range_cells_false_tracks_are_as_many_as_the_radar_is_allowed() -> None:
    """All ranges are one cell, and the search's beams step on beside what they found: they must confirm nothing."""
    dwells, per_hour = 1500, 60.0
    start = sky_start("radar.fidelity=best", f"radar.initiation.false_tracks_per_hour={per_hour}", dwells=dwells)
    nobody = [target | {"born_s": 1e6, "gone_s": None} for target in start.scenario["world"]["targets"]]
    world = start.scenario["world"] | {"targets": nobody}
    found = in_process.play(start.model_copy(update={"scenario": start.scenario | {"world": world}})).picture
    low, high = poisson.interval(0.999, per_hour * dwells / 3600.0)
    assert low <= found["false_tracks_per_hour"] * dwells / 3600.0 <= high


@pytest.mark.nightly
@pytest.mark.parametrize("sky", ["crossing", "meeting"])
def test_no_track_is_captured_by_another_s_echo_where_nothing_measures_range(sky: str) -> None:
    """The paper's cells, of whole angle bins: what two targets say in one of them cannot be told apart."""
    scenario = load(sky, ["radar.fidelity=robust", "radar.tracks=2"])
    for seed in range(1, 21):
        said = play(RunStart.of(scenario, Strategy.POWER_AWARE, seed, scenario.dwells))
        truths = {truth.k: truth for truth in said if isinstance(truth, Truth)}
        for track in _by_track(said).values():
            found = [plan for plan in track if plan.status == "tracking"]
            off = np.array([(truths[plan.k].states[plan.target] - plan.estimate)[[0, 2]] for plan in found])
            assert len(found) > 100
            assert np.abs(np.diff(np.hypot(*off.T))).max() < 10.0, f"seed {seed}"
