"""Max-min power allocation: the waveform covariance that gives the worst-off track as much echo as possible.

Symbols: nu_m spatial frequency of track m's bin; a_m = a(nu_m) its steering vector over n_tx antennas; delta_m its
weight (1/R^4); R = factor factor^H the covariance of the transmitted waveform; P its power; M tracks.

    maximise over R   min_m delta_m a_m^T R a_m^*     subject to  tr R = P,  R >= 0          (the paper, "Action Space")

An optimal R lives in the span of the a_m^*, and with the phase reference at the array's centre the problem is real.
With an orthonormal basis Q of that span, b_m the unit-norm coordinates of a_m^* and w_m = min_k delta_k / delta_m it is
the semidefinite program and its dual

    minimise tr X  s.t.  b_m^T X b_m >= w_m, X >= 0         maximise w^T x  s.t.  sum_m x_m b_m b_m^T <= I, x >= 0

of size at most M, with R = P Q X Q^T / tr X. `cogradar.shared.power.interior_point` solves both at once.
"""

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cogradar.shared.numerics.jit import kernel
from cogradar.shared.numerics.linear import dot, multiply, spectral_norm
from cogradar.shared.power.interior_point import interior_point
from cogradar.shared.signal.waveform import antennas, beam_factor, beampattern

FLOOR = 1e-7  # a steering vector this close (relative) to the span of the others adds no dimension
WEIGHT_RANGE = (1e-100, 1e100)  # so that a range of 0, or one without end, still leaves a waveform for the others
GAP_TARGET = 1e-9  # the iteration stops at this relative duality gap ...
GAP_OPTIMAL = 1e-6  # ... and a result counts as optimal up to this one


class Allocation(NamedTuple):
    """A feasible waveform and the proof of how good it is.

    shares are the optimal multipliers mu of the tracks' constraints times P. They attribute the power: at the optimum
    (sum_m mu_m delta_m a_m^* a_m^T) R = (value / P) R, whose trace says that serving track m takes mu_m P. For
    orthogonal steering vectors that is the power of beam m; a track that its neighbours' beams serve as well has
    share 0; tracks on one bin split the share of their common beam.
    """

    factor: NDArray[np.complex128]  # (n_tx, r), r <= M; R = factor factor^H, tr R = P
    shares: NDArray[np.float64]  # (M,) power attributed to each track, >= 0, sums to P
    value: float  # min_m delta_m a_m^T R a_m^*
    bound: float  # no feasible R has a higher value
    status: Literal["optimal", "inaccurate"]  # optimal: bound <= (1 + GAP_OPTIMAL) value


class Reduction(NamedTuple):
    """The program in the span of the steering vectors."""

    basis: NDArray[np.float64]  # (r, n_tx) orthonormal rows: Q^T in the real coordinates of the array
    beams: NDArray[np.float64]  # (r, M) columns b_m, |b_m|^2 = 1 - residual_m
    residual: NDArray[np.float64]  # (M,) squared norm of what the basis leaves out, at most FLOOR^2
    weights: NDArray[np.float64]  # (M,) w_m = min_k delta_k / delta_m, in (0, 1]
    scale: float  # P n_tx min_k delta_k, so that value = scale min_m(b_m^T X b_m / w_m) / tr X


def allocate(nus: ArrayLike, delta: ArrayLike, power: float, n_tx: int) -> Allocation:
    """Power allocation of one dwell.

    nus     : (M,) spatial frequencies of the tracks' bins, in [-0.5, 0.5]; may coincide
    delta   : (M,) >= 0, clipped to WEIGHT_RANGE; only ratios matter
    power   : P > 0, linear
    returns : Allocation; a function of the arguments alone, always feasible
    Cost O(M^3 + n_tx M^2). The relative gap ends below GAP_TARGET; below 1e-7 where bins nearly coincide.
    """
    reduction = reduce(nus, delta, power, n_tx)
    U, x = interior_point(reduction.beams, reduction.weights, GAP_TARGET)
    allocation = expand(reduction, U.T, x, power)
    if allocation.status == "optimal":
        return allocation
    closed = allocate_orthogonal(nus, delta, power, n_tx)
    return allocation if allocation.value >= closed.value else closed


def reduce(nus: ArrayLike, delta: ArrayLike, power: float, n_tx: int) -> Reduction:
    """Coordinates of the steering vectors in their own span; arguments as for `allocate`."""
    delta = clipped(delta)
    rows = real_steering_vectors(np.asarray(nus, dtype=np.float64), n_tx)
    basis = orthonormal_basis(rows)
    beams = multiply(basis, np.ascontiguousarray(rows.T))
    residual = np.maximum(1.0 - np.sum(beams**2, axis=0), 0.0)
    weakest = float(delta.min())
    return Reduction(basis, beams, residual, weakest / delta, power * n_tx * weakest)


def expand(reduction: Reduction, root: NDArray[np.float64], x: NDArray[np.float64], power: float) -> Allocation:
    """Waveform and certificate from a solution of the reduced program.

    root : (r, c), X = root root^T, any X > 0
    x    : (M,), feasible for the dual
    """
    w = reduction.weights
    trace = float(np.sum(root**2))
    projected = multiply(np.ascontiguousarray(root.T), reduction.beams)
    served = np.sum(projected**2, axis=0)  # b_m^T X b_m as a sum of squares: accurate when tiny
    value = reduction.scale * float(np.min(served / w)) / trace
    # What the basis leaves out adds at most sum_m x_m residual_m to the largest eigenvalue of the dual matrix.
    objective = float(np.sum(w * x))
    bound = reduction.scale * (1.0 + float(np.sum(x * reduction.residual))) / objective
    coordinates = multiply(np.ascontiguousarray(reduction.basis.T), root * np.sqrt(power / trace))
    return Allocation(antennas(coordinates), power * (w * x) / objective, value, bound, _status(value, bound))


def allocate_orthogonal(nus: ArrayLike, delta: ArrayLike, power: float, n_tx: int) -> Allocation:
    """Closed form, exact where the steering vectors are orthogonal and feasible everywhere.

        p_m = P (1/delta_m) / sum_k (1/delta_k),  R = sum_m p_m a_m^* a_m^T / n_tx,  value = P n_tx / sum_k (1/delta_k)

    Arguments as for `allocate`. Where the steering vectors overlap, value and bound tell how far it is off.
    """
    nus, delta = np.asarray(nus, dtype=np.float64), clipped(delta)
    inverse = delta.min() / delta
    shares = power * inverse / inverse.sum()
    factor = beam_factor(nus, shares, n_tx)
    value = float(np.min(delta * beampattern(0.0, factor, nus)))
    bound = dual_bound(shares / power, nus, delta, power, n_tx)
    return Allocation(factor, shares, value, bound, _status(value, bound))


def dual_bound(mu: ArrayLike, nus: ArrayLike, delta: ArrayLike, power: float, n_tx: int) -> float:
    """Upper bound on the value of every feasible waveform, for any mu >= 0 with sum 1.

    P lambda_max(sum_m mu_m delta_m a_m^* a_m^T)                   (weak duality; equality for the optimal mu)
    """
    root = beam_factor(nus, np.asarray(mu) * np.asarray(delta) * n_tx, n_tx)
    return power * spectral_norm(root) ** 2


class KktResiduals(NamedTuple):
    """How far an allocation is from satisfying the optimality conditions, each relative; all 0 at the optimum."""

    power: float  # |tr R - P| / P
    dual: float  # (P lambda - value) / value, lambda the largest eigenvalue of A = sum_m mu_m delta_m a_m^* a_m^T
    stationarity: float  # |A R - lambda R|_F / |lambda R|_F
    complementarity: float  # sum_m mu_m (delta_m a_m^T R a_m^* - value) / value


def kkt_residuals(nus: ArrayLike, delta: ArrayLike, power: float, allocation: Allocation) -> KktResiduals:
    """Optimality conditions of the full n_tx x n_tx program, from the definitions; mu = shares / P."""
    factor, delta = allocation.factor, np.asarray(delta, dtype=np.float64)
    mu = allocation.shares / power
    conjugates = beam_factor(nus, np.full(mu.size, factor.shape[0]), factor.shape[0])  # columns a_m^*
    A = (conjugates * (mu * delta)) @ conjugates.conj().T
    R = factor @ factor.conj().T
    echo = delta * beampattern(0.0, factor, nus)
    top = float(np.linalg.eigvalsh(A)[-1])
    return KktResiduals(
        power=abs(float(np.trace(R).real) - power) / power,
        dual=(power * top - float(echo.min())) / float(echo.min()),
        stationarity=float(np.linalg.norm(A @ R - top * R) / np.linalg.norm(top * R)),
        complementarity=float(mu @ (echo - echo.min())) / float(echo.min()),
    )


def clipped(delta: ArrayLike) -> NDArray[np.float64]:
    """Weights within WEIGHT_RANGE."""
    return np.clip(np.asarray(delta, dtype=np.float64), *WEIGHT_RANGE)


def _status(value: float, bound: float) -> Literal["optimal", "inaccurate"]:
    return "optimal" if bound <= (1 + GAP_OPTIMAL) * value else "inaccurate"


@kernel
def real_steering_vectors(nus: NDArray[np.float64], n_tx: int) -> NDArray[np.float64]:
    """Rows a(nu_m)^* / sqrt(n_tx) in real coordinates, (M, n_tx).

    Referred to the array's centre a(nu)^* is conjugate symmetric. Its coordinates in a unitary basis are sqrt 2 cos and
    sqrt 2 sin of 2 pi nu p over the antenna positions p > 0. If n_tx is odd there is 1 at p = 0. Through
    `steering_vector` instead of a kernel an allocation of 3 tracks takes 18 % more.
    """
    half = n_tx // 2
    rows = np.empty((nus.size, n_tx))
    for m in range(nus.size):
        for i in range(half):
            phase = 2.0 * np.pi * nus[m] * (i + 0.5 * (n_tx + 1) - half)
            rows[m, i] = np.sqrt(2.0 / n_tx) * np.cos(phase)
            rows[m, half + i] = np.sqrt(2.0 / n_tx) * np.sin(phase)
        if n_tx % 2 == 1:
            rows[m, n_tx - 1] = np.sqrt(1.0 / n_tx)
    return rows


@kernel
def orthonormal_basis(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Basis (r, n) of the span of unit vectors (M, n): Gram-Schmidt, twice; r counts the directions above FLOOR."""
    n_row, n = rows.shape
    basis = np.empty((min(n_row, n), n))
    rank = 0
    for m in range(n_row):
        rest = rows[m].copy()
        for _ in range(2):
            for i in range(rank):
                along = dot(basis[i], rest)
                for j in range(n):
                    rest[j] -= along * basis[i, j]
        norm = np.sqrt(dot(rest, rest))
        if norm > FLOOR and rank < n:
            for j in range(n):
                basis[rank, j] = rest[j] / norm
            rank += 1
    return basis[:rank].copy()
