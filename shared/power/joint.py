"""Cells and power of all tracks together: where the most detections are to be expected.

Symbols: i candidate cell of any track, p_i chance that its target is there, g_i gain of a look, w_i beam power, P all
of it; zeta = g w; f(zeta) probability of detection, Q_1(sqrt zeta, sqrt lambda) if the RCS is known; mu price of power.

    maximise  sum_i p_i f(g_i w_i)   subject to  sum_i w_i = P,  w_i >= 0

f is convex up to its bend and concave above: a little power is worth less than none, so that some cells stay dark. At a
price mu each cell buys either nothing or the zeta above the bend where p g f'(zeta) = mu, the latter if the chord from
f(0) is steeper than mu / (p g). This is the optimum of the concave envelope, a bound for all allocations. What it
leaves to decide are cells whose choice costs less than the gap to that bound; their subsets are tried. At the optimum
all lit cells have one price, and at most one is below the bend: of two, the one would give the other its power. So each
subset is tried above the bend, and with one more cell that gets what the others hardly need. Beams at centres of bins
are nearly orthogonal: what one beam sends into another's cell, and two tracks in one cell, are not reckoned with.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.elementwise import log
from cogradar.shared.numerics.jit import inlined, kernel
from cogradar.shared.power.curve import Curve, detected, wanted

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

CORE = 10  # cells whose subsets are tried
MAX_TRIES = 64  # of them, at most, and as many of one more cell with what they leave
CLOSE = 1e-4  # detections: a smaller gap to the bound is none
LEAST_GAIN = 1e-12
GRID, ZOOMS = 32, 4  # steps and repeats of the search for one cell's power


class Bought(NamedTuple):
    """Powers of candidate cells."""

    powers: Floats  # (n,) >= 0, sum P; 0: dark
    detections: float  # sum_i p_i f(g_i w_i), expected
    bound: float  # no allocation has more
    is_optimal: bool  # the bound is met, or all that could be better was tried


def most_detections(curve: Curve, chances: Floats, gains: Floats, power: float) -> Bought:
    """Powers of candidate cells, (n,) chances and (n,) gains, for the most expected detections."""
    safe = np.maximum(gains, LEAST_GAIN)
    log_worth = log(np.maximum(chances, 1e-12) * safe) + curve.steepest
    return Bought(*_solve(curve, _Cells(chances, safe, log_worth), power))


class _Cells(NamedTuple):
    """The candidates, (n,) each."""

    chances: Floats
    gains: Floats  # > 0
    log_worth: Floats  # ln of the slope over the power at the bend


@kernel
def _spent(curve: Curve, cells: _Cells, is_in: Bools, level: float) -> float:
    """Power that these cells buy at the price exp(-level); none below the bend."""
    total = 0.0
    for i in range(is_in.size):
        if is_in[i]:
            total += wanted(curve, np.sqrt(max(level + cells.log_worth[i], 0.0))) / cells.gains[i]
    return total


@inlined
def _lowest(cells: _Cells, is_in: Bools) -> float:
    """-ln of the highest price at which all of these cells are above the bend."""
    low = -np.inf
    for i in range(is_in.size):
        if is_in[i]:
            low = max(low, -cells.log_worth[i])
    return low


@kernel
def _shared_out(curve: Curve, cells: _Cells, is_in: Bools, power: float) -> tuple[bool, float, Floats]:
    """All the power over these cells at one price: whether it suffices for all above the bend, -ln price, powers."""
    powers = np.zeros(is_in.size)
    low, n = _lowest(cells, is_in), is_in.sum()
    if n == 0 or (n > 1 and _spent(curve, cells, is_in, low) > power):
        return False, 0.0, powers
    step, high = 1.0, low
    while _spent(curve, cells, is_in, high) < power:
        low, high, step = high, high + step, 2.0 * step
    for _ in range(40):
        middle = 0.5 * (low + high)
        if _spent(curve, cells, is_in, middle) < power:
            low = middle
        else:
            high = middle
    for i in range(is_in.size):
        if is_in[i]:
            powers[i] = wanted(curve, np.sqrt(max(high + cells.log_worth[i], 0.0))) / cells.gains[i]
    return True, high, powers * (power / powers.sum())


@kernel
def _expected(curve: Curve, cells: _Cells, powers: Floats) -> float:
    """Expected detections."""
    total = 0.0
    for i in range(powers.size):
        total += cells.chances[i] * detected(curve, cells.gains[i] * powers[i])
    return total


@kernel
def _hopes(curve: Curve, cells: _Cells, is_in: Bools, room: float, price: float) -> Floats:
    """What each other cell can add at most with some of this room, if below the bend; (n,).

    These cells lose at least the price for each power that is taken from them, and below the bend the other's gain is
    convex: most is to be had at the end.
    """
    hopes = np.zeros(is_in.size)
    for i in range(is_in.size):
        if not is_in[i]:
            most = min(room, curve.s[0] ** 2 / cells.gains[i])
            hopes[i] = cells.chances[i] * (detected(curve, cells.gains[i] * most) - curve.f[0]) - price * most
    return hopes


@kernel
def _with_one(curve: Curve, cells: _Cells, is_in: Bools, power: float, one: int, highest: float) -> Floats:
    """Powers if these cells, above the bend at one price of at least exp(-highest), leave the rest to one other."""
    low = _lowest(cells, is_in)
    end = np.sqrt(max(highest - low, 0.0))
    left, step, best, at, found = 0.0, end / GRID, -1.0, 0.0, np.zeros(is_in.size)
    for _ in range(ZOOMS):  # grids, each about the best of the one before
        for k in range(GRID + 1):
            root = min(left + k * step, end)
            powers = np.zeros(is_in.size)
            for i in range(is_in.size):
                if is_in[i]:
                    t = np.sqrt(max(low + root * root + cells.log_worth[i], 0.0))
                    powers[i] = wanted(curve, t) / cells.gains[i]
            powers[one] = max(power - powers.sum(), 0.0)
            value = _expected(curve, cells, powers)
            if value > best:
                best, at, found = value, root, powers
        left, step = max(at - step, 0.0), 2.0 * step / GRID
    found *= power / found.sum()
    return found


@kernel
def _envelope(curve: Curve, cells: _Cells, power: float) -> float:
    """-ln price at which the cells that are worth their price buy all the power, or would with the next one."""
    is_in = np.zeros(cells.gains.size, dtype=np.bool_)
    for i in np.argsort(-cells.log_worth):
        level = curve.t_chord**2 - cells.log_worth[i]  # from here on cell i is worth it
        if _spent(curve, cells, is_in, level) >= power:
            break
        is_in[i] = True
        if _spent(curve, cells, is_in, level) >= power:
            return float(level)
    return _shared_out(curve, cells, is_in, power)[1]


@kernel
def _priced(curve: Curve, cells: _Cells, power: float) -> tuple[float, Floats, Bools]:
    """Bound of all allocations; what it costs at least to decide otherwise of each cell, whether it is above the bend.

    Below the bend the profit is convex in the power, so that it is nowhere above the profit without power or at the
    bend.
    """
    n = cells.gains.size
    level = _envelope(curve, cells, power)
    price, nothing, bend = np.exp(-level), curve.f[0], curve.s[0] ** 2
    bound, losses, is_in = price * power, np.zeros(n), np.zeros(n, dtype=np.bool_)
    for i in range(n):
        zeta = wanted(curve, np.sqrt(max(level + cells.log_worth[i], 0.0)))
        profit = cells.chances[i] * (detected(curve, zeta) - nothing) - price * zeta / cells.gains[i]
        at_bend = cells.chances[i] * (detected(curve, bend) - nothing) - price * bend / cells.gains[i]
        bound += cells.chances[i] * nothing + max(profit, 0.0)
        losses[i], is_in[i] = (profit - max(at_bend, 0.0), True) if profit > 0.0 else (-profit, False)
    return bound, losses, is_in


@kernel
def _brightest(curve: Curve, cells: _Cells, power: float) -> Floats:
    """The best single look, with all the power."""
    values = np.zeros(cells.gains.size)
    for i in range(values.size):
        values[i] = cells.chances[i] * detected(curve, cells.gains[i] * power)
    powers = np.zeros(values.size)
    powers[np.argmax(values)] = power
    return powers


@kernel
def _costs(losses: Floats) -> Floats:
    """What it costs to decide otherwise of each subset of these cells, by the bits of its number."""
    costs = np.zeros(1 << losses.size)
    for subset in range(costs.size):
        for j in range(losses.size):
            if subset >> j & 1:
                costs[subset] += losses[j]
    return costs


@kernel
def _solve(curve: Curve, cells: _Cells, power: float) -> tuple[Floats, float, float, bool]:
    """Powers, expected detections, their bound, whether it is the optimum."""
    bound, losses, is_in = _priced(curve, cells, power)
    powers = _brightest(curve, cells, power)
    best = _expected(curve, cells, powers)
    core = np.argsort(losses)[: min(CORE, losses.size)]
    costs = _costs(losses[core])
    tries, searches = 0, 0
    for subset in np.argsort(costs):
        if costs[subset] > bound - best - CLOSE or tries == MAX_TRIES:
            break
        tries += 1
        chosen = is_in.copy()
        for j in range(core.size):
            if subset >> j & 1:
                chosen[core[j]] = not chosen[core[j]]
        is_enough, level, found = _shared_out(curve, cells, chosen, power)
        if not is_enough:
            continue
        value = _expected(curve, cells, found)
        if value > best:
            best, powers = value, found
        room = max(power - _spent(curve, cells, chosen, _lowest(cells, chosen)), 0.0)
        hopes = value + _hopes(curve, cells, chosen, room, np.exp(-level))
        for one in np.argsort(-hopes):
            if hopes[one] <= best + CLOSE or searches == MAX_TRIES:
                break
            searches += 1
            found = _with_one(curve, cells, chosen, power, one, level)
            value_with = _expected(curve, cells, found)
            if value_with > best:
                best, powers = value_with, found
    left = bound - best - CLOSE
    is_complete = max(tries, searches) < MAX_TRIES and (core.size == losses.size or np.sort(losses)[core.size] > left)
    return powers, best, bound, left <= 0.0 or is_complete
