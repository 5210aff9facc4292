"""A track made of its snapshot is the track itself, to the last bit, and stays so."""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cogradar.services.delivery.pacing import Lockstep
from cogradar.services.planner.decision import decide
from cogradar.services.planner.owned_track import OwnedTrack, detections_of, snapshot_of, state_of
from cogradar.shared.protocol.admission import check_snapshot
from cogradar.shared.protocol.fields import MAX_PARTICLES
from cogradar.shared.protocol.messages import Refused, Scan
from cogradar.shared.protocol.recovery import Snapshot
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.signal.array import bin_centres
from cogradar.shared.tracking.model import TrackerModel, TrackState
from cogradar.shared.tracking.track import observe, start
from cogradar.shared.wire.codec import decode, encode
from tests.shared.tracking.models import smoke_radar
from tests.shared.tracking.scans import BIN, N_BIN, OTHER, TARGET

DWELLS, MISSES = 30, range(6, 26)  # so long a gap that the track begins again, and more than once


class Looking:
    """A track and where it wants to look; it begins again whatever the fidelity."""

    def __init__(self, fidelity: str, seed: int, n_particle: int = 500) -> None:
        self.radar = smoke_radar(fidelity, n_particle=n_particle, reacquire_below=0.1)
        self.model = TrackerModel.of(self.radar, Strategy.POWER_AWARE, seed)
        self._seed = seed
        width = self.radar.receiver.range_cell_km
        self._scan = partial(_steered_scan, 100.5 * width) if not self.model.response.is_box else _scan
        scans = [detections_of(self.model, self._scan(k, [OTHER, BIN], seed)) for k in range(2)]
        self.state = start(self.model, TARGET, BIN, scans)

    def bin(self, state: TrackState) -> int:
        return int(decide(self.radar, self.model, state).bins[0])

    def scans(self) -> Iterator[Scan]:
        """Scans that the track observes. In the gap there is nothing where it looks, before and after it the target."""
        for k in range(2, DWELLS):
            hits, bin_ = ([], self.bin(self.state)) if k in MISSES else ([OTHER, BIN], BIN)
            scan = self._scan(k, hits, self._seed, bin_)
            self.state = observe(self.model, self.state, detections_of(self.model, scan))
            yield scan


def _scan(k: int, hits: Sequence[int], seed: int, bin_: int | None = None) -> Scan:
    """Every cell, or those of OTHER and `bin_`; `hits` have an echo. Noise is of its own in every dwell."""
    rng, cells = np.random.default_rng((seed, k)), list(range(N_BIN)) if bin_ is None else sorted({OTHER, bin_})
    n = len(cells)
    alpha_hat = np.where(np.isin(cells, hits), 1.2 + 0.1 * rng.random(n), 0.0).astype(np.complex64)
    sigma_hat = 0.08 + 0.01 * rng.random(n)
    return Scan(
        run="r",
        k=k,
        t=0 if bin_ is None else k,
        bins=np.array(cells, dtype=np.int32),
        statistic=2.0 * np.abs(alpha_hat.astype(np.complex128)) ** 2 / sigma_hat**2,
        alpha_hat=alpha_hat,
        sigma_hat=sigma_hat,
        signature_power=100.0 + rng.random(n),
        beams=np.array([-1, -1] if bin_ is None else [OTHER, bin_], dtype=np.int32)[:, np.newaxis],
    )


def _steered_scan(range_km: float, k: int, hits: Sequence[int], seed: int, bin_: int | None = None) -> Scan:
    """The same of steered cells, in the middle of the bins; `range_km` 0: without range cells."""
    scan, centres = _scan(k, hits, seed, bin_), bin_centres(N_BIN)
    nus, n = centres[scan.bins], scan.bins.size
    rng = np.random.default_rng((seed, k, 1))
    steered = {
        "nus": nus,
        "limits": np.full(n, 18.4),
        "ranges_km": np.full(n, range_km),
        "nu_hats": nus + 0.001 * rng.standard_normal(n),
        "nu_sigmas": np.full(n, 0.001),
        "beam_nus": np.where(scan.beams >= 0, centres[scan.beams], 0.0),
        "gates": np.array([[0.0, 0.0], [0.0, 0.0] if k % 2 else [49.0, 51.0]]),
    }
    return Scan.model_validate(dict(scan) | steered)


def received(state: TrackState) -> Snapshot:
    """A snapshot as it arrives."""
    back = decode(encode(snapshot_of("r", state)))
    assert isinstance(back, Snapshot)
    return back


def test_the_message_has_the_fields_of_the_state() -> None:
    assert list(Snapshot.model_fields) == ["run", *TrackState._fields, "unseen"]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("fidelity", ["robust", "paper", "best", "best-range"])
def test_a_restored_track_continues_as_the_one_that_observed_every_scan(fidelity: str, seed: int) -> None:
    """From every dwell: after detections, in a gap before and after the track began again, and after the gap."""
    replayed, restored, attempts = Looking(fidelity, seed), list[TrackState](), 0
    for scan in replayed.scans():
        restored = [observe(replayed.model, state, detections_of(replayed.model, scan)) for state in restored]
        restored.append(state_of(replayed.model, received(replayed.state)))
        attempts = max(attempts, replayed.state.attempts)
        expected, bin_ = snapshot_of("r", replayed.state), replayed.bin(replayed.state)
        for state in restored:
            assert snapshot_of("r", state) == expected
            assert replayed.bin(state) == bin_
    assert attempts >= 2


def test_a_track_that_was_missed_for_too_long_is_restored_without_its_last_detection() -> None:
    track, seed = Looking("robust", 4), 4
    state = track.state
    for k in range(2, 110):
        state = observe(track.model, state, detections_of(track.model, _scan(k, [OTHER], seed, BIN)))
    snapshot = received(state)
    assert snapshot.hit_bin == -1
    after = detections_of(track.model, _scan(110, [], seed, BIN))
    one, other = (observe(track.model, each, after) for each in (state, state_of(track.model, snapshot)))
    assert snapshot_of("r", one) == snapshot_of("r", other)


def test_after_a_detection_the_particles_are_sent_once() -> None:
    track = Looking("robust", 6)
    for scan in track.scans():
        assert received(track.state).remembered.shape[0] == (500 if scan.k in MISSES else 0)


def test_a_belief_that_is_too_large_for_a_message_has_no_snapshot(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cogradar.services.planner.owned_track.SNAPSHOT_DWELLS", 1)
    for n_particle, is_sent in ((MAX_PARTICLES + 1, False), (MAX_PARTICLES, True)):
        begun = Looking("robust", 7, n_particle)
        owned = OwnedTrack(begun.model, begun.state, since=1, pacing=Lockstep())
        owned.observe(detections_of(begun.model, _scan(2, [OTHER, BIN], 7, BIN)), begun.model)
        assert (owned.snapshot("r", acknowledged=3) is not None) == is_sent


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"target": 2}, "track 2 in dwell 1, there can be 2"),
        (
            {"belief": np.ones((499, 4)), "remembered": np.empty((0, 4))},
            r"belief of \(499, 4\) numbers, expected \(500, 4\)",
        ),
        ({"looked": np.ones((1, N_BIN + 1))}, "looks of 17 numbers and bin 9, expected 16 and one of 16 bins"),
        ({"hit_bin": N_BIN}, "looks of 16 numbers and bin 16, expected 16 and one of 16 bins"),
        ({"looked": np.full((1, N_BIN), -0.1)}, "negative standard deviation"),
    ],
)
def test_a_snapshot_of_another_scenario_is_refused(changed: dict[str, Any], reason: str) -> None:
    begun = Looking("robust", 8)
    snapshot = received(begun.state)
    check_snapshot(snapshot, begun.radar)
    with pytest.raises(Refused, match=reason):
        check_snapshot(snapshot.model_copy(update=changed), begun.radar)


@pytest.mark.parametrize("belief", [np.zeros((3, 31)), np.eye(3, 31, 6) + np.eye(3, 31)])
def test_a_snapshot_of_gaussians_that_are_none_is_refused(belief: NDArray[np.float64]) -> None:
    begun, radar = Looking("robust", 8), smoke_radar("best-range", filter="gaussian")
    changed = {"belief": belief, "remembered": np.empty((0, 4)), "looked": np.empty((0, 0))}
    with pytest.raises(Refused, match="weights of a belief must be 0 or more and sum to 1"):
        check_snapshot(received(begun.state).model_copy(update=changed), radar)
