"""Cells and power of all tracks together: where the most detections are to be expected.

Symbols: i candidate cell of any track, p_i chance that its target is there, g_i gain of a look, w_i beam power, P all
of it; zeta = g w; f(zeta) = Q_1(sqrt zeta, sqrt lambda) probability of detection; mu price of power.

    maximise  sum_i p_i f(g_i w_i)   subject to  sum_i w_i = P,  w_i >= 0

f is convex up to its bend and concave above: a little power is worth less than none, so that some cells stay dark. At a
price mu each cell buys either nothing or the zeta above the bend where p g f'(zeta) = mu, the latter if the chord from
f(0) is steeper than mu / (p g): the optimum of the concave envelope, a bound for all allocations. What it leaves to
decide are cells whose choice costs less than the gap to that bound; their subsets are tried. Beams point at centres of
bins, which are nearly orthogonal: what one beam sends into another's cell, and two tracks in one cell, are not reckoned
with.
"""

from functools import lru_cache
from math import log, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize_scalar
from scipy.special import i1e

from shared.numerics.jit import inlined, kernel
from shared.power.rules import Emission, Requests
from shared.scenario.radar_config import RadarConfig
from shared.signal.array import bin_centres
from shared.signal.receiver import detection_probability, threshold
from shared.signal.waveform import beam_factor

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

# Below, a cell beside a track's first one stays dark: what it adds to the detections is less than what its power adds,
# on the first one, to what is known of the range.
LEAST_CHANCE = 0.01
CORE = 10  # cells whose subsets are tried
MAX_TRIES = 64  # of them, at most
CLOSE = 1e-4  # detections: a smaller gap to the bound is none
_STEPS = 128  # of a table per unit
_BEYOND = 9.0  # in sqrt zeta, above sqrt lambda: P_D is 1 there to double precision


class Curve(NamedTuple):
    """f and the inverse of its slope above the bend. Both are tables over equal steps; s = sqrt zeta.

    s is a function of t = sqrt(ln f'(bend) - ln f'(zeta)), 0 at the bend and nearly a straight line.
    """

    f: Floats  # over s from 0
    s: Floats  # over t from 0
    steepest: float  # ln f'(bend)
    t_chord: float  # where the chord from f(0) is the tangent: from here on a look is worth its price
    s_chord: float


@lru_cache(maxsize=16)
def curve_of(limit: float) -> Curve:
    """The curve of a threshold lambda > 4: below, f is concave everywhere (P_FA above 0.135)."""

    def log_slope(zeta: float) -> float:
        # f'(zeta) = 1/2 sqrt(lambda / zeta) exp(-(lambda + zeta) / 2) I_1(sqrt(lambda zeta))
        return log(0.5 * sqrt(limit / zeta) * i1e(sqrt(limit * zeta))) - 0.5 * (sqrt(limit) - sqrt(zeta)) ** 2

    def f(zeta: float) -> float:
        return float(detection_probability(zeta, limit))

    bend = float(minimize_scalar(lambda zeta: -log_slope(zeta), bounds=(1e-9, 2.0 * limit), method="bounded").x)
    chord = float(
        brentq(lambda zeta: f(zeta) - f(0.0) - zeta * np.exp(log_slope(zeta)), bend * (1.0 + 1e-6), 4.0 * limit + 40.0)
    )
    s = np.arange(0.0, sqrt(limit) + _BEYOND, 1.0 / _STEPS)
    upper = np.concatenate(([sqrt(bend)], s[s > sqrt(bend)]))
    t = np.sqrt(np.maximum(log_slope(bend) - np.array([log_slope(one * one) for one in upper]), 0.0))
    steps = np.arange(0.0, t[-1], 1.0 / _STEPS)
    t_chord = sqrt(log_slope(bend) - log_slope(chord))
    return Curve(
        np.asarray(detection_probability(s * s, limit)),
        np.interp(steps, t, upper),
        log_slope(bend),
        t_chord,
        sqrt(chord),
    )


class Bought(NamedTuple):
    """Powers of candidate cells."""

    powers: Floats  # (n,) >= 0, sum P; 0: dark
    detections: float  # sum_i p_i f(g_i w_i), expected
    bound: float  # no allocation has more
    is_optimal: bool  # the bound is met, or all that could be better was tried


def most_detections(curve: Curve, chances: Floats, gains: Floats, power: float) -> Bought:
    """Powers of candidate cells, (n,) chances and (n,) gains, for the most expected detections."""
    powers, best, bound, is_optimal = _solve(curve, chances, gains, power)
    return Bought(powers, best, bound, is_optimal)


def detections(radar: RadarConfig, requests: Requests) -> Emission:
    """Most detections expected now, over all cells that tracks ask for."""
    return _emitted(radar, requests, np.arange(requests.ranges_km.size))


def urgency(radar: RadarConfig, requests: Requests) -> Emission:
    """A few bright looks: tracks that will be least known some dwells ahead first, as many as the power suffices for.

    Bright is the power at which a look at the most probable cell yields the most detections per power. Among the cells
    of the tracks chosen so it is `detections`; the others are dark in this dwell.
    """
    bright = curve_of(threshold(radar.detector.p_fa)).s_chord ** 2
    needs = bright / np.maximum(requests.gains, np.finfo(np.float64).tiny)
    lit, left = list[int](), radar.array.power
    for m in np.argsort(requests.outlooks, kind="stable"):
        if needs[m] <= left:
            lit.append(int(m))
            left -= needs[m]
    return _emitted(radar, requests, np.array(lit or range(needs.size)))


def _emitted(radar: RadarConfig, requests: Requests, tracks: Ints) -> Emission:
    """The waveform with the most expected detections of these tracks, (n,)."""
    array = radar.array
    shares = np.zeros(requests.bins.shape)
    pays = requests.chances[tracks] > LEAST_CHANCE
    pays[:, 0] = True
    rows, columns = np.nonzero(pays)
    rows = tracks[rows]
    bought = most_detections(
        curve_of(threshold(radar.detector.p_fa)), requests.chances[rows, columns], requests.gains[rows], array.power
    )
    shares[rows, columns] = bought.powers
    order = np.argsort(-shares, axis=1, kind="stable")
    shares = np.take_along_axis(shares, order, axis=1)
    beams = np.where(shares > 0.0, np.take_along_axis(requests.bins, order, axis=1), -1).astype(np.int32)
    n = int((shares > 0.0).sum(axis=1).max())
    is_lit = shares > 0.0
    factor = beam_factor(bin_centres(array.n_bin)[beams[is_lit]], shares[is_lit], array.n_tx)
    status = "optimal" if bought.is_optimal else "inaccurate"
    return Emission(0.0, factor, beams[:, :n].copy(), shares[:, :n].copy(), status)


@inlined
def _detected(curve: Curve, zeta: float) -> float:
    """f(zeta)."""
    x = np.sqrt(zeta) * _STEPS
    i = int(min(x, 1e6))
    if i >= curve.f.size - 1:
        return 1.0
    return float(curve.f[i] + (x - i) * (curve.f[i + 1] - curve.f[i]))


@inlined
def _wanted(curve: Curve, t: float) -> float:
    """zeta above the bend at t; beyond the table s goes on as a straight line."""
    x = t * _STEPS
    i = int(min(x, curve.s.size - 2))
    s = curve.s[i] + (x - i) * (curve.s[i + 1] - curve.s[i])
    return float(s * s)


@kernel
def _spent(curve: Curve, log_worth: Floats, gains: Floats, is_in: Bools, level: float) -> float:
    """Power that these cells buy at the price exp(-level); none below the bend."""
    total = 0.0
    for i in range(gains.size):
        if is_in[i]:
            total += _wanted(curve, np.sqrt(max(level + log_worth[i], 0.0))) / gains[i]
    return total


@kernel
def _shared_out(
    curve: Curve, log_worth: Floats, gains: Floats, is_in: Bools, power: float
) -> tuple[bool, float, Floats]:
    """All the power over these cells at one price: whether it suffices for all above the bend, -ln price, powers."""
    powers = np.zeros(gains.size)
    low, n = -np.inf, 0
    for i in range(gains.size):
        if is_in[i]:
            low, n = max(low, -log_worth[i]), n + 1
    if n == 0 or (n > 1 and _spent(curve, log_worth, gains, is_in, low) > power):
        return False, 0.0, powers
    step, high = 1.0, low
    while _spent(curve, log_worth, gains, is_in, high) < power:
        low, high, step = high, high + step, 2.0 * step
    for _ in range(40):
        middle = 0.5 * (low + high)
        if _spent(curve, log_worth, gains, is_in, middle) < power:
            low = middle
        else:
            high = middle
    total = 0.0
    for i in range(gains.size):
        if is_in[i]:
            powers[i] = _wanted(curve, np.sqrt(max(high + log_worth[i], 0.0))) / gains[i]
            total += powers[i]
    return True, high, powers * (power / total)


@kernel
def _expected(curve: Curve, chances: Floats, gains: Floats, powers: Floats) -> float:
    """Expected detections."""
    total = 0.0
    for i in range(gains.size):
        total += chances[i] * _detected(curve, gains[i] * powers[i])
    return total


@kernel
def _envelope(curve: Curve, log_worth: Floats, gains: Floats, power: float) -> float:
    """-ln price at which the cells that are worth their price buy all the power, or would with the next one."""
    order = np.argsort(-log_worth)
    is_in = np.zeros(gains.size, dtype=np.bool_)
    for i in order:
        level = curve.t_chord**2 - log_worth[i]  # from here on cell i is worth it
        if _spent(curve, log_worth, gains, is_in, level) >= power:
            break
        is_in[i] = True
        if _spent(curve, log_worth, gains, is_in, level) >= power:
            return float(level)
    return _shared_out(curve, log_worth, gains, is_in, power)[1]


@kernel
def _solve(curve: Curve, chances: Floats, gains: Floats, power: float) -> tuple[Floats, float, float, bool]:
    """Powers, expected detections, their bound, whether it is the optimum."""
    n = gains.size
    worth = np.maximum(chances, 1e-12) * np.maximum(gains, 1e-12)
    log_worth, safe = np.log(worth) + curve.steepest, np.maximum(gains, 1e-12)
    level = _envelope(curve, log_worth, safe, power)
    price, nothing = np.exp(-level), curve.f[0]
    losses, is_in = np.zeros(n), np.zeros(n, dtype=np.bool_)
    bound = price * power
    for i in range(n):  # what a look buys at this price, and what it costs to decide otherwise
        zeta = _wanted(curve, np.sqrt(max(level + log_worth[i], 0.0)))
        profit = chances[i] * (_detected(curve, zeta) - nothing) - price * zeta / safe[i]
        bound += chances[i] * nothing + max(profit, 0.0)
        losses[i], is_in[i] = abs(profit), profit > 0.0
    best, powers = -1.0, np.zeros(n)
    for i in range(n):  # one look with all the power is always there
        value = chances[i] * _detected(curve, safe[i] * power)
        if value > best:
            best = value
            powers[:] = 0.0
            powers[i] = power
    best = _expected(curve, chances, safe, powers)
    core = np.argsort(losses)[: min(CORE, n)]
    costs = np.zeros(1 << core.size)
    for subset in range(costs.size):
        for j in range(core.size):
            if subset >> j & 1:
                costs[subset] += losses[core[j]]
    tries = 0
    for subset in np.argsort(costs):
        if costs[subset] > bound - best - CLOSE or tries == MAX_TRIES:
            break
        tries += 1
        chosen = is_in.copy()
        for j in range(core.size):
            if subset >> j & 1:
                chosen[core[j]] = not chosen[core[j]]
        is_enough, _, found = _shared_out(curve, log_worth, safe, chosen, power)
        value = _expected(curve, chances, safe, found) if is_enough else -1.0
        if value > best:
            best, powers = value, found
    left = bound - best - CLOSE
    is_optimal = left <= 0.0 or (tries < MAX_TRIES and (core.size == n or np.sort(losses)[core.size] > left))
    return powers, best, bound, is_optimal
