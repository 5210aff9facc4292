"""Directions within the main lobe: what an array loses off its axis, and how a detection tells where its echo is from.

Symbols: N antennas; d = nu - nu_c direction of an echo off that of the cell, |d| < 1/N in the main lobe;
D(d) = sin(pi N d) / (N sin(pi d)) response to it, (1/N) sum_i exp(j 2 pi d (i - (N-1)/2)); rho(d) = D'(d) / D(d)
discriminator; kappa^2 = -rho'(0) = pi^2 (N^2 - 1) / 3; r = |alpha_hat| / sigma_hat. Monopulse in maximum likelihood:
Sherman and Barton, "Monopulse Principles and Techniques", 2nd ed.
"""

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.jit import inlined
from cogradar.shared.signal.receiver import wald_test

Echo = NDArray[np.complex128]
Real = TypeVar("Real", float, NDArray[np.float64])
_NEAR = 1e-4  # of N d: below it discriminator and slope are those on the axis, to 1e-8, and their terms would cancel
_HALVINGS = 45  # of the main lobe: to 1e-13 of its width


@inlined
def off_axis_loss(d: Real, n: int) -> Real:
    """|D(d)|, one way; numbers in kernels, arrays elsewhere. An echo comes as alpha D_T D_R: two ways."""
    result: Real = np.abs(np.sinc(n * d) / np.sinc(d))
    return result


def discriminator(d: float, n: int) -> float:
    """rho(d) = D'(d) / D(d) = pi (N cot(pi N d) - cot(pi d)): from infinity at d = -1/N down to minus that at 1/N."""
    if abs(n * d) < _NEAR:
        return -kappa_sq(n) * d
    return math.pi * (n / math.tan(math.pi * n * d) - 1.0 / math.tan(math.pi * d))


def slope(d: float, n: int) -> float:
    """rho'(d) = pi^2 (1 / sin^2(pi d) - N^2 / sin^2(pi N d)) < 0."""
    if abs(n * d) < _NEAR:
        return -kappa_sq(n)
    return math.pi**2 * (math.sin(math.pi * d) ** -2 - n**2 * math.sin(math.pi * n * d) ** -2)


def off_axis(rho: float, n: int) -> float:
    """d in the main lobe at which the discriminator is rho: the inverse of `discriminator`, by bisection."""
    low, high = 0.0, 1.0 / n
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if -discriminator(middle, n) < abs(rho) else (low, middle)
    return math.copysign(low, -rho)


def kappa_sq(n: int) -> float:
    """Power of the noise in the derivative's channel over that in the sum's, pi^2 (N^2 - 1) / 3."""
    return math.pi**2 * (n**2 - 1) / 3.0


def ratio(y: Echo, u: Echo, a_rx: Echo) -> float:
    """Discriminator as measured: -Re[(v'^H y) / (v^H y)] with v' = u kron da_R/dnu, about the array's centre.

    y    : (n_tx n_rx,) complex, echo
    u    : (n_tx,) complex, W^T a_T
    a_rx : (n_rx,) complex, a_R
    """
    received = a_rx.conj() * (u.conj() @ y.reshape(u.size, a_rx.size))
    return -float((_derivative(a_rx.size).conj() @ received / received.sum()).real)


def ratio_sigma(noise: Echo, u: Echo, a_rx: Echo, rho: float, alpha_hat: complex) -> float:
    """Standard deviation of the error of a measured discriminator, in first order of the noise.

        rho_hat - rho = -Re[(v' + rho v)^H c] / |v^H y|,   E |e^H c|^2 by the receiver's sum over lags, e = v' + rho v

    Of a flat spectrum it is `flat_ratio_sigma`; of a coloured one, whose derivative's channel hears the spectrum beside
    the cell, up to a tenth more or less in that of the paper with n = 100.

    noise     : (n_tx n_rx,) complex, what is left of the echo without the target's part
    alpha_hat : of the cell
    """
    error = wald_test(noise, u, (_derivative(a_rx.size) + rho) * a_rx)
    signal = abs(alpha_hat) * float(np.vdot(u, u).real) * a_rx.size  # |v^H y|
    return error.sigma_hat * error.signature_power / (math.sqrt(2.0) * signal)


def flat_ratio_sigma(rho: float, r: float, n: int) -> float:
    """The same where the disturbance's spectrum is flat over the main lobe: sqrt(kappa^2 + rho^2) / (sqrt2 r)."""
    return math.sqrt(kappa_sq(n) + rho**2) / (math.sqrt(2.0) * r)


def direction(nu: float, rho: float, rho_sigma: float, n: int) -> tuple[float, float]:
    """Direction of an echo and the standard deviation of its error, from those of the discriminator.

        nu_hat = nu + d,   sigma_nu = sigma_rho / |rho'(d)|,   rho(d) = rho

    on the axis of a cell in a flat spectrum sigma_nu is .39 / (N r).

    nu : direction of the cell
    n  : receive antennas
    """
    d = off_axis(rho, n)
    return min(max(nu + d, -0.5), 0.5), rho_sigma / -slope(d, n)


def _derivative(n: int) -> Echo:
    """What makes da_R/dnu of a_R, about the array's centre: 2 pi j times the antennas' places, (n,)."""
    return 2j * np.pi * (np.arange(n) - 0.5 * (n - 1)).astype(np.complex128)
