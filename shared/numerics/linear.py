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

_SWEEPS = 60  # of Jacobi's methods, which need 6 to 10
_ORTHOGONAL = 1e-15  # cosine below which two columns are left as they are
_NEARLY = 1e-8  # largest cosine of a sweep that is the last one: they fall as their squares
_ROUNDING = 1e-32  # share of all squares below which a column is nothing but rounding


def product(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    """Matrix product, as `a @ b`, of (n, m) or (m,) with (m, p) or (m,), real or complex."""
    kind = np.complex128 if a.dtype.kind == "c" or b.dtype.kind == "c" else np.float64
    if a.shape[-1] != b.shape[0] or a.ndim > 2 or b.ndim > 2:
        raise ValueError(f"product of {a.shape} and {b.shape}")
    left, right = np.ascontiguousarray(a, kind), np.ascontiguousarray(b, kind)
    found = multiply(np.atleast_2d(left), right if right.ndim == 2 else right[:, np.newaxis])
    return np.asarray(found.reshape(a.shape[:-1] + b.shape[1:]))


def inner(a: ArrayLike, b: ArrayLike) -> float:
    """Sum of the products of all elements of two real arrays of one size."""
    return float(dot(*(np.ascontiguousarray(x, np.float64).reshape(-1) for x in (a, b))))


def energy(z: NDArray[Any]) -> float:
    """Sum of |z|^2 over all elements."""
    return float(np.sum(squared_modulus(z)))


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


def singular(a: NDArray[Any]) -> tuple[NDArray[Any], Floats]:
    """Left singular vectors and singular values, descending: (n, m) -> (n, r) and (r,), r = min(n, m); real of real.

    By Jacobi's rotations of pairs of columns (Hestenes 1958). A singular value of 0 has a vector of zeros.
    """
    re = np.array(a.real.T, np.float64, order="C")
    im = np.array(a.imag.T, np.float64, order="C") if a.dtype.kind == "c" else np.empty((a.shape[1], 0))
    _orthogonalise(re, im)
    values = np.sqrt(np.sum(re * re, axis=1) + np.sum(im * im, axis=1))
    order = np.argsort(-values, kind="stable")[: min(a.shape)]
    values = values[order]
    vectors = re[order] + 1j * im[order] if im.shape[1] else re[order]
    return np.ascontiguousarray((vectors / np.where(values > 0.0, values, 1.0)[:, np.newaxis]).T), values


def spectral_norm(a: NDArray[Any]) -> float:
    """Largest singular value of a matrix."""
    return float(singular(a if a.shape[0] >= a.shape[1] else a.T)[1][0])


def eigh(a: Floats) -> tuple[Floats, Floats]:
    """Eigenvalues and eigenvectors (columns) of a real symmetric matrix, in no order, by Jacobi's rotations."""
    values, vectors = a.astype(np.float64), np.eye(a.shape[0])
    _diagonalise(values, vectors)
    return np.diagonal(values).copy(), np.ascontiguousarray(vectors.T)


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
def _orthogonalise(re: Floats, im: Floats) -> None:
    """Rotate pairs of rows until all are orthogonal, in place; im: (m, 0) of real rows."""
    squares = np.empty(re.shape[0])
    for _ in range(_SWEEPS):
        for p in range(squares.size):
            squares[p] = dot(re[p], re[p]) + dot(im[p], im[p])
        least, largest = _ROUNDING * squares.sum(), 0.0
        for p in range(squares.size - 1):
            for q in range(p + 1, squares.size):
                if min(squares[p], squares[q]) <= least:
                    continue
                between = _made_real(re[p], im[p], re[q], im[q]) if im.size else dot(re[p], re[q])
                cosine = abs(between) / math.sqrt(squares[p] * squares[q])
                if cosine <= _ORTHOGONAL:
                    continue
                largest = max(largest, cosine)
                cos, sin = _rotation(squares[p], squares[q], between)
                _rotate(re[p], re[q], cos, sin)
                if im.size:
                    _rotate(im[p], im[q], cos, sin)
                squares[p] -= sin / cos * between
                squares[q] += sin / cos * between
        if largest <= _NEARLY:
            break


@kernel
def _made_real(re: Floats, im: Floats, other_re: Floats, other_im: Floats) -> float:
    """Turn the phase of the other row so that x^H y is real, in place; x^H y then."""
    along, across = dot(re, other_re) + dot(im, other_im), dot(re[: im.size], other_im) - dot(im, other_re[: im.size])
    if across == 0.0:
        return along
    size = math.sqrt(along * along + across * across)
    cos, sin = along / size, across / size
    for i in range(im.size):
        x, y = other_re[i], other_im[i]
        other_re[i], other_im[i] = cos * x + sin * y, cos * y - sin * x
    return size


@kernel
def _rotate(x: Floats, y: Floats, cos: float, sin: float) -> None:
    """Rotate two rows; a function of its own, so that the compiler vectorises the loop."""
    for i in range(x.size):
        u, v = x[i], y[i]
        x[i], y[i] = cos * u - sin * v, sin * u + cos * v


@kernel
def _rotation(own: float, other: float, between: float) -> tuple[float, float]:
    """Cosine and sine of the smaller rotation that makes [[own, between], [between, other]] diagonal."""
    zeta = (other - own) / (2.0 * between)
    t = math.copysign(1.0, zeta) / (abs(zeta) + math.sqrt(1.0 + zeta * zeta))
    cos = 1.0 / math.sqrt(1.0 + t * t)
    return cos, cos * t


@kernel
def _diagonalise(a: Floats, vectors: Floats) -> None:
    """Make a symmetric matrix diagonal and rotate the rows of another one alike, in place."""
    n = a.shape[0]
    for _ in range(_SWEEPS):
        is_done = True
        for p in range(n - 1):
            for q in range(p + 1, n):
                if abs(a[p, q]) <= _ORTHOGONAL * math.sqrt(abs(a[p, p])) * math.sqrt(abs(a[q, q])):
                    continue
                is_done = False
                cos, sin = _rotation(a[p, p], a[q, q], a[p, q])
                for i in range(n):
                    u, v = a[i, p], a[i, q]
                    a[i, p], a[i, q] = cos * u - sin * v, sin * u + cos * v
                for i in range(n):
                    u, v = a[p, i], a[q, i]
                    a[p, i], a[q, i] = cos * u - sin * v, sin * u + cos * v
                    u, v = vectors[p, i], vectors[q, i]
                    vectors[p, i], vectors[q, i] = cos * u - sin * v, sin * u + cos * v
        if is_done:
            break


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
