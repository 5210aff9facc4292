"""What is radiated: isotropic power plus a few beams.

Symbols: R = W W^H transmit covariance, tr R = P_T; W = R^{1/2} Hermitian; R = (isotropic / n_tx) I + F F^H, F the
factor, (n_tx, r) complex, one column per beam (none: the orthogonal waveform); a(nu) transmit steering vector.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cogradar.shared.signal.array import steering_vector

Signature = tuple[NDArray[np.complex128], NDArray[np.complex128]]  # W^T a_T (n_tx,) and a_R (n_rx,)
_Root = tuple[float, NDArray[np.complex128], NDArray[np.float64]]  # w_0, U and d of the square root (`root`)


def covariance(isotropic: float, factor: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Transmit covariance R = (isotropic / n_tx) I + F F^H, (n_tx, n_tx) complex; tr R = isotropic + ||F||_F^2."""
    n_tx = factor.shape[0]
    R: NDArray[np.complex128] = isotropic / n_tx * np.eye(n_tx) + factor @ factor.conj().T
    return R


def root(isotropic: float, factor: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Waveform W = R^{1/2}, the Hermitian square root.

        W = w_0 I + U diag(d) U^H,   F = U S V^H,  w_0^2 = isotropic / n_tx,  d = sqrt(w_0^2 + S^2) - w_0

    isotropic : float >= 0, power sent equally in all directions
    factor    : (n_tx, r) complex, F
    returns   : (n_tx, n_tx) complex
    Cost O(n_tx r^2 + n_tx^2 r) through the thin SVD, against O(n_tx^3) for the square root of R itself.
    """
    level, u, gain = _root_parts(isotropic, factor)
    return level * np.eye(factor.shape[0]) + (u * gain) @ u.conj().T


def transmit_signatures(
    isotropic: float, factor: NDArray[np.complex128], nus: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """Transmit half of the signatures v = (W^T a_T(nu)) kron a_R(nu) in the directions nu.

        (W^T a)^T = a^T W = w_0 a^T + (a^T U) diag(d) U^H          (`root`; W itself is not formed)

    isotropic : float >= 0
    factor    : (n_tx, r) complex, F
    nus       : (n,) spatial frequencies
    returns   : (n, n_tx) complex, rows W^T a_T(nu); the squared norm of a row is `beampattern(nu)`
    """
    return _transmitted(_root_parts(isotropic, factor), nus)


class Signatures:
    """Both halves of the signatures v = (W^T a_T(nu)) kron a_R(nu) of a waveform, each worked out once."""

    def __init__(self, isotropic: float, factor: NDArray[np.complex128], n_rx: int) -> None:
        """Of R = (isotropic / n_tx) I + F F^H; factor (n_tx, r) complex, F."""
        self._parts, self._n_rx = _root_parts(isotropic, factor), n_rx
        self._known: dict[float, Signature] = {}

    def at(self, nu: float) -> Signature:
        """In a direction."""
        if nu not in self._known:
            self.prepare(np.array([nu]))
        return self._known[nu]

    def prepare(self, nus: NDArray[np.float64]) -> None:
        """In many directions, which is faster together."""
        halves = _transmitted(self._parts, nus), steering_vector(nus, self._n_rx)
        self._known |= zip(nus.tolist(), zip(*halves, strict=True), strict=True)


def beampattern(isotropic: float, factor: NDArray[np.complex128], nus: ArrayLike) -> NDArray[np.float64]:
    """Power sent towards nu, a^T R a^* = isotropic + ||a^T F||^2; (n,) spatial frequencies -> (n,) power."""
    fields = steering_vector(nus, factor.shape[0]) @ factor
    return np.asarray(isotropic + np.sum(fields.real**2 + fields.imag**2, axis=1))


def beam_factor(nus: ArrayLike, shares: ArrayLike, n_tx: int) -> NDArray[np.complex128]:
    """Factor of a sum of conventional beams, R = sum_m shares_m a_m^* a_m^T / n_tx.

    nus, shares : (M,) spatial frequencies, power of each beam; returns (n_tx, M), columns sqrt(shares_m / n_tx) a_m^*
    """
    return (np.sqrt(np.asarray(shares, dtype=np.float64) / n_tx)[:, None] * steering_vector(nus, n_tx).conj()).T


def _transmitted(parts: _Root, nus: NDArray[np.float64]) -> NDArray[np.complex128]:
    level, u, gain = parts
    a = steering_vector(nus, u.shape[0])
    return level * a + ((a @ u) * gain) @ u.conj().T


def _root_parts(isotropic: float, factor: NDArray[np.complex128]) -> _Root:
    """w_0, U and d of the square root (`root`)."""
    level = float(np.sqrt(isotropic / factor.shape[0]))
    u, s, _ = np.linalg.svd(factor, full_matrices=False)
    return level, u, np.sqrt(level**2 + s**2) - level
