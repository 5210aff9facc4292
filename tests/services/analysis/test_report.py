"""The report against results made up so that every number can be said beforehand."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import binomtest

from services.analysis.report import report
from services.analysis.report_tables import caption, tables, write
from services.errors import BadInput
from services.metrics.recording import take
from services.metrics.scores import Score
from services.metrics.store import Store, in_memory
from services.recorder.journal import Recording
from shared.scenario.radar_config import Strategy
from tests.services.loop import SMOKE
from tests.services.tables import assert_shown_whole, shown

DWELLS = 60
TARGETS = 2


def _recording(strategy: Strategy, seed: int, scores: list[Score], **other: Any) -> Recording:
    run = {
        "run": f"smoke-{strategy.value}-{seed}",
        "scenario": "smoke",
        "document": json.dumps(SMOKE.model_dump(mode="json"), sort_keys=True),
        "strategy": strategy.value,
        "seed": seed,
        "dwells": DWELLS,
        "rate_hz": 0.0,
        "n_target": TARGETS,
        "has_truth": 1,
        "acquisition_scans": 3 + seed,
        "conflicts": 0,
        "status": "complete",
        "reason": "",
        "digest": "0",
    } | other
    return Recording(run, [(run["run"], *score[1:]) for score in scores], [])


def _scores(seed: int, error_km: float, missed: int, lost_from: int = DWELLS + 1) -> list[Score]:
    """A run with a constant position error (times the seed), a velocity error of 5 m/s, misses at its end."""
    truth = (10.0, 0.1, 20.0, 0.2)
    estimate = (10.0 + 0.6 * error_km * seed, 0.103, 20.0 - 0.8 * error_km * seed, 0.196)
    return [
        # run, k, t, target, track, true_bin, bin, detected, snr_db, ..., share, signature_power, ...
        (
            "",
            t + 3,
            t,
            m,
            m,
            7,
            7 if t < lost_from else 9,
            t <= DWELLS - missed,
            -10.0,
            *truth,
            *estimate,
            0.25,
            9.0,
            0,
            0,
        )
        for t in range(1, DWELLS + 1)
        for m in range(TARGETS)
    ]


@pytest.fixture
def store() -> Store:
    """Uniform: errors 2 seed km, 10 misses at the end. Power-aware: 1 seed km, 5 misses; seed 3 is lost at the end."""
    made, place = in_memory(), 0
    for seed in (2, 1, 3):
        for strategy, error_km, missed in ((Strategy.UNIFORM, 2.0, 10), (Strategy.POWER_AWARE, 1.0, 5)):
            place += 1
            lost_from = DWELLS - 14 if strategy is Strategy.POWER_AWARE and seed == 3 else DWELLS + 1
            made.journal.add_recording(_recording(strategy, seed, _scores(seed, error_km, missed, lost_from)), place)
    return made


def _row(rows: list[dict[str, Any]], **wanted: Any) -> dict[str, Any]:
    (row,) = [row for row in rows if all(row[key] == value for key, value in wanted.items())]
    return row


def test_the_last_twenty_dwells(store: Store) -> None:
    """P_D 10/20 and 15/20 by construction; errors of 2, 4, 6 km: root mean square sqrt(56/3)."""
    found = report(store)
    uniform = _row(found["last"], target=2, strategy="uniform")
    assert (uniform["first_dwell"], uniform["last_dwell"], uniform["runs"], uniform["n"]) == (41, 60, 3, 60)
    assert uniform["p_d"] == 0.5
    assert uniform["position_rmse_km"] == pytest.approx((56 / 3) ** 0.5, rel=1e-12)
    assert uniform["velocity_rmse_km_s"] == pytest.approx(0.005, rel=1e-9)
    assert uniform["share"] == 0.25
    assert _row(found["last"], target=1, strategy="power-aware")["p_d"] == 0.75


def test_the_wilson_interval_is_scipys(store: Store) -> None:
    uniform = _row(report(store)["last"], target=1, strategy="uniform")
    expected = binomtest(30, 60).proportion_ci(method="wilson")
    assert uniform["p_d_wilson_low"] == pytest.approx(expected.low, rel=1e-9)
    assert uniform["p_d_wilson_high"] == pytest.approx(expected.high, rel=1e-9)


def test_the_bootstrap_resamples_runs_and_not_dwells(store: Store) -> None:
    """Every run has the same P_D: no width over runs, whatever Wilson says. Of three errors the extremes are drawn
    three times with probability 1/27 = 0.037 each, above the tail of 0.025: the interval reaches from 2 to 6 km."""
    uniform = _row(report(store)["last"], target=1, strategy="uniform")
    assert (uniform["p_d_low"], uniform["p_d_high"]) == (0.5, 0.5)
    low, high = uniform["position_rmse_km_low"], uniform["position_rmse_km_high"]
    assert (low, high) == (pytest.approx(2.0, rel=1e-9), pytest.approx(6.0, rel=1e-9))


def test_windows_of_fifty_dwells_and_the_whole_run(store: Store) -> None:
    rows = [row for row in report(store)["windows"] if row["target"] == 1 and row["strategy"] == "uniform"]
    assert [(row["first_dwell"], row["last_dwell"]) for row in rows] == [(1, 50), (51, 60), (1, 60)]
    assert [row["p_d"] for row in rows] == [1.0, 0.0, pytest.approx(50 / 60, rel=1e-12)]


def test_differences_are_paired_by_seed(store: Store) -> None:
    """Of one seed the errors differ by -seed km; of resampled runs by between -3 and -1 times, as RMSE is homogeneous.

    Unpaired resampling could give -6 + 1 = -5 and -2 + 3 = +1 km.
    """
    row = _row(report(store)["differences"], target=1)
    assert (row["strategy"], row["minus"], row["runs"]) == ("power-aware", "uniform", 3)
    assert (row["p_d"], row["p_d_low"], row["p_d_high"]) == (0.25, 0.25, 0.25)
    assert row["position_rmse_km"] == pytest.approx(-((14 / 3) ** 0.5), rel=1e-12)
    assert row["position_rmse_km_low"] == pytest.approx(-3.0, rel=1e-9)
    assert row["position_rmse_km_high"] == pytest.approx(-1.0, rel=1e-9)


def test_runs_without_a_partner_are_left_out_of_differences(store: Store) -> None:
    store.journal.add_recording(_recording(Strategy.UNIFORM, 4, _scores(4, 100.0, 0)), 99)
    found = report(store)
    assert found["runs"] == {"uniform": 4, "power-aware": 3}
    assert _row(found["differences"], target=1)["position_rmse_km"] == pytest.approx(-((14 / 3) ** 0.5), rel=1e-12)


def test_lost_tracks_and_bin_hits(store: Store) -> None:
    """Seed 3 asks for the wrong bin in the last 15 dwells: 5 hits of 20 are fewer than half, so it is lost."""
    found = report(store)
    row = _row(found["lost"], target=1, strategy="power-aware")
    expected = binomtest(1, 3).proportion_ci(method="wilson")
    assert (row["lost"], row["runs"], row["share"]) == (1, 3, pytest.approx(1 / 3))
    assert (row["share_low"], row["share_high"]) == (pytest.approx(expected.low), pytest.approx(expected.high))
    assert _row(found["lost"], target=1, strategy="uniform")["lost"] == 0
    assert _row(found["last"], target=1, strategy="power-aware")["hit_rate"] == pytest.approx((20 + 20 + 5) / 60)


def test_acquisition_and_failed_runs(store: Store) -> None:
    failed = {"status": "failed", "reason": "nothing found", "acquisition_scans": None}
    store.journal.add_recording(_recording(Strategy.UNIFORM, 5, [], **failed), 100)
    found = report(store)
    row = _row(found["acquisition"], strategy="uniform")
    assert (row["runs"], row["mean"], row["median"], row["max"]) == (3, 5.0, 5.0, 6)
    assert found["failed"] == [{"run": "smoke-uniform-5", "reason": "nothing found"}]
    assert "nothing found" in caption(found)


def test_a_single_run_has_no_bootstrap_interval() -> None:
    store = in_memory()
    store.journal.add_recording(_recording(Strategy.UNIFORM, 1, _scores(1, 1.0, 0)), 1)
    (row, _) = report(store)["last"]
    assert (row["p_d"], row["p_d_low"], row["position_rmse_km_high"]) == (1.0, None, None)
    json.dumps(report(store), allow_nan=False)


def _taken(store: Store, run: str) -> Recording:
    recording = take(store, run)
    assert recording is not None
    return recording


def test_the_report_is_the_same_whatever_the_order_of_the_runs(store: Store) -> None:
    other = in_memory()
    for place, run in enumerate(store.read("SELECT run FROM run ORDER BY run DESC")):
        other.journal.add_recording(_taken(store, run["run"]), place)
    assert report(other) == report(store)


def test_stores_that_cannot_be_reported_on(store: Store) -> None:
    with pytest.raises(BadInput, match="no complete run"):
        report(in_memory())
    store.journal.add_recording(_recording(Strategy.UNIFORM, 1, [], run="again"), 50)
    with pytest.raises(BadInput, match="of one seed twice"):
        report(store)
    other = in_memory()
    other.journal.add_recording(_recording(Strategy.UNIFORM, 1, _scores(1, 1.0, 0)), 1)
    other.journal.add_recording(_recording(Strategy.UNIFORM, 2, _scores(2, 1.0, 0), scenario="other"), 2)
    with pytest.raises(BadInput, match=r"several scenarios: other \(60 dwells\), smoke \(60 dwells\)"):
        report(other)


def test_tables_are_written_between_the_markers(store: Store, tmp_path: Path) -> None:
    page = tmp_path / "results.md"
    page.write_text("before\n<!-- report smoke -->\nold\n<!-- /report smoke -->\nafter\n")
    found = report(store)
    for _ in range(2):  # writing twice changes nothing more
        write(page, [found])
        text = page.read_text()
    assert text.startswith("before\n<!-- report smoke -->\n")
    assert text.endswith("<!-- /report smoke -->\nafter\n")
    assert "old" not in text
    assert text.count("| 1 | uniform | 0.500 |") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["results.md"]
    page.write_text("no markers")
    with pytest.raises(BadInput, match=r"results\.md: has no lines"):
        write(page, [found])


def test_a_page_that_cannot_be_written_is_named(store: Store, tmp_path: Path) -> None:
    page = tmp_path / "results.md"
    page.write_text("<!-- report smoke -->\n<!-- /report smoke -->\n")
    (tmp_path / "results.md.new").mkdir()
    with pytest.raises(BadInput, match=r"results\.md: Is a directory"):
        write(page, [report(store)])


def test_several_reports_go_between_their_own_markers_or_none_does(store: Store, tmp_path: Path) -> None:
    page = tmp_path / "results.md"
    markers = "<!-- report {0} -->\n<!-- /report {0} -->\n"
    page.write_text(markers.format("smoke") + markers.format("other"))
    smoke = report(store)
    other = smoke | {"scenario": "other", "fidelity": "paper"}
    write(page, [smoke, other])
    first, second = page.read_text().split("<!-- /report smoke -->")
    assert "smoke (robust): 3 uniform, 3 power-aware runs of 60 dwells" in first
    assert "other (paper): 3 uniform" in second
    before = page.read_text()
    with pytest.raises(BadInput, match="no lines <!-- report third -->"):
        write(page, [smoke | {"digest": "new"}, smoke | {"scenario": "third"}])
    assert page.read_text() == before


def test_the_caption_says_what_the_intervals_take_as_independent(store: Store) -> None:
    assert "intervals take runs as independent, not their dwells" in caption(report(store))


def test_the_tables_are_shown_whole_with_one_line_per_row(store: Store) -> None:
    made = tables(report(store))
    assert len(made) == 5 + TARGETS
    assert_shown_whole(made)
    for table in made:
        n_group = len({row[table.group] for row in table.rows}) if table.group else 1
        assert len(shown(table, 80).splitlines()) <= 4 + len(table.rows) + n_group


def test_messages_that_differed_are_a_warning(store: Store) -> None:
    assert report(store)["conflicts"] == 0
    assert "WARNING" not in caption(report(store))
    store.journal.add_recording(_recording(Strategy.UNIFORM, 9, _scores(9, 1.0, 0), conflicts=3), 200)
    assert report(store)["conflicts"] == 3
    assert "WARNING: 3 messages differed" in caption(report(store))


def test_perfect_runs_have_intervals_too() -> None:
    """Everything detected, no error: nothing may divide by zero."""
    store = in_memory()
    for seed in (1, 2):
        store.journal.add_recording(_recording(Strategy.ORTHOGONAL, seed, _scores(seed, 0.0, 0)), seed)
    row = report(store)["last"][0]
    assert (row["p_d"], row["position_rmse_km"]) == (1.0, 0.0)
    assert np.isfinite(row["p_d_wilson_low"])
