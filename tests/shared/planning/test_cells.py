"""What a plan says of cells: chances are counts of particles, the gain is that of radar equation and detector."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from cogradar.services.planner.decision import decide
from cogradar.shared.planning.cells import (
    AHEAD,
    bin_chances,
    information_gain,
    is_astray,
    look_gain,
    most_probable_cells,
    reach,
)
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.signal.array import angle_bin, spatial_frequency
from cogradar.shared.signal.radar_equation import snr_db
from cogradar.shared.signal.receiver import noncentrality
from cogradar.shared.tracking.belief.interface import Particles
from cogradar.shared.tracking.belief.particle_filter import predict
from cogradar.shared.tracking.model import TrackerModel
from cogradar.shared.tracking.track import start
from tests.shared.tracking.models import smoke_model, smoke_radar
from tests.shared.tracking.scans import ACQUISITION, BIN, RANGE_KM, SEED, TARGET

MODEL = smoke_model("robust")
SINGLE, JOINT = (load("smoke", [f"radar.planner.looks={looks}"]).radar for looks in ("single", "joint"))
STATE = start(MODEL, TARGET, BIN, ACQUISITION)
MOTION = np.array([[1.0, 1.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0], [0.0, 0.0, 0.0, 1.0]])


def test_chances_are_shares_of_the_particles() -> None:
    moved = STATE.belief.rows @ MOTION.T
    moved[:, 0] = np.maximum(moved[:, 0], 0.0)
    bins = angle_bin(spatial_frequency(moved), MODEL.sensor.n_bin)
    expected = np.bincount(bins, minlength=MODEL.sensor.n_bin) / bins.size
    np.testing.assert_allclose(bin_chances(MODEL, STATE), expected, atol=1e-12)


def test_the_most_probable_cells_come_first_and_impossible_ones_not_at_all() -> None:
    chances = np.array([0.0, 0.2, 0.0, 0.5, 0.2, 0.1])
    assert most_probable_cells(chances, 3).tolist() == [3, 1, 4]
    assert most_probable_cells(chances, 6).tolist() == [3, 1, 4, 5]


def test_the_gain_is_the_noncentrality_per_beam_power() -> None:
    """||v||^2 = n_rx n_tx w in the cell of a beam of power w, with the disturbance level that the track remembers."""
    array, w = smoke_radar("robust").array, 0.3
    snr = 10.0 ** (snr_db(RANGE_KM, 70.0) / 10.0)
    zeta = noncentrality(snr, array.n_rx * array.n_tx * w, STATE.level)
    assert look_gain(MODEL, STATE, RANGE_KM) * w == pytest.approx(float(zeta), rel=1e-12)
    assert 0.0 < look_gain(MODEL, STATE._replace(level=0.0), 0.0) < np.inf


def test_without_an_rcs_the_gain_is_that_of_the_echoes_whatever_the_range() -> None:
    unknown = replace(MODEL, sensor=MODEL.sensor._replace(rcs="unknown"))
    state = STATE._replace(echo=(10.0 ** (70.0 / 20.0) / RANGE_KM**2) ** 2)
    expected = pytest.approx(look_gain(MODEL, STATE, RANGE_KM), rel=1e-9)
    assert [look_gain(unknown, state, range_km) for range_km in (1.0, 200.0)] == [expected, expected]


def test_joint_looks_ask_for_the_most_probable_cells_without_a_search() -> None:
    made, chances = decide(JOINT, MODEL, STATE), bin_chances(MODEL, STATE)
    assert made.n_sim == 0
    assert made.bins.tolist() == most_probable_cells(chances, 3).tolist()
    np.testing.assert_array_equal(made.chances, chances[made.bins])
    assert (made.best_bin, made.worth) == (made.bins[0], information_gain(MODEL, STATE, made.bins))


@pytest.mark.parametrize("sigma_s", [0.004, 0.1])
@pytest.mark.parametrize("n_cell", [1, 2, 3])
def test_a_look_is_worth_what_it_adds_to_the_best_guess_some_dwells_later(sigma_s: float, n_cell: int) -> None:
    """Played out: how often they guess right who are told in which of the cells it is next, and who are not."""
    rng, model = np.random.default_rng(n_cell), replace(MODEL, motion=MODEL.motion._replace(sigma_s=sigma_s))
    n = 80000
    belief = rng.normal([40.0, 0.1, 10.0, 0.2], [3.0, 0.1, 5.0, 0.1], (n, 4))
    state = STATE._replace(belief=Particles(belief))
    cells = most_probable_cells(bin_chances(model, state), n_cell)
    known = list(angle_bin(spatial_frequency(belief @ MOTION.T), model.sensor.n_bin))
    later = belief
    for _ in range(AHEAD):
        later = predict(model.motion, later, rng)
    end = list(angle_bin(spatial_frequency(later), model.sensor.n_bin))
    told = [*cells.tolist(), None]
    right = sum(
        max(
            Counter(e for k, e in zip(known, end, strict=True) if (k if k in cells else None) == one).values(),
            default=0,
        )
        for one in told
    )
    expected = (right - max(Counter(end).values())) / n
    assert information_gain(model, state, cells) == pytest.approx(expected, abs=0.02)
    assert expected > 0.03


def test_a_look_at_what_is_known_is_worth_nothing() -> None:
    known = np.tile([30.0, 0.0, 2.0, 0.0], (1000, 1))
    model = replace(MODEL, motion=MODEL.motion._replace(sigma_s=0.0))
    assert information_gain(model, STATE._replace(belief=Particles(known)), np.array([8])) == 0.0


def test_a_track_reaches_as_far_as_its_target_may_have_gone_since_its_last_detection() -> None:
    """Apart by 2 v_max per dwell: at 20 km 0.7 km are 0.26 of the 15 steps of the grid, and each dwell adds as much."""
    missed = STATE._replace(detected=False, looked=np.ones((7, MODEL.sensor.n_bin)))
    assert [reach(MODEL, STATE, km) for km in (20.0, 2.0, 0.2, 0.0)] == [1, 3, 15, 15]
    assert [reach(MODEL, missed, km) for km in (20.0, 2.0)] == [3, 15]


def test_a_track_is_astray_when_its_misses_are_improbable() -> None:
    missed = STATE._replace(detected=False, log_evidence=np.log(0.5))
    assert [is_astray(state) for state in (STATE, missed)] == [False, False]
    assert is_astray(missed._replace(log_evidence=np.log(0.05)))
    assert is_astray(missed._replace(depleted=True))
    assert is_astray(missed._replace(attempts=1))
    assert not is_astray(STATE._replace(depleted=True))  # what was detected is found


def test_who_tests_every_cell_or_asks_for_a_single_one_never_widens_a_look() -> None:
    wide = TrackerModel.of(JOINT, Strategy.UNIFORM, SEED)
    missed = STATE._replace(detected=False, depleted=True)
    everywhere = TrackerModel.of(JOINT, Strategy.ORTHOGONAL, SEED)
    made = [decide(JOINT, wide, missed), decide(JOINT, everywhere, missed), decide(SINGLE, MODEL, missed)]
    assert [(one.reach > 0, one.astray) for one in made] == [(True, True), (False, False), (False, False)]
