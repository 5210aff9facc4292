"""Max-min with equal antennas: the full program, the bound, the sum constraint, conventional beams, determinism."""

import hashlib
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from cogradar.shared.power.equal_antennas import allocate_conventional, allocate_equal
from cogradar.shared.power.max_min import Allocation, allocate
from cogradar.shared.power.rules import Requests, power_rule
from cogradar.shared.scenario.files import load
from cogradar.shared.signal.array import bin_centres
from cogradar.shared.signal.waveform import antenna_powers, beampattern
from tests.oracles.allocation import full_program

Floats = NDArray[np.float64]


def problem(n_track: int, seed: int) -> tuple[Floats, Floats]:
    """Directions anywhere, also close together, and ranges of 10 to 100 km."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-0.49, 0.49, n_track), rng.uniform(10.0, 100.0, n_track) ** -4.0


def db(ratio: float) -> float:
    return float(10.0 * np.log10(ratio))


def check(allocation: Allocation, nus: Floats, delta: Floats, power: float) -> None:
    """Of equal antennas and the stated value, which no bound is below."""
    n_tx = allocation.factor.shape[0]
    np.testing.assert_allclose(antenna_powers(0.0, allocation.factor), power / n_tx, rtol=1e-12)
    assert np.min(delta * beampattern(0.0, allocation.factor, nus)) == pytest.approx(allocation.value, rel=1e-9)
    assert allocation.shares.sum() == pytest.approx(power)
    assert (allocation.shares >= 0.0).all()
    assert allocation.bound >= allocation.value


@pytest.mark.parametrize(("n_tx", "n_track", "seed"), [(8, 2, 1), (8, 4, 2), (11, 3, 3), (12, 5, 4), (16, 3, 5)])
def test_the_value_and_the_bound_enclose_the_full_program(n_tx: int, n_track: int, seed: int) -> None:
    nus, delta = problem(n_track, seed)
    found = allocate_equal(nus, delta, 2.0, n_tx)
    check(found, nus, delta, 2.0)
    full = full_program(nus, delta, 2.0, n_tx, equal=True)
    assert found.bound >= full * (1.0 - 1e-6)
    assert db(full / found.value) < 0.02
    assert full <= allocate(nus, delta, 2.0, n_tx).bound * (1.0 + 1e-6)


def test_twelve_aircraft_lose_little_to_equal_antennas() -> None:
    """Against the sum constraint, and against its optimum scaled down to its hottest antenna."""
    losses, conventional, scaled = [], [], []
    for seed in range(10):
        nus, delta = problem(12, seed)
        best, found, cheap = (one(nus, delta, 1.0, 100) for one in (allocate, allocate_equal, allocate_conventional))
        for one in (found, cheap):
            check(one, nus, delta, 1.0)
        assert found.status == "optimal"
        losses.append(db(best.value / found.value))
        conventional.append(db(best.value / cheap.value))
        scaled.append(db(100.0 * antenna_powers(0.0, best.factor).max()))
        assert db(found.bound / found.value) < 0.1
    assert np.mean(losses) < 0.2
    assert max(losses) < 0.35
    assert np.mean(losses) < np.mean(conventional) < 0.4
    assert min(scaled) > 2.0


@pytest.mark.parametrize("rule", [allocate_equal, allocate_conventional])
@pytest.mark.parametrize(
    ("nus", "delta"),
    [
        ([0.1], [1.0]),
        ([0.1, 0.1], [1.0, 1.0]),
        ([-0.5, 0.5], [1.0, 2.0]),
        ([0.1, 0.1001, -0.3], [1e-9, 1.0, 1e3]),
        ([0.0, 0.3], [0.0, np.inf]),
    ],
)
@pytest.mark.parametrize("n_tx", [2, 9, 32])
def test_there_is_always_a_waveform(
    rule: Callable[..., Allocation], nus: list[float], delta: list[float], n_tx: int
) -> None:
    found = rule(nus, delta, 3.0, n_tx)
    np.testing.assert_allclose(antenna_powers(0.0, found.factor), 3.0 / n_tx, rtol=1e-12)
    assert np.isfinite(found.factor).all()
    assert found.bound >= found.value > 0.0


def test_one_track_and_tracks_of_one_direction_lose_nothing() -> None:
    for nus in ([0.13], [0.13, 0.13]):
        found = allocate_equal(nus, np.ones(len(nus)), 1.0, 20)
        assert found.value == pytest.approx(20.0)
        assert found.status == "optimal"


def test_the_same_problem_has_the_same_bits() -> None:
    nus, delta = problem(12, 3)
    factors = [allocate_equal(nus, delta, 1.0, 64).factor.tobytes() for _ in range(2)]
    assert len({hashlib.sha256(one).digest() for one in factors}) == 1


@pytest.mark.parametrize("setting", ["antennas=equal", "beams=conventional"])
def test_the_scenario_chooses_it(setting: str) -> None:
    requests = Requests.of_single(bin_centres(100)[[20, 23, 60]], np.array([20.0, 60.0, 90.0]), np.ones(3))
    published, chosen = load("paper").radar, load("paper", [f"radar.allocation.{setting}"]).radar
    powers = [antenna_powers(0.0, power_rule("power-aware")(radar, requests).factor) for radar in (published, chosen)]
    assert powers[0].max() > 1.1 * powers[0].min()
    np.testing.assert_allclose(powers[1], chosen.array.power / chosen.array.n_tx)
