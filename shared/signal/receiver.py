"""The receiver: a Wald-type test of one cell that needs to know nothing of the disturbance.

Symbols: v = u kron a_R signature, u = W^T a_T; y = alpha v + c echo; l lags of the disturbance's memory;
Lambda statistic, chi-square with 2 degrees of freedom under H0, non-central with zeta under H1; lambda threshold.
Fortunati et al. 2020, "Massive MIMO radar for target detection" (arXiv 1906.06191), with its erratum.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cogradar.shared.numerics.elementwise import exp, modulus, squared_modulus
from cogradar.shared.numerics.jit import inlined, kernel

LEAST_DOF = 1e-3  # of an estimate from one transmit channel


class Cell(NamedTuple):
    """What the receiver says of one cell."""

    statistic: float  # Lambda, >= 0
    alpha_hat: complex  # estimated echo amplitude
    sigma_hat: float  # its standard deviation under the disturbance met
    signature_power: float  # ||v||^2, known to the receiver


def threshold(p_fa: float, n: int = 1) -> float:
    """Threshold lambda of the largest statistic of n independent cells; 0 < p_fa <= 1.

    lambda = -2 ln(1 - (1 - P_FA)^(1/n)), of a single one -2 ln P_FA: a false alarm in any of them has probability P_FA
    """
    return -2.0 * math.log(p_fa if n == 1 else -math.expm1(math.log1p(-p_fa) / n))


def false_alarm_probability(threshold: ArrayLike) -> NDArray[np.float64]:
    """P_FA = exp(-lambda / 2) as the number of virtual channels grows; (...) -> (...)."""
    return exp(-0.5 * np.asarray(threshold, dtype=np.float64))


def noncentrality(snr: ArrayLike, signature_power: ArrayLike, spectrum: ArrayLike) -> NDArray[np.float64]:
    """Noncentrality zeta = 2 |alpha|^2 ||v||^2 / S_c(nu); broadcasts.

    snr      : |alpha|^2 over the disturbance's power, linear, per virtual channel
    spectrum : S_c at the cell's spatial frequency (`disturbance.power_spectrum`)
    """
    return np.asarray(2.0 * np.asarray(snr) * np.asarray(signature_power) / np.asarray(spectrum), dtype=np.float64)


def detection_probability(zeta: ArrayLike, threshold: ArrayLike, rcs: str = "constant") -> NDArray[np.float64]:
    """P_D of a target whose RCS obeys a law of `world.rcs`; broadcasts.

        constant:   Q_1(sqrt zeta, sqrt lambda), Marcum's Q: the tail of chi-square(2, zeta), to 1e-11 absolute
        swerling1:  exp(-y / (1 + S)) = P_FA^(1 / (1 + S)),  S = zeta / 2, y = lambda / 2      (Swerling 1954, case I)
        swerling3:  exp(-y / (1 + h)) (1 + y h / (1 + h)^2),  h = S / 2                        (Swerling 1954, case III)

    zeta : noncentrality of the mean RCS
    """
    return _DETECTED[rcs](np.asarray(zeta, dtype=np.float64), np.asarray(threshold, dtype=np.float64))


def _detected_constant(zeta: NDArray[np.float64], threshold: NDArray[np.float64]) -> NDArray[np.float64]:
    from scipy.special import chndtr  # 0.4 s of import, which most processes need not spend

    return np.asarray(1.0 - chndtr(threshold, 2.0, zeta), dtype=np.float64)


def _detected_swerling1(zeta: NDArray[np.float64], threshold: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(exp(-0.5 * threshold / (1.0 + 0.5 * zeta)))


def _detected_swerling3(zeta: NDArray[np.float64], threshold: NDArray[np.float64]) -> NDArray[np.float64]:
    h, y = 0.25 * zeta, 0.5 * threshold
    return np.asarray(exp(-y / (1.0 + h)) * (1.0 + y * (h / (1.0 + h)) / (1.0 + h)))


_DETECTED: dict[str, Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]] = {
    "constant": _detected_constant,
    "swerling1": _detected_swerling1,
    "swerling3": _detected_swerling3,
}


def n_lag(n_virtual: int) -> int:
    """Lags l = ceil(N^{1/4}) of the covariance estimate; the double square root is exact for fourth powers."""
    return math.ceil(math.sqrt(math.sqrt(n_virtual)))


def wald_test(y: NDArray[np.complex128], u: NDArray[np.complex128], a_rx: NDArray[np.complex128]) -> Cell:
    """Statistic of a cell from its echo.

        alpha_hat = v^H y / ||v||^2,   x = (y - alpha_hat v) .* v^*
        B = sum_n |x_n|^2 + 2 Re sum_{m=1..l} sum_n x_n x_{n-m}^*          (Fortunati et al. 2020, eq. 23 with erratum)
        sigma_hat = sqrt(B) / ||v||^2,   Lambda = 2 |alpha_hat|^2 / sigma_hat^2

    y       : (n_tx n_rx,) complex, transmit channel by transmit channel
    u       : (n_tx,) complex, W^T a_T
    a_rx    : (n_rx,) complex, a_R
    returns : Cell; Lambda and sigma_hat are 0 if B <= 0 (the estimate is not positive semidefinite), everything is 0
              if nothing is sent in this direction
    """
    signature_power, alpha_hat, b = correlate(y, u, a_rx, n_lag(y.size))
    if b <= 0.0:
        return Cell(0.0, alpha_hat, 0.0, signature_power)
    sigma_hat = math.sqrt(b) / signature_power
    return Cell(2.0 * (modulus(alpha_hat) / sigma_hat) ** 2, alpha_hat, sigma_hat, signature_power)


@kernel
def correlate(
    y: NDArray[np.complex128], u: NDArray[np.complex128], a_rx: NDArray[np.complex128], n_lag: int
) -> tuple[float, complex, float]:
    """||v||^2, alpha_hat and B of one cell (`wald_test`); v is not formed."""
    n = a_rx.size
    signature_power, alpha_hat = matched(u, a_rx, beamformed(y, u, n))
    if signature_power == 0.0:
        return 0.0, 0j, 0.0
    band, x = no_band(), np.zeros(n_lag + n, dtype=np.complex128)
    for i in range(u.size):
        match_residual(y[i * n : (i + 1) * n], alpha_hat, u[i], a_rx, x[n_lag:])
        band = add_band(x, n_lag, band)
    return signature_power, alpha_hat, band[0] + 2.0 * band[1]


@kernel
def beamformed(y: NDArray[np.complex128], u: NDArray[np.complex128], n: int) -> NDArray[np.complex128]:
    """Sum over the transmit channels, u^H Y; (n_tx n,) -> (n,)."""
    total = np.zeros(n, dtype=np.complex128)
    for i in range(u.size):
        accumulate(y[i * n : (i + 1) * n], np.conj(u[i]), total)
    return total


@kernel
def matched(
    u: NDArray[np.complex128], a_rx: NDArray[np.complex128], received: NDArray[np.complex128]
) -> tuple[float, complex]:
    """||v||^2 and alpha_hat, both 0 where nothing is sent; received: (n_rx,) u^H Y."""
    signature_power = float(np.sum(squared_modulus(u)) * np.sum(squared_modulus(a_rx)))
    if signature_power == 0.0:
        return 0.0, 0j
    return signature_power, complex(np.sum(np.conj(a_rx) * received) / signature_power)


@kernel
def clustered(
    y: NDArray[np.complex128], u: NDArray[np.complex128], a_rx: NDArray[np.complex128]
) -> tuple[float, float]:
    """||v||^2, and B of one cell with transmit channels as clusters (`separation`), v = u kron a_R; v is not formed.

    B = k / (k - 1) sum_i |u_i|^2 |a_R^H y_i - alpha ||a_R||^2 u_i|^2,   k = ||u||^4 / sum_i |u_i|^4
    """
    n_rx, length = a_rx.size, float(np.sum(squared_modulus(a_rx)))
    received, powers, total = np.empty(u.size, np.complex128), squared_modulus(u), 0j
    for i in range(u.size):
        received[i] = np.sum(y[i * n_rx : (i + 1) * n_rx] * np.conj(a_rx))
        total += np.conj(u[i]) * received[i]
    power = float(np.sum(powers))
    if power == 0.0:
        return 0.0, 0.0
    left = received - total / power * u
    dof = power * power / np.sum(powers * powers) - 1.0
    b = float(np.sum(powers * squared_modulus(left))) * (dof + 1.0) / max(dof, LEAST_DOF)
    return power * length, b


# Loops over the row of one transmit channel, in functions of their own: only so does the compiler vectorise them.


@kernel
def accumulate(y: NDArray[np.complex128], weight: complex, total: NDArray[np.complex128]) -> None:
    """total += weight y."""
    for r in range(total.size):
        total[r] += weight * y[r]


@kernel
def match_residual(
    y: NDArray[np.complex128], alpha: complex, u: complex, a_rx: NDArray[np.complex128], x: NDArray[np.complex128]
) -> None:
    """x = (y - alpha v) .* v^*, v = u a_R."""
    for r in range(a_rx.size):
        v = u * a_rx[r]
        x[r] = (y[r] - alpha * v) * np.conj(v)


Band = tuple[float, float, complex]  # of the rows up to now: sum |x_n|^2, sum Re x_n s_n^*, and s of the next sample


@inlined
def no_band() -> Band:
    """Before the first row."""
    return 0.0, 0.0, 0j


@kernel
def add_band(x: NDArray[np.complex128], n_lag: int, before: Band) -> Band:
    """Add a row to B: with the running sum s_n = x_{n-1} + .. + x_{n-l} it is sum_n |x_n|^2 + 2 Re x_n s_n^*.

    Row by row, as the rows of 10^4 channels are written and read again in a core's first cache.

    x : (l + n,) the last l of the rows before, 0 at first, and the row; left as the next row needs it
    """
    own, cross, recent = before
    for n in range(n_lag, x.size):
        one = x[n]
        own += one.real * one.real + one.imag * one.imag
        cross += one.real * recent.real + one.imag * recent.imag
        recent += one - x[n - n_lag]
    for i in range(n_lag):
        x[i] = x[x.size - n_lag + i]
    return own, cross, recent


@kernel
def add_bands(
    x: NDArray[np.complex128], z: NDArray[np.complex128], n_lag: int, before: Band, before2: Band
) -> tuple[Band, Band]:
    """`add_band` of two: each sum waits for its last addition, and together they take less time than one by one."""
    own, cross, recent = before
    own2, cross2, recent2 = before2
    for n in range(n_lag, x.size):
        one, two = x[n], z[n]
        own += one.real * one.real + one.imag * one.imag
        own2 += two.real * two.real + two.imag * two.imag
        cross += one.real * recent.real + one.imag * recent.imag
        cross2 += two.real * recent2.real + two.imag * recent2.imag
        recent += one - x[n - n_lag]
        recent2 += two - z[n - n_lag]
    for i in range(n_lag):
        x[i], z[i] = x[x.size - n_lag + i], z[z.size - n_lag + i]
    return (own, cross, recent), (own2, cross2, recent2)
