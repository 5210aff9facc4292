"""Portable linear algebra and Fourier transforms against NumPy's."""

import numpy as np
import pytest

from cogradar.shared.numerics import linear
from cogradar.shared.numerics.fourier import fourier

SIZES = [1, 2, 3, 4, 5, 8, 13]  # below, at and above the four rows that are unrolled


def drawn(rng: np.random.Generator, *shape: int, is_complex: bool = True) -> np.ndarray:
    return rng.normal(size=shape) + (1j * rng.normal(size=shape) if is_complex else 0.0)


@pytest.mark.parametrize("is_complex", [False, True])
@pytest.mark.parametrize("n", SIZES)
def test_products_and_solutions_equal_numpy(n: int, is_complex: bool) -> None:
    rng = np.random.default_rng(n)
    a, b = drawn(rng, 3, n, is_complex=is_complex), drawn(rng, n, 7)
    for left, right in ((a, b), (a[0], b), (a, b[:, 0]), (a[0], b[:, 0]), (b.T, a.T), (a[:0], b)):
        np.testing.assert_allclose(linear.product(left, right), left @ right, rtol=0, atol=1e-13)
    square = drawn(rng, n, n, is_complex=is_complex)
    np.testing.assert_allclose(linear.solve(square, b), np.linalg.solve(square, b), rtol=1e-9)
    np.testing.assert_allclose(linear.solve(square, b[:, 0]), np.linalg.solve(square, b[:, 0]), rtol=1e-9)
    assert linear.inner(a.real, a.real[::-1]) == pytest.approx(float(np.sum(a.real * a.real[::-1])))
    assert linear.energy(b) == pytest.approx(float(np.linalg.norm(b)) ** 2)
    symmetric = square.real + square.real.T
    values, vectors = linear.eigh(symmetric)
    np.testing.assert_allclose(np.sort(values), np.linalg.eigvalsh(symmetric), rtol=0, atol=1e-12)
    np.testing.assert_allclose((vectors * values) @ vectors.T, symmetric, rtol=0, atol=1e-12)
    positive = square.real @ square.real.T + np.eye(n)
    np.testing.assert_allclose(linear.cholesky(positive), np.linalg.cholesky(positive), rtol=1e-12, atol=1e-12)


def test_products_of_other_shapes_and_singular_matrices_are_refused() -> None:
    with pytest.raises(ValueError, match=r"product of \(3, 2\) and \(3,\)"):
        linear.product(np.ones((3, 2)), np.ones(3))
    with pytest.raises(ValueError, match="singular"):
        linear.solve(np.ones((2, 2)), np.ones(2))


def test_elements_whose_squares_vanish_are_pivots_and_what_is_not_a_number_stays_so() -> None:
    tiny = np.array([[0.0, 2e-300j], [1e-300, 0.0]])
    np.testing.assert_allclose(linear.solve(tiny, np.array([2e-300, 3e-300])), [3.0, -1j], rtol=1e-15)
    assert np.isnan(linear.solve(np.array([[np.nan]]), np.ones(1))).all()


@pytest.mark.parametrize("shape", [(30, 3), (20, 20), (5, 9), (4, 0), (100, 100), (1, 1)])
def test_singular_values_and_vectors_equal_numpy(shape: tuple[int, int]) -> None:
    a = drawn(np.random.default_rng(3), *shape, is_complex=False)
    u, s = linear.singular(a)
    np.testing.assert_allclose(s, np.linalg.svd(a, compute_uv=False), rtol=1e-9)
    np.testing.assert_allclose((u * s**2) @ u.T, a @ a.T, rtol=0, atol=1e-11)
    np.testing.assert_allclose(u.T @ u, np.eye(s.size), rtol=0, atol=1e-11)


@pytest.mark.parametrize("n", [1, 2, 3, 50, 101])
def test_eigenvalues_of_one_size_tiny_ones_and_none_at_all(n: int) -> None:
    rng = np.random.default_rng(n)
    q = np.linalg.qr(drawn(rng, n, n, is_complex=False))[0]
    for values in (
        np.zeros(n),
        np.ones(n),
        np.repeat([3.0, -1.0], n)[::2][:n],
        10.0 ** -np.arange(n),
        1e-200 * np.arange(n),
    ):
        symmetric = (q * values) @ q.T
        symmetric = 0.5 * (symmetric + symmetric.T)
        found, vectors = linear.eigh(symmetric)
        scale = np.abs(values).max() or 1.0
        np.testing.assert_allclose(np.sort(found) / scale, np.sort(values) / scale, rtol=0, atol=1e-14 * n)
        np.testing.assert_allclose(vectors.T @ vectors, np.eye(n), rtol=0, atol=1e-14 * n)
        np.testing.assert_allclose((vectors * found) @ vectors.T / scale, symmetric / scale, rtol=0, atol=1e-14 * n)


@pytest.mark.parametrize("tiny", [1e-150, 1e-158, 1e-160, 2e-162, 1e-170, 5e-324])
def test_elements_whose_squares_vanish_leave_eigenvalues_as_they_are(tiny: float) -> None:
    a = np.eye(4)
    a[0, 1:] = a[1:, 0] = tiny
    values, vectors = linear.eigh(a)
    np.testing.assert_allclose(values, 1.0, rtol=1e-15)
    np.testing.assert_allclose(vectors.T @ vectors, np.eye(4), rtol=0, atol=1e-14)


def test_repeated_columns_have_a_singular_value_of_zero() -> None:
    a = np.outer(drawn(np.random.default_rng(4), 6), [1.0, 1j, 0.0])
    u, s = linear.singular(linear.embedded(a))
    assert s[:2] == pytest.approx(np.linalg.norm(a))
    assert not s[2:].any()
    assert not u[:, 2:].any()
    np.testing.assert_allclose((u * s**2) @ u.T, linear.embedded(a @ a.conj().T), rtol=0, atol=1e-13)
    assert linear.spectral_norm(a.T) == pytest.approx(s[0])


def test_polynomial_has_these_roots() -> None:
    roots = [0.5j, 0.2 + 0.1j, -0.3]
    np.testing.assert_allclose(linear.polynomial(roots), np.poly(roots), rtol=0, atol=1e-16)
    np.testing.assert_array_equal(linear.polynomial([]), [1.0])


@pytest.mark.parametrize("n", [1, 2, 3, 12, 30, 49, 64, 101])
def test_transform_equals_numpy(n: int) -> None:
    x = drawn(np.random.default_rng(n), 5, max(n // 2, 1))
    np.testing.assert_allclose(fourier(x, n), np.fft.fft(x, n, axis=1), rtol=0, atol=1e-12)
