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

from shared.numerics.jit import kernel

_COLUMNS = 64  # partial sums that are kept side by side: one would wait for itself


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
    # The echo cancels in the residual, y - alpha_hat v = c - beta v with beta = v^H c / ||v||^2, and adds to beta in
    # alpha_hat: neither v nor y is formed.
    signature_power, beta, b = _correlate(disturbance, u, a_rx, n_lag(disturbance.size))
    if signature_power == 0.0:
        return Cell(0.0, 0j, 0.0, 0.0)
    alpha_hat = complex(alpha + beta)
    if b <= 0.0:
        return Cell(0.0, alpha_hat, 0.0, signature_power)
    sigma_hat = math.sqrt(b) / signature_power
    return Cell(2.0 * (abs(alpha_hat) / sigma_hat) ** 2, alpha_hat, sigma_hat, signature_power)


@kernel
def _correlate(
    c: NDArray[np.complex128], u: NDArray[np.complex128], a_rx: NDArray[np.complex128], n_lag: int
) -> tuple[float, complex, float]:
    """||v||^2, beta = v^H c / ||v||^2 and B of one cell (`wald_test`).

    In loops over short rows whose sums do not wait for each other: these are what the compiler vectorises.
    """
    n_rx = a_rx.size
    a_re, a_im = a_rx.real.copy(), a_rx.imag.copy()
    a_power, u_power = a_re * a_re + a_im * a_im, u.real * u.real + u.imag * u.imag
    signature_power = np.sum(u_power) * np.sum(a_power)
    if signature_power == 0.0:
        return 0.0, 0j, 0.0
    # Matched filter: x = c .* v^*, after l zeros that stand for the samples before the first.
    x = np.empty(n_lag + c.size, dtype=np.complex128)
    x[:n_lag] = 0.0
    total = np.zeros(n_rx, dtype=np.complex128)
    for i in range(u.size):
        row = x[n_lag + i * n_rx : n_lag + (i + 1) * n_rx]
        _match(c[i * n_rx : (i + 1) * n_rx], u[i].real, u[i].imag, a_re, a_im, row, total)
    beta = np.sum(total) / signature_power
    # Residual: x - beta |v|^2.
    for i in range(u.size):
        row = x[n_lag + i * n_rx : n_lag + (i + 1) * n_rx]
        offset = beta * u_power[i]
        for r in range(n_rx):
            row[r] = complex(row[r].real - offset.real * a_power[r], row[r].imag - offset.imag * a_power[r])
    return float(signature_power), complex(beta), _band_sum(x, n_lag)


@kernel
def _match(
    c: NDArray[np.complex128],
    u_re: float,
    u_im: float,
    a_re: NDArray[np.float64],
    a_im: NDArray[np.float64],
    x: NDArray[np.complex128],
    total: NDArray[np.complex128],
) -> None:
    """Products x = c .* (u a)^* of one transmit channel, also added to `total`; all (n_rx,)."""
    for r in range(a_re.size):
        v_re, v_im = u_re * a_re[r] - u_im * a_im[r], u_re * a_im[r] + u_im * a_re[r]
        z = complex(c[r].real * v_re + c[r].imag * v_im, c[r].imag * v_re - c[r].real * v_im)
        x[r] = z
        total[r] += z


@kernel
def _band_sum(padded: NDArray[np.complex128], n_lag: int) -> float:
    """B = sum_n |x_n|^2 + 2 Re sum_{m=1..l} sum_n x_n x_{n-m}^* of x = padded[l:]; the first l are zeros, l >= 1.

    As sum_n x_n (x_n + 2 (x_{n-1} + .. + x_{n-l}))^*. The bracket is a sum of windows whose widths are powers of 2,
    each window two of half the width: 2 log2(l) additions per sample that do not wait for each other. Real and
    imaginary parts are added alike, hence the view as reals.
    """
    x = padded.view(np.float64)
    pad, window, width, lag = 2 * n_lag, x, 1, 1
    recent = np.zeros(x.size - pad)
    while True:
        if n_lag & width:  # lags lag .. lag + width - 1
            _add(window[pad - 2 * lag : x.size - 2 * lag], recent)
            lag += width
        if 2 * width > n_lag:
            break
        wider = np.empty_like(x)
        wider[: 2 * width] = 0.0
        _sum(window[2 * width :], window[: x.size - 2 * width], wider[2 * width :])
        window, width = wider, 2 * width
    return _band_total(x[pad:], recent)


@kernel
def _add(a: NDArray[np.float64], total: NDArray[np.float64]) -> None:
    """Add a to total, element by element."""
    for n in range(total.size):
        total[n] += a[n]


@kernel
def _sum(a: NDArray[np.float64], b: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    """a + b, element by element."""
    for n in range(out.size):
        out[n] = a[n] + b[n]


@kernel
def _band_total(x: NDArray[np.float64], recent: NDArray[np.float64]) -> float:
    """Sum of x (x + 2 recent)."""
    partial = np.zeros(_COLUMNS)
    whole = x.size - x.size % _COLUMNS
    for n in range(0, whole, _COLUMNS):
        for column in range(_COLUMNS):
            partial[column] += x[n + column] * (x[n + column] + 2.0 * recent[n + column])
    for n in range(whole, x.size):
        partial[0] += x[n] * (x[n] + 2.0 * recent[n])
    return float(np.sum(partial))
