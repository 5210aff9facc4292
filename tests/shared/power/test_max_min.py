"""Optimality of the power allocation: the full program, the dual certificate, closed forms, KKT conditions."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from cogradar.shared.power import max_min as module
from cogradar.shared.power.max_min import (
    Allocation,
    allocate,
    allocate_orthogonal,
    dual_bound,
    kkt_residuals,
)
from cogradar.shared.power.sdp_reference import ReducedProgram
from cogradar.shared.signal.array import bin_centres, steering_vector
from cogradar.shared.signal.waveform import beam_factor, beampattern
from tests.oracles.allocation import full_program

Floats = NDArray[np.float64]


def sdp(nus: Floats, delta: Floats, power: float, n_tx: int) -> Allocation:
    return ReducedProgram(nus.size).allocate(nus, delta, power, n_tx)


SOLVERS = [pytest.param(allocate, id="barrier"), pytest.param(sdp, id="sdp")]


def value_of(R: NDArray[np.complex128], nus: Floats, delta: Floats) -> float:
    """min_m delta_m a_m^T R a_m^*, from the definition."""
    steering = [steering_vector(float(nu), R.shape[0]) for nu in nus]
    return min(float(d * (a @ R @ a.conj()).real) for a, d in zip(steering, delta, strict=True))


def check(allocation: Allocation, nus: Floats, delta: Floats, power: float, gap: float) -> None:
    """Feasible, of the stated value, and proved to be within `gap` of the optimum by a bound computed here."""
    R = allocation.factor @ allocation.factor.conj().T
    assert np.trace(R).real == pytest.approx(power, rel=1e-12)
    assert value_of(R, nus, delta) == pytest.approx(allocation.value, rel=max(gap, 1e-8))  # as R itself is rounded
    assert (allocation.shares >= 0).all()
    assert allocation.shares.sum() == pytest.approx(power, rel=1e-12)
    bound = dual_bound(allocation.shares / power, nus, delta, power, R.shape[0])
    assert allocation.value * (1 - 1e-10) <= bound <= (1 + gap) * allocation.value
    assert bound <= (1 + 1e-10) * allocation.bound <= (1 + gap) * (1 + 1e-10) * allocation.value
    assert allocation.status == "optimal"


def paper_bins(n_beam: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Distinct bins of the paper's grid; ranges over the prior, 5 .. 200 km, so that delta spans 2.56e6."""
    return rng.choice(bin_centres(100), n_beam, replace=False), rng.uniform(5.0, 200.0, n_beam) ** -4


SMALL = {
    "one": ([0.1], [20.0]),
    "paper, t = 0": ([-0.4747, 0.0606, 0.4949], [63.2, 60.5, 60.2]),
    "5 km beside 200 km": ([0.0, 0.03, -0.2], [5.0, 200.0, 40.0]),
    "coincident": ([0.2, 0.2, -0.1], [30.0, 50.0, 40.0]),
    "coincident by grating": ([-0.5, 0.5, 0.0], [30.0, 50.0, 40.0]),
    **{f"apart {gap:g}": ([0.2, 0.2 + gap, -0.1], [30.0, 50.0, 40.0]) for gap in (1e-1, 1e-2, 1e-3, 1e-5, 1e-7, 1e-9)},
    "cluster": ([0.0, 0.02, 0.04, 0.05, -0.3], [60.0, 20.0, 50.0, 61.0, 33.0]),
}


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("n_tx", [5, 16])
@pytest.mark.parametrize("case", SMALL)
def test_reduced_program_has_the_optimum_of_the_full_one(solver: Any, n_tx: int, case: str) -> None:
    nus, delta = np.array(SMALL[case][0]), np.array(SMALL[case][1]) ** -4
    best = full_program(nus, delta, 2.0, n_tx)
    allocation = solver(nus, delta, 2.0, n_tx)
    assert allocation.value == pytest.approx(best, rel=1e-6)
    check(allocation, nus, delta, 2.0, gap=1e-6)


@pytest.mark.parametrize("n_beam", [*range(1, 11), 30, 100])
def test_barrier_is_certified_at_full_size(n_beam: int) -> None:
    nus, delta = paper_bins(n_beam, np.random.default_rng(n_beam))
    check(allocate(nus, delta, 1.0, 100), nus, delta, 1.0, gap=2e-9)


@pytest.mark.parametrize("n_beam", range(1, 11))
def test_sdp_is_certified_at_full_size(n_beam: int) -> None:
    nus, delta = paper_bins(n_beam, np.random.default_rng(n_beam))
    allocation = sdp(nus, delta, 1.0, 100)
    check(allocation, nus, delta, 1.0, gap=1e-6)
    assert allocation.value == pytest.approx(allocate(nus, delta, 1.0, 100).value, rel=1e-6)


def test_one_program_is_solved_anew_for_each_dwell() -> None:
    program, rng = ReducedProgram(3), np.random.default_rng(0)
    for _ in range(5):
        nus, delta = paper_bins(3, rng)
        check(program.allocate(nus, delta, 1.0, 100), nus, delta, 1.0, gap=1e-6)


@pytest.mark.parametrize("gap", [1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 0.0])
def test_close_pair_passes_into_one_shared_beam(gap: float) -> None:
    """Two tracks `gap` apart, the third orthogonal to the first (0.5 = 50/n_tx away).

    Without the second track the closed form holds: P n_tx / (1/delta_1 + 1/delta_3). With it the optimum is at most
    that, and at least what the same two beams give it: D^2 of that, with the Dirichlet kernel
    D = sin(pi n_tx gap) / (n_tx sin(pi gap)).
    """
    nus, delta = np.array([0.11, 0.11 + gap, 0.11 - 0.5]), np.array([1.0, 1.0, 2.0])
    shared = 100.0 / (1 / 1.0 + 1 / 2.0)
    dirichlet = np.sin(100 * np.pi * gap) / (100 * np.sin(np.pi * gap)) if gap else 1.0
    allocation = allocate(nus, delta, 1.0, 100)
    check(allocation, nus, delta, 1.0, gap=1e-7)
    assert allocation.value <= shared * (1 + 1e-9)
    assert allocation.value >= shared * dirichlet**2 * (1 - 1e-7)


def test_tracks_on_one_bin_share_one_beam() -> None:
    nus, delta = np.array([0.25, 0.25, -0.25]), np.array([1.0, 1.0, 0.5])
    allocation = allocate(nus, delta, 1.0, 100)
    assert allocation.factor.shape == (100, 2)
    # 0.25 and -0.25 are 50/100 apart: orthogonal. Powers 1 : 2; the two equal tracks have equal halves of theirs.
    np.testing.assert_allclose(allocation.shares, [1 / 6, 1 / 6, 2 / 3], rtol=0, atol=1e-6)
    np.testing.assert_allclose(beampattern(0.0, allocation.factor, nus), [100 / 3, 100 / 3, 200 / 3], rtol=1e-6)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("n_tx", [8, 100])
def test_closed_form_for_orthogonal_steering_vectors(solver: Any, n_tx: int) -> None:
    """nu spaced by multiples of 1/n_tx. A gap of g leaves shares uncertain by about sqrt(g)."""
    nus = 0.013 + np.array([0, 1, 3, 6]) / n_tx
    delta = np.array([40.0, 90.0, 60.0, 75.0]) ** -4
    closed = allocate_orthogonal(nus, delta, 3.0, n_tx)
    check(closed, nus, delta, 3.0, gap=1e-12)
    assert closed.value == pytest.approx(3.0 * n_tx / np.sum(1 / delta), rel=1e-12)
    np.testing.assert_allclose(closed.shares, 3.0 * (1 / delta) / np.sum(1 / delta), rtol=1e-12)
    np.testing.assert_allclose(beampattern(0.0, closed.factor, nus), n_tx * closed.shares, rtol=1e-12)
    solved = solver(nus, delta, 3.0, n_tx)
    assert solved.value == pytest.approx(closed.value, rel=1e-7)
    np.testing.assert_allclose(solved.shares, closed.shares, rtol=0, atol=1e-3)


@pytest.mark.parametrize(("distance", "ratio"), [(0.003, 1.0), (0.004, 30.0), (0.015, 7.0), (0.3, 1e6)])
def test_two_tracks_against_the_scalar_dual(distance: float, ratio: float) -> None:
    """For two tracks the dual is min over mu of lambda_max of a 2 x 2 Gram matrix: one number to minimise over."""
    n_tx, delta = 100, np.array([1.0, ratio])
    overlap = np.sin(np.pi * n_tx * distance) / np.sin(np.pi * distance)

    def largest_eigenvalue(log_odds: float) -> float:
        p, q = delta * np.array([1.0, np.exp(log_odds)]) / (1.0 + np.exp(log_odds))
        trace, det = n_tx * (p + q), p * q * (n_tx**2 - overlap**2)
        return float(trace / 2 + np.sqrt(trace**2 / 4 - det))

    best = minimize_scalar(largest_eigenvalue, bounds=(-40, 20), method="bounded", options={"xatol": 1e-9}).fun
    allocation = allocate(np.array([0.1, 0.1 + distance]), delta, 1.0, n_tx)
    assert allocation.value == pytest.approx(best, rel=1e-7)


@pytest.mark.parametrize(("solver", "stationarity"), [(allocate, 1e-6), (sdp, 1e-4)])
def test_kkt_conditions_hold(solver: Any, stationarity: float) -> None:
    """Off the central path A R - lambda R is only of the order of the root of the gap: cvxpy's is 1e-10."""
    rng = np.random.default_rng(3)
    for n_beam in (1, 2, 3, 6, 10):
        nus, delta = paper_bins(n_beam, rng)
        residuals = kkt_residuals(nus, delta, 1.0, solver(nus, delta, 1.0, 100))
        assert max(residuals._replace(stationarity=0.0)) < 1e-6
        assert residuals.stationarity < stationarity


def test_kkt_residuals_and_certificate_see_a_waveform_that_is_not_optimal() -> None:
    nus, delta = np.array([0.1, 0.106, -0.2]), np.array([1.0, 1.0, 2.0])
    closed, best = allocate_orthogonal(nus, delta, 1.0, 100), allocate(nus, delta, 1.0, 100)
    assert closed.status == "inaccurate"
    assert closed.value < 0.99 * best.value
    assert best.value <= closed.bound
    assert max(kkt_residuals(nus, delta, 1.0, closed)) > 1e-2
    louder = best._replace(factor=best.factor * 1.01)
    assert kkt_residuals(nus, delta, 1.0, louder).power == pytest.approx(1.01**2 - 1, rel=1e-9)


@pytest.mark.parametrize(("solver", "gap"), [(allocate, 2e-9), (sdp, 1e-6)])
@pytest.mark.parametrize("decades", [6, 10, 16])
def test_far_and_near_track_together(solver: Any, gap: float, decades: int) -> None:
    """A near track needs 10^-decades of the power; it must get it without costing the far one more than that."""
    nus, delta = np.array([0.0, 0.2, -0.31]), np.array([1.0, 10.0**decades, 3.0])
    check(solver(nus, delta, 1.0, 100), nus, delta, 1.0, gap=gap)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("delta", [[np.inf, 1.0, 2.0], [0.0, 1.0, 2.0], [np.inf, np.inf, 0.0], [0.0, 0.0, 0.0]])
def test_any_weight_leaves_a_feasible_waveform(solver: Any, delta: list[float]) -> None:
    allocation = solver(np.array([0.0, 0.2, -0.31]), np.array(delta), 1.0, 100)
    assert np.sum(np.abs(allocation.factor) ** 2) == pytest.approx(1.0, rel=1e-12)
    assert np.isfinite(allocation.shares).all()
    assert allocation.status == "optimal"


def test_more_tracks_than_antennas() -> None:
    nus, delta = np.linspace(-0.5, 0.5, 23), np.linspace(1.0, 2.0, 23)
    allocation = allocate(nus, delta, 1.0, 8)
    assert allocation.factor.shape == (8, 8)
    check(allocation, nus, delta, 1.0, gap=1e-7)


def test_same_arguments_give_the_same_bytes() -> None:
    nus, delta = paper_bins(10, np.random.default_rng(1))
    first, second = allocate(nus, delta, 1.0, 100), allocate(nus.copy(), delta.copy(), 1.0, 100)
    assert first.factor.tobytes() == second.factor.tobytes()
    assert first.shares.tobytes() == second.shares.tobytes()


def test_failing_iteration_falls_back_on_the_closed_form(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the solver returns, the waveform is feasible, and worse than the closed form only within its gap."""
    nus, delta = np.array([0.1, 0.106, -0.2]), np.array([1.0, 1.0, 2.0])
    closed = allocate_orthogonal(nus, delta, 1.0, 100)
    for U in (np.full((3, 3), np.nan), np.diag([1.0, 1e-3, 1e-3])):
        monkeypatch.setattr(module, "interior_point", lambda *_, U=U: (U, np.full(3, 1e-3)))
        fallen = allocate(nus, delta, 1.0, 100)
        assert fallen.status == "inaccurate"
        np.testing.assert_array_equal(fallen.factor, closed.factor)


def test_failing_solver_falls_back_on_the_closed_form(monkeypatch: pytest.MonkeyPatch) -> None:
    import cvxpy  # noqa: PLC0415  only this test needs it

    def fail(*_: object, **__: object) -> None:
        raise cvxpy.error.SolverError("broken")

    nus, delta = np.array([0.1, 0.106]), np.array([1.0, 2.0])
    program = ReducedProgram(2)
    monkeypatch.setattr(program._problem, "solve", fail)
    fallen = program.allocate(nus, delta, 1.0, 100)
    assert fallen.status == "inaccurate"
    np.testing.assert_array_equal(fallen.factor, allocate_orthogonal(nus, delta, 1.0, 100).factor)


@st.composite
def problems(draw: st.DrawFn) -> tuple[Floats, Floats, int]:
    """Clusters of directions from coincident to orthogonal, weights over up to twelve decades."""
    n_beam = draw(st.integers(1, 8))
    centres = draw(st.lists(st.floats(-0.45, 0.45), min_size=1, max_size=3))
    offsets = st.one_of(st.just(0.0), st.builds(lambda e: 10.0**e, st.floats(-10, -1.4)))
    nus = [draw(st.sampled_from(centres)) + draw(offsets) for _ in range(n_beam)]
    decades = draw(st.sampled_from([0, 6, 12]))
    delta = [10.0 ** (decades * draw(st.floats(0, 1))) for _ in range(n_beam)]
    return np.array(nus), np.array(delta), draw(st.integers(2, 32))


@settings(deadline=None, max_examples=60)
@given(problems())
def test_feasible_certified_and_at_least_as_good_as_uniform(problem: tuple[Floats, Floats, int]) -> None:
    nus, delta, n_tx = problem
    allocation = allocate(nus, delta, 1.0, n_tx)
    check(allocation, nus, delta, 1.0, gap=1e-6)
    uniform = beam_factor(nus, np.full(nus.size, 1.0 / nus.size), n_tx)
    assert allocation.value >= np.min(delta * beampattern(0.0, uniform, nus)) * (1 - 1e-6)


@settings(deadline=None, max_examples=40)
@given(problems(), st.randoms(use_true_random=False), st.floats(-0.3, 0.3))
def test_order_scale_and_rotation_do_not_matter(
    problem: tuple[Floats, Floats, int], random: Any, rotation: float
) -> None:
    """The value is the same for permuted tracks and for a common shift of nu, and scales with delta and power."""
    nus, delta, n_tx = problem
    value = allocate(nus, delta, 1.0, n_tx).value
    order = np.array(random.sample(range(nus.size), nus.size))
    assert allocate(nus[order], delta[order], 1.0, n_tx).value == pytest.approx(value, rel=1e-6)
    assert allocate(nus + rotation, delta, 1.0, n_tx).value == pytest.approx(value, rel=1e-6)
    assert allocate(nus, 8.0 * delta, 0.5, n_tx).value == pytest.approx(4.0 * value, rel=1e-12)


def test_shares_and_gains_follow_their_tracks() -> None:
    """Distinct bins: the optimum is unique, and its shares known to about sqrt(GAP_TARGET)."""
    rng = np.random.default_rng(8)
    nus, delta = paper_bins(7, rng)
    order = rng.permutation(7)
    one, other = allocate(nus, delta, 1.0, 100), allocate(nus[order], delta[order], 1.0, 100)
    np.testing.assert_allclose(other.shares, one.shares[order], rtol=0, atol=1e-4)
    np.testing.assert_allclose(beampattern(0.0, other.factor, nus), beampattern(0.0, one.factor, nus), rtol=1e-3)


def test_farther_track_takes_more_power() -> None:
    shares = [allocate([0.0, 0.2], np.array([60.0, r]) ** -4, 1.0, 100).shares[1] for r in (30.0, 60.0, 90.0, 120.0)]
    assert all(a < b for a, b in pairwise(shares))
