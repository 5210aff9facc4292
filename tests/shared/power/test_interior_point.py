"""The dense kernels against NumPy's linear algebra, the solver against small programs with known solutions."""

import numpy as np
import pytest

from cogradar.shared.power import interior_point as ip

SIZES = [1, 2, 3, 4, 5, 8, 13]  # below, at and above the four rows that are unrolled


def positive_definite(n: int, rng: np.random.Generator) -> np.ndarray:
    A = rng.normal(size=(n, n + 2))
    return A @ A.T


@pytest.mark.parametrize("n", SIZES)
def test_weighted_product_equals_numpy(n: int) -> None:
    rng = np.random.default_rng(n)
    A, v, B = rng.normal(size=(3, n)), rng.normal(size=n), rng.normal(size=(n, 7))
    np.testing.assert_allclose(ip._weighted_product(A, v, B), (A * v) @ B, rtol=0, atol=1e-13)


@pytest.mark.parametrize("n", SIZES)
def test_factor_inverse_and_solution_equal_numpy(n: int) -> None:
    rng = np.random.default_rng(n)
    A, b = positive_definite(n, rng), rng.normal(size=n)
    U = np.zeros((n, n))
    assert ip._cholesky(A, U, 0.0)
    np.testing.assert_allclose(U, np.linalg.cholesky(A).T, rtol=0, atol=1e-12)
    tolerance = 1e-13 * np.linalg.cond(A)
    np.testing.assert_allclose(ip._inverse(U), np.linalg.inv(A), rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(ip._solve(A, U, b), np.linalg.solve(A, b), rtol=tolerance, atol=tolerance)


def test_cholesky_reports_what_is_not_positive_definite() -> None:
    indefinite = np.array([[1.0, 2.0], [2.0, 1.0]])  # eigenvalues 3 and -1
    assert not ip._cholesky(indefinite, np.zeros((2, 2)), 0.0)
    assert not ip._cholesky(np.array([[np.nan]]), np.zeros((1, 1)), 0.0)


def test_repeated_row_is_left_out_of_the_solution() -> None:
    A = np.array([[2.0, 2.0, 0.0], [2.0, 2.0, 0.0], [0.0, 0.0, 4.0]])
    U = np.zeros((3, 3))
    assert ip._cholesky(A, U, ip.PIVOT_FLOOR)
    np.testing.assert_allclose(ip._solve(A, U, np.array([2.0, 2.0, 4.0])), [1.0, 0.0, 1.0], rtol=0, atol=1e-15)


def test_step_ends_short_of_both_boundaries() -> None:
    """From the identity along -I/2 the boundary is at 2, so the whole step fits; along -4 I it is at 1/4."""
    eye, v = np.eye(3), np.ones(2)
    assert ip._step(eye, -0.5 * eye, v, 0 * v) == 1.0
    assert ip.BACKTRACK * 0.25 * ip.TO_BOUNDARY <= ip._step(eye, -4.0 * eye, v, 0 * v) <= 0.25
    assert ip._step(eye, eye, v, -5.0 * v) == pytest.approx(0.2 * ip.TO_BOUNDARY, rel=1e-15)


def test_orthogonal_beams_are_weighted_one_to_one() -> None:
    """For b_m the unit vectors: X = diag(w), tr X = sum w, and x = 1."""
    w = np.array([1.0, 0.25, 1e-6])
    U, x = ip.interior_point(np.eye(3), w, 1e-10)
    X = U.T @ U
    assert np.trace(X) == pytest.approx(w.sum(), rel=1e-10)
    assert (np.diag(X) >= w).all()
    np.testing.assert_allclose(np.diag(X), w, rtol=0, atol=1e-10)
    assert w @ x == pytest.approx(w.sum(), rel=1e-10)
    assert (x < 1).all()


@pytest.mark.parametrize("gap", [1e-3, 1e-6, 1e-9])
def test_pair_is_feasible_and_within_the_asked_gap(gap: float) -> None:
    rng = np.random.default_rng(5)
    B = rng.normal(size=(4, 6))
    B /= np.linalg.norm(B, axis=0)
    w = rng.uniform(0.01, 1.0, 6)
    U, x = ip.interior_point(B, w, gap)
    assert (np.sum((U @ B) ** 2, axis=0) >= w).all()
    assert np.linalg.eigvalsh((B * x) @ B.T)[-1] < 1.0
    assert (x > 0).all()
    assert 0 <= np.sum(U**2) - w @ x <= gap * (w @ x)
