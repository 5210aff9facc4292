"""What is radiated: isotropic power plus a few beams.

Symbols: R = W W^H transmit covariance, tr R = P_T; W = R^{1/2} Hermitian; R = (isotropic / n_tx) I + F F^H, F the
factor, (n_tx, r) complex, one column per beam (none: the orthogonal waveform); a(nu) transmit steering vector.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cogradar.shared.numerics.elementwise import log10, squared_modulus, times
from cogradar.shared.numerics.jit import kernel
from cogradar.shared.numerics.linear import embedded, product, singular
from cogradar.shared.signal.array import steering_vector
from cogradar.shared.signal.receiver import accumulate

Signature = tuple[NDArray[np.complex128], NDArray[np.complex128]]  # W^T a_T (n_tx,) and a_R (n_rx,)
# w_0, U, d and U^H of the square root (`root`)
Root = tuple[float, NDArray[np.complex128], NDArray[np.float64], NDArray[np.complex128]]


def covariance(isotropic: float, factor: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Transmit covariance R = (isotropic / n_tx) I + F F^H, (n_tx, n_tx) complex; tr R = isotropic + ||F||_F^2."""
    n_tx = factor.shape[0]
    R: NDArray[np.complex128] = isotropic / n_tx * np.eye(n_tx) + product(factor, factor.conj().T)
    return R


def root(isotropic: float, factor: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Waveform W = R^{1/2}, the Hermitian square root.

        W = w_0 I + U diag(d) U^H,   F = U S V^H,  w_0^2 = isotropic / n_tx,  d = sqrt(w_0^2 + S^2) - w_0

    isotropic : float >= 0, power sent equally in all directions
    factor    : (n_tx, r) complex, F
    returns   : (n_tx, n_tx) complex
    Cost O(n_tx r^2 + n_tx^2 r) through singular vectors, against O(n_tx^3) for the square root of R itself. Of a
    factor without the symmetry of `antennas` each vector is there twice, turned by 90 degrees, with half of d.
    """
    level, u, gain, hermitian = _root_parts(isotropic, factor)
    return np.asarray(level * np.eye(factor.shape[0]) + product(u * gain, hermitian))


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
    return _transmitted(_root_parts(isotropic, factor), steering_vector(nus, factor.shape[0]))


class Elements(NamedTuple):
    """Complex gains of the antennas, 1 of one without an error, 0 of a dead one."""

    sent: NDArray[np.complex128]  # (n_tx,)
    received: NDArray[np.complex128]  # (n_rx,)


class Signatures:
    """Both halves of the signatures v = (W^T a_T(nu)) kron a_R(nu) of a waveform, each worked out once."""

    def __init__(
        self, isotropic: float, factor: NDArray[np.complex128], n_rx: int, elements: Elements | None = None
    ) -> None:
        """Of R = (isotropic / n_tx) I + F F^H.

        factor   : (n_tx, r) complex, F
        elements : what the antennas make of a_T and a_R; None: nothing, as the receiver assumes
        """
        self.root, self.n_rx, self._elements = _root_parts(isotropic, factor), n_rx, elements
        self._known: dict[float, Signature] = {}
        self._powers: dict[float, float] = {}
        self._grid: tuple[NDArray[np.float64], NDArray[np.complex128]] | None = None
        self._expected: list[list[float]] = []  # directions that are not worked out yet

    @property
    def isotropic_level(self) -> float | None:
        """w_0 of a waveform W = w_0 I; None if it has beams."""
        level, u, *_ = self.root
        return None if u.shape[1] else level

    def at(self, nu: float) -> Signature:
        """In a direction."""
        if nu not in self._known:
            together = next((nus for nus in self._expected if nu in nus), [nu])
            self._work_out(np.array(together))
            self._expected = [nus for nus in self._expected if nus is not together]
        return self._known[nu]

    def power_at(self, nu: float) -> float:
        """||v||^2 in a direction."""
        self.at(nu)
        return self._powers[nu]

    def prepare(self, nus: list[float]) -> None:
        """Expect many directions: they are worked out together, which is faster, with the first that is needed."""
        self._expected.append(nus)

    def grid(self, n: int) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
        """n directions at equal steps from -0.5 on, (n,), and the transmit halves of their signatures, (n, n_tx)."""
        if self._grid is None or self._grid[0].size != n:
            nus = np.arange(n) / n - 0.5
            self._grid = nus, _transmitted(self.root, steering_vector(nus, self.root[1].shape[0]))
        return self._grid

    def _work_out(self, nus: NDArray[np.float64]) -> None:
        n_tx = self.root[1].shape[0]
        a_tx = steering_vector(nus, n_tx)
        a_rx = a_tx if self.n_rx == n_tx else steering_vector(nus, self.n_rx)
        if self._elements is not None:
            a_tx, a_rx = times(a_tx, self._elements.sent), times(a_rx, self._elements.received)
        halves = _transmitted(self.root, a_tx), a_rx
        self._known |= zip(nus.tolist(), zip(*halves, strict=True), strict=True)
        powers = np.sum(squared_modulus(halves[0]), axis=1) * np.sum(squared_modulus(a_rx), axis=1)
        self._powers |= zip(nus.tolist(), powers.tolist(), strict=True)


@kernel
def signature(root: Root, nu: float, n_rx: int) -> Signature:
    """Both halves of the signature in one direction, for kernels."""
    level, u, gain, hermitian = root
    n_tx = u.shape[0]
    a_tx, a_rx = np.empty(n_tx, np.complex128), np.empty(n_rx, np.complex128)
    for i in range(n_tx):
        a_tx[i] = np.exp(2j * np.pi * nu * i)
    for i in range(n_rx):
        a_rx[i] = a_tx[i] if i < n_tx else np.exp(2j * np.pi * nu * i)
    sent = np.zeros(gain.size, np.complex128)
    for i in range(n_tx):
        accumulate(u[i], a_tx[i], sent)
    total = level * a_tx
    for j in range(gain.size):
        accumulate(hermitian[j], gain[j] * sent[j], total)
    return total, a_rx


def beampattern(isotropic: float, factor: NDArray[np.complex128], nus: ArrayLike) -> NDArray[np.float64]:
    """Power sent towards nu, a^T R a^* = isotropic + ||a^T F||^2; (n,) spatial frequencies -> (n,) power."""
    fields = product(np.atleast_2d(steering_vector(nus, factor.shape[0])), factor)
    return np.asarray(isotropic + np.sum(fields.real**2 + fields.imag**2, axis=1))


def antenna_powers(isotropic: float, factor: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Power of each transmit antenna, R_ii = isotropic / n_tx + ||F_i||^2, (n_tx,)."""
    return np.asarray(isotropic / factor.shape[0] + np.sum(factor.real**2 + factor.imag**2, axis=1))


def peak_to_average_db(isotropic: float, factor: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Peak over mean power of what each transmit antenna sends, dB, (n_tx,); 0 of one that sends nothing.

    What is sent is X = W S. S depends on the hardware. Here it has the n_tx cyclic shifts of a Zadoff-Chu sequence of
    n_tx samples: orthonormal rows of constant modulus, with which one direction alone is sent with constant modulus.
    """
    n = factor.shape[0]
    m = np.arange(n)
    sequence = np.exp(-1j * np.pi * m * (m + n % 2) / n)
    power = squared_modulus(product(root(isotropic, factor), sequence[(m - m[:, np.newaxis]) % n]))
    mean = power.mean(axis=1)
    ratio = np.divide(power.max(axis=1), mean, out=np.ones(n), where=mean > 0.0)
    return np.asarray(10.0 * log10(ratio))


def beam_factor(nus: ArrayLike, shares: ArrayLike, n_tx: int) -> NDArray[np.complex128]:
    """Factor of a sum of conventional beams, R = sum_m shares_m a_m^* a_m^T / n_tx.

    nus, shares : (M,) spatial frequencies, power of each beam
    returns     : (n_tx, M), columns sqrt(shares_m / n_tx) a_m^*, a_m with its phase reference at the array's centre:
                  they are conjugate symmetric to the last bit, as `antennas` makes them
    """
    places = np.arange(n_tx) - 0.5 * (n_tx - 1)
    beams: NDArray[np.complex128] = np.exp(-2j * np.pi * np.multiply.outer(places, nus))
    return beams * np.sqrt(np.asarray(shares, dtype=np.float64) / n_tx)


def antennas(coordinates: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Conjugate symmetric excitations of the antennas from their real coordinates, (n_tx, r) -> (n_tx, r).

    The coordinates are of a unitary basis: sqrt 2 times the real and minus the imaginary parts of the upper half, and
    the middle antenna if n_tx is odd.
    """
    half = coordinates.shape[0] // 2
    upper = (coordinates[:half] - 1j * coordinates[half : 2 * half]) / np.sqrt(2)
    middle = coordinates[2 * half :].astype(np.complex128)
    return np.concatenate([upper[::-1].conj(), middle, upper])


def _coordinates(factor: NDArray[np.complex128]) -> NDArray[np.float64] | None:
    """What `antennas` makes the factor of; None of one whose columns are not conjugate symmetric."""
    if not np.array_equal(factor, factor[::-1].conj()):
        return None
    half = factor.shape[0] // 2
    upper, middle = factor[factor.shape[0] - half :], factor[half : factor.shape[0] - half]
    return np.concatenate((np.sqrt(2) * upper.real, -np.sqrt(2) * upper.imag, middle.real))


def _transmitted(parts: Root, a: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """W^T a of steering vectors, (n, n_tx) -> (n, n_tx)."""
    level, u, gain, hermitian = parts
    return np.asarray(level * a + product(product(a, u) * gain, hermitian))


def _root_parts(isotropic: float, factor: NDArray[np.complex128]) -> Root:
    """w_0, U and d of the square root (`root`)."""
    level = float(np.sqrt(isotropic / factor.shape[0]))
    real = _coordinates(factor)  # of all built-in rules: a quarter of the arithmetic
    u, s = singular(embedded(factor) if real is None else real)
    gain = np.sqrt(level**2 + s**2) - level
    if real is not None:
        vectors = antennas(u)
    else:  # each singular value twice, with two vectors
        half = factor.shape[0]
        vectors, gain = u[:half] + 1j * u[half:], 0.5 * gain
    vectors = np.ascontiguousarray(vectors)
    return level, vectors, gain, np.ascontiguousarray(vectors.conj().T)
