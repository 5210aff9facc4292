"""The radar equation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.signal.radar_equation import amplitude, snr_db


@pytest.mark.parametrize(
    ("start", "t", "expected_db"),
    [
        ((20.0, 0.05, -60.0, 0.01), 0, -12.0),
        ((20.0, 0.05, -60.0, 0.01), 300, -13.0),
        ((60.0, 0.20, 7.5, 0.10), 0, -11.3),
        ((60.0, 0.20, 7.5, 0.10), 75, -15.4),
        ((60.0, 0.20, 7.5, 0.10), 300, -24.0),
    ],
)
def test_snr_of_the_paper(start: tuple[float, float, float, float], t: float, expected_db: float) -> None:
    """Targets 1 and 2 of arXiv 2507.17506, stated there to one decimal for random flights of this mean.

    Straight flight gives -12.04, -13.02, -11.26, -15.34, -23.97: one unit of the last decimal is allowed.
    """
    x, vx, y, vy = start
    assert snr_db(np.hypot(x + vx * t, y + vy * t), 60.0) == pytest.approx(expected_db, abs=0.1)


@given(range_km=st.floats(0.01, 1e4), amplitude_db=st.floats(-100.0, 200.0))
def test_snr_is_the_amplitude_in_decibels(range_km: float, amplitude_db: float) -> None:
    assert snr_db(range_km, amplitude_db) == pytest.approx(20.0 * np.log10(amplitude(range_km, amplitude_db)), abs=1e-9)


def test_amplitude_falls_with_the_square_of_range() -> None:
    np.testing.assert_allclose(amplitude([1.0, 2.0, 10.0], 60.0), [1000.0, 250.0, 10.0], rtol=1e-12)


def test_a_target_over_the_array_has_a_finite_echo() -> None:
    """A target can fly there when the motion noise is 0; a range of a millimetre is short enough for it."""
    assert np.isfinite(amplitude([0.0, 1e-200], 200.0)).all()
    assert np.isfinite(snr_db([0.0, 1e-200], 60.0)).all()
