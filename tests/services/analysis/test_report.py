"""The report against results made up so that every number can be said beforehand."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binomtest

from cogradar.services.analysis.report import ROWS, _windows, report
from cogradar.services.analysis.report_tables import caption, heading, tables, verdict, write
from cogradar.services.errors import BadInput
from cogradar.services.metrics.experiments import experiments
from cogradar.services.metrics.recording import take
from cogradar.services.metrics.selection import Selection
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.store.tables import Recording
from cogradar.services.runs.run import WINDOW
from cogradar.shared.protocol.events import Event, Tick
from cogradar.shared.protocol.messages import Message, RunCancel
from cogradar.shared.protocol.orders import EndRun, Order
from cogradar.shared.scenario.limits import NO_END
from cogradar.shared.scenario.radar_config import Strategy
from tests.services.analysis.conftest import (
    DWELLS,
    NEES,
    OTHER,
    TARGETS,
    TURNS_UNTIL,
    made_picture,
    made_recording,
    made_scores,
    report_of,
    row_of,
)
from tests.services.loop import SMOKE, play, smoke_start
from tests.services.stored import seal
from tests.services.tables import assert_shown_whole, shown


def test_the_last_twenty_dwells(store: Store) -> None:
    """P_D 10/20 and 15/20 by construction; errors of 2, 4, 6 km: root mean square sqrt(56/3)."""
    found = report_of(store)
    uniform = row_of(found["last"], target=2, strategy="uniform")
    assert (uniform["first_dwell"], uniform["last_dwell"], uniform["runs"], uniform["n"]) == (41, 60, 3, 60)
    assert uniform["p_d"] == 0.5
    assert uniform["position_rmse_km"] == pytest.approx((56 / 3) ** 0.5, rel=1e-12)
    assert uniform["velocity_rmse_km_s"] == pytest.approx(0.005, rel=1e-9)
    assert uniform["share"] == 0.25
    assert row_of(found["last"], target=1, strategy="power-aware")["p_d"] == 0.75


def test_the_wilson_interval_is_scipys(store: Store) -> None:
    uniform = row_of(report_of(store)["last"], target=1, strategy="uniform")
    expected = binomtest(30, 60).proportion_ci(method="wilson")
    assert uniform["p_d_wilson_low"] == pytest.approx(expected.low, rel=1e-9)
    assert uniform["p_d_wilson_high"] == pytest.approx(expected.high, rel=1e-9)


def test_the_bootstrap_resamples_runs_and_not_dwells(store: Store) -> None:
    """Every run has the same P_D: no width over runs, whatever Wilson says. Of three errors the extremes are drawn
    three times with probability 1/27 = 0.037 each, above the tail of 0.025: the interval reaches from 2 to 6 km."""
    uniform = row_of(report_of(store)["last"], target=1, strategy="uniform")
    assert (uniform["p_d_low"], uniform["p_d_high"]) == (0.5, 0.5)
    low, high = uniform["position_rmse_km_low"], uniform["position_rmse_km_high"]
    assert (low, high) == (pytest.approx(2.0, rel=1e-9), pytest.approx(6.0, rel=1e-9))


def test_windows_of_fifty_dwells_and_the_whole_run(store: Store) -> None:
    rows = [row for row in report_of(store)["windows"] if row["target"] == 1 and row["strategy"] == "uniform"]
    assert [(row["first_dwell"], row["last_dwell"]) for row in rows] == [(1, 50), (51, 60), (1, 60)]
    assert [row["p_d"] for row in rows] == [1.0, 0.0, pytest.approx(50 / 60, rel=1e-12)]


def test_differences_are_paired_by_seed(store: Store) -> None:
    """Of one seed the errors differ by -seed km; of resampled runs by between -3 and -1 times, as RMSE is homogeneous.

    Unpaired resampling could give -6 + 1 = -5 and -2 + 3 = +1 km.
    """
    row = row_of(report_of(store)["differences"], target=1)
    assert (row["strategy"], row["minus"], row["runs"]) == ("power-aware", "uniform", 3)
    assert (row["p_d"], row["p_d_low"], row["p_d_high"]) == (0.25, 0.25, 0.25)
    assert row["position_rmse_km"] == pytest.approx(-((14 / 3) ** 0.5), rel=1e-12)
    assert row["position_rmse_km_low"] == pytest.approx(-3.0, rel=1e-9)
    assert row["position_rmse_km_high"] == pytest.approx(-1.0, rel=1e-9)


def test_runs_without_a_partner_are_left_out_of_differences(store: Store) -> None:
    store.journal.add_recording(made_recording(Strategy.UNIFORM, 4, made_scores(4, 100.0, 0)), 99)
    found = report_of(store)
    assert found["runs"] == {"uniform": 4, "power-aware": 3}
    assert row_of(found["differences"], target=1)["position_rmse_km"] == pytest.approx(-((14 / 3) ** 0.5), rel=1e-12)


def test_lost_tracks_and_bin_hits(store: Store) -> None:
    """Seed 3 believes in the wrong bin in all of the last 20 dwells, and asks for it, so it is lost."""
    found = report_of(store)
    row = row_of(found["lost"], target=1, strategy="power-aware")
    expected = binomtest(1, 3).proportion_ci(method="wilson")
    assert (row["lost"], row["runs"], row["share"]) == (1, 3, pytest.approx(1 / 3))
    assert (row["share_low"], row["share_high"]) == (pytest.approx(expected.low), pytest.approx(expected.high))
    assert row_of(found["lost"], target=1, strategy="uniform")["lost"] == 0
    assert row_of(found["last"], target=1, strategy="power-aware")["hit_rate"] == pytest.approx(40 / 60)
    assert row_of(found["last"], target=1, strategy="power-aware")["in_bin"] == pytest.approx(40 / 60)
    assert (row["outage_longest"], row["outage"]) == (20, pytest.approx(20 / 3))


def test_acquisition_and_failed_runs(store: Store) -> None:
    failed = {"status": "failed", "reason": "nothing found", "acquisition_scans": None}
    store.journal.add_recording(made_recording(Strategy.UNIFORM, 5, [], **failed), 100)
    found = report_of(store)
    row = row_of(found["acquisition"], strategy="uniform")
    assert (row["runs"], row["mean"], row["median"], row["max"]) == (3, 5.0, 5.0, 6)
    assert found["failed"] == [{"run": "smoke-uniform-5", "reason": "nothing found"}]
    assert "nothing found" in caption(found)


def test_a_single_run_has_no_bootstrap_interval() -> None:
    store = in_memory()
    store.journal.add_recording(made_recording(Strategy.UNIFORM, 1, made_scores(1, 1.0, 0)), 1)
    (row, _) = report_of(store)["last"]
    assert (row["p_d"], row["p_d_low"], row["position_rmse_km_high"]) == (1.0, None, None)
    json.dumps(report_of(store), allow_nan=False)


def test_of_a_single_run_only_what_is_known_is_shown() -> None:
    store = in_memory()
    store.journal.add_recording(made_recording(Strategy.UNIFORM, 1, made_scores(1, 1.0, missed=2)), 1)
    report = report_of(store)
    columns = {table.title.partition(",")[0]: [c.heading for c in table.columns] for table in tables(report)}
    assert columns["Detection"] == ["target", "strategy", "P_D", "95 %, Wilson", "bin hits", "in bin", "power"]
    assert columns["Errors of the belief mean"] == ["target", "strategy", "RMSE km", "RMSE m/s"]
    assert "of a single run there is no interval over runs" in caption(report)
    assert "takes runs as independent" not in caption(report)
    assert caption(report).endswith(f"digest {report['digest']}, of the results of all these runs together")
    assert heading(report) == f"smoke: {SMOKE.title}"


def _taken(store: Store, run: str) -> Recording:
    recording = take(store, run)
    assert recording is not None
    return recording


def test_the_report_is_the_same_whatever_the_order_of_the_runs(store: Store) -> None:
    other = in_memory()
    for place, run in enumerate(store.read("SELECT run FROM run ORDER BY run DESC")):
        other.journal.add_recording(_taken(store, run["run"]), place)
    assert report_of(other) == report_of(store)


def test_a_store_without_a_complete_run_cannot_be_reported_on(store: Store) -> None:
    with pytest.raises(BadInput, match=r"no complete run with truth in this store$"):
        report_of(in_memory())
    with pytest.raises(BadInput, match=r"no complete run with truth in this store, of seed = 7$"):
        experiments(store, Selection(run="all", seed=7))


def _recorded(*said: Message) -> Store:
    made = in_memory()
    core = RecorderCore(made.journal)
    events: list[Event] = [*said, *3 * [Tick(0.0)]]
    for event in events:
        core.handle(event)
    made.derive()
    return made


def _endless(k: int = 30, dwells: int = NO_END) -> list[Message]:
    """A run without an end, or a long one, which a command ends with this dwell."""
    return play(smoke_start(dwells=dwells), orders=[Order(n=1, k=k, action=EndRun())])


@pytest.mark.parametrize("dwells", [NO_END, 500])
def test_a_run_that_a_command_has_ended_is_reported_on(tmp_path: Path, dwells: int) -> None:
    made = _recorded(*_endless(dwells=dwells))
    (row,) = made.read("SELECT status, acknowledged_t AS t FROM run")
    assert (row["status"], row["t"] > 0) == ("complete", True)
    found = report_of(made)
    assert (found["dwells"], found["windows"][0]["last_dwell"], found["first"]) == (row["t"], row["t"], None)
    (page := tmp_path / "page.md").write_text("<!-- report smoke -->\n<!-- /report smoke -->\n")
    write(page, [found])
    assert f"of {row['t']} dwells" in page.read_text()
    assert "cogradar run" not in page.read_text()  # no number of dwells repeats it


def test_a_run_that_is_not_reported_on_is_named_with_the_reason_and_what_shows_it() -> None:
    said = _endless()
    stopped = _recorded(*said[:-20], RunCancel(run="r"))
    with pytest.raises(
        BadInput, match=r"run r stopped at dwell \d+, by user; `cogradar query summary --run r --store "
    ):
        report_of(stopped)
    cut = _recorded(*said)
    (t,) = (row["t"] for row in cut.read("SELECT acknowledged_t AS t FROM run"))
    cut.journal.write("UPDATE run SET kept_k = acknowledged_k - 2")
    seal(cut.journal)
    with pytest.raises(
        BadInput, match=rf"run r has lost its dwells before {t - 1}, which were cut; `cogradar query su"
    ):
        report_of(cut)


def test_a_long_run_has_no_more_rows_in_time_than_can_be_read() -> None:
    assert len(_windows(2000)) == ROWS + 1
    assert _windows(2000)[1] == (WINDOW + 1, 2 * WINDOW)
    assert len(_windows(100_000)) == ROWS + 1
    assert _windows(100_000)[-2:] == [(97_501, 100_000), (1, 100_000)]


def test_of_runs_of_one_seed_the_newest_complete_one_counts(store: Store) -> None:
    before = report_of(store)
    (name,) = (run["run"] for run in store.read("SELECT run FROM run WHERE strategy = 'uniform' AND seed = 1"))
    again = _taken(store, name)
    better = [score | {"detected": 1} for score in again.scores]
    for run, status in (("again", "complete"), ("begun", "failed")):
        row = again.run | {"run": run, "status": status}
        place = 50 if run == "again" else 51
        store.journal.add_recording(
            Recording(row, [score | {"run": run} for score in better], made_picture(run, 1), []), place
        )
    after = report_of(store)
    assert (after["runs"], after["failed"]) == (before["runs"], [])
    rows = (row_of(found["last"], target=1, strategy="uniform") for found in (before, after))
    assert next(rows)["p_d"] < next(rows)["p_d"]


def test_experiments_are_reported_on_one_by_one(store: Store) -> None:
    store.journal.add_recording(made_recording(Strategy.UNIFORM, 2, made_scores(2, 1.0, 0), **OTHER), 52)
    found = experiments(store, Selection(run="all"))
    assert [(one.label, len(one.complete)) for one in found] == [("smoke", 6), ("other", 1)]
    assert [report(store, one)["scenario"] for one in found] == ["smoke", "other"]
    (other,) = experiments(store, Selection(run="all", scenario="other"))
    assert report(store, other) == report(store, found[1])
    alone = in_memory()
    alone.journal.add_recording(_taken(store, "other-uniform-2"), 1)
    assert report_of(alone) == report(store, other)  # the digest is that of its runs, too
    (one,) = experiments(store, Selection(run="all", scenario="smoke", strategy="uniform", seed=3))
    assert [run["run"] for run in one.complete] == ["smoke-uniform-3"]


def test_experiments_of_one_name_are_told_apart(store: Store) -> None:
    """By their dwells; by their documents if that is not enough."""
    for place, (dwells, document) in enumerate([(30, None), (60, "changed")], 60):
        again = _taken(store, "smoke-uniform-1")
        row = again.run | {"run": f"r{place}", "dwells": dwells, "acknowledged_t": dwells}
        if document:
            row["document"] = row["document"].replace('"smoke"', '"smoke "')
        scores = [score | {"run": f"r{place}"} for score in again.scores if score["t"] <= dwells]
        picture = [found for found in made_picture(f"r{place}", 1) if found["t"] <= dwells]
        store.journal.add_recording(Recording(row, scores, picture, []), place)
    labels = [one.label for one in experiments(store, Selection(run="all"))]
    assert len(set(labels)) == 3
    assert "smoke-30" in labels
    assert sum(bool(re.fullmatch("smoke-60-[0-9a-f]{6}", label)) for label in labels) == 2
    reports = [report(store, one) for one in experiments(store, Selection(run="all"))]
    with pytest.raises(BadInput, match="several experiments of one scenario"):
        write(Path("nowhere.md"), reports)


def test_a_strategy_of_another_version_is_reported_on_like_any_other(store: Store) -> None:
    again = _taken(store, "smoke-uniform-1")
    row = again.run | {"run": "theirs", "strategy": "proportional"}
    store.journal.add_recording(
        Recording(row, [score | {"run": "theirs"} for score in again.scores], made_picture("theirs", 1), []), 70
    )
    found = report_of(store)
    assert list(found["runs"]) == ["uniform", "power-aware", "proportional"]
    theirs, ours = (row_of(found["last"], target=1, strategy=name) for name in ("proportional", "uniform"))
    assert (theirs["runs"], ours["runs"]) == (1, 3)
    assert {(row["strategy"], row["minus"]) for row in found["differences"]} >= {("proportional", "uniform")}


def test_the_air_picture_is_pooled_over_runs(store: Store) -> None:
    """Seeds 1 to 3: both targets off by as many km as the seed; in the last dwell of each run one is missed."""
    row = row_of(report_of(store)["picture"], strategy="uniform")
    squares = [seed**2 * (2 * (DWELLS - 1) + 1) / DWELLS for seed in (1, 2, 3)]
    assert row["gospa_localisation_km"] == pytest.approx(np.sqrt(np.mean(squares)))
    assert row["gospa_missed_km"] == row["gospa_missed_km_low"] == pytest.approx(np.sqrt(12.5 / DWELLS))
    assert row["gospa_km"] ** 2 == pytest.approx(row["gospa_localisation_km"] ** 2 + row["gospa_missed_km"] ** 2)
    assert row["gospa_km_low"] < row["gospa_km"] < row["gospa_km_high"]
    assert (row["completeness"], row["spuriousness"], row["breaks"]) == (1 - 0.5 / DWELLS, 0.0, 1.0)


def test_blind_cells_are_counted_by_run(store: Store) -> None:
    found = report_of(store)
    row = row_of(found["picture"], strategy="uniform")
    assert (row["blind_cells"], row["blind_dwells"]) == (2.0, 1.0)
    assert (row["blind_share"], row["blind_share_low"]) == pytest.approx((2.0 / 600.0, 1.0 / 600.0))
    (table,) = [table for table in tables(found) if table.title == "Cells whose noise had no estimate"]
    assert [column.cell(table.rows[0]) for column in table.columns][1:4] == ["2.0", "1.0", "3.33e-03"]


def test_all_tracks_together_and_the_honesty_of_their_beliefs(store: Store) -> None:
    found = report_of(store)
    overall = row_of(found["overall"], strategy="uniform")
    lost_tracks = [row for row in found["lost"] if row["strategy"] == "uniform"]
    assert (overall["lost"], overall["tracks"]) == (sum(row["lost"] for row in lost_tracks), 3 * len(lost_tracks))
    assert overall["share"] == pytest.approx(overall["lost"] / overall["tracks"])
    assert overall["in_bin_low"] <= overall["in_bin"] <= overall["in_bin_high"]
    row = row_of(found["consistency"], target=1, strategy="uniform")
    assert row["nees"] == pytest.approx(NEES)
    assert (row["nees_position"], row["nees_velocity"]) == pytest.approx((0.5 * NEES, 0.6 * NEES))
    assert (row["in_band"], row["beyond_99"]) == (1.0, 0.0)


def test_consistency_is_split_by_the_acceleration_of_the_targets(store: Store) -> None:
    found = [row for row in report_of(store)["flights"] if row["strategy"] == "uniform"]
    of_all = 3 * TARGETS
    assert {row["flight"]: row["n"] for row in found} == {
        "all": of_all * DWELLS,
        "straight": of_all * (DWELLS - TURNS_UNTIL),
        "0.1-1 g": 0,
        "1-3 g": of_all * TURNS_UNTIL,
        "over 3 g": 0,
    }
    for row in (found[0], found[1], found[3]):
        assert row["nees"] == row["nees_low"] == row["nees_high"] == pytest.approx(NEES)
        assert (row["nees_position"], row["beyond_99"]) == (pytest.approx(0.5 * NEES), 0.0)
    assert all((found[i]["nees"], found[i]["beyond_99"]) == (None, None) for i in (2, 4))


def test_the_verdict_says_which_strategy_lost_and_where_they_differ_most() -> None:
    overall = [{"strategy": "orthogonal", "lost": 2, "tracks": 6, "runs": 3}]
    overall += [{"strategy": "power-aware", "lost": 0, "tracks": 6, "runs": 3}]
    row = {"strategy": "power-aware", "minus": "orthogonal", "runs": 3, "first_dwell": 11, "last_dwell": 60}
    differences = [
        row | {"target": m + 1, "p_d": p_d, "p_d_low": p_d - 0.1, "p_d_high": p_d + 0.1}
        for m, p_d in enumerate((0.05, -0.3, 0.2))
    ]
    assert verdict({"overall": overall, "differences": differences}) == (
        "orthogonal lost 2 of 6 tracks in 3 runs, power-aware lost 0 of 6 tracks in 3 runs."
        " power-aware - orthogonal, dwells 11-60, 3 runs: P_D of target 2 differs most, -0.300 [-0.400, -0.200]"
    )
    said = verdict({"overall": [], "differences": differences[:1]})
    assert said.endswith("no target's P_D differs beyond its interval")


def test_the_caption_says_what_the_intervals_take_as_independent(store: Store) -> None:
    said = caption(report_of(store))
    for kind, what in (("95 %, runs", "bootstrap over whole runs"), ("95 %, Wilson", "single dwells")):
        assert f"{kind}: {what}" in said


def test_the_tables_are_shown_whole_with_one_line_per_row(store: Store) -> None:
    made = tables(report_of(store))
    assert len(made) == 10 + TARGETS  # a table of no rows is left out
    assert_shown_whole(made)
    for table in made:
        n_group = len({row[table.group] for row in table.rows}) if table.group else 1
        assert len(shown(table, 80).splitlines()) <= 4 + len(table.rows) + n_group


def test_messages_that_differed_are_a_warning(store: Store) -> None:
    assert report_of(store)["conflicts"] == 0
    assert "WARNING" not in caption(report_of(store))
    store.journal.add_recording(made_recording(Strategy.UNIFORM, 9, made_scores(9, 1.0, 0), conflicts=3), 200)
    assert report_of(store)["conflicts"] == 3
    assert "WARNING: 3 messages differed" in caption(report_of(store))


def test_perfect_runs_have_intervals_too() -> None:
    """Everything detected, no error: nothing may divide by zero."""
    store = in_memory()
    for seed in (1, 2):
        store.journal.add_recording(made_recording(Strategy.ORTHOGONAL, seed, made_scores(seed, 0.0, 0)), seed)
    row = report_of(store)["last"][0]
    assert (row["p_d"], row["position_rmse_km"]) == (1.0, 0.0)
    assert np.isfinite(row["p_d_wilson_low"])


def test_a_run_to_repeat_is_named_of_a_shipped_scenario_only(store: Store) -> None:
    """With other settings, or of a file of its own, its name means something else on a command line."""
    (one,) = experiments(store, Selection.of({"run": "all"}))
    first = {"strategy": "power-aware", "seed": 1, "dwells": 60, "digest": "0" * 64}
    assert report(store, one)["first"].keys() == first.keys()
    document = json.loads(one.document)
    document["radar"]["planner"]["rule"] = "mean"
    for other in (replace(one, document=json.dumps(document)), replace(one, scenario="smoke-1")):
        assert report(store, other)["first"] is None
