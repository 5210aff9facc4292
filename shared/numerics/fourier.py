"""Discrete Fourier transform that gives the same bytes on every processor (ADR 42)."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.jit import kernel

Complexes = NDArray[np.complex128]


def fourier(x: Complexes, n: int | None = None) -> Complexes:
    """Transform of each row, sum_i x_i exp(-j 2 pi k i / n), (m, n) -> (m, n); shorter rows are filled up with zeros.

    Cost O(n s) a row, s the sum of the prime factors of n.
    """
    n = n or x.shape[1]
    columns = np.zeros((n, x.shape[0]), np.complex128)
    columns[: x.shape[1]] = x.T
    found = _transformed(columns.reshape(-1), x.shape[0], _factors(n), _turns(n))
    return np.ascontiguousarray(found.reshape(columns.shape).T)


@cache
def _factors(n: int) -> NDArray[np.int64]:
    """Factors of n, ascending: 4 as one, and primes."""
    found, factor = list[int](), 2
    while n > 1:
        step = 4 if n % 4 == 0 else factor
        if n % step == 0:
            found.append(step)
            n //= step
        else:
            factor += 1
    return np.array(found, np.int64)


@cache
def _turns(n: int) -> Complexes:
    """exp(-j 2 pi k / n), k = 0 .. n-1."""
    return np.asarray(np.exp(-2j * np.pi * np.arange(n) / n))


@kernel
def _transformed(x: Complexes, m: int, factors: NDArray[np.int64], turns: Complexes) -> Complexes:
    """Stockham's algorithm for m transforms at once, of x[i m + row], (n m,); x is used up."""
    y, n = np.empty_like(x), turns.size
    done, left = 1, n  # product of the factors so far and of the others
    for factor in factors:
        left //= factor
        width = m * done
        for j in range(left):
            for k in range(factor):
                at = width * (factor * j + k)
                total, first = y[at : at + width], done * j * k
                total[:] = 0.0
                for i in range(0, factor - factor % 4, 4):
                    _add_four(
                        total,
                        turns,
                        first + i * k * (n // factor),
                        k * (n // factor),
                        x[width * (j + left * i) :],
                        width * left,
                    )
                for i in range(factor - factor % 4, factor):
                    at = width * (j + left * i)
                    _add(total, turns[(first + i * k * (n // factor)) % n], x[at : at + width])
        x, y, done = y, x, done * factor
    return x


# Loops over many transforms, in functions of their own: only so does the compiler vectorise them.


@kernel
def _add_four(total: Complexes, turns: Complexes, first: int, step: int, x: Complexes, apart: int) -> None:
    """total += sum_i turns[first + i step] x[i apart :], of four terms."""
    t0, t1 = turns[first % turns.size], turns[(first + step) % turns.size]
    t2, t3 = turns[(first + 2 * step) % turns.size], turns[(first + 3 * step) % turns.size]
    x0, x1, x2, x3 = x, x[apart:], x[2 * apart :], x[3 * apart :]
    for q in range(total.size):
        total[q] += (t0 * x0[q] + t1 * x1[q]) + (t2 * x2[q] + t3 * x3[q])


@kernel
def _add(total: Complexes, turn: complex, x: Complexes) -> None:
    """total += turn x."""
    for q in range(total.size):
        total[q] += turn * x[q]
