"""Primal-dual interior-point method for the reduced max-min program, and the dense kernels it needs.

    minimise tr X  s.t.  b_m^T X b_m >= w_m, X >= 0         maximise w^T x  s.t.  sum_m x_m b_m b_m^T <= I, x >= 0

Symbols: B (r, M) columns b_m; slacks s_m = b_m^T X b_m - w_m and Z = I - B diag(x) B^T; the duality gap is
tr X - w^T x = <X, Z> + s^T x.
HKM direction with Mehrotra's corrector (Helmberg, Rendl, Vanderbei, Wolkowicz 1996). Both iterates stay strictly
feasible, so every iteration ends with a waveform and a bound, and stopping early is safe. The loops are our own rather
than BLAS: the same bits whatever BLAS is installed and however many threads it uses, and no exceptions.
"""

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.jit import kernel
from cogradar.shared.numerics.linear import dot, multiply

Floats = NDArray[np.float64]

PIVOT_FLOOR = 1e-15  # relative pivot below which a row of the Schur complement repeats others
TO_BOUNDARY = 0.97  # fraction of the way to the boundary that a step may go
BACKTRACK = 0.9
MAX_ITERATIONS = 50
STALLED = 0.98  # an iteration that leaves more of the gap than this has met the limits of double precision
LEFT_OUT = 1e150  # pivot that makes a solution's component zero


@kernel
def interior_point(B: Floats, w: Floats, gap_target: float) -> tuple[Floats, Floats]:
    """Solve the program and its dual to a relative gap, or as far as double precision goes.

    B       : (r, M) columns b_m of norm at most 1, together of rank r
    w       : (M,) in [0, 1], not all 0
    returns : upper triangular U (r, r) with X = U^T U, and x (M,); both strictly feasible
    Cost O(M^3) per iteration, 8 .. 16 iterations.
    """
    r, n_beam = B.shape
    Bt = B.T.copy()
    X, x = _start(B, Bt, w)
    Z = _plus_identity(_weighted_product(B, -x, Bt))
    U, L, C = np.zeros((r, r)), np.zeros((r, r)), np.zeros((n_beam, n_beam))
    _cholesky(X, U, 0.0)
    _cholesky(Z, L, 0.0)
    for _ in range(MAX_ITERATIONS):
        objective = dot(w, x)
        gap = _trace(X) - objective
        Y = multiply(X, B)
        T = multiply(Bt, Y)
        s = _diagonal(T) - w
        if gap <= gap_target * objective or _smallest(s) <= 0.0:
            break
        # Newton system: H = (B^T X B) o (B^T Z^-1 B) + diag(s / x)
        Zi = _inverse(L)
        Wt = multiply(Bt, Zi)
        S = multiply(Wt, B)
        H = _schur_complement(T, S, s / x)
        _cholesky(H, C, PIVOT_FLOOR)
        # Predictor: straight for the optimum; the share of the gap it leaves sets the corrector's aim
        dx = _solve(H, C, w)
        dX = _blend(_symmetric_part(_weighted_product(Y, dx, Wt)), -1.0, X)
        Ya = multiply(dX, B)
        Ta = multiply(Bt, Ya)
        ds = _diagonal(Ta)
        primal, dual = _step(X, dX, s, ds), _step(Z, _weighted_product(B, -dx, Bt), x, dx)
        left = max(0.0, gap + primal * _trace(dX) - dual * dot(w, dx)) / gap
        mu = left * left * gap / (r + n_beam)
        # Corrector: towards X Z = mu I, s x = mu, with the predictor's second-order terms
        second = _hadamard_times(Ta, S, dx)
        push = mu * _diagonal(S) + second
        bent = _weighted_product(Ya, dx, Wt)
        dx = _solve(H, C, w + (mu - ds * dx) / x - push)
        ds = push + _hadamard_times(T, S, dx) - _diagonal(T)
        dX = _blend(_blend(_symmetric_part(_blend(bent, 1.0, _weighted_product(Y, dx, Wt))), mu, Zi), -1.0, X)
        primal, dual = _step(X, dX, s, ds), _step(Z, _weighted_product(B, -dx, Bt), x, dx)
        # Keep the candidate if it pays and rounding has not put it outside the cones
        X_next, x_next = _blend(X, primal, dX), x + dual * dx
        U_next = np.zeros((r, r))
        Z = _plus_identity(_weighted_product(B, -x_next, Bt))
        pays = _trace(X_next) / dot(w, x_next) - 1.0 < STALLED * gap / objective
        if not (pays and _cholesky(X_next, U_next, 0.0) and _cholesky(Z, L, 0.0)):
            break
        X, x, U = X_next, x_next, U_next
    return U, x


@kernel
def _start(B: Floats, Bt: Floats, w: Floats) -> tuple[Floats, Floats]:
    """Strictly feasible pair: conventional beams and some of everything; x by lambda_max <= row sums of |B^T B|."""
    X = _weighted_product(B, w, Bt)
    G = multiply(Bt, B)
    little = 0.2 * w.sum() / w.size
    for i in range(X.shape[0]):
        X[i, i] += little
    largest = 0.0
    for i in range(w.size):
        largest = max(largest, np.abs(G[i]).sum())
    return X, np.full(w.size, 0.9 / largest)


@kernel
def _step(A: Floats, dA: Floats, v: Floats, dv: Floats) -> float:
    """Step length, at most 1, that goes TO_BOUNDARY of the way out of A >= 0, v >= 0 along (dA, dv)."""
    length = 1.0 / TO_BOUNDARY
    for i in range(v.size):
        if v[i] + length * dv[i] < 0.0:
            length = -v[i] / dv[i]
    U = np.empty_like(A)
    while not _cholesky(_blend(A, length, dA), U, 0.0):
        length *= BACKTRACK
        if length < 1e-6:
            return 0.0
    return TO_BOUNDARY * length


@kernel
def _cholesky(A: Floats, U: Floats, floor: float) -> bool:
    """Factor A = U^T U into the upper triangle of U; False if A is not positive definite.

    With floor > 0, a row whose relative pivot is below it is left out instead: `_solve` gives it the value 0.
    """
    n = A.shape[0]
    for i in range(n):
        for j in range(i, n):
            U[i, j] = A[i, j]
        k = 0
        while k + 4 <= i:
            u0, u1, u2, u3 = U[k, i], U[k + 1, i], U[k + 2, i], U[k + 3, i]
            for j in range(i, n):
                U[i, j] -= (u0 * U[k, j] + u1 * U[k + 1, j]) + (u2 * U[k + 2, j] + u3 * U[k + 3, j])
            k += 4
        while k < i:
            u0 = U[k, i]
            for j in range(i, n):
                U[i, j] -= u0 * U[k, j]
            k += 1
        pivot = U[i, i]
        if pivot > floor * A[i, i]:
            inverse = 1.0 / np.sqrt(pivot)
            for j in range(i, n):
                U[i, j] *= inverse
        elif floor > 0.0:
            U[i, i:] = 0.0
            U[i, i] = LEFT_OUT
        else:
            return False
    return True


@kernel
def _inverse(U: Floats) -> Floats:
    """Inverse of U^T U, symmetric to the last bit."""
    n = U.shape[0]
    V = np.zeros((n, n))  # U^-T, lower triangular
    for i in range(n):
        V[i, i] = 1.0
        for k in range(i):
            u = U[k, i]
            for j in range(k + 1):
                V[i, j] -= u * V[k, j]
        inverse = 1.0 / U[i, i]
        for j in range(i + 1):
            V[i, j] *= inverse
    A = np.zeros((n, n))
    for k in range(n):
        for i in range(k + 1):
            v = V[k, i]
            for j in range(i + 1):
                A[i, j] += v * V[k, j]
    for i in range(n):
        for j in range(i):
            A[j, i] = A[i, j]
    return A


@kernel
def _solve(A: Floats, U: Floats, b: Floats) -> Floats:
    """Solution of A y = b from A = U^T U, with one step of iterative refinement."""
    y = _substitute(U, b)
    rest = np.empty_like(b)
    for i in range(b.size):
        rest[i] = b[i] - dot(A[i], y)
    return y + _substitute(U, rest)


@kernel
def _substitute(U: Floats, b: Floats) -> Floats:
    n = b.size
    y = b.copy()
    for i in range(n):
        y[i] /= U[i, i]
        for j in range(i + 1, n):
            y[j] -= U[i, j] * y[i]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            y[i] -= U[i, j] * y[j]
        y[i] /= U[i, i]
    return y


@kernel
def _schur_complement(T: Floats, S: Floats, d: Floats) -> Floats:
    """T o S + diag(d), o the elementwise product."""
    H = T * S
    for i in range(d.size):
        H[i, i] += d[i]
    return H


@kernel
def _hadamard_times(A: Floats, B: Floats, v: Floats) -> Floats:
    """(A o B) v."""
    AB = A * B
    y = np.empty_like(v)
    for i in range(v.size):
        y[i] = dot(AB[i], v)
    return y


@kernel
def _weighted_product(A: Floats, v: Floats, B: Floats) -> Floats:
    """A diag(v) B, four rows of B at a time so that the inner loop runs in vector registers."""
    n, depth = A.shape
    C = np.zeros((n, B.shape[1]))
    for i in range(n):
        k = 0
        while k + 4 <= depth:
            a0, a1, a2, a3 = A[i, k] * v[k], A[i, k + 1] * v[k + 1], A[i, k + 2] * v[k + 2], A[i, k + 3] * v[k + 3]
            for j in range(B.shape[1]):
                C[i, j] += (a0 * B[k, j] + a1 * B[k + 1, j]) + (a2 * B[k + 2, j] + a3 * B[k + 3, j])
            k += 4
        while k < depth:
            a0 = A[i, k] * v[k]
            for j in range(B.shape[1]):
                C[i, j] += a0 * B[k, j]
            k += 1
    return C


@kernel
def _blend(A: Floats, c: float, B: Floats) -> Floats:
    """A + c B."""
    return A + c * B


@kernel
def _symmetric_part(A: Floats) -> Floats:
    return 0.5 * (A + A.T)


@kernel
def _plus_identity(A: Floats) -> Floats:
    for i in range(A.shape[0]):
        A[i, i] += 1.0
    return A


@kernel
def _diagonal(A: Floats) -> Floats:
    d = np.empty(A.shape[0])
    for i in range(d.size):
        d[i] = A[i, i]
    return d


@kernel
def _trace(A: Floats) -> float:
    total = 0.0
    for i in range(A.shape[0]):
        total += A[i, i]
    return total


@kernel
def _smallest(v: Floats) -> float:
    least = np.inf
    for i in range(v.size):
        least = min(least, v[i])
    return least
