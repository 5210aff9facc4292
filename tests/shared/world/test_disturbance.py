"""The disturbance against its spectrum and its marginal laws.

Statistical intervals: p > 1e-6 for Kolmogorov-Smirnov tests, 5 sigma (5.7e-7) for means.
"""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.signal import lfilter
from scipy.stats import gamma, ks_2samp, kstest

from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.world import disturbance
from cogradar.shared.world.disturbance import draw, power_spectrum

MODELS = ("ar6-t", "ar3-t", "compound-ar6", "white")
# Poles (modulus, angle / 2 pi), from Lisi et al. (arXiv 2112.02628)
POLES = {
    "ar6-t": [(0.5, -0.4), (0.6, -0.2), (0.7, 0.0), (0.4, 0.1), (0.5, 0.3), (0.6, 0.35)],
    "ar3-t": [(0.5, 0.0), (0.3, -0.1), (0.4, 0.05)],
    "white": [],
}
POLES["compound-ar6"] = POLES["ar6-t"]


def rng(k: int) -> np.random.Generator:
    return generator(4, Purpose.DISTURBANCE, 0, k)


# Spectrum


@pytest.mark.parametrize("model", MODELS)
def test_spectrum_is_the_product_over_the_poles_with_mean_one(model: str) -> None:
    def unnormalised(nu: float) -> float:
        factors = [abs(1 - r * np.exp(2j * np.pi * (turns - nu))) ** -2 for r, turns in POLES[model]]
        return float(np.prod(factors))

    mean = quad(unnormalised, -0.5, 0.5, epsabs=1e-12)[0]
    nus = np.linspace(-0.5, 0.5, 41)
    np.testing.assert_allclose(power_spectrum(model, nus), [unnormalised(nu) / mean for nu in nus], rtol=1e-9)


@pytest.mark.parametrize("n", [0, 1, 2000])
@pytest.mark.parametrize("model", MODELS)
def test_levels_of_many_directions_are_those_of_each_alone_to_the_last_bit(model: str, n: int) -> None:
    nus = np.random.default_rng(3).uniform(-0.5, 0.5, n).tolist()
    assert disturbance.levels(model, nus) == [float(power_spectrum(model, nu)) for nu in nus]


def test_range_of_the_ar6_spectrum() -> None:
    """0.283 .. 2.617, 10 dB apart: the extremes of the closed form, to the three decimals printed."""
    spectrum = power_spectrum("ar6-t", np.linspace(-0.5, 0.5, 10_001))
    assert spectrum.min() == pytest.approx(0.283, abs=5e-4)
    assert spectrum.max() == pytest.approx(2.617, abs=5e-4)


@pytest.mark.parametrize("model", MODELS)
def test_periodogram_follows_the_spectrum(model: str) -> None:
    """Mean periodogram at five frequencies: exponential with mean S_c, so 5 S_c / sqrt(400) either side.

    Its own bias at 2000 samples is at most 0.5 % at these.
    """
    nus = np.array([-0.36, -0.17, 0.003, 0.11, 0.3])
    kernel = np.exp(-2j * np.pi * np.outer(nus, np.arange(2000)))
    n_cell = 400
    cells = np.array([draw(model, 2000, rng(k)) for k in range(n_cell)])
    cells /= np.sqrt(np.mean(np.abs(cells) ** 2, axis=1, keepdims=True))  # the texture
    periodogram = np.abs(cells @ kernel.T) ** 2 / 2000
    deviation = np.abs(periodogram.mean(axis=0) / power_spectrum(model, nus) - 1.0)
    assert np.all(deviation < 5.0 / np.sqrt(n_cell))


# Power and texture


@pytest.mark.parametrize("model", ["ar6-t", "ar3-t", "white"])
@pytest.mark.parametrize("n", [16, 1000, 10_000])
def test_sample_power_is_one(model: str, n: int) -> None:
    c = draw(model, n, rng(n))
    assert c.shape == (n,)
    assert c.dtype == np.complex128
    assert c.flags.c_contiguous
    assert np.mean(np.abs(c) ** 2) == pytest.approx(1.0, rel=1e-12)


def test_texture_is_inverse_gamma_and_one_per_vector() -> None:
    """The sample power of a compound vector is its texture, 1 / Gamma(2, 1)."""
    power = np.array([np.mean(np.abs(draw("compound-ar6", 50, rng(k))) ** 2) for k in range(3000)])
    assert kstest(1.0 / power, gamma(2.0).cdf).pvalue > 1e-6


def test_the_transient_is_gone() -> None:
    """Stationary from the first sample on: E|c_0|^2 = 1; at the filter's start it is 0.78 (one over the power gain).

    Gaussian speckle of power 1, so |c_0|^2 is nearly exponential: 5 / sqrt(4000) either side.
    """
    cells = np.array([draw("compound-ar6", 100, rng(k)) for k in range(4000)])
    cells /= np.sqrt(np.mean(np.abs(cells) ** 2, axis=1, keepdims=True))
    assert abs(np.mean(np.abs(cells[:, 0]) ** 2) - 1.0) < 5.0 / np.sqrt(4000)


def test_white_is_circular_gaussian() -> None:
    c = draw("white", 10_000, rng(0))
    assert kstest(np.abs(c) ** 2, "expon").pvalue > 1e-6
    assert kstest(np.angle(c) / (2 * np.pi), "uniform", args=(-0.5, 1.0)).pvalue > 1e-6
    assert abs(np.mean(c**2)) < 5.0 * np.sqrt(2.0 / 10_000)  # E|c^2|^2 = 2


# Innovations


def test_innovations_are_complex_t() -> None:
    w = complex_t(20_000, rng(1))
    power = np.abs(w) ** 2
    assert kstest(power, lambda x: 1.0 - (1.0 + x) ** -2.0).pvalue > 1e-6
    other = rng(2)
    literal = other.standard_normal(40_000).view(np.complex128) / np.sqrt(2.0 * other.gamma(2.0, 1.0, 20_000))
    assert ks_2samp(w.real, literal.real).pvalue > 1e-6
    assert ks_2samp(w.imag, literal.imag).pvalue > 1e-6
    assert kstest(np.angle(w) / (2 * np.pi), "uniform", args=(-0.5, 1.0)).pvalue > 1e-6
    # The angle is independent of the modulus: the same law for the weak half as for the strong one.
    strong = power > np.median(power)
    assert ks_2samp(np.angle(w[strong]), np.angle(w[~strong])).pvalue > 1e-6
    # Samples are independent of their neighbours; signs, because the fourth moment is infinite.
    assert abs(np.mean(np.sign(w.real[1:] * w.real[:-1]))) < 5.0 / np.sqrt(20_000)


@pytest.mark.parametrize(
    ("model", "heavy"), [("ar6-t", True), ("ar3-t", True), ("compound-ar6", False), ("white", False)]
)
def test_innovations_of_every_model(model: str, heavy: bool) -> None:
    """A(z) takes the colour out again; what is left has its law up to scale, which the median fixes."""
    c = draw(model, 10_000, rng(7))
    w = lfilter(np.poly([r * np.exp(2j * np.pi * turns) for r, turns in POLES[model]]), [1.0], c)[6:]
    power = np.abs(w) ** 2 / np.median(np.abs(w) ** 2)
    lomax, exponential = (lambda x: 1.0 - (1.0 + x * (np.sqrt(2.0) - 1.0)) ** -2.0), (lambda x: 1.0 - 0.5**x)
    assert (kstest(power, lomax).pvalue > 1e-6) == heavy
    assert (kstest(power, exponential).pvalue > 1e-6) == (not heavy)


def complex_t(n: int, rng: np.random.Generator) -> NDArray[np.complex128]:
    parts = np.empty((2, n))
    disturbance._draw_complex_t(parts, rng)
    return np.asarray(parts[0] + 1j * parts[1])


def test_words_become_complex_t_as_written() -> None:
    """40 bits of modulus, 22 of angle within a quadrant, 2 of quadrant; the extremes among them."""
    u = np.array([0, 2**40 - 1, 2**38, 12345678901, 2**39], dtype=np.uint64)
    psi = np.array([0, 2**22 - 1, 2**21, 1234567, 7], dtype=np.uint64)
    quadrant = np.array([0, 1, 2, 3, 3], dtype=np.uint64)
    re, im = np.empty((2, 5))
    disturbance._to_complex_t(u << np.uint64(24) | psi << np.uint64(2) | quadrant, re, im)
    modulus = np.sqrt(((u.astype(float) + 0.5) / 2.0**40) ** -0.5 - 1.0)
    angle = np.pi / 2 * (psi.astype(float) + 0.5) / 2.0**22
    sign_re, sign_im = np.where(quadrant & np.uint64(1), -1.0, 1.0), np.where(quadrant & np.uint64(2), -1.0, 1.0)
    # 1e-10 of the modulus: the Taylor sums are good to 7e-12 of theirs, near the axes one component is all but 0.
    np.testing.assert_allclose(re / modulus, sign_re * np.cos(angle), rtol=0, atol=1e-10)
    np.testing.assert_allclose(im / modulus, sign_im * np.sin(angle), rtol=0, atol=1e-10)


@pytest.mark.parametrize("model", MODELS)
def test_recursion_equals_the_general_filter(model: str) -> None:
    a = np.poly([r * np.exp(2j * np.pi * turns) for r, turns in POLES[model]])
    n_transient, n_lane, n_step = disturbance._TRANSIENT, disturbance._LANES, 375
    w = np.empty((2, n_lane * (n_transient + n_step)))
    disturbance._draw_complex_t(w, rng(3))
    padded = np.zeros(disturbance._MAX_ORDER + 1, dtype=np.complex128)
    padded[: np.size(a)] = a
    c = disturbance._autoregress(padded, w)
    steps = (w[0] + 1j * w[1]).reshape(n_transient + n_step, n_lane)
    in_order = np.concatenate((steps[:n_transient, 0], steps[n_transient:].T.ravel()))
    expected = lfilter([1.0], a, in_order)[n_transient:]  # from rest; 0.7^128 = 1e-20 of that is left, in every stretch
    assert c.shape == (3000,)
    np.testing.assert_allclose(c, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("n", [1, 7, 8, 9, 100, 257])
def test_a_vector_of_any_length_is_one_stretch_of_the_process(n: int) -> None:
    """Cut into stretches that are filtered side by side, or not: the same samples, up to the scale of the vector."""
    longer, c = draw("ar6-t", 8 * -(-n // 8), rng(4)), draw("ar6-t", n, rng(4))
    assert c.shape == (n,)
    assert np.mean(np.abs(c) ** 2) == pytest.approx(1.0, rel=1e-12)
    np.testing.assert_allclose(c / c[0], longer[:n] / longer[0], rtol=1e-9)


# Reproducibility


@pytest.mark.parametrize("model", MODELS)
def test_a_generator_gives_one_vector(model: str) -> None:
    np.testing.assert_array_equal(draw(model, 500, rng(5)), draw(model, 500, rng(5)))
    assert not np.any(draw(model, 500, rng(5)) == draw(model, 500, rng(6)))
