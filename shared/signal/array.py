"""The arrays and the grid of angle bins.

Symbols: nu = 0.5 sin(theta) spatial frequency of direction theta from boresight; a(nu) steering vector of a
half-wavelength uniform linear array; x boresight, y along the array.
"""

import math
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cogradar.shared.numerics.moduli import hypot
from cogradar.shared.numerics.quadrature import gauss_legendre

# What a track remembers of a dwell with steered looks: these many of them, with what they have in common.
KEPT_LOOKS = 16
_ELEVATIONS, _SHARES = gauss_legendre(8)
_LEAST_COS = 0.05  # of an elevation: straight above the array's line nothing is known of x
_BEYOND = 3.0  # standard deviations beyond an end at which a direction may be measured
_NEAR_KM = 1e-3  # keeps a direction finite
_ROUNDING = 1e-9  # of directions that are compared
_FEW = 1000  # pairs of directions that are compared as fast as they are sorted
LOOKS_ROW = 3 + 2 * KEPT_LOOKS  # numbers: limit and gate, directions, standard deviations


def bin_centres(n_bin: int) -> NDArray[np.float64]:
    """Spatial frequencies of the bin centres, (n_bin,), equally spaced over [-0.5, 0.5], ends included.

    Their spacing is 1/(n_bin - 1): neighbouring steering vectors are nearly, not exactly, orthogonal, and bins 0 and
    n_bin - 1 are one direction (grating).
    """
    return _bin_centres(n_bin).copy()


@cache
def _bin_centres(n_bin: int) -> NDArray[np.float64]:
    return np.linspace(-0.5, 0.5, n_bin)


def steering_vector(nu: ArrayLike, n: int) -> NDArray[np.complex128]:
    """Steering vectors a(nu)_i = exp(j 2 pi nu i), i = 0 .. n-1; (...) -> (..., n) complex."""
    vectors: NDArray[np.complex128] = np.exp(2j * np.pi * np.multiply.outer(nu, np.arange(n)))
    return vectors


def spatial_frequency(states: ArrayLike) -> NDArray[np.float64]:
    """Spatial frequency nu = 0.5 sin(atan2(y, x)) = 0.5 y / R of states [x, vx, y, vy], (..., 4) -> (...).

    0 at the array itself, as atan2 has it; NaN of NaN.
    """
    s = np.asarray(states, dtype=np.float64)
    r = hypot(s[..., 0], s[..., 2])
    return np.asarray(np.divide(0.5 * s[..., 2], r, out=np.zeros(r.shape), where=r != 0.0))


def in_plane(states: ArrayLike, heights_km: ArrayLike) -> NDArray[np.float64]:
    """Where in the plane of the array a target would have the range and the direction that it has at its height.

    A linear array measures y and the distance from its line, hypot(x, z). Positions of one range R and one direction
    nu = 0.5 y / R are a circle about the line, on a cone. At height 0 nothing changes but the sign of x.

    states     : (..., 4) [x, vx, y, vy], x and y on the ground, km
    heights_km : (...) z
    returns    : (..., 4), x replaced by hypot(x, z); velocities as they are
    """
    found = np.array(states, dtype=np.float64)
    found[..., 0] = hypot(found[..., 0], np.asarray(heights_km, dtype=np.float64))
    return found


def on_ground(
    mean: NDArray[np.float64], covariance: NDArray[np.float64], height_max_km: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean, (4,), and covariance, (4, 4), on the ground, of a target that is known in the plane of the array.

    Of its height z it is known only that it is between 0 and height_max_km. The elevation phi, sin phi = z / x', is
    uniform, which is a uniform density of x and z. Of each elevation to first order, x' = hypot(x, z), z constant:

        x = x' cos phi,  v_x = v_x' / cos phi

    Straight above the array's line v_x has no bound. cos phi is kept above 0.05 there, and d v_x / d x' is taken as at
    x' = height_max_km. A target that is nearer than that may be anywhere on its circle.
    """
    from cogradar.shared.numerics.linear import product

    x, vx = max(float(mean[0]), 0.0), float(mean[1])
    highest = math.asin(min(height_max_km / x, 1.0)) if x > 0.0 else 0.5 * np.pi
    cos = np.maximum(np.cos(0.5 * highest * (1.0 + _ELEVATIONS)), _LEAST_COS)
    means = np.tile(mean, (cos.size, 1))
    means[:, 0], means[:, 1] = x * cos, vx / cos
    by = np.tile(np.eye(4), (cos.size, 1, 1))
    by[:, 0, 0] = by[:, 1, 1] = 1.0 / cos
    by[:, 1, 0] = vx / max(x, height_max_km) / cos * (1.0 - 1.0 / cos**2)
    shares = 0.5 * _SHARES
    ground = product(shares, means)
    off = means - ground
    spreads = [product(product(one, covariance), one.T) for one in by] + off[:, :, np.newaxis] * off[:, np.newaxis]
    spread = np.sum(shares[:, np.newaxis, np.newaxis] * spreads, axis=0)
    return ground, 0.5 * (spread + spread.T)


def apart(nu: ArrayLike, other: ArrayLike) -> NDArray[np.float64]:
    """Distance of spatial frequencies, broadcasts. It is circular: -0.5 and 0.5 are one direction of the array."""
    d = np.abs(np.asarray(nu, dtype=np.float64) - np.asarray(other, dtype=np.float64))
    return np.asarray(np.minimum(d, 1.0 - d))


def near_pairs(
    nus: NDArray[np.float64], others: NDArray[np.float64], reach: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which directions, (n,), are nearer than `reach` to which others, (m,): pairs (i, j), in this order; (p,) each.

    Cost O((n + m) log m + p): what is far is not compared, but if there are few.
    """
    if nus.size * others.size <= _FEW:
        i, j = np.nonzero(apart(nus[:, np.newaxis], others) < reach)
        return i, j
    order, wide = np.argsort(others), reach + _ROUNDING
    turns = np.array([[-1.0], [0.0], [1.0]]) if wide < 0.5 else np.zeros((1, 1))
    around_nus, half = nus + turns, wide if wide < 0.5 else np.inf
    first = np.searchsorted(others[order], around_nus - half).ravel()
    n = np.searchsorted(others[order], around_nus + half, side="right").ravel() - first
    i, before = np.repeat(np.tile(np.arange(nus.size), turns.size), n), np.repeat(np.cumsum(n) - n - first, n)
    j = order[np.arange(i.size) - before]
    is_near = apart(nus[i], others[j]) < reach
    found = np.lexsort((j[is_near], i[is_near]))
    return i[is_near][found], j[is_near][found]


def around(nu: ArrayLike) -> NDArray[np.float64]:
    """Directions within -0.5 .. 0.5: beyond an end the array hears what comes from the other one; (...) -> (...)."""
    nu = np.asarray(nu, dtype=np.float64)
    return np.asarray(nu - np.rint(nu))


def mean_direction(nus: NDArray[np.float64]) -> tuple[float, float]:
    """Mean and standard deviation of directions, (n,), on the circle, which is cut at boresight if they are at both
    ends.
    """
    turned = np.where(nus < 0.0, nus + 1.0, nus)
    is_across = nus.max() - nus.min() > 0.5 and turned.std() < nus.std()
    cut = turned if is_across else nus
    return float(around(cut.mean())), float(cut.std())


def at_own_end(nu: float, sigma: float, own: float) -> float:
    """A measured direction, beyond the end at which a track is and not at the other one, where noise explains that.

    sigma : of the measurement
    own   : direction of the track
    """
    beyond = nu + float(np.rint(own - nu))
    return beyond if abs(beyond) < 0.5 + _BEYOND * sigma else nu


def angle_bin(nu: ArrayLike, n_bin: int) -> NDArray[np.int64]:
    """Index of the bin whose centre is nearest to nu, 0 .. n_bin-1; (...) -> (...)."""
    return np.floor((np.asarray(nu) + 0.5) * (n_bin - 1) + 0.5).astype(np.int64)


def across_km(mean: NDArray[np.float64], covariance: NDArray[np.float64]) -> float:
    """Standard deviation of a place across the line of sight, km; of mean (4,) and covariance (4, 4) of its state."""
    x, y = float(mean[0]), float(mean[2])
    range_km = max(math.hypot(x, y), _NEAR_KM)
    c, s = x / range_km, y / range_km
    xx, xy, yy = covariance[0, 0], covariance[0, 2], covariance[2, 2]
    return math.sqrt(max(float(s * s * xx - 2.0 * c * s * xy + c * c * yy), 0.0))
