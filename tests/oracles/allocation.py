"""The max-min power allocation as the paper states it: one n_tx x n_tx Hermitian program. Slow; n_tx <= 16."""

import warnings
from typing import Any

import cvxpy
import numpy as np
from numpy.typing import NDArray

from cogradar.shared.signal.array import steering_vector

cp: Any = cvxpy  # its functions are not annotated


def full_program(
    nus: NDArray[np.float64], delta: NDArray[np.float64], power: float, n_tx: int, *, equal: bool = False
) -> float:
    """Value max_R min_m delta_m a_m^T R a_m^* subject to tr R = power, R >= 0, from the definition.

    equal : subject to R_ii = power / n_tx, too

    The solver's R is made exactly feasible and its value taken from that, so that this is a lower bound whatever the
    solver says of its own accuracy. Divided by n_tx min delta, so that an absolute tolerance is a relative one.
    """
    steering = [steering_vector(float(nu), n_tx) for nu in nus]
    weights = delta / delta.min()
    R = cp.Variable((n_tx, n_tx), hermitian=True)
    value = cp.Variable()
    constraints = [R >> 0, cp.real(cp.diag(R)) == 1 / n_tx if equal else cp.real(cp.trace(R)) == 1]
    constraints += [w / n_tx * cp.real(a @ R @ a.conj()) >= value for w, a in zip(weights, steering, strict=True)]
    problem = cp.Problem(cp.Maximize(value), constraints)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        problem.solve(solver=cp.CLARABEL)
    values, vectors = np.linalg.eigh(R.value)
    feasible = (vectors * np.maximum(values, 0)) @ vectors.conj().T
    if equal:
        roots = np.sqrt(power / n_tx / np.diag(feasible).real)
        feasible = roots[:, None] * feasible * roots
    feasible *= power / np.trace(feasible).real
    return min(float(d * (a @ feasible @ a.conj()).real) for d, a in zip(delta, steering, strict=True))
