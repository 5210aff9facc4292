"""The discriminator of an echo and the standard deviation of its error, product by product."""

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.signal.monopulse import off_axis
from cogradar.shared.signal.receiver import wald_test
from cogradar.shared.signal.waveform import Signatures

Echo = NDArray[np.complex128]


def ratio(y: Echo, u: Echo, a_rx: Echo) -> float:
    """Discriminator as measured, -Re[(v'^H y) / (v^H y)], v' = u kron da_R/dnu."""
    return -float((np.vdot(np.kron(u, _derivative(a_rx)), y) / np.vdot(np.kron(u, a_rx), y)).real)


def measured(y: Echo, signatures: Signatures, nu: float) -> tuple[float, float, float]:
    """Discriminator, the standard deviation of its error, and sigma_hat of what the echo leaves."""
    u, a_rx = signatures.at(nu)
    rho = ratio(y, u, a_rx)
    v = np.kron(*signatures.at(nu + off_axis(rho, a_rx.size)))
    noise = y - np.vdot(v, y) / np.vdot(v, v) * v
    error = wald_test(noise, u, _derivative(a_rx) + rho * a_rx)
    signal = abs(np.vdot(np.kron(u, a_rx), y))
    return rho, error.sigma_hat * error.signature_power / (np.sqrt(2.0) * signal), wald_test(noise, u, a_rx).sigma_hat


def _derivative(a_rx: Echo) -> Echo:
    return 2j * np.pi * (np.arange(a_rx.size) - 0.5 * (a_rx.size - 1)) * a_rx
