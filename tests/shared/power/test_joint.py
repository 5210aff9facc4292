"""Joint looks against dynamic programming, their bound, and what they must do in cases that are plain to see."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cogradar.shared.power.curve import curve_of
from cogradar.shared.power.joint import most_detections
from cogradar.shared.power.looks import detections
from cogradar.shared.power.rules import Emission, Requests
from cogradar.shared.scenario.files import load
from cogradar.shared.signal.array import angle_bin, bin_centres
from cogradar.shared.signal.receiver import detection_probability, threshold
from cogradar.shared.signal.waveform import beampattern
from tests.oracles.looks import best_on_a_grid, expected_detections

Floats = NDArray[np.float64]
RADAR = load("paper").radar
LAMBDA = threshold(1e-4)
CURVE = curve_of(LAMBDA)


def problem(n_target: int, seed: int, plenty: float = 1.0) -> tuple[Floats, Floats]:
    """Three cells for each target: chances from sharp to blurred, and gains of 30 to 130 km at the paper's SNR."""
    rng = np.random.default_rng((n_target, seed))
    chances = np.concatenate([rng.dirichlet(rng.choice([0.1, 1.0, 10.0], 3)) for _ in range(n_target)])
    return chances, np.repeat(plenty * 2e10 * rng.uniform(30.0, 130.0, n_target) ** -4.0, 3)


@pytest.mark.parametrize("n_target", [1, 2, 3])
@pytest.mark.parametrize("plenty", [0.03, 0.1, 0.5, 3.0])
def test_no_grid_of_powers_is_better(n_target: int, plenty: float) -> None:
    """The oracle's best is within 1e-3 of ours, and ours, which says that it is the best, below its bound."""
    for seed in range(8):
        chances, gains = problem(n_target, seed, plenty)
        found = most_detections(CURVE, chances, gains, 1.0)
        value = expected_detections(chances, gains, found.powers, LAMBDA)
        assert found.is_optimal
        assert found.powers.sum() == pytest.approx(1.0, rel=1e-9)
        assert found.powers.min() >= 0.0
        assert value == pytest.approx(found.detections, abs=2e-5)
        assert best_on_a_grid(chances, gains, 1.0, LAMBDA, 300) <= min(value + 1e-3, found.bound + 1e-4)


@pytest.mark.parametrize("plenty", [0.1, 3.0])
def test_no_grid_of_powers_is_better_for_targets_that_fluctuate(plenty: float) -> None:
    curve = curve_of(LAMBDA, "swerling1")
    for seed in range(4):
        chances, gains = problem(3, seed, plenty)
        found = most_detections(curve, chances, gains, 1.0)
        value = expected_detections(chances, gains, found.powers, LAMBDA, "swerling1")
        assert found.is_optimal
        assert value == pytest.approx(found.detections, abs=2e-4)  # the table's end
        assert best_on_a_grid(chances, gains, 1.0, LAMBDA, 300, "swerling1") <= min(value + 1e-3, found.bound + 2e-4)


@pytest.mark.parametrize("gains", [[1e4, 12.0], [1e4, 1e4, 12.0], [1e8, 12.0, 11.0]])
def test_what_sure_looks_leave_goes_to_one_weak_cell(gains: list[float]) -> None:
    """It stays below the bend, but what the power adds there is more than where P_D is nearly 1."""
    chances = np.ones(len(gains))
    found = most_detections(CURVE, chances, np.array(gains), 1.0)
    assert found.is_optimal
    assert (found.powers > 0.0).sum() == sum(gain > 12.0 for gain in gains) + 1
    assert found.detections >= best_on_a_grid(chances, np.array(gains), 1.0, LAMBDA, 600) - 1e-4


@settings(deadline=None, max_examples=50)
@given(
    n=st.integers(1, 100),
    seed=st.integers(0, 2**32),
    p_fa=st.sampled_from([0.1, 1e-4, 1e-9]),
    scale=st.floats(-30.0, 30.0),
    power=st.sampled_from([1e-3, 1.0, 1e6]),
)
def test_whatever_is_asked_for_the_power_is_spent(n: int, seed: int, p_fa: float, scale: float, power: float) -> None:
    chances, gains = problem(n, seed, 10.0**scale)
    found = most_detections(curve_of(threshold(p_fa)), chances, gains, power)
    assert found.powers.sum() == pytest.approx(power, rel=1e-9)
    assert found.powers.min() >= 0.0
    assert found.detections <= found.bound + 1e-6


@pytest.mark.parametrize("rcs", ["constant", "swerling1"])
@pytest.mark.parametrize("p_fa", [0.1, 1e-2, 1e-4, 1e-9])
def test_the_curve_is_that_of_the_closed_form(p_fa: float, rcs: str) -> None:
    """At the bend the slope is steepest; the chord is a tangent: no power per look yields more detections per power."""
    limit = threshold(p_fa)
    curve, zeta = curve_of(limit, rcs), np.linspace(0.0, 200.0, 20001)
    f = detection_probability(zeta, limit, rcs)
    slope = np.gradient(f, zeta)
    assert np.log(slope.max()) == pytest.approx(curve.steepest, abs=1e-3)
    rise = (f[1:] - f[0]) / zeta[1:]
    assert zeta[1 + rise.argmax()] == pytest.approx(curve.s_chord**2, abs=0.05)
    s = np.arange(curve.f.size) / 128
    np.testing.assert_allclose(curve.f, detection_probability(s * s, limit, rcs), atol=1e-12)
    assert curve.f[-1] == pytest.approx(1.0, abs=2e-4)


def asked(bins: list[list[int]], chances: list[list[float]], gains: list[float]) -> Requests:
    nus, far = bin_centres(100)[np.array(bins)], np.full(len(bins), 60.0)
    return Requests(nus, np.array(chances), far, np.array(gains), np.ones(len(bins)))


def lit_bins(sent: Emission) -> NDArray[np.int64]:
    """The cells lit for each track, (M, L); -1: none."""
    return np.where(np.isnan(sent.nus), -1, angle_bin(np.nan_to_num(sent.nus), 100))


def check(sent: Emission, requests: Requests) -> None:
    """All the power, brightest cell first, nothing and no power behind the last."""
    assert sent.shares.sum() == pytest.approx(RADAR.array.power, rel=1e-9)
    assert (np.diff(sent.shares, axis=1) <= 0.0).all()
    lit = ~np.isnan(sent.nus)
    assert (lit == (sent.shares > 0.0)).all()
    assert all(np.isin(row[~np.isnan(row)], own).all() for row, own in zip(sent.nus, requests.nus, strict=True))
    towards = beampattern(0.0, sent.factor, sent.nus[lit])
    np.testing.assert_allclose(towards, 100.0 * sent.shares[lit], rtol=0.1)


def test_a_target_at_a_border_gets_both_its_cells_and_one_amid_its_bin_gets_one() -> None:
    requests = asked([[10, 11, 12], [60, 61, -1]], [[0.5, 0.495, 0.005], [1.0, 0.0, 0.0]], [1000.0, 1000.0])
    sent = detections(RADAR, requests)
    check(sent, requests)
    assert lit_bins(sent).tolist() == [[10, 11], [60, -1]]
    assert sent.status == "optimal"


def test_power_that_suffices_for_one_look_makes_one() -> None:
    """Four targets, each needs .8 of the power: spread over all it would detect none."""
    bright = CURVE.s_chord**2 / 0.8
    requests = asked([[10], [30], [50], [70]], 4 * [[1.0]], 4 * [bright])
    sent = detections(RADAR, requests)
    check(sent, requests)
    assert (lit_bins(sent) >= 0).sum() == 1
