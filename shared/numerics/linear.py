"""Linear algebra of small matrices that gives the same bytes on every processor (ADR 42).

BLAS and LAPACK order their sums by the processor that they find. Here each sum has one order on all of them: what the
compiler vectorises are independent results.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cogradar.shared.numerics.elementwise import squared_modulus
from cogradar.shared.numerics.jit import kernel

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

_STEPS = 60  # of QL for an eigenvalue, which needs two or three
_EPS = 2.0**-52
_VANISHED = 1e-140  # of the largest element: squares of what is left of a row would
_NOTHING = 1e-14  # share of the largest eigenvalue of a^T a below which one is nothing but rounding


def product(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    """Matrix product, as `a @ b`, of (n, m) or (m,) with (m, p) or (m,), real or complex."""
    kind = np.complex128 if a.dtype.kind == "c" or b.dtype.kind == "c" else np.float64
    if a.shape[-1] != b.shape[0] or a.ndim > 2 or b.ndim > 2:
        raise ValueError(f"product of {a.shape} and {b.shape}")
    left, right = np.ascontiguousarray(a, kind), np.ascontiguousarray(b, kind)
    found = multiply(left if left.ndim == 2 else left[np.newaxis], right if right.ndim == 2 else right[:, np.newaxis])
    return np.asarray(found.reshape(a.shape[:-1] + b.shape[1:]))


def inner(a: ArrayLike, b: ArrayLike) -> float:
    """Sum of the products of all elements of two real arrays of one size."""
    return float(dot(*(np.ascontiguousarray(x, np.float64).reshape(-1) for x in (a, b))))


def energy(z: NDArray[Any]) -> float:
    """Sum of |z|^2 over all elements."""
    return float(squared_modulus(z).sum())


def polynomial(roots: ArrayLike) -> Complexes:
    """Coefficients of the monic polynomial with these roots, (n,) -> (n + 1,), highest power first."""
    found = [1.0 + 0.0j]
    for root in np.asarray(roots, np.complex128).tolist():
        shifted = [_product(one, -root) for one in found]
        found = [a + b for a, b in zip([*found, 0j], [0j, *shifted], strict=True)]
    return np.array(found)


def _product(a: complex, b: complex) -> complex:
    """By the parts: a compiler of Python may contract its own."""
    return complex(a.real * b.real - a.imag * b.imag, a.real * b.imag + a.imag * b.real)


def singular(a: Floats) -> tuple[Floats, Floats]:
    """Left singular vectors and singular values, descending, of a real matrix: (n, m) -> (n, r), (r,), r = min(n, m).

    By the eigenvectors of the smaller of a^T a and a a^T: a value below 1e-7 of the largest is rounding. If n > m it is
    0 then, with a vector of zeros.
    """
    tall = a.shape[0] > a.shape[1]
    squares, vectors = eigh(product(a.T, a) if tall else product(a, a.T))
    order = np.argsort(-squares, kind="stable")
    squares, vectors = np.maximum(squares[order], 0.0), vectors[:, order]
    if not tall:
        return vectors, np.sqrt(squares)
    values = np.sqrt(np.where(squares > _NOTHING * squares[:1], squares, 0.0))
    return product(a, vectors) / np.where(values > 0.0, values, np.inf), values


def embedded(a: NDArray[Any]) -> Floats:
    """[[Re, -Im], [Im, Re]] of a matrix, (n, m) -> (2 n, 2 m): it has the products, roots and norms of the matrix."""
    return np.block([[a.real, -a.imag], [a.imag, a.real]])


def spectral_norm(a: NDArray[Any]) -> float:
    """Largest singular value of a matrix."""
    return float(singular(embedded(a) if a.dtype.kind == "c" else a)[1][0])


def eigh(a: Floats) -> tuple[Floats, Floats]:
    """Eigenvalues, (n,), and eigenvectors, the columns of (n, n), of a real symmetric matrix, in no order.

    By Householder's reflections to tridiagonal form and implicit QL steps (Golub and Van Loan, Matrix Computations,
    8.3), in O(n^3): Jacobi's rotations took four times as long for the hundred beams of a search, many of one strength.
    """
    scale = float(np.max(np.abs(a), initial=0.0))
    if not 0.0 < scale < np.inf:
        return np.diagonal(a).astype(np.float64), np.eye(a.shape[0])
    values, beside, vectors = _tridiagonal(a / scale)
    _diagonalise(values, beside, vectors)
    return values * scale, np.ascontiguousarray(vectors.T)


def solve(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    """x of a x = b by Gaussian elimination with pivots; (n, n) with (n,) or (n, p), real or complex.

    Raises ValueError for a singular matrix.
    """
    kind = np.complex128 if a.dtype.kind == "c" or b.dtype.kind == "c" else np.float64
    left, right = np.array(a, kind, order="C"), np.array(b, kind, order="C")
    if not _eliminate(left, right if right.ndim == 2 else right[:, np.newaxis]):
        raise ValueError("the matrix is singular")
    return right


def cholesky(a: Floats) -> Floats:
    """Lower triangular L with a = L L^T, of a positive definite matrix (n, n); else its square roots are NaN."""
    lower = np.zeros(a.shape)
    for i in range(a.shape[0]):
        for j in range(i + 1):
            left = a[i, j] - inner(lower[i, :j], lower[j, :j])
            lower[i, j] = np.sqrt(left) if i == j else left / lower[j, j]
    return lower


@kernel
def multiply(a: Any, b: Any) -> Any:
    """Product of two matrices of one type, (n, m) and (m, p)."""
    found = np.zeros((a.shape[0], b.shape[1]), a.dtype)
    for i in range(a.shape[0]):
        row, k = found[i], 0
        while k + 4 <= a.shape[1]:
            _add_four(row, a[i, k], a[i, k + 1], a[i, k + 2], a[i, k + 3], b[k : k + 4])
            k += 4
        while k < a.shape[1]:
            _add_one(row, a[i, k], b[k])
            k += 1
    return found


# Loops over a row, in functions of their own: only so does the compiler vectorise them.


@kernel
def _add_four(total: Any, a0: Any, a1: Any, a2: Any, a3: Any, b: Any) -> None:
    """total += a0 b_0 + a1 b_1 + a2 b_2 + a3 b_3."""
    b0, b1, b2, b3 = b[0], b[1], b[2], b[3]
    for j in range(total.size):
        total[j] += (a0 * b0[j] + a1 * b1[j]) + (a2 * b2[j] + a3 * b3[j])


@kernel
def _add_one(total: Any, a: Any, b: Any) -> None:
    """total += a b."""
    for j in range(total.size):
        total[j] += a * b[j]


@kernel
def dot(a: Floats, b: Floats) -> float:
    """a^T b in four interleaved sums: fast, and in the same order everywhere."""
    s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
    n = a.size - a.size % 4
    for i in range(0, n, 4):
        s0 += a[i] * b[i]
        s1 += a[i + 1] * b[i + 1]
        s2 += a[i + 2] * b[i + 2]
        s3 += a[i + 3] * b[i + 3]
    for i in range(n, a.size):
        s0 += a[i] * b[i]
    return (s0 + s1) + (s2 + s3)


@kernel
def _tridiagonal(a: Floats) -> tuple[Floats, Floats, Floats]:
    """Diagonal, (n,), elements beside it, (n,), the last one 0, and Q^T, (n, n), of a = Q T Q^T; overwrites a."""
    n = a.shape[0]
    reflections, scales, beside = np.zeros((n, n)), np.zeros(n), np.zeros(n)
    for k in range(n - 1):
        x = a[k, k + 1 :]  # of the row, for a is symmetric
        size = math.sqrt(dot(x, x))
        beside[k] = -math.copysign(size, x[0])
        if k == n - 2 or size < _VANISHED:
            beside[k] = x[0]
            continue
        v = reflections[k, k + 1 :]
        v[:] = x
        v[0] -= beside[k]
        scales[k] = 2.0 / dot(v, v)
        rest = a[k + 1 :, k + 1 :]
        w = np.empty(v.size)
        for i in range(v.size):
            w[i] = scales[k] * dot(rest[i], v)
        _add_one(w, -0.5 * scales[k] * dot(w, v), v)
        for i in range(v.size):
            _add_one(rest[i], -v[i], w)
            _add_one(rest[i], -w[i], v)
    vectors = np.eye(n)
    for k in range(n - 3, -1, -1):
        v = reflections[k, k + 1 :]
        for i in range(k + 1, n):
            row = vectors[i, k + 1 :]
            _add_one(row, -scales[k] * dot(row, v), v)
    return np.diag(a).copy(), beside, vectors


@kernel
def _diagonalise(d: Floats, e: Floats, vectors: Floats) -> None:
    """Make a tridiagonal matrix diagonal by QL steps with implicit shifts, and turn rows along with it, in place.

    d : (n,) diagonal; e : (n,) elements beside it, the last one unused
    """
    n = d.size
    for first in range(n):
        for _ in range(_STEPS):
            m = first  # the block from there to m is on its own
            while m < n - 1 and abs(e[m]) > _EPS * (abs(d[m]) + abs(d[m + 1])):
                m += 1
            if m == first:
                break
            half = 0.5 * (d[first + 1] - d[first]) / e[first]
            shift = d[first] - e[first] / (half + math.copysign(math.sqrt(1.0 + half * half), half))
            g, sin, cos, taken = d[m] - shift, 1.0, 1.0, 0.0
            for i in range(m - 1, first - 1, -1):
                f, b = sin * e[i], cos * e[i]
                size = math.sqrt(f * f + g * g)
                e[i + 1] = size
                if size == 0.0:  # the block is two
                    d[i + 1] -= taken
                    e[m] = 0.0
                    break
                sin, cos = f / size, g / size
                g = d[i + 1] - taken
                bent = (d[i] - g) * sin + 2.0 * cos * b
                taken = sin * bent
                d[i + 1] = g + taken
                g = cos * bent - b
                _rotate(vectors[i], vectors[i + 1], cos, sin)
            else:
                d[first] -= taken
                e[first] = g
                e[m] = 0.0


@kernel
def _rotate(x: Floats, y: Floats, cos: float, sin: float) -> None:
    """Rotate two rows; a function of its own, so that the compiler vectorises the loop."""
    for i in range(x.size):
        u, v = x[i], y[i]
        x[i], y[i] = cos * u - sin * v, sin * u + cos * v


@kernel
def _pivot(a: Any, j: int) -> int:
    """Row of the largest element of a column from its diagonal on."""
    found = j
    for i in range(j + 1, a.shape[0]):
        if squared_modulus(a[i, j]) > squared_modulus(a[found, j]):
            found = i
    if squared_modulus(a[found, j]) == 0.0:  # so are the squares of the smallest numbers
        for i in range(j + 1, a.shape[0]):
            if abs(a[i, j].real) + abs(a[i, j].imag) > abs(a[found, j].real) + abs(a[found, j].imag):
                found = i
    return found


@kernel
def _eliminate(a: Any, b: Any) -> bool:
    """Solve a x = b for the columns of b, in place; False of a singular matrix."""
    n = a.shape[0]
    for j in range(n):
        pivot = _pivot(a, j)
        if a[pivot, j] == 0.0:
            return False
        if pivot != j:
            for both in (a, b):
                row = both[j].copy()
                both[j] = both[pivot]
                both[pivot] = row
        for i in range(j + 1, n):
            factor = a[i, j] / a[j, j]
            _add_one(a[i, j:], -factor, a[j, j:])
            _add_one(b[i], -factor, b[j])
    for j in range(n - 1, -1, -1):
        for i in range(j + 1, n):
            _add_one(b[j], -a[j, i], b[i])
        for k in range(b.shape[1]):
            b[j, k] /= a[j, j]
    return True
