"""The radar equation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cogradar.shared.numerics.jit import kernel
from cogradar.shared.signal.radar_equation import amplitude, amplitude_at_1_km, snr_db


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
    expected = 20.0 * np.log10(amplitude(amplitude_at_1_km(amplitude_db), range_km**2))
    assert snr_db(range_km, amplitude_db) == pytest.approx(expected, abs=1e-9)
    assert snr_db(range_km, amplitude_db) == pytest.approx(amplitude_db - 40.0 * np.log10(range_km), abs=1e-9)


def test_amplitude_falls_with_the_square_of_range() -> None:
    at_1_km = amplitude_at_1_km(60.0)
    np.testing.assert_allclose(amplitude(at_1_km, np.array([1.0, 4.0, 100.0])), [1000.0, 250.0, 10.0], rtol=1e-12)
    np.testing.assert_array_equal(amplitude(np.array([[1.0], [2.0]]), np.array([2.0, 4.0])), [[0.5, 0.25], [1.0, 0.5]])


@kernel
def _in_a_kernel(at_1_km: float, range_sq: float) -> float:
    return amplitude(at_1_km, range_sq)


@given(at_1_km=st.floats(1e-6, 1e12), range_sq=st.floats(0.0, 1e12))
def test_the_equation_is_the_same_in_kernels(at_1_km: float, range_sq: float) -> None:
    assert _in_a_kernel(at_1_km, range_sq) == amplitude(at_1_km, range_sq)


def test_a_target_over_the_array_has_a_finite_echo() -> None:
    """A target can fly there when the motion noise is 0; a range of a millimetre is short enough for it."""
    assert np.isfinite(amplitude(amplitude_at_1_km(200.0), np.array([0.0, 1e-300]))).all()
    assert np.isfinite(snr_db([0.0, 1e-200], 60.0)).all()
