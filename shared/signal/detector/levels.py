"""The noise of a look from other range cells of its dwell: for what one data set cannot tell of itself.

A line in one direction that is coherent along transmit and receive channels looks like an echo in each data set. Only
other range cells say that it is there everywhere. Range cells differ in their level, though: sea clutter has a texture.
So a look's amplitude in range cell i, without a target, is taken to be complex Gaussian with

    E |alpha_i|^2 = A + rho t_i

t_i : level of a range cell, median over ln 2 of its two-dimensional spectrum with a Hann window in both directions:
      a line is in few points of it
A, rho : of the look, from M other range cells by expectation and maximisation. Alpha is the sum of a part with variance
      A, the same in all of them, and of one with rho t_i

A target in another range cell is left out by its power, CENSORED times what is expected: of noise one in e^CENSORED.
Lambda / 2 = |alpha|^2 / (A + rho t_i) has about an F distribution with 2 and 2 nu degrees of freedom. Here is 1 / nu =
1 / (M - 2) + LEVEL_SPREAD / (n_tx n_rx). It is reported as the chi-square of the same probability.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.elementwise import squared_modulus
from cogradar.shared.numerics.fourier import fourier
from cogradar.shared.numerics.jit import kernel

Complexes = NDArray[np.complex128]
Floats = NDArray[np.float64]

MOST_REFERENCES = 64  # range cells: with half as many the threshold is 0.3 dB higher
FEWEST_REFERENCES = 16
CENSORED = 7.0
LEVEL_SPREAD = 5.0  # squared relative error of a level times the number of channels
_ROUNDS = 40
_TINY = 1e-300
_LEAST = 1e-150  # power: its square is no 0


class Levels(NamedTuple):
    """Of n looks, (n,) each."""

    constant: Floats  # A
    per_level: Floats  # rho
    dof: Floats  # nu

    def of(self, rows: NDArray[np.int64]) -> "Levels":
        """Of some of the looks."""
        return Levels(*(column[rows] for column in self))


def references(range_cells: Sequence[int]) -> Sequence[int]:
    """The range cells that levels are estimated from: at most MOST_REFERENCES of these, at equal steps."""
    return range_cells[:: -(-len(range_cells) // MOST_REFERENCES)]


def level_of(y: Complexes, n_rx: int) -> float:
    """Level t of a data set, (n_tx n_rx,): mean power of an element of noise alone."""
    data = y.reshape(-1, n_rx)
    window = np.multiply.outer(*(np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 2 for n in data.shape))
    spectrum = squared_modulus(fourier(fourier(data * window).T))
    return float(np.median(spectrum) / (math.log(2.0) * np.sum(window**2)))


def range_levels(powers: Floats, levels: Floats, n_channel: int) -> Levels:
    """A, rho and nu of looks from other range cells.

    powers : (M, n) |alpha_hat|^2 of each look in each of them
    levels : (M,) t of each
    """
    constant, per_level, kept = _expected(np.ascontiguousarray(powers.T), levels)
    return Levels(constant, per_level, 1.0 / (1.0 / np.maximum(kept - 2.0, 1.0) + LEVEL_SPREAD / n_channel))


@kernel
def _expected(powers: Floats, levels: Floats) -> tuple[Floats, Floats, Floats]:
    """A, rho and the number of range cells that were not left out; powers: (n, M)."""
    n, m = powers.shape
    constant, per_level, kept = np.empty(n), np.empty(n), np.empty(n)
    share = 1.0 - CENSORED * np.exp(-CENSORED) / (1.0 - np.exp(-CENSORED))  # of the mean that is left below CENSORED
    relative = np.empty(m)
    for look in range(n):
        p = powers[look]
        for j in range(m):
            relative[j] = p[j] / max(levels[j], _TINY)
        # Where levels are alike, A and rho are one: the start decides that it is rho.
        a, rho = 0.1 * np.median(p) / np.log(2.0), 0.9 * np.median(relative) / np.log(2.0)
        for _ in range(_ROUNDS):
            sum_a, sum_rho, count = 0.0, 0.0, 0.0
            for j in range(m):
                own = rho * levels[j]
                total = max(a + own, _LEAST)
                if p[j] < CENSORED * total:
                    both, power = a * own / total, p[j] / share / total / total
                    sum_a += a * a * power + both
                    sum_rho += (own * own * power + both) / max(levels[j], _TINY)
                    count += 1.0
            a, rho = sum_a / max(count, 1.0), sum_rho / max(count, 1.0)
        constant[look], per_level[look], kept[look] = a, rho, count
    return constant, per_level, kept
