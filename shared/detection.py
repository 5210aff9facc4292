"""The receiver: a Wald-type test of one cell that needs to know nothing of the disturbance.

Symbols: v = u kron a_R signature, u = W^T a_T; y = alpha v + c echo; l lags of the disturbance's memory;
Lambda statistic, chi-square with 2 degrees of freedom under H0, non-central with zeta under H1; lambda threshold.
Fortunati et al. 2020, "Massive MIMO radar for target detection" (arXiv 1906.06191), with its erratum.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chndtr

from shared.jit import kernel


class Cell(NamedTuple):
    """What the receiver says of one cell."""

    statistic: float  # Lambda, >= 0
    alpha_hat: complex  # estimated echo amplitude
    sigma_hat: float  # its standard deviation under the disturbance met
    signature_power: float  # ||v||^2, known to the receiver


def threshold(p_fa: float) -> float:
    """Threshold lambda = -2 ln P_FA of the statistic; 0 < p_fa <= 1."""
    return -2.0 * math.log(p_fa)


def false_alarm_probability(threshold: ArrayLike) -> NDArray[np.float64]:
    """P_FA = exp(-lambda / 2) as the number of virtual channels grows; (...) -> (...)."""
    return np.exp(-0.5 * np.asarray(threshold, dtype=np.float64))


def noncentrality(snr: ArrayLike, signature_power: ArrayLike, spectrum: ArrayLike) -> NDArray[np.float64]:
    """Noncentrality zeta = 2 |alpha|^2 ||v||^2 / S_c(nu); broadcasts.

    snr      : |alpha|^2 over the disturbance's power, linear, per virtual channel
    spectrum : S_c at the cell's spatial frequency (`disturbance.power_spectrum`)
    """
    return np.asarray(2.0 * np.asarray(snr) * np.asarray(signature_power) / np.asarray(spectrum), dtype=np.float64)


def detection_probability(zeta: ArrayLike, threshold: ArrayLike) -> NDArray[np.float64]:
    """P_D = Q_1(sqrt zeta, sqrt lambda), Marcum's Q: the tail of chi-square(2, zeta); broadcasts, to 1e-11 absolute."""
    tail = 1.0 - chndtr(np.asarray(threshold, dtype=np.float64), 2.0, np.asarray(zeta, dtype=np.float64))
    return np.asarray(tail, dtype=np.float64)


def n_lag(n_virtual: int) -> int:
    """Lags l = ceil(N^{1/4}) of the covariance estimate; the double square root is exact for fourth powers."""
    return math.ceil(math.sqrt(math.sqrt(n_virtual)))


def wald_test(
    disturbance: NDArray[np.complex128], u: NDArray[np.complex128], a_rx: NDArray[np.complex128], alpha: complex
) -> Cell:
    """Statistic of a cell whose echo is y = alpha v + c, v = u kron a_R.

        alpha_hat = v^H y / ||v||^2,   x = (y - alpha_hat v) .* v^*
        B = sum_n |x_n|^2 + 2 Re sum_{m=1..l} sum_n x_n x_{n-m}^*          (Fortunati et al. 2020, eq. 23 with erratum)
        sigma_hat = sqrt(B) / ||v||^2,   Lambda = 2 |alpha_hat|^2 / sigma_hat^2

    disturbance : (n_tx n_rx,) complex, c
    u           : (n_tx,) complex, W^T a_T
    a_rx        : (n_rx,) complex, a_R
    returns     : Cell; Lambda and sigma_hat are 0 if B <= 0 (the estimate is not positive semidefinite), everything
                  is 0 if nothing is sent in this direction
    """
    signature_power = float(np.sum(u.real**2 + u.imag**2) * np.sum(a_rx.real**2 + a_rx.imag**2))
    if signature_power == 0.0:
        return Cell(0.0, 0j, 0.0, 0.0)
    # The echo cancels in the residual, y - alpha_hat v = c - beta v with beta = v^H c / ||v||^2, and adds to beta in
    # alpha_hat: neither v nor y is formed.
    beta, b = _correlate(disturbance, u, a_rx, signature_power, n_lag(disturbance.size))
    alpha_hat = complex(alpha + beta)
    if b <= 0.0:
        return Cell(0.0, alpha_hat, 0.0, signature_power)
    sigma_hat = math.sqrt(b) / signature_power
    return Cell(2.0 * (abs(alpha_hat) / sigma_hat) ** 2, alpha_hat, sigma_hat, signature_power)


@kernel
def _correlate(
    c: NDArray[np.complex128],
    u: NDArray[np.complex128],
    a_rx: NDArray[np.complex128],
    signature_power: float,
    n_lag: int,
) -> tuple[complex, float]:
    """beta = v^H c / ||v||^2 and B of one cell (`wald_test`).

    The lag products are summed as 2 Re sum_n x_n (x_{n-1} + .. + x_{n-l})^*, the bracket a sliding sum: O(N) for any l.
    """
    n_rx = a_rx.size
    # Matched filter: x = c .* v^*, after l zeros that stand for the samples before the first.
    x = np.zeros(n_lag + c.size, dtype=np.complex128)
    beta = 0j
    for i in range(u.size):
        u_conj = np.conj(u[i])
        for r in range(n_rx):
            z = c[i * n_rx + r] * (u_conj * np.conj(a_rx[r]))
            x[n_lag + i * n_rx + r] = z
            beta += z
    beta = beta / signature_power
    # Residual: x - beta |v|^2.
    for i in range(u.size):
        u_beta = beta * (u[i].real * u[i].real + u[i].imag * u[i].imag)
        for r in range(n_rx):
            x[n_lag + i * n_rx + r] -= u_beta * (a_rx[r].real * a_rx[r].real + a_rx[r].imag * a_rx[r].imag)
    # Band sum.
    b = 0.0
    recent = 0j
    for n in range(n_lag, x.size):
        b += x[n].real * (x[n].real + 2.0 * recent.real) + x[n].imag * (x[n].imag + 2.0 * recent.imag)
        recent += x[n] - x[n - n_lag]
    return beta, b
