"""The first belief of a track that nobody announced."""

import numpy as np
import pytest
from scipy.stats import kstest

from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.signal.array import spatial_frequency
from cogradar.shared.tracking.birth import born
from cogradar.shared.tracking.model import TrackerModel, TrackState

DETECTION = np.array([0.1, 22.0, 50.25, 0.102, 0.001, 0.05, 0.005, 400.0])


def _born(fidelity: str, detection: np.ndarray = DETECTION, target: int = 4) -> tuple[TrackerModel, TrackState]:
    """A track whose belief is particles."""
    settings = f"radar.fidelity={fidelity}", 'radar.tracks="unknown"', "radar.belief.filter=likelihood"
    radar = load("paper", settings).radar
    model = TrackerModel.of(radar, Strategy.POWER_AWARE, 7)
    return model, born(model, target, 9, detection)


def test_it_is_where_it_was_measured_and_flies_anywhere() -> None:
    model, state = _born("best-range")
    ranges = np.hypot(state.belief.rows[:, 0], state.belief.rows[:, 2])
    v_max = model.acquisition.v_max_km_s
    assert kstest(ranges, "uniform", args=(50.0, 0.5)).pvalue > 1e-3
    assert kstest(spatial_frequency(state.belief.rows), "norm", args=(0.102, 0.001)).pvalue > 1e-3
    for velocity in state.belief.rows[:, 1::2].T:
        assert kstest(velocity, "uniform", args=(-v_max, 2.0 * v_max)).pvalue > 1e-3
    assert (state.target, state.k) == (4, 9)
    assert state.level == pytest.approx(0.005**2 * 400.0)
    assert state.echo > 0.0


def test_without_range_cells_its_amplitude_says_how_far_it_is() -> None:
    detection = DETECTION.copy()
    detection[[2, 3]] = 0.0, 0.1  # on its axis
    model, state = _born("best", detection)
    ranges = np.hypot(state.belief.rows[:, 0], state.belief.rows[:, 2])
    expected = np.sqrt(model.sensor.amplitude / 0.05)
    assert np.median(ranges) == pytest.approx(expected, rel=0.05)


def test_it_is_a_function_of_its_number_and_its_detection() -> None:
    states = [_born("best-range", target=target)[1] for target in (4, 4, 5)]
    assert states[0].belief.rows.tobytes() == states[1].belief.rows.tobytes() != states[2].belief.rows.tobytes()
