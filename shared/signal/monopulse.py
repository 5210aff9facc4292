"""Directions within the main lobe: what an array loses off its axis, and how a detection tells where its echo is from.

Symbols: N antennas; d = nu - nu_c direction of an echo off the cell's, |d| < 1/N in the main lobe;
D(d) = sin(pi N d) / (N sin(pi d)) response to it, (1/N) sum_i exp(j 2 pi d (i - (N-1)/2)); rho(d) = D'(d) / D(d)
discriminator; kappa^2 = -rho'(0) = pi^2 (N^2 - 1) / 3; r = |alpha_hat| / sigma_hat. Monopulse in maximum likelihood:
Sherman and Barton, "Monopulse Principles and Techniques", 2nd ed.
"""

import math
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.elementwise import modulus, squared_modulus
from cogradar.shared.numerics.jit import inlined, kernel
from cogradar.shared.signal.array import around
from cogradar.shared.signal.receiver import (
    accumulate,
    add_bands,
    beamformed,
    clustered,
    match_residual,
    matched,
    no_band,
)
from cogradar.shared.signal.waveform import Root, Signature, signature

Echo = NDArray[np.complex128]
Real = TypeVar("Real", float, NDArray[np.float64])
_NEAR = 1e-4  # of N d: below it discriminator and slope are those on the axis, to 1e-8, and their terms would cancel
_HALVINGS = 45  # of the main lobe: to 1e-13 of its width


@inlined
def off_axis_loss(d: Real, n: int) -> Real:
    """|D(d)|, one way; numbers in kernels, arrays elsewhere. An echo comes as alpha D_T D_R: two ways."""
    result: Real = np.abs(np.sinc(n * d) / np.sinc(d))
    return result


@inlined
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


@kernel
def off_axis(rho: float, n: int) -> float:
    """d in the main lobe at which the discriminator is rho: the inverse of `discriminator`, by bisection."""
    low, high = 0.0, 1.0 / n
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if -discriminator(middle, n) < abs(rho) else (low, middle)
    return math.copysign(low, -rho)


@inlined
def kappa_sq(n: int) -> float:
    """Power of the noise in the derivative's channel over that in the sum's, pi^2 (N^2 - 1) / 3."""
    return math.pi**2 * (n**2 - 1) / 3.0


class OffAxis(NamedTuple):
    """What a detected echo says of where it is from."""

    rho: float  # discriminator as measured
    rho_sigma: float  # standard deviation of its error; 0: the estimate is not positive semidefinite
    sigma_hat: float  # of what the echo leaves, along the cell's signature; 0: likewise


def off_axis_echo(y: Echo, own: Signature, root: Root, nu: float, lags: int) -> OffAxis:
    """The discriminator of an echo, and the noise beside it.

        rho_hat = -Re[(v'^H y) / (v^H y)],   v' = u kron da_R/dnu, about the array's centre
        rho_hat - rho = -Re[(v' + rho v)^H c] / |v^H y|,   E |e^H c|^2 by the receiver's sums, e = v' + rho v

    in first order of the noise c, for which stands what the echo from the measured direction leaves of y. Of a flat
    spectrum the error is `flat_ratio_sigma`; of a coloured one, whose derivative's channel hears the spectrum beside
    the cell, up to a tenth more or less in the paper's with n = 100.

    y    : (n_tx n_rx,) complex, echo
    own  : the cell's signature
    root : of the waveform
    nu   : direction of the cell
    lags : of the sum over lags; 0: rows are clusters (`separation`)
    """
    rho, power, signal, b, b_error = _off_axis_echo(y, *own, root, nu, lags)
    return OffAxis(rho, math.sqrt(max(b_error, 0.0) / 2.0) / signal, math.sqrt(max(b, 0.0)) / power)


@kernel
def _off_axis_echo(
    y: Echo, u: Echo, a_rx: Echo, root: Root, nu: float, lags: int
) -> tuple[float, float, float, float, float]:
    """Discriminator, ||v||^2, |v^H y|, and B of the noise along v and along e."""
    n = a_rx.size
    received = beamformed(y, u, n)
    rho = _ratio(received, a_rx)
    nu_hat = nu + off_axis(rho, n)
    u_hat, a_hat = signature(root, nu_hat - np.rint(nu_hat), n)
    power = float(np.sum(squared_modulus(u_hat))) * n
    alpha = np.sum(np.conj(a_hat) * beamformed(y, u_hat, n)) / power if power > 0.0 else 0j
    noise, left = np.empty_like(y), np.zeros(n, np.complex128)
    for i in range(u.size):
        row = noise[i * n : (i + 1) * n]
        row[:] = y[i * n : (i + 1) * n]
        if power > 0.0:
            accumulate(a_hat, -alpha * u_hat[i], row)
        accumulate(row, np.conj(u[i]), left)
    signal = modulus(np.sum(np.conj(a_rx) * received))
    error = (_derivative(n) + rho) * a_rx
    if lags > 0:
        (own_power, along_v), (_, along_e) = matched(u, a_rx, left), matched(u, error, left)
        band, error_band = no_band(), no_band()
        x, z = np.zeros(lags + n, np.complex128), np.zeros(lags + n, np.complex128)
        for i in range(u.size):
            row = noise[i * n : (i + 1) * n]
            match_residual(row, along_v, u[i], a_rx, x[lags:])
            match_residual(row, along_e, u[i], error, z[lags:])
            band, error_band = add_bands(x, z, lags, band, error_band)
        b, b_error = band[0] + 2.0 * band[1], error_band[0] + 2.0 * error_band[1]
    else:
        own_power, b = clustered(noise, u, a_rx)
        _, b_error = clustered(noise, u, error)
    return rho, own_power, signal, b, b_error


@kernel
def ratio(y: Echo, u: Echo, a_rx: Echo) -> float:
    """Discriminator as measured, rho_hat of `off_axis_echo`."""
    return _ratio(beamformed(y, u, a_rx.size), a_rx)


@kernel
def _ratio(received: Echo, a_rx: Echo) -> float:
    """`ratio` of u^H Y, (n,)."""
    signal = np.conj(a_rx) * received
    return -float((np.sum(np.conj(_derivative(a_rx.size)) * signal) / np.sum(signal)).real)


@inlined
def _derivative(n: int) -> Echo:
    """What makes da_R/dnu of a_R, about the array's centre: 2 pi j times the antennas' places, (n,)."""
    return 2j * np.pi * (np.arange(n) - 0.5 * (n - 1)).astype(np.complex128)


def flat_ratio_sigma(rho: float, r: float, n: int) -> float:
    """The same where the disturbance's spectrum is flat over the main lobe: sqrt(kappa^2 + rho^2) / (sqrt2 r)."""
    return math.sqrt(kappa_sq(n) + rho**2) / (math.sqrt(2.0) * r)


def direction(nu: float, rho: float, rho_sigma: float, n: int) -> tuple[float, float]:
    """Direction of an echo and the standard deviation of its error, from the discriminator and its error.

        nu_hat = nu + d,   sigma_nu = sigma_rho / |rho'(d)|,   rho(d) = rho

    on the axis of a cell in a flat spectrum sigma_nu is .39 / (N r). Beyond an end nu_hat is at the other end.

    nu : direction of the cell
    n  : receive antennas
    """
    d = off_axis(rho, n)
    return float(around(nu + d)), rho_sigma / -slope(d, n)
