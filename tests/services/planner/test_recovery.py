"""A track that is on the wrong bin, in the loop of the real cores: who finds its target again, and at what price."""

import tomllib

import numpy as np
import pytest

from cogradar.services.allocator.track_update import unchanged
from cogradar.services.allocator.waveform import waveform
from cogradar.services.emulator.core import EmulatorCore
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.services.planner.decision import Decision, decide
from cogradar.services.planner.owned_track import detections_of
from cogradar.shared.protocol.messages import Plan, RunStart, Scan, Truth
from cogradar.shared.scenario.files import SCENARIO_DIR, parse
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.signal.array import angle_bin, spatial_frequency
from cogradar.shared.tracking.acquisition import Candidates
from cogradar.shared.tracking.belief.interface import Particles
from cogradar.shared.tracking.model import TrackerModel, TrackState
from cogradar.shared.tracking.track import observe, start
from tests.services.loop import checkpoint

MISLED_AT, DWELLS = 20, 60


def scenario(fidelity: str, **belief: float) -> Scenario:
    """The paper's radar and targets, with less to compute."""
    document = tomllib.loads((SCENARIO_DIR / "paper.toml").read_text(encoding="utf-8"))
    document["radar"]["fidelity"] = fidelity
    document["radar"]["belief"] |= {"n_particle": 1000} | belief
    document["radar"]["planner"] |= {"n_sim": 1000}
    return parse(document, source="paper")


class Loop:
    """Emulator, tracks and allocation, dwell by dwell; `off` says by how many bins each track asked wrongly."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        self.radar, self._strategy = scenario.radar, Strategy.POWER_AWARE
        self._model = TrackerModel.of(self.radar, self._strategy, seed)
        self._emulator = EmulatorCore(SimulatedFrontEnd.open)
        begin = RunStart(
            run="r", scenario=scenario.model_dump(), strategy=self._strategy, seed=seed, dwells=DWELLS + MISLED_AT
        )
        scan, truth = self._emulator.handle(checkpoint(begin))
        scans = []
        while True:
            assert isinstance(scan, Scan)
            assert isinstance(truth, Truth)
            scans.append(detections_of(self._model, scan))
            if (bins := Candidates(self._model, scans).bins()) is not None:
                break
            searching = [Plan(run="r", k=scan.k, t=0, target=m, status="searching") for m in range(3)]
            scan, truth = self._emulator.handle(
                waveform(self.radar, self._strategy, unchanged(searching, searching[0].k))
            )
        self._k = scan.k
        self.tracks = [start(self._model, m, int(bins[m]), scans) for m in range(3)]
        # Tracks are in the order of their bins.
        self._target = np.argsort(truth.bins)
        self.off: list[list[int]] = []
        self.depleted: list[list[bool]] = []

    def dwell(self) -> None:
        decisions = [decide(self.radar, self._model, track) for track in self.tracks]
        plans = [self._plan(m, decision) for m, decision in enumerate(decisions)]
        scan, truth = self._emulator.handle(waveform(self.radar, self._strategy, unchanged(plans, plans[0].k)))
        assert isinstance(scan, Scan)
        assert isinstance(truth, Truth)
        self.tracks = [observe(self._model, track, detections_of(self._model, scan)) for track in self.tracks]
        self._k = scan.k
        self.off.append([int(d.bins[0] - b) for d, b in zip(decisions, truth.bins[self._target], strict=True)])
        self.depleted.append([track.depleted for track in self.tracks])

    def _plan(self, target: int, decision: Decision) -> Plan:
        return Plan(
            run="r",
            k=self._k,
            t=0,
            target=target,
            status="tracking",
            **(vars(decision) | {"n_sim": 0}),
        )


def misled(track: TrackState, n_bin: int, by: int) -> TrackState:
    """The belief turned by some bins, its velocities away from the target; range and spread stay."""
    x, y = track.belief.rows[:, 0], track.belief.rows[:, 2]
    centre = angle_bin(spatial_frequency(track.belief.rows), n_bin) + by
    nu = spatial_frequency(track.belief.rows) + by / (n_bin - 1)
    theta, r = np.arcsin(2.0 * np.clip(nu, -0.5, 0.5)), np.hypot(x, y)
    assert (centre >= 0).all()
    assert (centre < n_bin).all()
    vy = np.full_like(x, 0.1 * np.sign(by))
    return track._replace(belief=Particles(np.column_stack((r * np.cos(theta), 0 * x, r * np.sin(theta), vy))))


def play_misled(scenario: Scenario, by: int, seed: int) -> Loop:
    loop = Loop(scenario, seed)
    for _ in range(MISLED_AT):
        loop.dwell()
    loop.tracks[1] = misled(loop.tracks[1], scenario.radar.array.n_bin, by)
    for _ in range(DWELLS):
        loop.dwell()
    return loop


def dwells_until_found(scenario: Scenario, by: int) -> int:
    off = np.array(play_misled(scenario, by, seed=3).off)[:, 1]
    assert np.mean(off[MISLED_AT - 5 : MISLED_AT] == 0) >= 0.8
    assert off[MISLED_AT] == by
    found = np.flatnonzero(off[MISLED_AT:] == 0)
    return int(found[0]) if found.size else DWELLS


@pytest.mark.slow
@pytest.mark.parametrize("by", [-4, 4])
def test_a_misled_track_comes_back_at_once_and_only_by_beginning_again(by: int) -> None:
    """Four bins off, with velocities that lead away: at P_D near 1 each look at a wrong bin says all about it."""
    assert dwells_until_found(scenario("robust"), by) <= 3  # 2 and 1; the others 60, 60 and 20, 13
    assert dwells_until_found(scenario("robust", reacquire_below=0.0), by) > 10
    assert dwells_until_found(scenario("paper"), by) > 10


@pytest.mark.parametrize("target", range(3))
def test_a_track_that_never_doubts_is_the_same_to_the_last_bit(target: int) -> None:
    """Nothing is drawn for a re-acquisition that does not happen."""
    with_it, without = Loop(scenario("robust"), seed=3), Loop(scenario("robust", reacquire_below=0.0), seed=3)
    for _ in range(8):
        with_it.dwell()
        without.dwell()
    assert not np.any(with_it.depleted)
    np.testing.assert_array_equal(with_it.tracks[target].belief.rows, without.tracks[target].belief.rows)
