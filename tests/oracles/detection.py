"""Slow, obvious versions of the receiver."""

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.signal.receiver import Cell, n_lag

Complexes = NDArray[np.complex128]


def literal_cell(y: Complexes, v: Complexes) -> Cell:
    """Fortunati et al. 2020, eq. 23 with its erratum, term by term."""
    signature_power = float(np.vdot(v, v).real)
    alpha_hat = complex(np.vdot(v, y)) / signature_power
    x = (y - alpha_hat * v) * v.conj()
    b = float(np.sum(np.abs(x) ** 2))
    for m in range(1, n_lag(len(y)) + 1):
        for n in range(m, len(y)):
            b += 2.0 * float((x[n] * np.conj(x[n - m])).real)
    return _cell(alpha_hat, b, signature_power)


def covariance_cell(y: Complexes, v: Complexes) -> Cell:
    """The same through a covariance matrix: B = v^H Gamma_hat v, Gamma_hat the band |i - j| <= l of r r^H."""
    signature_power = float(np.vdot(v, v).real)
    alpha_hat = complex(np.vdot(v, y)) / signature_power
    r = y - alpha_hat * v
    i = np.arange(len(y))
    gamma_hat = np.where(np.abs(i[:, None] - i) <= n_lag(len(y)), np.outer(r, r.conj()), 0.0)
    return _cell(alpha_hat, float(np.vdot(v, gamma_hat @ v).real), signature_power)


def _cell(alpha_hat: complex, b: float, signature_power: float) -> Cell:
    if b <= 0.0:
        return Cell(0.0, alpha_hat, 0.0, signature_power)
    sigma_hat = np.sqrt(b) / signature_power
    return Cell(float(2.0 * np.abs(alpha_hat) ** 2 / sigma_hat**2), alpha_hat, float(sigma_hat), signature_power)
