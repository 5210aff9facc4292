"""What the receiver gives on average at finite size: its closed forms hold as the number of channels grows.

Symbols: v signature, N = n_tx n_rx channels, Gamma covariance of the disturbance, r_m its autocovariance at lag m,
S_c(nu) its spectrum; B the receiver's estimate of v^H Gamma v from l lags (`cogradar.shared.signal.receiver`).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammaincinv

from cogradar.shared.signal.detector.levels import LEVEL_SPREAD, MOST_REFERENCES
from cogradar.shared.signal.receiver import LEAST_DOF, detection_probability, n_lag, noncentrality
from cogradar.shared.world.disturbance import power_spectrum

_REACH = 120  # lags that count: the slowest pole leaves 0.7^120 = 1e-19
_QUANTILES = (np.arange(64) + 0.5) / 64.0  # of B
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(16)  # of B, in standard deviations from its mean


class FiniteSize(NamedTuple):
    """Moments of the estimate in a cell of finite size, under a disturbance with the model's spectrum."""

    band_mean: float  # E[B] / ||v||^2
    band_spread: float  # standard deviation of B over its mean
    level: float  # v^H Gamma v / ||v||^2: the variance that B estimates; S_c(nu) as N_R grows
    dof: float = 0.0  # nu of a B that is gamma distributed, with 2 nu degrees of freedom; 0: it is Gaussian, by lags

    def false_alarm_probability(self, p_fa: float) -> float:
        """P_FA to be expected where the closed form says p_fa.

        E[exp(-lambda B / (2 v^H Gamma v))] with B Gaussian and independent of alpha_hat, at lambda = -2 ln p_fa
        """
        if self.dof:  # E[exp(-t B)], t from the limit of an F distribution
            limit = self.dof * np.expm1(-np.log(p_fa) / self.dof)
            return float((1.0 + limit * self.band_mean / self.level / self.dof) ** -self.dof)
        t = -np.log(p_fa) * self.band_mean / self.level
        return float(np.exp(-t + 0.5 * (t * self.band_spread) ** 2))

    def detection_probability(
        self, snr: ArrayLike, signature_power: float, threshold: float, rcs: str = "constant"
    ) -> NDArray[np.float64]:
        """P_D of an echo on the axis of its cell, mean |alpha|^2 = snr over the disturbance's power; (...) -> (...).

            E[Q_1(sqrt zeta, sqrt(lambda B / v^H Gamma v))],   zeta = 2 |alpha|^2 ||v||^4 / v^H Gamma v

        or what stands for Q_1 under another law of `world.rcs`; B is Gaussian and independent of alpha_hat. The
        asymptotic form takes B for v^H Gamma v. It is biased, though: a window of l lags lets the spectrum's peaks leak
        into its dips and flattens the peaks, and where the signature jumps in phase between transmit channels its
        products are lost. A bias of 1 % moves P_D by up to 0.009.
        """
        b, weights = 1.0 + self.band_spread * _NODES, _WEIGHTS
        if self.dof:
            b = np.asarray(gammaincinv(self.dof, _QUANTILES) / self.dof, np.float64)
            weights = np.ones(_QUANTILES.size)
            threshold = 2.0 * self.dof * float(np.expm1(threshold / (2.0 * self.dof)))
        limits = threshold * self.band_mean / self.level * np.maximum(b, 0.0)
        zeta = noncentrality(snr, signature_power, self.level)
        p_d = np.where(b > 0.0, detection_probability(zeta[..., None], limits, rcs), 0.0)  # B <= 0 is no detection
        return np.asarray(p_d @ weights / weights.sum())


def finite_size(model: str, nu: float, v: NDArray[np.complex128], noise: str = "lags", n_rx: int = 0) -> FiniteSize:
    """Moments of the estimate B in a cell with the signature v, (n_tx n_rx,), by `radar.receiver.noise`.

    rows        : E[B] is the part of v^H Gamma v within transmit channels, 2 (k - 1) degrees of freedom with
                  k = ||u||^4 / sum_i |u_i|^4 (`cogradar.shared.signal.detector.separation`)
    range-cells : E[B] is v^H Gamma v, degrees of freedom as of `cogradar.shared.signal.detector.levels` with the most
                  range cells
    """
    by_lags = _by_lags(model, nu, v)
    if noise == "lags":
        return by_lags
    if noise == "range-cells":
        dof = 1.0 / (1.0 / (MOST_REFERENCES - 2.0) + LEVEL_SPREAD / v.size)
        return FiniteSize(by_lags.level, dof**-0.5, by_lags.level, dof)
    rows = v.reshape(-1, n_rx)
    weights = np.sum(np.abs(rows) ** 2, axis=1)
    r = np.fft.ifft(power_spectrum(model, np.arange(4096) / 4096))
    products = np.fft.ifft(np.abs(np.fft.fft(rows, 2 * n_rx, axis=1)) ** 2, axis=1).sum(axis=0)[:n_rx]
    within = r[0].real * products[0].real + 2.0 * float(np.sum(r[1:n_rx] * products[1:].conj()).real)
    dof = max(float(weights.sum() ** 2 / np.sum(weights**2)) - 1.0, LEAST_DOF)
    return FiniteSize(within / products[0].real, dof**-0.5, by_lags.level, dof)


def _by_lags(model: str, nu: float, v: NDArray[np.complex128]) -> FiniteSize:
    """Exact first moment of B and the Blackman-Tukey approximation of its second.

    E[B] = sum_{|m|<=l} r_m sum_n v_n^* v_{n-m}, less the share (2l+1)/N that fitting alpha_hat takes out.
    The variance is var[B] / ||v||^4 = (1/N) int (D_l(nu - nu') - b)^2 S_c(nu')^2 dnu', with D_l the Dirichlet kernel of
    2l+1 lags and b = E[B] / ||v||^2. The disturbance is normalised to sample power 1, so that b of what B varies with
    is taken out again. With it goes, to first order, all that heavy tails would add (Bartlett's formula of ratios of
    autocovariances).

    model : of `disturbance.draw`; a texture scales B and |alpha_hat|^2 alike
    nu    : spatial frequency of the cell; v : (N,) complex, its signature
    """
    n, lags = len(v), n_lag(len(v))
    grid = np.arange(4096) / 4096
    spectrum = power_spectrum(model, grid)
    r = np.fft.ifft(spectrum)  # r_m = int S_c e^{j 2 pi nu m} dnu; negative m from the end
    products = np.fft.ifft(np.abs(np.fft.fft(v, 2 * n)) ** 2)  # at m: sum_n v_n v_{n-m}^*

    def quadratic_form(band: int) -> float:
        total = r[0].real * products[0].real + 2.0 * np.sum(r[1 : band + 1] * products[1 : band + 1].conj()).real
        return float(total / products[0].real)

    dirichlet = 1.0 + 2.0 * np.cos(2.0 * np.pi * np.outer(nu - grid, np.arange(1, lags + 1))).sum(axis=1)
    band = quadratic_form(lags)
    spread = np.sqrt(np.mean(((dirichlet - band) * spectrum) ** 2) / n) / band
    return FiniteSize(band * (1.0 - (2 * lags + 1) / n), float(spread), quadratic_form(min(n - 1, _REACH)))
