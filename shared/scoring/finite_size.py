"""What the receiver gives on average at finite size: its closed forms hold as the number of channels grows.

Symbols: v signature, N = n_tx n_rx channels, Gamma covariance of the disturbance, r_m its autocovariance at lag m,
S_c(nu) its spectrum; B the receiver's estimate of v^H Gamma v from l lags (`shared.signal.receiver`).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shared.signal.receiver import n_lag
from shared.world.disturbance import power_spectrum

_REACH = 120  # lags that count: the slowest pole leaves 0.7^120 = 1e-19


class FiniteSize(NamedTuple):
    """Moments of the estimate in a cell of finite size, under a Gaussian disturbance with the model's spectrum."""

    band_mean: float  # E[B] / ||v||^2
    band_spread: float  # standard deviation of B over its mean
    level: float  # v^H Gamma v / ||v||^2: the variance that B estimates; S_c(nu) as N_R grows

    def false_alarm_probability(self, p_fa: float) -> float:
        """P_FA to be expected where the closed form says p_fa.

        E[exp(-lambda B / (2 v^H Gamma v))] with B Gaussian and independent of alpha_hat, at lambda = -2 ln p_fa
        """
        t = -np.log(p_fa) * self.band_mean / self.level
        return float(np.exp(-t + 0.5 * (t * self.band_spread) ** 2))


def finite_size(model: str, nu: float, v: NDArray[np.complex128]) -> FiniteSize:
    """Exact first moment of B and the Blackman-Tukey approximation of its second.

    E[B] = sum_{|m|<=l} r_m sum_n v_n^* v_{n-m}, less the share (2l+1)/N that fitting alpha_hat takes out;
    var[B] / ||v||^4 = (1/N) int D_l(nu - nu')^2 S_c(nu')^2 dnu', D_l the Dirichlet kernel of 2l+1 lags.

    model : of `disturbance.draw`, one without a texture or normalised to sample power 1
    nu    : spatial frequency of the cell; v : (N,) complex, its signature
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
    return FiniteSize(band * (1.0 - (2 * lags + 1) / n), float(spread), quadratic_form(min(n - 1, _REACH)))
