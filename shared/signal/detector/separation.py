"""Echoes told apart: the Wald test of a look beside other echoes in the same data set.

Symbols: Y (n_tx, n_rx) data set, y its rows one after another; v_j = u_j kron a_j signature of direction nu_j, v_1 of
the look's; c disturbance; l lags of its memory.

    G_jk = v_j^H v_k = (u_j^H u_k)(a_j^H a_k),   b_j = v_j^H y = u_j^H Y a_j^*,   alpha = G^-1 b
    e = sum_j (G^-1)_j1 v_j,   alpha_hat = alpha_1 = e^H y,   B = E |e^H c|^2,   Lambda = 2 |alpha_hat|^2 / B

Without a target in the look's direction Lambda has the distribution of `wald_test`, however strong the other echoes
are. What is left of the signature's power ||v||^2 beside its neighbours is 1 / (G^-1)_11.

The disturbance stays unknown. Of what all echoes leave, r = y - sum_j alpha_j v_j, with x = r .* e^*:

    lags   B = sum_n |x_n|^2 + 2 Re sum_{m=1..l} sum_n x_n x_{n-m}^*
    rows   B = k / (k - 1) sum_i |sum_r x_ir|^2,   k = (sum_i E_i)^2 / sum_i E_i^2,   E_i = sum_r |e_ir|^2

`wald_test` has the first; it is negative now and then where noise comes from one direction. The second takes
transmit channels as independent clusters (Liang and Zeger 1986) and is never negative, whatever is correlated along the
receive array. Its Lambda / 2 has an F distribution with 2 and 2 (k - 1) degrees of freedom, exactly if all E_i are
equal and rows are independent; what is reported,

    2 (k - 1) ln(1 + Lambda / (2 (k - 1))),

is chi-square again. Short rows are not independent in a coloured disturbance: with 4 receive antennas P_FA is three
times the nominal one.

The other echoes are found in the data themselves. First comes the strongest direction of a grid, measured as in
`monopulse`; then all directions again, each with the others removed (RELAX; Li and Stoica 1996). The next one follows,
until none is strong. Of n found ones the next n // 4 + 1 are looked for at a time, as RELAX takes a time proportional
to n.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.elementwise import log1p, modulus, squared_modulus, times
from cogradar.shared.numerics.fourier import fourier
from cogradar.shared.numerics.jit import kernel
from cogradar.shared.numerics.linear import product, solve
from cogradar.shared.signal.monopulse import off_axis, ratio
from cogradar.shared.signal.receiver import LEAST_DOF, accumulate, add_band, beamformed, no_band
from cogradar.shared.signal.waveform import Root, Signature, Signatures, signature

Complexes = NDArray[np.complex128]
Floats = NDArray[np.float64]

MOST_ECHOES = 32  # of one data set
FOUND_ABOVE = 30.0  # statistic of an echo that is told apart
_PER_LOBE = 4  # directions of the grid in half of a main lobe
_MEASURED = 2  # times that the direction of a new echo is measured
_SWEEPS = 2  # over all directions at the end
_FOUND_FOR_EACH = 4  # echoes that were found before two, three ... further ones are looked for at a time
_CLEAR = 1.5  # lobes between echoes that are found at a time
_ABOVE_SIDELOBES = 0.1  # power of an echo that is found beside a stronger one: the largest sidelobe has 0.05
_ONE_ECHO = 0.25  # lobes between two directions that are one
_RIDGE, _TINY = 1e-12, 1e-300


class Echoes(NamedTuple):
    """What was found in a data set, J echoes."""

    nus: Floats  # (J,) directions
    u: Complexes  # (J, n_tx) transmit halves of their signatures
    a: Complexes  # (J, n_rx) receive halves


class Fitted(NamedTuple):
    """What a joint fit says of its first signature."""

    alpha_hat: complex
    b: float  # E |e^H c|^2; not above 0: no estimate
    signature_power: float  # left of it beside the others
    dof: float  # k - 1; 0: of the sum over lags


def find_echoes(y: Complexes, signatures: Signatures) -> Echoes:
    """The echoes in a data set.

    y : (n_tx n_rx,) complex, Y transmit channel by transmit channel
    """
    n_rx, root = signatures.n_rx, signatures.root
    grid_nus, grid_u = signatures.grid(_PER_LOBE * max(n_rx, root[1].shape[0]))
    turns = np.exp(1j * np.pi * np.arange(n_rx))  # the grid begins at -0.5
    nus, left = np.empty(0), y
    while nus.size < MOST_ECHOES:
        z = fourier(times(left.reshape(-1, n_rx), turns), grid_nus.size)
        alphas, b, power, dof = row_tests(z.T, grid_u, n_rx)
        statistic = as_chi_square(2.0 * squared_modulus(alphas) * power**2 / np.maximum(b, _TINY), dof)
        most = min(1 + nus.size // _FOUND_FOR_EACH, MOST_ECHOES - nus.size)
        new = grid_nus[_strongest(grid_nus, statistic, squared_modulus(alphas) * power, most, _CLEAR / n_rx)]
        if new.size == 0:
            break
        for _ in range(_MEASURED):
            new = np.array([_measured(left, root, nu, n_rx) for nu in new.tolist()])
        found = _relaxed(y, root, np.append(nus, new), n_rx, 1)
        if found.size <= nus.size:  # what was found is what had been found
            break
        nus, left = found, _left(y, *_signatures(root, found, n_rx), np.ones(found.size, np.bool_))
    if nus.size > 1:
        nus = _relaxed(y, root, nus, n_rx, _SWEEPS)
    return Echoes(nus, *_signatures(root, nus, n_rx))


def _strongest(nus: Floats, statistic: Floats, power: Floats, most: int, clear: float) -> NDArray[np.int64]:
    """The largest statistics above FOUND_ABOVE that are so clear of each other that none is another's sidelobe.

    nus   : (n,) directions of the grid
    power : (n,) that an echo there explains
    """
    left, found = statistic.copy(), list[int]()
    while len(found) < most:
        at = int(np.argmax(left))
        if left[at] < FOUND_ABOVE:
            break
        found.append(at)
        off = np.abs(nus - nus[at])
        left[(np.minimum(off, 1.0 - off) < clear) | (power < _ABOVE_SIDELOBES * power[at])] = 0.0
    return np.array(found, np.int64)


def no_echoes(n_tx: int, n_rx: int) -> Echoes:
    """None were found."""
    return Echoes(np.empty(0), np.empty((0, n_tx), np.complex128), np.empty((0, n_rx), np.complex128))


def fit(y: Complexes, own: Signature, others: Echoes, lags: int) -> Fitted:
    """What a joint fit of a look's signature and other echoes' says of the first.

    y    : (n_tx n_rx,) complex
    lags : of the sum over lags; 0: rows are clusters
    """
    alpha_hat, b, power, dof = _fitted(y, *own, others.u, others.a, lags)
    return Fitted(alpha_hat, b, power, dof)


def is_beside(echoes: Echoes, nu: float) -> NDArray[np.bool_]:
    """Which are outside of the main lobe of a look in this direction, (J,): what is in it may be the look's own."""
    off = np.abs(echoes.nus - nu)
    return np.asarray(np.minimum(off, 1.0 - off) >= 1.0 / echoes.a.shape[1])


def is_beside_each(echoes: Echoes, nus: Floats) -> NDArray[np.bool_]:
    """The same of n looks, (n, J)."""
    off = np.abs(echoes.nus - nus[:, np.newaxis])
    return np.asarray(np.minimum(off, 1.0 - off) >= 1.0 / echoes.a.shape[1])


def power_beside(echoes: Echoes, u: Complexes, a: Complexes) -> Floats:
    """What is left of the power of n signatures beside the echoes, ||v||^2 - g^H G^-1 g with g = V^H v, (n,).

    u, a : (n, n_tx) and (n, n_rx), both halves of the signatures
    """
    gram = times(product(echoes.u.conj(), echoes.u.T), product(echoes.a.conj(), echoes.a.T))
    g = times(product(echoes.u.conj(), u.T), product(echoes.a.conj(), a.T))
    power = np.sum(squared_modulus(u), axis=1) * np.sum(squared_modulus(a), axis=1)
    ridge = np.diag(_RIDGE * modulus(np.diag(gram)) + _TINY)
    taken = np.sum(times(g.conj(), solve(gram + ridge, g)).real, axis=0)
    return np.asarray(np.maximum(power - taken, 0.0))


def beside(echoes: Echoes, nu: float) -> Echoes:
    """Those outside of the main lobe of a look in this direction."""
    is_other = is_beside(echoes, nu)
    return Echoes(echoes.nus[is_other], echoes.u[is_other], echoes.a[is_other])


def without(y: Complexes, echoes: Echoes, is_removed: NDArray[np.bool_]) -> Complexes:
    """A data set without some echoes, (J,); all of them are fitted, so that none has a part of another."""
    return _left(y, echoes.u, echoes.a, is_removed)


def as_chi_square(statistic: Floats, dof: Floats) -> Floats:
    """The statistic that has, without a target, the chi-square distribution with 2 degrees of freedom; (n,) -> (n,).

    dof : (n,) k - 1, as F has 2 and 2 (k - 1) degrees of freedom; 0: it has this distribution
    """
    twice = 2.0 * np.where(dof > 0.0, dof, 1.0)
    return np.where(dof > 0.0, twice * log1p(statistic / twice), statistic)


def row_tests(z: Complexes, u: Complexes, n_rx: int) -> tuple[Complexes, Floats, Floats, Floats]:
    """Tests of n directions without other echoes, rows as clusters: alpha_hat, B, ||v||^2 and k - 1, (n,) each.

    z, u : (n, n_tx) complex, Y a_R^* and W^T a_T of each direction
    """
    alphas, b, power, dof = _row_tests(np.ascontiguousarray(z), np.ascontiguousarray(u), n_rx)
    return alphas, b, power, dof


@kernel
def _row_tests(z: Complexes, u: Complexes, n_rx: int) -> tuple[Complexes, Floats, Floats, Floats]:
    n = u.shape[0]
    alphas, bs, powers, dofs = np.zeros(n, np.complex128), np.zeros(n), np.zeros(n), np.zeros(n)
    for g in range(n):
        power, squares, total = 0.0, 0.0, 0j
        for i in range(u.shape[1]):
            p = u[g, i].real ** 2 + u[g, i].imag ** 2
            power, squares, total = power + p, squares + p * p, total + np.conj(u[g, i]) * z[g, i]
        if power == 0.0:
            continue
        alphas[g], b = total / (power * n_rx), 0.0
        for i in range(u.shape[1]):
            x = np.conj(u[g, i]) * (z[g, i] - alphas[g] * n_rx * u[g, i])
            b += x.real * x.real + x.imag * x.imag
        dofs[g] = power * power / squares - 1.0
        bs[g] = b * (dofs[g] + 1.0) / max(dofs[g], LEAST_DOF)
        powers[g] = power * n_rx
    return alphas, bs, powers, dofs


@kernel
def _measured(y: Complexes, root: Root, nu: float, n_rx: int) -> float:
    """Direction of the echo near nu."""
    u, a = signature(root, nu, n_rx)
    if np.sum(modulus(u)) == 0.0:
        return nu
    nu += off_axis(ratio(y, u, a), n_rx)
    return float(nu - np.floor(nu + 0.5))  # -0.5 and 0.5 are one direction


@kernel
def _signatures(root: Root, nus: Floats, n_rx: int) -> tuple[Complexes, Complexes]:
    """Both halves of the signatures in n directions, (n, n_tx) and (n, n_rx)."""
    u, a = np.empty((nus.size, root[1].shape[0]), np.complex128), np.empty((nus.size, n_rx), np.complex128)
    for j in range(nus.size):
        u[j], a[j] = signature(root, nus[j], n_rx)
    return u, a


@kernel
def _relaxed(y: Complexes, root: Root, nus: Floats, n_rx: int, sweeps: int) -> Floats:
    """Directions measured again, each with the others removed; of two that have become one the first is kept."""
    u, a = _signatures(root, nus, n_rx)
    alphas, _ = _solved(y, u, a)
    left, nus = y.copy(), nus.copy()
    for j in range(nus.size):
        _add(left, -alphas[j], u[j], a[j])
    for _ in range(sweeps):
        for j in range(nus.size):
            _add(left, alphas[j], u[j], a[j])
            nus[j] = _measured(left, root, nus[j], n_rx)
            u[j], a[j] = signature(root, nus[j], n_rx)
            power = np.sum(squared_modulus(u[j])) * n_rx
            alphas[j] = np.sum(np.conj(a[j]) * beamformed(left, u[j], n_rx)) / power if power > 0.0 else 0j
            _add(left, -alphas[j], u[j], a[j])
    is_kept = np.ones(nus.size, np.bool_)
    for j in range(nus.size):
        for i in range(j):
            off = abs(nus[j] - nus[i])
            is_kept[j] &= not is_kept[i] or min(off, 1.0 - off) > _ONE_ECHO / max(n_rx, u.shape[1])
    return nus[is_kept]


@kernel
def _left(y: Complexes, u: Complexes, a: Complexes, is_removed: NDArray[np.bool_]) -> Complexes:
    """What some of the signatures, all fitted together, leave of a data set."""
    left = y.copy()
    if u.shape[0] > 0:
        alphas, _ = _solved(y, u, a)
        for j in np.flatnonzero(is_removed):
            _add(left, -alphas[j], u[j], a[j])
    return left


@kernel
def _add(y: Complexes, alpha: complex, u: Complexes, a: Complexes) -> None:
    """y += alpha u kron a."""
    for i in range(u.size):
        accumulate(a, alpha * u[i], y[i * a.size : (i + 1) * a.size])


@kernel
def _solved(y: Complexes, u: Complexes, a: Complexes) -> tuple[Complexes, Complexes]:
    """alpha = G^-1 b and c = G^-1 e_1, (m,) each, by Gaussian elimination: G is positive definite."""
    m, n_rx = u.shape[0], a.shape[1]
    gram, right = np.empty((m, m), np.complex128), np.zeros((m, 2), np.complex128)
    right[0, 1] = 1.0
    for j in range(m):
        right[j, 0] = np.sum(np.conj(a[j]) * beamformed(y, u[j], n_rx))
        for k in range(m):
            gram[j, k] = np.sum(np.conj(u[j]) * u[k]) * np.sum(np.conj(a[j]) * a[k])
        gram[j, j] += _RIDGE * modulus(gram[j, j]) + _TINY
    for j in range(m):
        for k in range(j + 1, m):
            factor = gram[k, j] / gram[j, j]
            gram[k, j:] -= factor * gram[j, j:]
            right[k] -= factor * right[j]
    for j in range(m - 1, -1, -1):
        for k in range(j + 1, m):
            right[j] -= gram[j, k] * right[k]
        right[j] /= gram[j, j]
    return right[:, 0].copy(), right[:, 1].copy()


@kernel
def _fitted(
    y: Complexes, own_u: Complexes, own_a: Complexes, other_u: Complexes, other_a: Complexes, lags: int
) -> tuple[complex, float, float, float]:
    """The fields of `Fitted`."""
    n_tx, n_rx, m = own_u.size, own_a.size, other_u.shape[0] + 1
    u, a = np.empty((m, n_tx), np.complex128), np.empty((m, n_rx), np.complex128)
    u[0], a[0], u[1:], a[1:] = own_u, own_a, other_u, other_a
    if np.sum(modulus(own_u)) == 0.0:
        return 0j, 0.0, 0.0, 0.0
    alphas, c = _solved(y, u, a)
    band, x = no_band(), np.zeros(lags + n_rx, np.complex128)
    row = x[lags:]
    clusters, weights = 0.0, np.zeros(n_tx)
    for i in range(n_tx):
        e, left = np.zeros(n_rx, np.complex128), y[i * n_rx : (i + 1) * n_rx].copy()
        for j in range(m):
            accumulate(a[j], c[j] * u[j, i], e)
            accumulate(a[j], -alphas[j] * u[j, i], left)
        _match(left, e, row)
        total = np.sum(row)
        clusters += total.real * total.real + total.imag * total.imag
        weights[i] = np.sum(e.real * e.real + e.imag * e.imag)
        band = add_band(x, lags, band)
    power = 1.0 / c[0].real
    if lags > 0:
        return alphas[0], band[0] + 2.0 * band[1], power, 0.0
    dof = np.sum(weights) ** 2 / np.sum(weights * weights) - 1.0
    return alphas[0], clusters * (dof + 1.0) / max(dof, LEAST_DOF), power, dof


@kernel
def _match(left: Complexes, e: Complexes, x: Complexes) -> None:
    """x = left .* e^*; a function of its own, so that the compiler vectorises the loop."""
    for r in range(x.size):
        x[r] = left[r] * np.conj(e[r])
