"""paper_world.py: the simulated world of the scenario `paper` as a front end, which tests the cells itself.

    python paper_world.py roof --listen tcp/127.0.0.1:7448 --seed 3
    cogradar run paper --seed 3 --front-end zenoh:roof@tcp/127.0.0.1:7448

It imports no cogradar, and `cogradar run paper --seed 3` has the same digest. Each number therefore has the last bit of
cogradar's: sums have one order (`last`, `product`), and complex products are taken by their parts (`times`). Nothing of
BLAS or LAPACK is called (docs/adr/0042-one-arithmetic.md). Symbols are in docs/explanation/model.md.
"""

import hashlib
import math
import struct

import numpy as np
from numpy.random.bit_generator import ISeedSequence
from zenoh_front_end import serve

TARGETS = ((20.0, 0.05, -60.0, 0.01), (60.0, 0.20, 7.5, 0.10), (5.0, 0.05, 60.0, 0.01))  # x, vx, y, vy; km, km/s
POLES = ((0.5, -0.4), (0.6, -0.2), (0.7, 0.0), (0.4, 0.1), (0.5, 0.3), (0.6, 0.35))  # modulus, angle / 2 pi
TRANSIENT, LANES = 128, 8  # innovations before a stretch of the disturbance; stretches of a cell, side by side


class _Words(ISeedSequence):
    """The three words of a generator's state."""

    def __init__(self, digest):
        self._words = np.frombuffer(digest, "<u8")

    def generate_state(self, n_words, dtype=np.uint64):
        return self._words[:n_words].astype(dtype)


def generator(seed, purpose, index, k):
    """Random numbers of (seed, purpose, target or bin, dwell), whatever was drawn before."""
    key = struct.pack("<Qqq", seed, index, k) + purpose
    return np.random.Generator(np.random.SFC64(_Words(hashlib.blake2b(key, digest_size=24).digest())))


def times(a, b):
    """Product of complex numbers by their parts; broadcasts."""
    found = np.empty(np.broadcast_shapes(np.shape(a), np.shape(b)), np.complex128)
    found.real = a.real * b.real - a.imag * b.imag
    found.imag = a.real * b.imag + a.imag * b.real
    return found


def square(z):
    """|z|^2."""
    return z.real * z.real + z.imag * z.imag


def last(x, axis=-1):
    """Sum from the first element to the last; `np.sum` has an order of its own."""
    return np.cumsum(x, axis).take(-1, axis)


def product(a, b):
    """Matrix product of complex matrices, four terms of a sum at a time."""
    terms = [times(a[:, [k]], b[k]) for k in range(len(b))]
    fours, total = len(terms) - len(terms) % 4, np.zeros((len(a), b.shape[1]), np.complex128)
    for k in range(0, fours, 4):
        total += (terms[k] + terms[k + 1]) + (terms[k + 2] + terms[k + 3])
    for term in terms[fours:]:
        total += term
    return total


def steering(nus, n):
    """a(nu)_i = exp(j 2 pi nu i), (nus, n)."""
    return np.exp(2j * np.pi * np.multiply.outer(nus, np.arange(n)))


# The signature of a direction: u = W^T a_T with W = R^(1/2), R = isotropic / n_tx I + F F^H, by the eigenvectors of
# F^H F. Householder's reflections make it tridiagonal, QL steps with implicit shifts diagonal. A beam each of three
# tracks: sums have up to three terms.


def tridiagonal(a):
    """Diagonal, elements beside it, and the rows of the reflections, of a real symmetric matrix, which is changed."""
    n = len(a)
    vectors, beside, kept = np.eye(n), np.zeros(n), []
    for k in range(n - 1):
        x = a[k, k + 1 :].copy()
        size = math.sqrt(last(x * x))
        if k == n - 2 or size < 1e-140:
            beside[k] = x[0]
            continue
        beside[k] = -math.copysign(size, x[0])
        x[0] -= beside[k]
        scale, rest = 2.0 / last(x * x), a[k + 1 :, k + 1 :]
        w = scale * last(rest * x)
        w += -0.5 * scale * last(w * x) * x
        rest += -x[:, np.newaxis] * w
        rest += -w[:, np.newaxis] * x
        kept.append((k, scale, x))
    for k, scale, x in reversed(kept):
        rows = vectors[k + 1 :, k + 1 :]
        rows += (-scale * last(rows * x))[:, np.newaxis] * x
    return np.diag(a).copy(), beside, vectors


def eigenvectors(a):
    """Eigenvalues, and eigenvectors as columns, of a real symmetric matrix."""
    scale = np.max(np.abs(a), initial=0.0)
    if scale == 0.0:
        return np.diag(a).copy(), np.eye(len(a))
    d, e, rows = tridiagonal(a / scale)
    for first in range(len(d)):
        while True:
            m = first  # the block from there to m is on its own
            while m < len(d) - 1 and abs(e[m]) > 2.0**-52 * (abs(d[m]) + abs(d[m + 1])):
                m += 1
            if m == first:
                break
            half = 0.5 * (d[first + 1] - d[first]) / e[first]
            shift = d[first] - e[first] / (half + math.copysign(math.sqrt(1.0 + half * half), half))
            g, sin, cos, taken = d[m] - shift, 1.0, 1.0, 0.0
            for i in range(m - 1, first - 1, -1):
                f, b = sin * e[i], cos * e[i]
                e[i + 1] = size = math.sqrt(f * f + g * g)
                sin, cos = f / size, g / size
                g = d[i + 1] - taken
                bent = (d[i] - g) * sin + 2.0 * cos * b
                taken = sin * bent
                d[i + 1] = g + taken
                g = cos * bent - b
                rows[i], rows[i + 1] = cos * rows[i] - sin * rows[i + 1], sin * rows[i] + cos * rows[i + 1]
            d[first] -= taken
            e[first], e[m] = g, 0.0
    return d * scale, rows.T


def signatures(isotropic, factor, nus):
    """u of n directions, (n, n_tx)."""
    n_tx, root = len(factor), np.sqrt(2)
    level, upper = float(np.sqrt(isotropic / n_tx)), factor[n_tx // 2 :]
    # Columns of F are conjugate symmetric: real coordinates say all.
    real = np.concatenate((root * upper.real, -root * upper.imag))
    squares, vectors = eigenvectors(product(real.T, real).real)
    order = np.argsort(-squares, kind="stable")
    squares, vectors = np.maximum(squares[order], 0.0), vectors[:, order]
    values = np.sqrt(np.where(squares > 1e-14 * squares[:1], squares, 0.0))
    columns = product(real, vectors).real / np.where(values > 0.0, values, np.inf)
    half = (columns[: n_tx // 2] - 1j * columns[n_tx // 2 :]) / root
    basis, gain = np.concatenate((half[::-1].conj(), half)), np.sqrt(level**2 + values**2) - level
    a = steering(nus, n_tx)
    return level * a + product(product(a, basis) * gain, basis.conj().T)


def innovations(words):
    """Complex t variates w of a word each: 40 bits for |w|^2 = u^(-1/2) - 1, 22 for the angle, 2 for the quadrant."""
    u = ((words >> np.uint64(24)).astype(np.float64) + 0.5) * 2.0**-40
    turn = (words >> np.uint64(2) & np.uint64(0x3FFFFF)).astype(np.float64)
    psi = (turn - (2.0**21 - 0.5)) * (np.pi / 2.0**23)
    p = psi * psi
    sine = psi * (1 + p * (-1 / 6 + p * (1 / 120 + p * (-1 / 5040 + p * (1 / 362880 + p * (-1 / 39916800))))))
    cosine = 1 + p * (
        -1 / 2 + p * (1 / 24 + p * (-1 / 720 + p * (1 / 40320 + p * (-1 / 3628800 + p * (1 / 479001600)))))
    )
    root = np.sqrt(u)
    r = np.sqrt((0.5 - 0.5 * root) / root)
    x = (1.0 - 2.0 * (words & np.uint64(1)).astype(np.float64)) * (r * (cosine - sine))
    return x, (1.0 - (words & np.uint64(2)).astype(np.float64)) * (r * (cosine + sine))


def coefficients():
    """-a_6 .. -a_1 of A(z) = prod (1 - p_i z^-1)."""
    found = np.array([1.0 + 0.0j])
    for modulus, turns in POLES:
        shifted = times(found, -(modulus * np.exp(2j * np.pi * turns)))
        found = np.append(found, 0j) + np.concatenate(([0j], shifted))
    return found[:0:-1, np.newaxis, np.newaxis]


def disturbance(seed, k, bins, n):
    """c_i = w_i - sum_j a_j c_{i-j} of each bin's cell, (bins, n), mean |c_i|^2 = 1."""
    n_step = -(-n // LANES)
    n_word = LANES * (TRANSIENT + n_step)
    words = [generator(seed, b"disturbance", b, k).bit_generator.random_raw(n_word) for b in bins]
    # Step by step, real and imaginary parts, of all lanes of all bins.
    w = np.array(innovations(np.array(words))).reshape(2, len(bins), -1, LANES).transpose(2, 0, 1, 3).copy()
    w[:TRANSIENT, ..., 1:] = w[n_step : n_step + TRANSIENT, ..., :-1]  # a lane starts with the end of the one before
    w = w.reshape(len(w), 2, -1)
    turned, a = np.stack((-w[:, 1], w[:, 0]), axis=1), coefficients()  # c, and j c
    for i in range(6, len(w)):
        p = a.real * w[i - 6 : i] + a.imag * turned[i - 6 : i]
        w[i] = ((w[i] - ((p[0] + p[1]) + (p[2] + p[3]))) - p[4]) - p[5]
        turned[i, 0], turned[i, 1] = -w[i, 1], w[i, 0]
    lanes = w[TRANSIENT:].reshape(n_step, 2, len(bins), LANES).transpose(2, 3, 0, 1)
    c = lanes.reshape(len(bins), -1)[:, : 2 * n]
    squares, whole = c * c, 2 * n - 2 * n % 64
    partial = last(squares[:, :whole].reshape(len(bins), -1, 64), axis=1)
    partial[:, 0] = last(np.concatenate((partial[:, :1], squares[:, whole:]), axis=1))
    return (c * np.sqrt(1.0 * n / last(partial))[:, np.newaxis]).view(np.complex128)


def wald_test(y, u, a_rx):
    """Columns of n cells, y (n, n_tx, n_rx): a Wald-type test that knows nothing of the disturbance."""
    n, lags = len(y), math.ceil(math.sqrt(math.sqrt(y[0].size)))
    power = last(square(u)) * last(square(a_rx))
    alpha = last(times(a_rx.conj(), last(times(u.conj()[..., np.newaxis], y), axis=1)))
    alpha.real, alpha.imag = alpha.real / power, alpha.imag / power
    v = times(u[..., np.newaxis], a_rx[:, np.newaxis])
    x = times(y - times(alpha[:, np.newaxis, np.newaxis], v), v.conj()).reshape(n, -1)
    before = np.concatenate((np.zeros((n, lags)), x), axis=1)[:, : x.shape[1]]
    recent = np.concatenate((np.zeros((n, 1)), np.cumsum(x - before, axis=1)[:, :-1]), axis=1)  # sum of the last lags
    b = last(square(x)) + 2.0 * last(x.real * recent.real + x.imag * recent.imag)
    sigma = np.sqrt(np.maximum(b, 0.0)) / power
    ratio = np.divide(np.sqrt(square(alpha)), sigma, out=np.zeros(n), where=sigma > 0.0)
    return {
        "statistic": np.array([2.0 * one**2 for one in ratio.tolist()]),  # not ratio**2, which is a product
        "alpha_hat": alpha.astype(np.complex64),
        "sigma_hat": sigma,
        "signature_power": power,
    }


class PaperWorld:
    """Three targets, each in the middle of its bin, and a disturbance of its own in each cell and dwell."""

    hands_over = "looks"

    def __init__(self, opening, seed):
        """What the radar is, as its scenario says."""
        radar = opening["radar"]
        self.n_tx, self.n_rx, self._n_bin = (radar["array"][name] for name in ("n_tx", "n_rx", "n_bin"))
        if radar["receiver"]["cells"] != "bins" or self.n_tx % 2:
            raise ValueError("this is the world of paper: radar.receiver.cells must be bins, radar.array.n_tx even")
        self._amplitude = 10.0 ** (radar["echo"]["amplitude_db"] / 20.0)
        self._dt_s, self._sigma = radar["motion"]["dt_s"], radar["motion"]["sigma_s_km_s2"]
        self._seed, self._states = seed, [np.array(TARGETS)]  # at clock 0, 1, ..

    def _at(self, t):
        while len(self._states) <= t:
            before, dt, m = self._states[-1], self._dt_s, range(len(TARGETS))
            w = [generator(self._seed, b"motion", one, len(self._states)).standard_normal(2) for one in m]
            w, after = self._sigma * np.array(w), np.empty_like(before)
            after[:, 0::2] = before[:, 0::2] + dt * before[:, 1::2] + 0.5 * dt * dt * w
            after[:, 1::2] = before[:, 1::2] + dt * w
            after[:, 0] = np.maximum(after[:, 0], 0.0)
            self._states.append(after)
        return self._states[t]

    def _echoes(self, k, t):
        """Amplitude of the echo of each bin with a target."""
        x, y = self._at(t)[:, 0], self._at(t)[:, 2]
        bins = np.floor((0.5 * y / np.sqrt(x * x + y * y) + 0.5) * (self._n_bin - 1) + 0.5).astype(int).tolist()
        turns = np.array([generator(self._seed, b"phase", m, k).random() for m in range(len(TARGETS))])
        alphas = self._amplitude / np.maximum(x**2 + y**2, 1e-12) * np.exp(2j * np.pi * turns)
        return {b: last(alphas[np.equal(bins, b)]) for b in bins}

    def receive(self, dwell):
        """Columns of dwell k, a row for each look."""
        bins, nus, echoes = dwell["bins"].tolist(), dwell["nus"], self._echoes(dwell["k"], dwell["t"])
        u, a_rx = signatures(dwell["isotropic"], dwell["factor"].astype(np.complex128), nus), steering(nus, self.n_rx)
        y = disturbance(self._seed, dwell["k"], bins, self.n_tx * self.n_rx).reshape(-1, self.n_tx, self.n_rx)
        for one, bin_ in enumerate(bins):
            if bin_ in echoes:
                y[one] += times(times(echoes[bin_], u[one])[:, np.newaxis], a_rx[one])
        return {"bins": dwell["bins"], **wald_test(y, u, a_rx)}


if __name__ == "__main__":
    serve(PaperWorld)
