"""A track out of a snapshot is the track itself: to the last bit, and so it stays."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest

from shared.protocol.admission import check_snapshot
from shared.protocol.messages import MAX_PARTICLES, Refused, Scan, Snapshot
from shared.scenario.files import load
from shared.scenario.radar_config import FIDELITY, Strategy
from shared.scenario.scenario import Scenario
from shared.tracking.track import Decision, Track
from shared.wire.codec import decode, encode

SMOKE = load("smoke")
N_BIN, TARGET, BIN, OTHER = SMOKE.radar.array.n_bin, 1, 9, 3
DWELLS, MISSES = 30, range(6, 26)  # so long a gap that the track begins again, and more than once


def _scenario(fidelity: str, n_particle: int = 500) -> Scenario:
    """The small scenario with all that a fidelity stands for; it begins again whatever the fidelity."""
    document = SMOKE.model_dump() | {"fidelity": fidelity}
    for section, settings in FIDELITY[fidelity].items():
        document[section] = document[section] | settings
    document["belief"] |= {"n_particle": n_particle, "reacquire_below": 0.1}
    return Scenario.model_validate(document)


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
        beams=np.array([-1, -1] if bin_ is None else [OTHER, bin_], dtype=np.int32),
    )


def _seen(track: Track, seed: int) -> Iterator[Scan]:
    """Scans that look where the track wants to; in the gap there is nothing, before and after it the target."""
    for k in range(2, DWELLS):
        yield _scan(k, [OTHER] if k in MISSES else [OTHER, BIN], seed, track.decide().bin if k in MISSES else BIN)


def _track(scenario: Scenario, seed: int) -> Track:
    acquisition = [_scan(k, [OTHER, BIN], seed) for k in range(2)]
    return Track(scenario, Strategy.POWER_AWARE, seed, TARGET, BIN, acquisition)


def _taken(track: Track) -> Snapshot:
    """A snapshot as it arrives."""
    snapshot = track.snapshot("r")
    assert snapshot is not None
    back = decode(encode(snapshot))
    assert isinstance(back, Snapshot)
    return back


def _same(one: Decision, other: Decision) -> bool:
    return repr(one) == repr(other) and one.estimate.tobytes() == other.estimate.tobytes()


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("fidelity", ["robust", "paper"])
def test_a_restored_track_goes_on_as_the_one_that_saw_every_scan(fidelity: str, seed: int) -> None:
    """From every dwell: after detections, in a gap before and after the track began again, and after the gap."""
    scenario, restored, attempts = _scenario(fidelity), dict[int, Track](), 0
    replayed = _track(scenario, seed)
    for scan in _seen(replayed, seed):
        replayed.observe(scan)
        for track in restored.values():
            track.observe(scan)
        restored[scan.k] = Track.restored(scenario, Strategy.POWER_AWARE, seed, _taken(replayed))
        decision, snapshot = replayed.decide(), _taken(replayed)
        attempts = max(attempts, snapshot.attempts)
        for track in restored.values():
            assert _same(track.decide(), decision)
            assert _taken(track) == snapshot  # all that it is, bit for bit
    assert attempts >= 2


def test_a_track_that_was_not_seen_for_too_long_is_restored_without_its_last_detection() -> None:
    scenario, seed = _scenario("robust"), 4
    track = _track(scenario, seed)
    for k in range(2, 110):
        track.observe(_scan(k, [OTHER], seed, BIN))
    snapshot = _taken(track)
    assert snapshot.hit_bin == -1
    restored, after = Track.restored(scenario, Strategy.POWER_AWARE, seed, snapshot), _scan(110, [], seed, BIN)
    for each in (track, restored):
        each.observe(after)
    assert _taken(restored) == _taken(track)


def test_a_snapshot_is_not_changed_by_what_the_track_sees_later() -> None:
    track = _track(_scenario("robust"), 5)
    snapshot = track.snapshot("r")
    assert snapshot is not None
    before = encode(snapshot)
    for scan in _seen(track, 5):
        track.observe(scan)
    assert encode(snapshot) == before


def test_after_a_detection_the_particles_are_said_once() -> None:
    track = _track(_scenario("robust"), 6)
    for scan in _seen(track, 6):
        track.observe(scan)
        assert _taken(track).remembered.shape[0] == (500 if scan.k in MISSES else 0)


def test_a_belief_that_is_too_large_for_a_message_has_no_snapshot() -> None:
    assert _track(_scenario("robust", MAX_PARTICLES + 1), 7).snapshot("r") is None
    assert _track(_scenario("robust", MAX_PARTICLES), 7).snapshot("r") is not None


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"target": 2}, "track 2, there are 2"),
        ({"particles": np.ones((499, 4)), "remembered": np.empty((0, 4))}, "499 particles, expected 500"),
        ({"looked": np.ones((1, N_BIN + 1))}, "grid of 17 bins, expected 16"),
    ],
)
def test_a_snapshot_of_another_scenario_is_refused(changed: dict[str, Any], reason: str) -> None:
    snapshot = _taken(_track(_scenario("robust"), 8))
    check_snapshot(snapshot, SMOKE)
    with pytest.raises(Refused, match=reason):
        check_snapshot(snapshot.model_copy(update=changed), SMOKE)
