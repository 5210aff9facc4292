"""What a scan tells one track: whose detection it is, and with which noise a miss is read."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.signal.array import bin_centres
from cogradar.shared.signal.scan import Detections
from cogradar.shared.tracking.association import assigned_tracks, associate, expected_sigma
from cogradar.shared.tracking.belief.interface import Particles
from cogradar.shared.tracking.belief.likelihood import Looks
from cogradar.shared.tracking.model import TrackerModel, TrackState
from cogradar.shared.tracking.sensor import MAX_AMPLITUDE
from cogradar.shared.tracking.track import observe, start
from tests.shared.tracking.models import sigma_of_bins, smoke_model
from tests.shared.tracking.scans import ACQUISITION, BIN, HIT, LAST, N_BIN, OTHER, TARGET, scan_of, with_beams

ORTHOGONAL = smoke_model("robust", Strategy.ORTHOGONAL)
ADAPTIVE = smoke_model("robust")
NOISE = np.linspace(0.02, 0.17, N_BIN)  # sigma_hat of each cell
GATE = 2


def started(model: TrackerModel, target: int = TARGET) -> TrackState:
    return start(model, target, (OTHER, BIN)[target], ACQUISITION)


def focused(model: TrackerModel) -> TrackState:
    """After a detection in a beam."""
    return observe(model, started(model), HIT)


def scan(*detected: int, beams: tuple[int, int] = (OTHER, BIN)) -> Detections:
    """All cells, each with noise of its own, whoever asked for what."""
    whole = scan_of(LAST + 1, detected, power=16.0, sigma_hat=0.1)
    return with_beams(whole._replace(sigma_hat=NOISE), np.array(beams, dtype=np.int32)[:, np.newaxis])


def told(model: TrackerModel, state: TrackState, seen: Detections) -> tuple[Looks, float]:
    """The looks of a track, and ||v||^2 of its look."""
    return associate(model, state, seen)[:2]


def bins_of(cells: NDArray[np.float64]) -> list[int]:
    return np.flatnonzero(cells).tolist()


def all_but(*bins: int) -> list[int]:
    return [b for b in range(N_BIN) if b not in bins]


# Whose detection it is.


@pytest.mark.parametrize(
    ("bins", "beams", "expected"),
    [
        ([3, 9], [3, 9], [0, 1]),
        ([9], [3, 9], [1]),
        ([4], [4, 4], [0]),  # the lower track of two that asked for one bin
        ([4, 5], [4, 4], [0, 1]),  # ... and the other one gets the next
        ([6, 90], [4, 6], [1, 0]),  # closest pairs first; that 90 is far from 4 is for the gate to say
        ([5, 7], [4, 6], [0, 1]),
        ([1, 2, 3], [2], [-1, 0, -1]),
        ([], [3, 9], []),
        ([2], [-1, 7], [1]),  # a track that asked for nothing is near to nothing
        ([2, 3], [7, -1], [-1, 0]),
    ],
)
def test_detections_are_assigned_one_to_one(bins: list[int], beams: list[int], expected: list[int]) -> None:
    assert assigned_tracks(np.array(bins, np.int32), np.array(beams, np.int32)).tolist() == expected


@given(
    bins=st.lists(st.integers(0, 99), unique=True, max_size=8),
    beams=st.lists(st.integers(0, 99), min_size=1, max_size=6),
)
def test_no_pair_is_left_that_is_closer_than_those_of_both(bins: list[int], beams: list[int]) -> None:
    tracks = assigned_tracks(np.array(sorted(bins), np.int32), np.array(beams, np.int32))
    given_away = [m for m in tracks.tolist() if m >= 0]
    assert len(given_away) == len(set(given_away)) == min(len(bins), len(beams))
    detection_of = {m: i for i, m in enumerate(tracks.tolist())}
    for i, b in enumerate(sorted(bins)):
        for m, beam in enumerate(beams):
            mine = abs(b - beams[tracks[i]]) if tracks[i] >= 0 else np.inf
            its = abs(sorted(bins)[detection_of[m]] - beam) if m in detection_of else np.inf
            assert abs(b - beam) >= min(mine, its)


def test_each_track_takes_its_own_and_the_other_says_nothing() -> None:
    for target, own in ((0, OTHER), (1, BIN)):
        observation, power = told(ORTHOGONAL, started(ORTHOGONAL, target), scan(OTHER, BIN))
        assert observation.hit_bin == own
        assert bins_of(sigma_of_bins(observation)) == all_but(OTHER + BIN - own)
        assert power == 16.0


def test_a_detection_that_belongs_to_another_track_is_neither_a_hit_nor_a_miss() -> None:
    """Both believe their target in BIN; only track 0 gets the detection, and track 1 keeps its particles there."""
    both_there = scan(BIN, beams=(BIN, BIN))
    second = started(ORTHOGONAL)
    first = second._replace(target=0)
    assert told(ORTHOGONAL, first, both_there)[0].hit_bin == BIN
    observation, _ = told(ORTHOGONAL, second, both_there)
    assert observation.hit_bin == -1
    assert bins_of(sigma_of_bins(observation)) == all_but(BIN)
    after = observe(ORTHOGONAL, second, both_there)
    assert not after.detected
    assert not after.depleted


@pytest.mark.parametrize("off", range(-4, 5))
def test_a_detection_in_the_gate_redraws_and_one_beyond_is_a_false_alarm(off: int) -> None:
    """All particles are in BIN or move into a neighbour; an adaptive track would look up to two bins further."""
    assert ORTHOGONAL.gate_bins == GATE
    state = started(ORTHOGONAL)
    state = state._replace(belief=Particles(state.belief.rows * [1.0, 0.0, 1.0, 0.0]))
    after = observe(ORTHOGONAL, state, scan(OTHER, BIN + off))
    assert after.detected == (abs(off) <= GATE)
    assert after.depleted == (off != 0)  # beyond the gate: a miss of 500 particles that are sure to be detected


def test_two_tracks_never_have_one_detection() -> None:
    rng = np.random.default_rng(3)
    tracks = [started(ORTHOGONAL, target) for target in range(2)]
    for _ in range(200):
        detected = rng.choice(N_BIN, rng.integers(0, 6), replace=False)
        beams = tuple(rng.integers(0, N_BIN, 2).tolist())
        made = [told(ORTHOGONAL, track, scan(*detected, beams=beams))[0].hit_bin for track in tracks]
        assert made[0] != made[1] or made[0] == -1


def test_before_anybody_asked_a_track_takes_the_detection_that_it_expects_most() -> None:
    """In real time there may be one more scan of the acquisition after the tracks have begun, whatever the strategy."""
    for model in (ORTHOGONAL, ADAPTIVE):
        track = started(model)
        assert told(model, track, scan(OTHER, BIN, beams=(-1, -1)))[0].hit_bin == BIN
        assert told(model, track, scan(OTHER, beams=(-1, -1)))[0].hit_bin == -1
        assert told(model, track, scan(beams=(-1, -1)))[0].hit_bin == -1


def test_the_rule_is_the_strategys_and_not_a_question_of_how_many_cells_were_tested() -> None:
    """An adaptive track is told of its own cell, also if the others' beams happen to cover the grid."""
    observation, _ = told(ADAPTIVE, started(ADAPTIVE), scan(BIN + 1))
    assert observation.hit_bin == -1
    assert bins_of(sigma_of_bins(observation)) == [BIN]


# Lists of cells.


def lists(*beams: list[int]) -> NDArray[np.int32]:
    return np.array(beams, dtype=np.int32)


@pytest.mark.parametrize(
    ("first", "second", "detected", "expected"),
    [
        ([4, 5, 6, 7, 8, 9], [9, 8, -1, -1, -1, -1], 9, (-1, 9)),  # 4's look reaches over the cell of the other target
        ([4, 5, 6, 7, 8, 9], [9, 8, -1, -1, -1, -1], 7, (7, -1)),  # a cell that nobody else has
        ([4, 5, 6], [7, 6, 5], 5, (5, -1)),
        ([4, 5, 6], [6, 5, 4], 5, (5, 5)),  # as near to both: they share it
        ([5, 4, 6], [5, 6, -1], 6, (6, 6)),
    ],
)
def test_a_widened_look_is_not_captured_by_the_target_of_a_nearer_track(
    first: list[int], second: list[int], detected: int, expected: tuple[int, int]
) -> None:
    wide = replace(ADAPTIVE, wide_looks=True)
    cells = with_beams(scan(detected), lists(first, second))
    for target, hit in enumerate(expected):
        observation, _ = told(wide, started(wide, target), cells)
        assert observation.hit_bin == hit
        own = (first, second)[target]
        missed = [b for b in own if b >= 0 and b != detected]
        assert bins_of(sigma_of_bins(observation)) == sorted(missed + [hit] * (hit >= 0))


@pytest.mark.parametrize(
    ("detected", "hit", "missed"),
    [
        ((), -1, [BIN - 1, BIN, BIN + 1]),
        ((BIN,), BIN, [BIN - 1, BIN + 1]),
        ((BIN - 1,), BIN - 1, [BIN, BIN + 1]),
        ((BIN - 1, BIN), BIN, [BIN + 1]),  # of two detections the more probable one; the other's cell tells nothing
        ((OTHER,), -1, [BIN - 1, BIN, BIN + 1]),
    ],
)
def test_a_track_observes_the_cells_that_were_lit_for_it(
    detected: tuple[int, ...], hit: int, missed: list[int]
) -> None:
    beams = lists([OTHER, -1, -1], [BIN, BIN + 1, BIN - 1])  # the brightest first, whatever its number
    observation, power = told(ADAPTIVE, started(ADAPTIVE), with_beams(scan(*detected), beams))
    assert observation.hit_bin == hit
    assert bins_of(sigma_of_bins(observation)) == sorted([*missed, *([hit] if hit >= 0 else [])])
    assert power == 16.0


def test_of_two_detections_that_of_the_expected_amplitude_is_the_tracks() -> None:
    """An aircraft three times as far off is in the more probable bin; the track's own is at 50 km in the next one."""
    state, beams = started(ADAPTIVE), lists([OTHER, -1], [BIN, BIN + 1])
    split = state.belief.rows.copy()
    split[::3, 0::2] = bearing_of(BIN + 1, np.hypot(split[::3, 0], split[::3, 2]))
    seen = with_beams(scan(BIN, BIN + 1), beams)._replace(sigma_hat=np.full(N_BIN, 0.1))
    strength = np.where(seen.bins == BIN, 1.0 / 9.0, 1.0)
    weak = seen._replace(alpha_hat=(seen.alpha_hat * strength).astype(np.complex64))
    for cells, hit in ((seen, BIN), (weak, BIN + 1)):
        assert told(ADAPTIVE, state._replace(belief=Particles(split)), cells)[0].hit_bin == hit


def test_of_amplitudes_that_nobody_explains_the_more_probable_bin_counts() -> None:
    beams = lists([OTHER, -1], [BIN, BIN - 1])
    seen = with_beams(scan(BIN - 1, BIN), beams)._replace(sigma_hat=np.full(N_BIN, 1e-6))
    assert told(ADAPTIVE, started(ADAPTIVE), seen)[0].hit_bin == BIN


def bearing_of(bin_: int, range_km: NDArray[np.float64]) -> NDArray[np.float64]:
    """Positions in the middle of a bin, (n, 2) km."""
    theta = np.arcsin(2.0 * bin_centres(N_BIN)[bin_])
    return np.asarray(range_km[:, np.newaxis] * np.array([np.cos(theta), np.sin(theta)]))


# Noise of a miss.


@pytest.mark.parametrize(
    ("fidelity", "strategy", "expected"),
    [
        ("robust", Strategy.ORTHOGONAL, NOISE),
        ("paper", Strategy.ORTHOGONAL, NOISE),
        ("robust", Strategy.UNIFORM, np.where(np.arange(N_BIN) == BIN, NOISE, 0.0)),
        ("paper", Strategy.UNIFORM, np.where(np.arange(N_BIN) == BIN, 0.09, 0.0)),  # of the last detection
    ],
)
def test_a_miss_is_read_with_the_noise_of_its_cell(
    fidelity: str, strategy: Strategy, expected: NDArray[np.float64]
) -> None:
    model = smoke_model(fidelity, strategy)
    observation, _ = told(model, focused(model), scan())
    np.testing.assert_array_equal(sigma_of_bins(observation), expected)


@pytest.mark.parametrize(("fidelity", "sigma"), [("paper", 0.09), ("robust", 0.09 * np.sqrt(128.0 / 4.0))])
def test_where_the_receiver_has_no_estimate_the_memory_does(fidelity: str, sigma: float) -> None:
    model = smoke_model(fidelity)
    blind = scan()._replace(sigma_hat=np.zeros(N_BIN), signature_power=np.full(N_BIN, 4.0))
    observation, _ = told(model, focused(model), blind)
    assert sigma_of_bins(observation)[BIN] == pytest.approx(sigma, rel=1e-12)


@pytest.mark.parametrize(("own", "sigma"), [(NOISE, NOISE[BIN]), (np.zeros(N_BIN), 0.25 * np.sqrt(16.0 / 128.0))])
def test_the_noise_of_the_acquisition_is_no_beams(own: NDArray[np.float64], sigma: float) -> None:
    """The paper's memory, before a detection in a beam: the receiver's own estimate; without one, for the beam sent."""
    model = smoke_model("paper")
    missed = scan()._replace(sigma_hat=own, signature_power=np.full(N_BIN, 128.0))
    observation, _ = told(model, started(model), missed)
    assert sigma_of_bins(observation)[BIN] == pytest.approx(sigma, rel=1e-12)
    assert expected_sigma(model, started(model), 128.0) == pytest.approx(0.25 * np.sqrt(16.0 / 128.0), rel=1e-12)
    assert expected_sigma(model, focused(model), 4.0) == pytest.approx(0.09, rel=1e-12)


@pytest.mark.parametrize("power", [4.0, 16.0])
def test_the_noise_of_a_weak_beam_is_a_beams(power: float) -> None:
    """A near target's beam may have less power on it than the acquisition, 16."""
    model = smoke_model("paper")
    weak = scan_of(LAST + 1, [OTHER, BIN], power=power, sigma_hat=0.13, beams=[OTHER, BIN])
    after = observe(model, started(model), weak)
    assert after.in_beam
    assert sigma_of_bins(told(model, after, scan())[0])[BIN] == pytest.approx(0.13, rel=1e-12)
    assert expected_sigma(model, after, 4.0 * power) == pytest.approx(0.13, rel=1e-12)
    # A miss leaves it as it is, and one more scan of the acquisition is no beam.
    assert observe(model, after, scan_of(LAST + 2, [OTHER], power, 0.5, beams=[OTHER, BIN])).in_beam
    assert not observe(model, after, ACQUISITION[0]._replace(k=LAST + 2)).in_beam


def test_an_amplitude_is_counted_in_the_noise_of_its_cell() -> None:
    observation, _ = told(ORTHOGONAL, started(ORTHOGONAL), scan(BIN))
    expected = np.float32(10.0 ** (70.0 / 20.0) / 50.0**2) / NOISE[BIN]
    assert observation.amplitude == pytest.approx(expected, rel=1e-12)
    nothing_to_compare_with = scan(BIN)._replace(sigma_hat=np.full(N_BIN, 1e-300))
    assert told(ORTHOGONAL, started(ORTHOGONAL), nothing_to_compare_with)[0].amplitude == MAX_AMPLITUDE
