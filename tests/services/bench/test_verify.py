"""The checks pass on what is right and fail on what is not."""

import json
from itertools import product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom, chi2
from typer.testing import CliRunner

from cogradar.services.bench import golden, verify
from cogradar.services.bench.verify import Check
from cogradar.services.cli import app as cli
from cogradar.services.cli.terminal import layout
from cogradar.shared.power.max_min import Allocation, allocate_orthogonal
from cogradar.shared.scenario.files import load
from cogradar.shared.signal.detector import reception
from cogradar.shared.signal.detector.levels import Levels, range_levels
from cogradar.shared.signal.receiver import Cell, threshold, wald_test
from cogradar.shared.signal.scan import Detections
from cogradar.shared.tracking.model import TrackerModel, TrackState
from cogradar.shared.tracking.track import observe
from cogradar.shared.world.disturbance import draw

PAPER = load("paper")


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer draws: intervals grow, and follow."""
    monkeypatch.setattr(verify, "N_VECTOR", 150)
    monkeypatch.setattr(verify, "N_TARGETS", (3, 10))
    monkeypatch.setattr(verify, "N_RUN", 3)
    monkeypatch.setattr(verify, "N_DWELL", 10)


def test_everything_passes_here() -> None:
    sent: list[str] = []
    checks = verify.verify(sent.append)
    assert [check.name for check in checks if not check.passed] == []
    assert len(sent) == 5
    assert len({check.name for check in checks}) == len(checks) == 1 + 1 + 3 * 3 + 1 + 2 * 2 + 2 + 2 * 2 + 1


@pytest.mark.parametrize(
    "wrong", [{"separates": False}, {"separates": False, "by_rows": False}], ids=["not told apart", "as published"]
)
def test_a_receiver_that_takes_echoes_for_noise_is_found(
    wrong: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(verify, "TOLD_APART", verify.TOLD_APART._replace(**wrong))
    assert not any(check.passed for check in verify.receivers() if "P_D" in check.name)


def test_a_receiver_with_a_low_limit_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verify, "threshold", lambda p_fa: threshold(10.0 * p_fa))
    assert not any(check.passed for check in verify.receivers() if "P_FA, " in check.name)


@pytest.mark.parametrize("noise", ["rows", "lags"])
def test_noise_of_a_data_set_alone_is_found_at_a_line(noise: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The line looks like an echo in each range cell, and is taken for noise in none."""
    monkeypatch.setattr(verify, "BY_RANGE", verify.BY_RANGE._replace(by_range=False, by_rows=noise == "rows"))
    monkeypatch.setattr(verify, "MOST_REFERENCES", 0)
    p_fa, _ = verify.noise_from_range_cells()
    assert p_fa.measured > 3.0 * p_fa.expected
    assert not p_fa.passed


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_levels_of_range_cells_that_are_off_are_found(factor: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A look's noise is off by a factor in power."""

    def wrong(*given: Any) -> Levels:
        found = range_levels(*given)
        return found._replace(constant=factor * found.constant, per_level=factor * found.per_level)

    monkeypatch.setattr(reception, "range_levels", wrong)
    p_fa, p_d = verify.noise_from_range_cells()
    assert not p_fa.passed
    assert p_d.passed == (factor < 1.0)  # of a P_D of 0.84 only a loss is seen


def off(monkeypatch: pytest.MonkeyPatch, factor: float) -> None:
    """A receiver whose noise estimate is off by a factor in power."""

    def wrong(y: Any, u: Any, a_rx: Any) -> Cell:
        cell = wald_test(y, u, a_rx)
        return cell._replace(statistic=cell.statistic / factor, sigma_hat=cell.sigma_hat * factor**0.5)

    monkeypatch.setattr(verify, "wald_test", wrong)


@pytest.mark.parametrize("factor", [0.7, 1.4])
def test_a_wrong_noise_estimate_is_found(factor: float, monkeypatch: pytest.MonkeyPatch) -> None:
    off(monkeypatch, factor)
    cells = verify.empty_cells(PAPER)
    assert not any(check.passed for check in verify.false_alarms(cells))
    assert [check.passed for check in verify.detection(PAPER, cells)] == [True, *9 * [False]]
    assert not any(check.passed for check in verify.spectrum(cells))


def test_another_disturbance_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verify, "draw", lambda _model, n, rng: draw("ar3-t", n, rng))
    assert not any(check.passed for check in verify.spectrum(verify.empty_cells(PAPER)))


def test_an_echo_that_changes_the_noise_estimate_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def wrong(y: Any, u: Any, a_rx: Any) -> Cell:
        cell = wald_test(y, u, a_rx)
        return cell._replace(sigma_hat=cell.sigma_hat + 1e-6 * abs(cell.alpha_hat))

    monkeypatch.setattr(verify, "wald_test", wrong)
    assert not verify._echo_check(PAPER).passed


def test_one_bin_that_is_off_is_found_among_all() -> None:
    samples = np.random.default_rng(1).normal(0.0, 1.0, (400, 100))
    assert verify._worst_bin("x", np.zeros(100), samples).passed
    samples[:, 37] += 0.3  # six standard errors
    check = verify._worst_bin("x", np.zeros(100), samples)
    assert not check.passed
    assert check.name == "x: worst bin, 37"


@pytest.mark.nightly
def test_detection_is_within_a_hundredth_of_the_closed_form_in_every_bin(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 20 000 disturbances: standard errors of 0.002."""
    monkeypatch.setattr(verify, "N_VECTOR", 20_000)
    cells = verify.empty_cells(PAPER)
    for zeta, rcs in product(verify.ZETAS, ("constant", "swerling1", "swerling3")):
        expected, chances = verify.detection_chances(PAPER, cells, zeta, rcs)
        assert np.abs(chances.mean(axis=0) - expected).max() < 0.01


def test_a_suboptimal_allocation_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def conventional(nus: Any, delta: Any, power: float, n_tx: int) -> Allocation:
        return allocate_orthogonal(nus, delta, power, n_tx)

    monkeypatch.setattr(verify, "allocate", conventional)
    assert not all(check.passed for check in verify.allocation(PAPER))


def test_an_overconfident_belief_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    covariance = np.cov
    # Half the standard deviation: the NEES is four times as large.
    monkeypatch.setattr("numpy.cov", lambda particles, rowvar: 0.25 * covariance(particles, rowvar=rowvar))
    assert not all(check.passed for check in verify.consistency(PAPER))


def test_tracks_are_scored_against_their_own_targets(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = list[NDArray[np.float64]]()

    def noting(model: TrackerModel, state: TrackState, scan: Detections) -> TrackState:
        state = observe(model, state, scan)
        seen.append(state.belief.rows)
        return state

    monkeypatch.setattr(verify, "observe", noting)
    assert len(verify._run_nees(verify._random_targets(PAPER, 0), 1)) == 3
    assert len(seen) == 3 * verify.N_DWELL


@pytest.mark.parametrize(("n", "p"), [(20_000, 0.0104), (400, 0.76), (50, 0.5)])
def test_interval_of_a_share_is_binomial(n: int, p: float) -> None:
    check = verify._share("x", n // 2, n, p)
    assert (check.low, check.high) == pytest.approx(np.array(binom.interval(1.0 - 1e-4, n, p)) / n)


def test_interval_of_the_nees_is_chi_square() -> None:
    (check,) = verify.consistency(PAPER)
    assert (check.low, check.high) == pytest.approx(np.array(chi2.interval(1.0 - 1e-4, 36)) / 9)
    assert check.expected == 4.0


@pytest.mark.parametrize(("measured", "code"), [(1.0, 0), (2.5, 1)])
@pytest.mark.parametrize("as_json", [True, False])
def test_exit_code_tells_whether_all_passed(
    measured: float, code: int, as_json: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cogradar.services.kernels.compile_all", lambda *_: None)
    monkeypatch.setattr(
        verify, "verify", lambda _: [Check("a", 1.0, 0.5, 2.0, measured), Check("b", 1.0, 0.5, 2.0, 1.0)]
    )
    done = CliRunner().invoke(cli.app, ["verify", *(["--json"] if as_json else [])])
    assert done.exit_code == code
    if as_json:
        rows = json.loads(done.stdout)
        assert rows[0] == {
            "name": "a", "expected": 1.0, "low": 0.5, "high": 2.0, "measured": measured, "passed": code == 0
        }  # fmt: skip
    else:
        assert ("FAIL" in done.stdout) == (code == 1)


@pytest.mark.parametrize(("measured", "says"), [("a1", "as everywhere"), ("b2", "this machine computes otherwise")])
def test_a_machine_that_plays_another_run_is_found(measured: str, says: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verify, "verify", lambda _: [])
    monkeypatch.setattr(golden, "digest", lambda: golden.Digest("a1", measured))
    done = CliRunner().invoke(cli.app, ["verify"])
    assert done.exit_code == int(measured != "a1")
    assert says in done.stdout


def test_intervals_and_verdicts_are_shown_in_80_columns() -> None:
    checks = [
        verify._share("noise by range, 16 x 24: P_FA 0.01", 0, 12000, 0.009876),
        verify._share("beside echoes, 20 x 32: P_D(16)", 411, 500, 0.8219),
        verify._worst_bin("P_D(10), swerling1", np.full(100, 0.2123), np.random.default_rng(1).random((40, 100))),
    ]
    lines = [str(line) for line in layout(verify.table(checks), 80)]
    assert max(map(len, lines)) <= 80
    assert any("FAIL" in line and line.endswith("0.009876") for line in lines)
    assert any("ok" in line and line.endswith("0.8219") for line in lines)
    assert not any("left out" in line for line in lines)
