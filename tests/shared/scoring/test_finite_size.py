"""Moments at finite size against covariance matrices written out, and against simulation in test_detection.py."""

import numpy as np
import pytest
from numpy.typing import NDArray

from cogradar.shared.scoring.finite_size import finite_size
from cogradar.shared.signal.receiver import detection_probability, n_lag
from cogradar.shared.world.disturbance import power_spectrum

GRID = np.arange(4096) / 4096


def covariance(model: str, n: int) -> NDArray[np.complex128]:
    """Gamma_ij = r_{i-j}, r_m = int S_c e^{j 2 pi nu m} dnu by the mean over a fine grid."""
    lag = np.subtract.outer(np.arange(n), np.arange(n))
    r = np.array([np.mean(power_spectrum(model, GRID) * np.exp(2j * np.pi * GRID * m)) for m in range(n)])
    return np.asarray(np.where(lag >= 0, r[np.abs(lag)], r[np.abs(lag)].conj()), dtype=np.complex128)


def signature(nu: float, n_tx: int, n_rx: int) -> NDArray[np.complex128]:
    a = np.exp(2j * np.pi * nu * np.arange(max(n_tx, n_rx)))
    return np.kron(a[:n_tx], a[:n_rx]).astype(np.complex128)


@pytest.mark.parametrize("model", ["ar6-t", "ar3-t", "white"])
@pytest.mark.parametrize("nu", [-0.36, 0.0, 0.21])
def test_means_are_quadratic_forms_of_the_covariance(model: str, nu: float) -> None:
    v = signature(nu, 6, 8)
    n, lags = v.size, n_lag(v.size)
    gamma, power = covariance(model, n), float(np.vdot(v, v).real)
    lag = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    result = finite_size(model, nu, v)
    assert result.level == pytest.approx(float(np.vdot(v, gamma @ v).real) / power, rel=1e-9)
    band = float(np.vdot(v, np.where(lag <= lags, gamma, 0.0) @ v).real) / power
    assert result.band_mean == pytest.approx(band * (1.0 - (2 * lags + 1) / n), rel=1e-9)


def test_white_disturbance_has_the_spread_of_2l_independent_products() -> None:
    # S_c = 1: var[B]/||v||^4 = (1/N) int (D_l - 1)^2 = 2l/N, and the mean is 1: the power, lag 0, is normalised.
    v = signature(0.1, 16, 16)
    result = finite_size("white", 0.1, v)
    assert result.band_spread == pytest.approx(np.sqrt(2 * n_lag(256) / 256), rel=1e-9)


def test_false_alarms_tend_to_the_closed_form() -> None:
    exact = finite_size("white", 0.0, signature(0.0, 2, 2))._replace(band_mean=1.0, band_spread=0.0, level=1.0)
    assert exact.false_alarm_probability(1e-4) == pytest.approx(1e-4, rel=1e-12)
    # E[exp(-t (1 + s x))] of a standard normal x, by quadrature.
    x, w = np.polynomial.hermite_e.hermegauss(40)
    t = -np.log(1e-3)
    expected = float(w @ np.exp(-t * (1.0 + 0.05 * x)) / w.sum())
    assert exact._replace(band_spread=0.05).false_alarm_probability(1e-3) == pytest.approx(expected, rel=1e-9)


def test_detections_tend_to_the_closed_form() -> None:
    exact = finite_size("white", 0.0, signature(0.0, 2, 2))._replace(band_mean=1.0, band_spread=0.0, level=1.0)
    snr = np.array([0.02, 0.09, 0.2])
    np.testing.assert_allclose(
        exact.detection_probability(snr, 100.0, 18.42), detection_probability(200.0 * snr, 18.42), atol=1e-12
    )
    # Without an echo it is the false alarms, whose mean over B is known in closed form.
    spread = exact._replace(band_mean=1.03, band_spread=0.05)
    limit = -2.0 * np.log(1e-3)
    assert spread.detection_probability(0.0, 100.0, limit) == pytest.approx(
        spread.false_alarm_probability(1e-3), rel=1e-6
    )


def test_an_estimate_that_may_be_negative_detects_nothing_there() -> None:
    wide = finite_size("white", 0.0, signature(0.0, 2, 2))._replace(band_mean=1.0, band_spread=1.0, level=1.0)
    # B < 0 with probability Phi(-1) = 0.159; sixteen nodes have that to half the weight of one of them.
    assert 1.0 - float(wide.detection_probability(1e6, 100.0, 18.42)) == pytest.approx(0.159, abs=0.08)
