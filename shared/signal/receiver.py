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
from cogradar.shared.numerics.jit import kernel

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
    signature_power, alpha_hat, padded = residual(y, u, a_rx, beamformed(y, u, a_rx.size), n_lag)
    return signature_power, alpha_hat, band_sum(padded, n_lag) if signature_power > 0.0 else 0.0


@kernel
def beamformed(y: NDArray[np.complex128], u: NDArray[np.complex128], n: int) -> NDArray[np.complex128]:
    """Sum over the transmit channels, u^H Y; (n_tx n,) -> (n,)."""
    total = np.zeros(n, dtype=np.complex128)
    for i in range(u.size):
        accumulate(y[i * n : (i + 1) * n], np.conj(u[i]), total)
    return total


@kernel
def residual(
    y: NDArray[np.complex128],
    u: NDArray[np.complex128],
    a_rx: NDArray[np.complex128],
    received: NDArray[np.complex128],
    n_lag: int,
) -> tuple[float, complex, NDArray[np.complex128]]:
    """||v||^2, alpha_hat, and x behind l zeros, as `band_sum` takes it, all 0 where nothing is sent; v is not formed.

    received : (n_rx,) u^H Y
    """
    n_rx = a_rx.size
    padded = np.empty(n_lag + y.size, dtype=np.complex128)
    padded[:n_lag] = 0.0
    signature_power = float(np.sum(squared_modulus(u)) * np.sum(squared_modulus(a_rx)))
    if signature_power == 0.0:
        padded[n_lag:] = 0.0
        return 0.0, 0j, padded
    alpha_hat = complex(np.sum(np.conj(a_rx) * received) / signature_power)
    x = padded[n_lag:]
    for i in range(u.size):
        row = slice(i * n_rx, (i + 1) * n_rx)
        _match_residual(y[row], alpha_hat, u[i], a_rx, x[row])
    return signature_power, alpha_hat, padded


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
def _match_residual(
    y: NDArray[np.complex128], alpha: complex, u: complex, a_rx: NDArray[np.complex128], x: NDArray[np.complex128]
) -> None:
    """x = (y - alpha v) .* v^*, v = u a_R."""
    for r in range(a_rx.size):
        v = u * a_rx[r]
        x[r] = (y[r] - alpha * v) * np.conj(v)


@kernel
def band_sum(padded: NDArray[np.complex128], n_lag: int) -> float:
    """B of x = padded[l:], whose first l are zeros: with the running sum s_n = x_{n-1} + .. + x_{n-l} it is

    sum_n |x_n|^2 + 2 Re x_n s_n^*.
    """
    own, cross, recent = 0.0, 0.0, 0j
    for n in range(n_lag, padded.size):
        x = padded[n]
        own += x.real * x.real + x.imag * x.imag
        cross += x.real * recent.real + x.imag * recent.imag
        recent += x - padded[n - n_lag]
    return own + 2.0 * cross


@kernel
def band_sums(padded: NDArray[np.complex128], other: NDArray[np.complex128], n_lag: int) -> tuple[float, float]:
    """`band_sum` of two: each sum waits for its last addition, and together they take the time of one."""
    own, cross, recent, own2, cross2, recent2 = 0.0, 0.0, 0j, 0.0, 0.0, 0j
    for n in range(n_lag, padded.size):
        x, z = padded[n], other[n]
        own += x.real * x.real + x.imag * x.imag
        own2 += z.real * z.real + z.imag * z.imag
        cross += x.real * recent.real + x.imag * recent.imag
        cross2 += z.real * recent2.real + z.imag * recent2.imag
        recent += x - padded[n - n_lag]
        recent2 += z - other[n - n_lag]
    return own + 2.0 * cross, own2 + 2.0 * cross2
