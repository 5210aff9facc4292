"""The reduced max-min program in cvxpy with Clarabel: an independent reference for the optimum of `max_min.allocate`.

It takes further constraints on the tracks (linear in the b_m^T X b_m). Constraints on antennas, such as a power limit
of each, do not fit. Their multipliers nu turn the range of an optimal R from span{a_m^*} into diag(nu)^{-1}
span{a_m^*}. This is not known in advance, so that the reduction to M x M fails. Also `expand` rescales R to the whole
power, which may exceed a limit. For equal powers there is `cogradar.shared.power.equal_antennas`.

Importing cvxpy takes about a second, so this module is imported only for this solver.
"""

import warnings
from typing import Any

import cvxpy as cp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cogradar.shared.numerics.linear import eigh, product, spectral_norm
from cogradar.shared.power.max_min import Allocation, Reduction, allocate_orthogonal, expand, reduce

TOLERANCES = {"tol_gap_abs": 1e-10, "tol_gap_rel": 1e-10, "tol_feas": 1e-10}  # of Clarabel; status is our own


class ReducedProgram:
    """The M x M semidefinite program, compiled once for M tracks and solved anew at each dwell with other numbers.

        minimise tr X   subject to   b_m^T X b_m >= w_m,  X >= 0               (symbols: cogradar.shared.power.max_min)

    Disciplined parametrised program: the b_m b_m^T and w_m are its parameters. One solution takes about 2 ms for 3
    tracks and 5 ms for 10; the semidefinite cone makes it 0.2 s for 30, and no choice for 100.
    """

    def __init__(self, n_beam: int) -> None:
        self._X: Any = cp.Variable((n_beam, n_beam), PSD=True)
        self._outer = cp.Parameter((n_beam, n_beam * n_beam))  # rows vec(b_m b_m^T)
        self._weights = cp.Parameter(n_beam, nonneg=True)
        vec_X = self._X.flatten(order="C")
        self._served: Any = self._outer @ vec_X >= self._weights
        trace = np.eye(n_beam).ravel() @ vec_X
        self._problem: Any = cp.Problem(cp.Minimize(trace), [self._served])

    def allocate(self, nus: ArrayLike, delta: ArrayLike, power: float, n_tx: int) -> Allocation:
        """Power allocation of one dwell; arguments and result as for `max_min.allocate`."""
        reduction = reduce(nus, delta, power, n_tx)
        if not self._solve(reduction):
            return allocate_orthogonal(nus, delta, power, n_tx)
        rank = reduction.beams.shape[0]
        root = _feasible_root(self._X.value[:rank, :rank], reduction)
        x = _feasible_dual(self._served.dual_value, reduction)
        return expand(reduction, root, x, power)

    def _solve(self, reduction: Reduction) -> bool:
        rank, n_beam = reduction.beams.shape
        beams = np.zeros((n_beam, n_beam))  # coincident tracks leave dimensions unused
        beams[:rank] = reduction.beams
        self._outer.value = (beams.T[:, :, np.newaxis] * beams.T[:, np.newaxis]).reshape(n_beam, -1)
        self._weights.value = reduction.weights
        try:
            with warnings.catch_warnings():  # cvxpy warns of inaccurate solutions; the certificate tells
                warnings.simplefilter("ignore")
                self._problem.solve(solver=cp.CLARABEL, **TOLERANCES)
        except cp.error.SolverError:
            return False
        return self._X.value is not None and self._served.dual_value is not None


def _feasible_root(X: NDArray[np.float64], reduction: Reduction) -> NDArray[np.float64]:
    """Root of the nearest X >= 0, with what a track still lacks added on its own beam.

    The solver is accurate to about 1e-10 of the largest weight, which may be more than a near track's whole share.
    """
    B = reduction.beams
    values, vectors = eigh(X)
    X = product(vectors * np.maximum(values, 0.0), vectors.T)
    lack = np.maximum(reduction.weights - np.sum(B * product(X, B), axis=0), 0.0)
    values, vectors = eigh(X + product(B * lack, B.T))
    root: NDArray[np.float64] = vectors * np.sqrt(np.maximum(values, 0.0))
    return root


def _feasible_dual(x: NDArray[np.float64], reduction: Reduction) -> NDArray[np.float64]:
    x = np.maximum(x, 0.0)
    largest = spectral_norm(reduction.beams * np.sqrt(x)) ** 2
    return x / largest
