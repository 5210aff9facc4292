"""What the receiver tests in one direction: a cell, or one in each of some range cells; and what it reports of them."""

import math
from collections.abc import Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.signal.array import bin_centres
from cogradar.shared.signal.monopulse import direction, flat_ratio_sigma, ratio, ratio_sigma
from cogradar.shared.signal.receiver import Cell, wald_test
from cogradar.shared.signal.waveform import Signatures

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

    With range cells two a bin, a quarter of it to either side, of which one is reported: thresholds are higher then,
    and a target at a border would be met with a sixth of its power. (Without, the tracker reads what a cell says of a
    target in all scans, which takes one direction.)
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
    nu_hat: float  # direction of the echo; that of the look if it was not measured
    nu_sigma: float  # standard deviation of its error; 0: not measured


def measure(
    look: Look,
    y: NDArray[np.complex128],
    range_km: float,
    signatures: Signatures,
    *,
    is_steered: bool,
    monopulse: bool,
) -> Measured:
    """Test one cell of a look, and if it is over the limit of a steered cell measure the direction of its echo.

    What the cell's signature does not match of an echo off its axis is in the residual, and makes sigma_hat too large:
    r then is at most some sqrt(N D^4 / ((1 - D^4) (2 l + 1))), D^2 the two-way loss, however strong the echo. So once
    its direction is measured, sigma_hat is that of what the echo from there leaves; alpha_hat stays that of the cell.

    y        : (n_tx n_rx,) complex, echo (`wald_test`)
    range_km : centre of the range cell; 0: there is none
    """
    signature = signatures.at(look.nu)
    cell, n = wald_test(y, *signature), signature[1].size
    if not is_steered or cell.statistic < look.limit:
        return Measured(look, cell, range_km, look.nu, 0.0)
    rho = ratio(y, *signature)
    nu_hat, _ = direction(look.nu, rho, 0.0, n)
    v = np.kron(*signatures.at(nu_hat))
    noise = y - np.vdot(v, y) / np.vdot(v, v) * v
    cell = cell._replace(sigma_hat=wald_test(noise, *signature).sigma_hat or cell.sigma_hat)
    if not monopulse:
        return Measured(look, cell, range_km, look.nu, 0.0)
    rho_sigma = ratio_sigma(noise, *signature, rho, cell.alpha_hat)
    if rho_sigma == 0.0:  # the estimate was not positive semidefinite
        rho_sigma = flat_ratio_sigma(rho, abs(cell.alpha_hat) / cell.sigma_hat, n)
    return Measured(look, cell, range_km, *direction(look.nu, rho, rho_sigma, n))


def reported(measured: Sequence[Measured]) -> list[Measured]:
    """What is reported of all cells of a dwell, by direction.

    Of each look the largest statistic, and all others that are over the limit, largest first; of looks that are merged
    only the largest of each bin.
    """
    rows = []
    for merged in (True, False):
        chosen = [one for one in measured if one.look.is_merged == merged]
        for _, group in groupby(chosen, key=lambda one: one.look.bin if one.look.is_merged else one.look):
            first, *others = sorted(group, key=lambda one: -one.cell.statistic)
            rows += [first, *(one for one in others if one.cell.statistic >= one.look.limit and not merged)]
    return sorted(rows, key=lambda one: one.look.nu)
