"""How well a run, or many, went: detection probability, errors and their intervals, consistency, loss.

States are [x, vx, y, vy] in km and km/s, along the last axis.
"""

from collections.abc import Callable
from math import inf
from statistics import NormalDist
from typing import Any, NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cogradar.shared.numerics.constants import G_KM_S2
from cogradar.shared.scoring.columns import TargetDwell

Floats = NDArray[np.float64]

LOST_WINDOW = 20  # dwells of an outage at the end of a run that make a track lost,
LONG_OUTAGE = 60  # ... and of one anywhere in it
NEES_99 = 13.276704135987622  # 99 % of a chi-square distribution with four degrees of freedom


class Flight(NamedTuple):
    """How a target flies in a dwell, by its true acceleration: low_g <= acceleration < high_g."""

    name: str
    low_g: float
    high_g: float


EVERY = Flight("all", -inf, inf)  # also a dwell of which the acceleration is not known
FLIGHTS = (
    EVERY,
    Flight("straight", 0.0, 0.1),
    Flight("0.1-1 g", 0.1, 1.0),
    Flight("1-3 g", 1.0, 3.0),
    Flight("over 3 g", 3.0, inf),
)


@overload
def wilson_interval(hits: int, n: int, confidence: float = 0.95) -> tuple[float, float]: ...
@overload
def wilson_interval(hits: ArrayLike, n: ArrayLike, confidence: float = 0.95) -> tuple[Floats, Floats]: ...
def wilson_interval(hits: ArrayLike, n: ArrayLike, confidence: float = 0.95) -> tuple[Any, Any]:
    """Wilson score interval of a probability.

        |hits/n - p| <= z sqrt(p (1 - p) / n),   z = Phi^-1((1 + confidence) / 2)                  (Wilson 1927)

    hits, n : (...), 0 <= hits <= n; n = 0 tells nothing and gives (0, 1)
    returns : low, high (...), the solutions p of the equality
    """
    hits, n = np.asarray(hits, dtype=np.float64), np.asarray(n, dtype=np.float64)
    z = NormalDist().inv_cdf(0.5 * (1.0 + confidence))
    centre = (hits + 0.5 * z**2) / (n + z**2)
    half = z * np.sqrt(hits * (n - hits) / np.maximum(n, 1.0) + 0.25 * z**2) / (n + z**2)
    # At hits = 0 and hits = n the ends are 0 and 1; say so exactly.
    low = np.where(hits == 0, 0.0, np.maximum(centre - half, 0.0))
    high = np.where(hits == n, 1.0, np.minimum(centre + half, 1.0))
    return low[()], high[()]  # numbers for numbers


def position_error(estimates: ArrayLike, truths: ArrayLike) -> Floats:
    """Distance between estimate and truth, km; (..., 4), (..., 4) -> (...)."""
    d = np.asarray(estimates, dtype=np.float64) - np.asarray(truths, dtype=np.float64)
    return np.asarray(np.hypot(d[..., 0], d[..., 2]))


def velocity_error(estimates: ArrayLike, truths: ArrayLike) -> Floats:
    """Length of the velocity difference, km/s; (..., 4), (..., 4) -> (...)."""
    d = np.asarray(estimates, dtype=np.float64) - np.asarray(truths, dtype=np.float64)
    return np.asarray(np.hypot(d[..., 1], d[..., 3]))


def nees(error: ArrayLike, covariance: ArrayLike) -> float | None:
    """Normalised estimation error squared, e^T P^{-1} e                     (Bar-Shalom et al. 2001, section 5.4).

    error      : (4,) of the mean of a belief, [x, vx, y, vy] in km and km/s
    covariance : (4, 4) of the belief, P
    returns    : 4 on average if the belief is what it claims to be; None if it spans no volume
    """
    e, p = np.asarray(error, dtype=np.float64), np.asarray(covariance, dtype=np.float64)
    try:
        value = float(e @ np.linalg.solve(p, e))
    except np.linalg.LinAlgError:
        return None
    return value if value >= 0.0 else None


def nees_of(dwell: TargetDwell) -> float | None:
    """NEES of the whole state of a target's track in a dwell."""
    error = _error_of(dwell)
    return None if error is None or dwell.covariance is None else nees(error, dwell.covariance)


def nees_position(dwell: TargetDwell) -> float | None:
    """NEES of the position alone, 2 on average of an honest belief."""
    return _nees_of_pair(dwell, 0, 2)


def nees_velocity(dwell: TargetDwell) -> float | None:
    """NEES of the velocity alone, 2 on average of an honest belief."""
    return _nees_of_pair(dwell, 1, 3)


def _nees_of_pair(dwell: TargetDwell, i: int, j: int) -> float | None:
    """NEES of two components of the state, in closed form: every dwell of every target is scored."""
    error = _error_of(dwell)
    if error is None or dwell.covariance is None:
        return None
    p = dwell.covariance
    a, b, c = float(p[i, i]), float(p[i, j]), float(p[j, j])
    determinant = a * c - b * b
    if determinant <= 0.0:
        return None
    value = (c * error[i] ** 2 - 2.0 * b * error[i] * error[j] + a * error[j] ** 2) / determinant
    return value if value >= 0.0 else None


def _error_of(dwell: TargetDwell) -> list[float] | None:
    """Estimate minus truth, [x, vx, y, vy]; None if either is unknown."""
    estimate = dwell.x_hat, dwell.vx_hat, dwell.y_hat, dwell.vy_hat
    pairs = zip(estimate, (dwell.x, dwell.vx, dwell.y, dwell.vy), strict=True)
    error = [e - s for e, s in pairs if e is not None and s is not None]
    return error if len(error) == len(estimate) else None


def acceleration_g(before: ArrayLike, velocities: ArrayLike, elapsed_s: float) -> Floats:
    """Mean acceleration between two moments: the finite difference of the velocity, in g.

        |v(t) - v(t - T)| / T

    Of a recorded trajectory no more is known. In a steady turn through the angle a it is 2 sin(a/2) / a of the
    acceleration: 0.96 of it for a = 1 rad.

    before, velocities : (..., 2), km/s
    elapsed_s          : > 0, T
    returns            : (...)
    """
    d = np.asarray(velocities, dtype=np.float64) - np.asarray(before, dtype=np.float64)
    return np.asarray(np.hypot(d[..., 0], d[..., 1]) / max(elapsed_s * G_KM_S2, 1e-300))


def rmse(errors: ArrayLike, axis: int | tuple[int, ...] | None = 0) -> Floats:
    """Root of the mean squared error over `axis`; runs come first. NaN, of a target without a track, is left out."""
    squares = np.asarray(errors, dtype=np.float64) ** 2
    is_known = ~np.isnan(squares)
    with np.errstate(invalid="ignore"):  # 0/0: nothing is known
        return np.asarray(np.sqrt(np.sum(np.where(is_known, squares, 0.0), axis=axis) / np.sum(is_known, axis=axis)))


def bootstrap_interval(
    values: ArrayLike,
    rng: np.random.Generator,
    statistic: Callable[[Floats], Floats] = np.asarray,
    confidence: float = 0.95,
    n_resample: int = 2000,
) -> tuple[Floats, Floats]:
    """Percentile bootstrap over runs of a function of means (Efron 1979).

    values    : (n_run, ...), one row per run; rows are drawn together, so columns of one run stay paired; NaN: unknown
    statistic : from means over the runs, (n_resample, ...), to what is asked for, (n_resample, ...)
    returns   : low, high (...)

    RMSE: values = error**2, statistic = np.sqrt. Difference of two strategies' RMSE: stack their squared errors in a
    last axis, statistic = sqrt(m[..., 0]) - sqrt(m[..., 1]). Difference of P_D: values = differences of the hits.
    """
    values = np.asarray(values, dtype=np.float64)
    n_run = values.shape[0]
    counts = rng.multinomial(n_run, np.full(n_run, 1.0 / n_run), size=n_resample)
    is_known = ~np.isnan(values)
    means = np.tensordot(counts / n_run, np.where(is_known, values, 0.0), axes=1)
    if not is_known.all():
        with np.errstate(invalid="ignore"):
            means /= np.tensordot(counts / n_run, is_known, axes=1)
    tail = 0.5 * (1.0 - confidence)
    low, high = np.quantile(statistic(means), [tail, 1.0 - tail], axis=0)
    return np.asarray(low), np.asarray(high)


def lost(outages: ArrayLike) -> NDArray[np.bool_]:
    """Is a track lost: out of its target's bin for the last 20 dwells, or for any 60 in a row.

    outages : (..., T) dwells in a row, up to this one, that a track is out of the bin (with joint looks: by 2 or more),
              NaN while the target is not there. Of less than 20 dwells with it all must be out
    returns : (...) bool
    """
    outages = np.asarray(outages, dtype=np.float64)
    if not outages.shape[-1]:
        return np.zeros(outages.shape[:-1], dtype=np.bool_)
    there = ~np.isnan(outages)
    last = outages.shape[-1] - 1 - np.argmax(there[..., ::-1], axis=-1)  # dwell with the target
    at_end = np.take_along_axis(outages, last[..., np.newaxis], axis=-1)[..., 0]  # NaN if there is none
    is_out = at_end >= np.minimum(LOST_WINDOW, there.sum(axis=-1))
    return np.asarray(is_out | (np.nan_to_num(outages).max(axis=-1) >= LONG_OUTAGE))


def nees_in_band(values: ArrayLike) -> Floats:
    """Share of dwells in which the mean NEES over runs lies in `nees_band`.

    values  : (n_run, T, ...), NaN: unknown
    returns : (...); .95 of an honest belief
    """
    found = np.asarray(values, dtype=np.float64)
    is_known = ~np.isnan(found)
    n = np.maximum(is_known.sum(axis=0), 1)
    mean = np.where(is_known, found, 0.0).sum(axis=0) / n
    low, high = nees_band(n)
    return np.asarray(((mean >= low) & (mean <= high)).mean(axis=0))


def nees_band(n: ArrayLike) -> tuple[Floats, Floats]:
    """The 95 % band of the mean NEES over n runs, if their beliefs are what they claim to be; (...) -> (...), (...).

    chi2_{4n}(.025)/n <= mean <= chi2_{4n}(.975)/n                 (Bar-Shalom et al. 2001, section 5.4)
    """
    from scipy.special import chdtri  # the inverse of the upper tail; not loaded for other scores

    n = np.asarray(n, dtype=np.float64)
    return np.asarray(chdtri(4.0 * n, 0.975) / n), np.asarray(chdtri(4.0 * n, 0.025) / n)
