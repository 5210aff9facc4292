"""Slow, obvious versions of the receiver, and what it must give on average at finite size."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shared.detection import Cell, n_lag
from shared.disturbance import power_spectrum

Complexes = NDArray[np.complex128]


def literal_cell(y: Complexes, v: Complexes) -> Cell:
    """Fortunati et al. 2020, eq. 23 with its erratum, term by term."""
    signature_power = float(np.vdot(v, v).real)
    alpha_hat = complex(np.vdot(v, y)) / signature_power
    x = (y - alpha_hat * v) * v.conj()
    b = float(np.sum(np.abs(x) ** 2))
    for m in range(1, n_lag(len(y)) + 1):
        for n in range(m, len(y)):
            b += 2.0 * float((x[n] * np.conj(x[n - m])).real)
    return _cell(alpha_hat, b, signature_power)


def covariance_cell(y: Complexes, v: Complexes) -> Cell:
    """The same through a covariance matrix: B = v^H Gamma_hat v, Gamma_hat the band |i - j| <= l of r r^H."""
    signature_power = float(np.vdot(v, v).real)
    alpha_hat = complex(np.vdot(v, y)) / signature_power
    r = y - alpha_hat * v
    i = np.arange(len(y))
    gamma_hat = np.where(np.abs(i[:, None] - i) <= n_lag(len(y)), np.outer(r, r.conj()), 0.0)
    return _cell(alpha_hat, float(np.vdot(v, gamma_hat @ v).real), signature_power)


def _cell(alpha_hat: complex, b: float, signature_power: float) -> Cell:
    if b <= 0.0:
        return Cell(0.0, alpha_hat, 0.0, signature_power)
    sigma_hat = np.sqrt(b) / signature_power
    return Cell(float(2.0 * np.abs(alpha_hat) ** 2 / sigma_hat**2), alpha_hat, float(sigma_hat), signature_power)


class FiniteSize(NamedTuple):
    """Moments of the estimate in a cell of finite size, under a Gaussian disturbance with the model's spectrum."""

    band_mean: float  # E[B] / ||v||^2
    band_spread: float  # standard deviation of B over its mean
    level: float  # v^H Gamma v / ||v||^2: the variance that B estimates; S_c(nu) as N_R grows

    def false_alarm_probability(self, p_fa: float) -> float:
        """E[exp(-lambda B / (2 v^H Gamma v))] with B Gaussian and independent of alpha_hat, at lambda = -2 ln p_fa."""
        t = -np.log(p_fa) * self.band_mean / self.level
        return float(np.exp(-t + 0.5 * (t * self.band_spread) ** 2))


def finite_size(model: str, nu: float, v: Complexes) -> FiniteSize:
    """Exact first moment of B and the Blackman-Tukey approximation of its second.

    E[B] = sum_{|m|<=l} r_m sum_n v_n^* v_{n-m}, less the share (2l+1)/N that fitting alpha_hat takes out;
    var[B] / ||v||^4 = (1/N) int D_l(nu - nu')^2 S_c(nu')^2 dnu', D_l the Dirichlet kernel of 2l+1 lags.
    """
    n, lags = len(v), n_lag(len(v))
    grid = np.arange(4096) / 4096
    spectrum = power_spectrum(model, grid)
    r = np.fft.ifft(spectrum)  # r_m = int S_c e^{j 2 pi nu m} dnu; negative m from the end

    def quadratic_form(band: int) -> float:
        signature_power = float(np.sum(np.abs(v) ** 2))
        total = float(r[0].real) * signature_power
        for m in range(1, band + 1):
            total += 2.0 * float((r[m] * np.sum(v[m:].conj() * v[:-m])).real)
        return total / signature_power

    m = np.arange(-lags, lags + 1)
    dirichlet = np.exp(2j * np.pi * np.outer(nu - grid, m)).sum(axis=1).real
    band = quadratic_form(lags)
    spread = np.sqrt(np.mean((dirichlet * spectrum) ** 2) / n) / band
    return FiniteSize(band * (1.0 - (2 * lags + 1) / n), float(spread), quadratic_form(min(n - 1, 120)))
