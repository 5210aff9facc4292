"""The range bound against closed forms, Kalman's filter, and a particle filter that may not beat it."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.linalg import solve_discrete_are
from scipy.special import ive

from cogradar.shared.scoring.bounds import amplitude_information, range_bound, range_information
from cogradar.shared.signal.echo_laws import log_rice_likelihood

Floats = NDArray[np.float64]


def density(r: float, u: float) -> float:
    return float(2.0 * r * np.exp(-((r - u) ** 2)) * ive(0, 2.0 * r * u))


@pytest.mark.parametrize("u", [0.02, 0.3, 1.0, 3.0, 12.0])
def test_information_is_the_variance_of_the_score(u: float) -> None:
    # d log f / du by a difference quotient of the density itself; its error is of the order of (1e-4)^2.
    def score_squared(r: float) -> float:
        slope = (density(r, u + 1e-4) - density(r, u - 1e-4)) / 2e-4
        return slope**2 / density(r, u)

    expected, _ = quad(score_squared, max(u - 6.0, 1e-9), u + 6.0, epsabs=1e-9, limit=200)
    assert float(amplitude_information(u)) == pytest.approx(expected, rel=1e-5)


def test_information_of_faint_and_strong_echoes() -> None:
    # f(r|u) = f(r|0) (1 + u^2 (r^2 - 1) + ..): the score is 2 u (r^2 - 1), of variance 4 u^2 as r^2 is exponential.
    assert amplitude_information([0.0, 1e-3]) == pytest.approx([0.0, 4e-6], rel=1e-5)
    # r ~ N(u, 1/2) for strong echoes; the next term of the expansion is -1/(2 u^2).
    assert amplitude_information([1e2, 1e6]) == pytest.approx([2.0 - 0.5e-4, 2.0], rel=1e-6)


def test_range_information_is_that_of_the_amplitude_with_u_as_its_inverse_square() -> None:
    # Strong echo: R = c u^(-1/2), sigma_u^2 = 1/2, so sigma_R = R/(2 u) / sqrt 2.
    assert range_information(80.0, 50.0) == pytest.approx(2.0 * (2.0 * 50.0 / 80.0) ** 2, rel=2e-4)


def test_without_noise_the_information_of_all_dwells_adds_up() -> None:
    # R_t = R_T + (t - T) V: J_T = sum_t i_t [1, t-T][1, t-T]^T, the first term from the acquisition at t = 0.
    information = np.array([0.5, 2.0, 1.0, 3.0])
    J = np.zeros((2, 2))
    back = np.array([[1.0, -8.0], [0.0, 1.0]])  # state at T -> state at 0; four dwells of 2 s
    J += back.T @ np.diag([0.7, 1.0 / 0.2**2]) @ back
    for t, i in enumerate(information, 1):
        h = np.array([1.0, 2.0 * (t - 4)])
        J += i * np.outer(h, h)
    bound = range_bound(information, 0.7, 0.2, dt=2.0, sigma_s=0.0)
    expected = np.sqrt(np.diag(np.linalg.inv(J)))
    assert (bound.position_km[-1], bound.velocity_km_s[-1]) == pytest.approx(tuple(expected), rel=1e-9)


def test_steady_state_is_that_of_the_kalman_filter() -> None:
    i, dt, sigma_s = 0.8, 1.0, 0.004
    A, h = np.array([[1.0, dt], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    g = np.array([[0.5 * dt * dt], [dt]])
    predicted = solve_discrete_are(A.T, h.T, sigma_s**2 * g @ g.T, np.array([[1.0 / i]]))
    gain = predicted @ h.T / (h @ predicted @ h.T + 1.0 / i)
    filtered = predicted - gain @ h @ predicted
    bound = range_bound(np.full(3000, i), 1e-3, 0.2, dt, sigma_s)
    expected = np.sqrt(np.diag(filtered))
    assert (bound.position_km[-1], bound.velocity_km_s[-1]) == pytest.approx(tuple(expected), rel=1e-6)


def filter_errors(n_run: int, n_particle: int, n_dwell: int, u_at_1_km: float) -> tuple[Floats, Floats]:
    """Errors of range (n_run, n_dwell) of the optimal tracker along a known line of sight, and the information met."""
    rng = np.random.default_rng(1)
    truth = np.stack((60.0 + 1.0 * rng.standard_normal(n_run), 0.2 * rng.standard_normal(n_run)), axis=-1)
    shape = (n_run, n_particle)
    cloud = np.stack((60.0 + 1.0 * rng.standard_normal(shape), 0.2 * rng.standard_normal(shape)), axis=-1)
    errors, information = np.empty((n_run, n_dwell)), np.empty(n_dwell)
    for t in range(n_dwell):
        for states in (truth, cloud):
            w = 0.02 * rng.standard_normal(states.shape[:-1])
            states[..., 0] += states[..., 1] + 0.5 * w
            states[..., 1] += w
        u = u_at_1_km / truth[:, 0] ** 2
        information[t] = float(range_information(truth[:, 0], u).mean())
        noise = np.sqrt(0.5) * rng.standard_normal((2, n_run))
        r = np.hypot(u + noise[0], noise[1])
        log_w = log_rice_likelihood(r[:, None], u_at_1_km / cloud[..., 0] ** 2)
        weights = np.exp(log_w - log_w.max(axis=1, keepdims=True))
        weights /= weights.sum(axis=1, keepdims=True)
        errors[:, t] = np.sum(weights * cloud[..., 0], axis=1) - truth[:, 0]
        for n in range(n_run):
            cloud[n] = cloud[n][rng.choice(n_particle, n_particle, p=weights[n])]
    return errors, information


@pytest.mark.parametrize("u", [2.0, 12.0])  # at 60 km: fainter than target 2 at its end, and as at its start
def test_optimal_tracker_is_not_below_the_bound_nor_far_above(u: float) -> None:
    n_run = 400
    errors, information = filter_errors(n_run, n_particle=800, n_dwell=15, u_at_1_km=u * 60.0**2)
    bound = range_bound(information, initial_information=1.0, velocity_sigma=0.2, dt=1.0, sigma_s=0.02)
    ratio = np.sqrt(np.mean(errors**2, axis=0)) / bound.position_km
    # An RMSE over n runs of nearly Gaussian errors has a relative deviation of 1/sqrt(2 n) = 3.5 %: five of them.
    # From above the same, and 5 % for finitely many particles and the curvature of 1/R^2.
    assert np.all(ratio > 1.0 - 5.0 / np.sqrt(2.0 * n_run))
    assert np.all(ratio < 1.05 + 5.0 / np.sqrt(2.0 * n_run))


def test_what_bearings_say_of_the_range_is_negligible() -> None:
    """The approximation that the bound states: R theta'' + 2 R' theta' = a_t ~ N(0, sigma_s^2) each dwell.

    About R' that is an information of (2 theta' / sigma_s)^2. For target 2, theta' <= 0.2 / 60 rad/s; against what
    30 dwells, about the memory of the filter, add up to in the steady state.
    """
    sigma_s, theta_rate = 0.004, 0.09 / 60.0  # its transverse velocity is about 0.075 .. 0.09 km/s
    leak = 30.0 * (2.0 * theta_rate / sigma_s) ** 2
    information = range_information(np.full(300, 60.0), 12.0)
    velocity = range_bound(information, 1.0, 0.2, 1.0, sigma_s).velocity_km_s[-1]
    assert leak * velocity**2 < 0.01
