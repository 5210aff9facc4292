"""Which directions and ranges one track asks for when its cells are steered.

Symbols: nu direction of a particle at the next dwell; D_T D_R loss of its echo off the axis of a cell; N n_rx.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.elementwise import hypot
from cogradar.shared.numerics.jit import kernel
from cogradar.shared.signal.angle import apart
from cogradar.shared.signal.array import angle_bin, bin_centres, mean_direction
from cogradar.shared.signal.response import Response
from cogradar.shared.tracking.model import TrackerModel, TrackState

Floats = NDArray[np.float64]

_PER_LOBE = 16  # places in a main lobe's half at which a cell is tried
_REFINED = 5  # steps of its direction to the mean of what it covers
_SIGMAS = 4.0  # of the predicted range, on either side, that a gate holds
_LEAST_CELLS = 4  # range cells of a gate


class Directions(NamedTuple):
    """Cells for the next dwell."""

    nus: Floats  # (c,)
    chances: Floats  # (c,) share of the belief that each covers
    loss: float  # mean of (D_T D_R)^2 there, of the first: what a look's gain is lowered by


def expected_at(model: TrackerModel, state: TrackState) -> tuple[Floats, Floats]:
    """Direction and range in km at the next dwell of a belief's sample, without noise but with turns; (n,) each."""
    return _directions_and_ranges(state.belief.expected(model, state.modes))


def directions(response: Response, nus: Floats, most: int) -> Directions:
    """The cells that cover most of a belief whose particles will be in these directions, (n,); at most so many.

    A cell covers what is within half of its lobe: beyond, an echo has lost 8 dB and more. The first is where most of
    the particles are within its reach, at the mean of what it receives. The next ones are likewise, of what is left,
    but a whole lobe from the nearest one where they would be less. Beams a lobe apart are orthogonal: with others in
    between, an echo off its axis is not lowered by D_T, and what its amplitude says of the range is wrong.
    """
    found, chances, off = _covering(nus, most, response.lobe, response.loss_table())
    lost = np.square(response.loss(off))
    return Directions(found, chances, float(np.add.reduce(lost) / lost.size) if lost.size else 1.0)


@kernel
def _covering(nus: Floats, most: int, lobe: float, loss: Floats) -> tuple[Floats, Floats, Floats]:
    """`directions`: the cells, the share of each, (c,), and how far off the axis of the first the particles in it are.

    loss : D_T D_R at equal steps from the axis to the lobe's edge
    """
    found, chances, off_axis = np.empty(most), np.empty(most), np.empty(0)
    left, n_left, n = nus.copy(), nus.size, 0
    is_around = n_left > 0 and nus.min() < lobe - 0.5 and nus.max() > 0.5 - lobe
    while n_left > 0 and n < most:
        nu = _moved_apart(_best(left[:n_left], lobe, loss), found[:n], lobe, is_around)
        off, n_covered, n_kept = np.empty(n_left), 0, 0
        for i in range(n_left):
            off_axis_by = apart(left[i], nu)
            if off_axis_by <= 0.5 * lobe:
                off[n_covered] = off_axis_by
                n_covered += 1
            else:
                left[n_kept] = left[i]
                n_kept += 1
        if n_covered == 0:
            break
        if n == 0:
            off_axis = off[:n_covered]
        found[n], chances[n], n_left, n = nu, n_covered / nus.size, n_kept, n + 1
    return found[:n], chances[:n], off_axis


@kernel
def _moved_apart(nu: float, others: Floats, lobe: float, is_around: bool) -> float:
    """A direction, moved away from the nearest of others to a lobe from it if it is nearer.

    is_around : particles are at both ends, so that it may move around them; else it stays within the field
    """
    if others.size == 0:
        return nu
    nearest, least = nu, 1.0
    for other in others:
        if apart(nu, other) < least:
            nearest, least = other + round(nu - other), apart(nu, other)
    moved = nearest + math.copysign(max(abs(nu - nearest), lobe), nu - nearest)
    return float(moved - round(moved) if is_around else min(max(moved, -0.5), 0.5))


@kernel
def _directions_and_ranges(states: Floats) -> tuple[Floats, Floats]:
    """Direction and range in km of states, (n, 4) -> (n,) each."""
    nus, ranges_km = np.zeros(states.shape[0]), np.empty(states.shape[0])
    for i in range(states.shape[0]):
        ranges_km[i] = hypot(states[i, 0], states[i, 2])
        if ranges_km[i] != 0.0:
            nus[i] = 0.5 * states[i, 2] / ranges_km[i]
    return nus, ranges_km


def direction_in(response: Response, nus: Floats, bin_: int) -> Directions:
    """The mean direction of the particles that will be in a bin, its centre if there are none.

    The bins at both ends are one.
    """
    centre = float(bin_centres(response.n_bin)[bin_])
    is_own = angle_bin(nus, response.n_bin) == bin_
    if abs(centre) == 0.5:
        is_own |= angle_bin(nus, response.n_bin) == response.n_bin - 1 - bin_
    own = nus[is_own]
    nu = mean_direction(own)[0] if own.size else centre
    loss = float((response.loss(own - nu) ** 2).mean()) if own.size else 1.0
    return Directions(np.array([nu]), np.array([own.size / nus.size]), loss)


def gate(model: TrackerModel, ranges_km: Floats, apart_km: float) -> Floats:
    """Ranges to be tested, (2,) in km, for particles that will be at these ranges; (0, 0): all.

    2^j whole cells that hold them to four standard deviations, so that there are few different limits of the test.

    apart_km : how far from them the target may be besides
    """
    width = model.response.range_cell_km
    mean = float(np.add.reduce(ranges_km)) / ranges_km.size
    reach_km = _SIGMAS * math.sqrt(np.add.reduce(np.square(ranges_km - mean)) / ranges_km.size) + apart_km
    first, last = (math.floor(max(mean + off, 0.0) / width) for off in (-reach_km, reach_km))
    n_cell = _LEAST_CELLS
    while n_cell < last - first + 1:
        n_cell *= 2
    if n_cell * width >= model.acquisition.range_max_km - model.acquisition.range_min_km:
        return np.zeros(2)
    low = max(first - (n_cell - (last - first + 1)) // 2, 0)
    return np.array([low, low + n_cell]) * width


@kernel
def _best(nus: Floats, lobe: float, loss: Floats) -> float:
    """Direction of the cell that covers most of these, (n,); `loss` is D_T D_R from the axis to the null at `lobe`."""
    step, fine = lobe / _PER_LOBE, (loss.size - 1) / lobe
    n = round(1.0 / step)  # places on the circle; the first ones follow the last ones again
    count = np.zeros(n + _PER_LOBE, dtype=np.int64)
    for nu in nus:
        place = int((nu + 0.5) / step)
        count[place + 1] += 1
        if place < _PER_LOBE - 1:
            count[n + place + 1] += 1
    count = np.cumsum(count)
    first = np.argmax(count[_PER_LOBE:] - count[:-_PER_LOBE])  # places first .. first + _PER_LOBE - 1
    best = -0.5 + (float(first) + 0.5 * _PER_LOBE) * step
    for _ in range(_REFINED):
        total, moment = 0.0, 0.0
        for nu in nus:
            position = apart(nu, best) * fine
            if position < loss.size - 1:
                weight = loss[int(position)] ** 2
                total += weight
                moment += weight * (nu + round(best - nu))  # as near to the cell as it is around the ends
        best = moment / total
    return best - round(best)
