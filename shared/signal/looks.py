"""What the receiver tests in one direction: a cell, or one in each of some range cells; and what it reports of them."""

import math
from collections.abc import Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.elementwise import modulus
from cogradar.shared.signal.array import bin_centres
from cogradar.shared.signal.receiver import Cell

NO_RANGE = -1  # number of the range cell where there are none
NEIGHBOURS = 1.5  # range cells, or lobes, between two looks that may both have the echo of one target
IN_PHASE = 3.0  # standard deviations of an amplitude in quadrature to another of the same echo
_TINY = 1e-300
_ROUNDING = 1e-9  # of a range cell: an end of a gate that is nearer to an edge is at it


def range_cells(low_km: float, high_km: float, width_km: float) -> range:
    """Numbers of the range cells that a gate touches, one at least; cell i covers [i, i + 1) widths."""
    first = math.floor(low_km / width_km + _ROUNDING)
    return range(first, max(math.ceil(high_km / width_km - _ROUNDING), first + 1))


def n_range_cells(low_km: float, high_km: float, width_km: float) -> int:
    """How many cells one direction has in a gate: 1 without range cells."""
    return len(range_cells(low_km, high_km, width_km)) if width_km > 0.0 else 1


def range_cell_centre(i: int, width_km: float) -> float:
    """Middle of a range cell, km."""
    return (i + 0.5) * width_km


def directions_everywhere(n_bin: int, range_cell_km: float) -> NDArray[np.float64]:
    """Directions of the looks while power goes everywhere, (n,) ascending: the centres of the bins.

    With range cells two a bin, a quarter of it to either side, and one is reported. Thresholds are higher then, and a
    target at a border would be met with a sixth of its power. (Without, the tracker reads what a cell says of a target
    in all scans, which takes one direction.)
    """
    centres = bin_centres(n_bin)
    if not 0.0 < range_cell_km < np.inf:
        return centres
    quarter = 0.25 / (n_bin - 1)
    return np.clip(np.stack((centres - quarter, centres + quarter), axis=-1).ravel(), -0.5, 0.5)


class Look(NamedTuple):
    """A direction in which cells are tested in one dwell."""

    nu: float  # spatial frequency
    bin: int  # the nearest one
    cells: Sequence[int]  # numbers of the range cells; empty: one cell for all ranges
    limit: float  # that each statistic is compared with
    is_merged: bool = False  # of all such looks of a bin the largest statistic is reported


class Measured(NamedTuple):
    """A cell of a look, and what was measured in it."""

    look: Look
    cell: Cell
    range_km: float  # centre of its range cell; 0: there is none
    nu_hat: float  # direction of the echo; the look's if it was not measured
    nu_sigma: float  # standard deviation of its error; 0: not measured


def reported(cells: Sequence[Measured], straddled_km: float = 0.0) -> list[Measured]:
    """What is reported of all cells of a dwell, by direction.

    Of each look the largest statistic, and all others that are over the limit, largest first; of looks that are merged
    only the largest of each bin. A target between two range cells echoes in both, in phase: the weaker one is left out.

    straddled_km : width of a range cell, if an echo may be in two; 0: it may not
    """
    rows = []
    for merged in (True, False):
        chosen = [one for one in cells if one.look.is_merged == merged]
        for _, group in groupby(chosen, key=lambda one: one.look.bin if one.look.is_merged else one.look):
            first, *others = sorted(group, key=lambda one: -one.cell.statistic)
            kept = [first]
            for one in others:
                is_hit = one.cell.statistic >= one.look.limit and not merged
                if is_hit and not any(_is_of_one_echo(other, one, straddled_km) for other in kept):
                    kept.append(one)
            rows += kept
    return sorted(rows, key=lambda one: one.look.nu)


def _is_of_one_echo(stronger: Measured, weaker: Measured, straddled_km: float) -> bool:
    """Whether two cells of a look may have the echo of one target: neighbours in range, amplitudes in phase."""
    is_beside = 0.0 < abs(stronger.range_km - weaker.range_km) < NEIGHBOURS * straddled_km
    own, other = weaker.cell.alpha_hat, stronger.cell.alpha_hat
    # Of `own` times the conjugate of the other, by the parts: a compiler of Python may contract its own product.
    along, across = own.real * other.real + own.imag * other.imag, own.imag * other.real - own.real * other.imag
    quadrature = abs(across) / max(modulus(other), _TINY)
    return is_beside and along > 0.0 and quadrature <= IN_PHASE * weaker.cell.sigma_hat
