"""The rules compared: the runs there are to be, what they show, and the page."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from services.analysis.tables import markdown
from services.cli.app import app
from services.cli.decisions import COSTS
from services.errors import BadInput
from services.metrics.store import Store, in_memory
from services.runs import in_process
from services.sweeps import decision_page
from services.sweeps.decision_runs import play_one
from services.sweeps.decisions import SETTINGS, Asked, Decisions, Plan, Played, Result, Setting, losses, variant
from shared.scenario.tables import BIN_RULES, RULES

OWN = Setting(0.0, "robust", 0.004)
PLAN = Plan("smoke", 3, 1, 1, 30)
COST_ROWS = [{"case": name, "what": "", "median_ms": 1.0, "loops": i + 1.0} for i, name in enumerate(COSTS)]


@pytest.fixture(scope="module")
def results() -> list[Result]:
    """Three rules at the scenario's own setting, two seeds; one of them a third."""
    asked = [Asked(OWN, rule, seed) for rule in ("pomcp", "mean", "oracle") for seed in (1, 2)]
    return [play_one(PLAN, one) for one in [*asked, Asked(OWN, "mean", 3)]]


@pytest.fixture(scope="module")
def stores() -> dict[tuple[str, int], Store]:
    """The same runs, whole, by rule and seed."""
    found = {}
    for rule, seed in [("pomcp", 1), ("pomcp", 2), ("mean", 1), ("mean", 2)]:
        found[rule, seed] = in_memory()
        in_process.play(PLAN.start(Asked(OWN, rule, seed)), store=found[rule, seed])
    return found


def _result(rule: str, seed: int, lost: list[int | None], decisions: Decisions | None = None) -> Result:
    common: dict[str, Any] = {"scenario": "smoke", "dwells": 30, "document": "s", "program": "p", "digest": "d"}
    common |= {"p_d": [1.0, 1.0], "p_d_last": [1.0, 1.0], **OWN._asdict()}
    return Result(**common, rule=rule, seed=seed, lost=lost, decisions=decisions)


def test_every_rule_is_played_in_every_setting() -> None:
    asked = Plan("paper", 100, 30, 3, None).asked()
    assert len(asked) == len(set(asked)) == len(RULES) * (100 * 4 + 30 * 8)
    assert [one.seed for one in asked] == sorted(one.seed for one in asked)  # complete pairs first
    scenarios = {variant("paper", setting, rule).name for setting in SETTINGS for rule in RULES}
    assert len(scenarios) == len(SETTINGS) * len(RULES)
    weak = variant("paper", Setting(-6.0, "paper", 0.03), "mode")
    assert (weak.radar.echo.amplitude_db, weak.simulated.echo.amplitude_db) == (54.0, 54.0)
    assert (weak.radar.motion.sigma_s_km_s2, weak.simulated.motion.sigma_s_km_s2) == (0.03, 0.03)
    assert (weak.radar.fidelity, weak.radar.planner.rollout, weak.radar.planner.rule) == ("paper", "random", "mode")


def test_a_result_has_what_its_run_detected(results: list[Result], stores: dict[tuple[str, int], Store]) -> None:
    for result in results:
        if (store := stores.get((result.rule, result.seed))) is None:
            continue
        (run,) = store.read("SELECT digest, dwells FROM run")
        assert (result.digest, result.dwells, result.failed) == (run["digest"], run["dwells"], None)
        for key, first in (("p_d", 1), ("p_d_last", 11)):
            hits = store.read(
                "SELECT AVG(detected) AS p FROM score WHERE t >= ? GROUP BY target ORDER BY target", [first]
            )
            assert getattr(result, key) == pytest.approx([hit["p"] for hit in hits], abs=1e-6)
    assert [result.rule for result in results if result.decisions] == ["pomcp"]  # of the seeds that are asked for


def test_a_row_has_what_the_runs_of_a_rule_detected(results: list[Result]) -> None:
    played = Played(results)
    rows = {row["rule"]: row for row in played.detection(0.0)}
    assert list(rows) == ["pomcp", "mean", "oracle"]
    assert rows["oracle"]["name"] == "oracle (knows the truth)"
    assert [row["runs"] for row in rows.values()] == [2, 3, 2]
    for rule, row in rows.items():
        p_d = np.mean(np.array([result.p_d for result in results if result.rule == rule], dtype=float), axis=0)
        assert row["p_d"] == pytest.approx(p_d[1])
        assert row["p_d_worst"] == pytest.approx(min(p_d))
        assert p_d[row["worst"] - 1] == min(p_d)
    assert played.detection(-3.0) == []


def test_a_track_that_was_never_begun_is_not_counted() -> None:
    (row,) = Played([_result("mode", 1, [1, None]), _result("mode", 2, [0, 0])]).detection(0.0)
    assert (row["lost"], row["tracks"]) == (1, 3)


def test_a_target_that_is_gone_at_the_end_counts_while_it_was_there() -> None:
    gone = _result("mode", 1, [0, 0]).model_copy(update={"p_d": [1.0, 0.5], "p_d_last": [1.0, None]})
    (row,) = Played([gone, _result("mode", 2, [0, 0])]).detection(0.0)
    assert (row["p_d"], row["p_d_last"], row["runs"]) == (0.75, 1.0, 2)


def test_a_run_that_failed_is_counted_and_shown_nowhere_else() -> None:
    failed = _result("mode", 3, [0, 0]).model_copy(update={"failed": "no acquisition"})
    played = Played([failed, _result("mode", 1, [0, 0]), _result("mode", 2, [0, 0])])
    assert [row["runs"] for row in played.detection(0.0)] == [2]
    assert "; 1 more failed. Program p." in decision_page.words(PLAN, played, [], COST_ROWS)[-1]
    with pytest.raises(BadInput, match="no run is complete yet"):
        Played([failed])


def test_differences_are_taken_within_seeds(results: list[Result]) -> None:
    rows = {row["rule"]: row for row in Played(results).differences(0.0)}
    assert list(rows) == ["mean", "oracle"]
    assert [row["runs"] for row in rows.values()] == [2, 2]
    of_rules = {
        rule: [result.p_d[1] for result in results if result.rule == rule and result.seed < 3]
        for rule in ("pomcp", "mean")
    }
    expected = np.array(of_rules["mean"], dtype=float) - np.array(of_rules["pomcp"], dtype=float)
    assert rows["mean"]["p_d"] == pytest.approx(expected.mean())
    assert (rows["mean"]["p_d_low"], rows["mean"]["p_d_high"]) == pytest.approx((expected.min(), expected.max()))


def test_the_decisions_of_a_run_are_looked_into(results: list[Result]) -> None:
    (counts,) = [result.decisions for result in results if result.decisions]
    assert counts.n == 2 * (PLAN.start(Asked(OWN, "pomcp", 1)).dwells + 1)  # with those after the acquisition
    assert 0 <= counts.open <= counts.open_any < counts.n
    assert counts.loss["exact"] == 0.0
    assert set(counts.loss) == set(BIN_RULES)
    for rule in BIN_RULES:
        assert 0.0 <= counts.loss_open[rule] <= counts.loss[rule] + 1e-12
    assert counts.loss["mode"] == pytest.approx(counts.loss_open["mode"])  # elsewhere it is the best
    rows = losses(results, list(BIN_RULES))
    assert [row["rule"] for row in rows] == list(BIN_RULES)
    assert rows[0]["open"] == counts.open / counts.n


def test_losses_are_means_over_the_decisions_of_all_runs() -> None:
    looked_into = [
        Decisions(n=n, open=n_open, open_any=n_open, loss={"mode": loss}, loss_open={"mode": loss})
        for n, n_open, loss in ((90, 1, 0.2), (10, 3, 0.6))
    ]
    (row,) = losses([_result("pomcp", i, [0, 0], one) for i, one in enumerate(looked_into)], ["mode"])
    assert (row["runs"], row["decisions"], row["open"]) == (2, 100, 0.04)
    assert (row["loss"], row["loss_open"]) == pytest.approx((8.0, 200.0))


def test_the_page_says_what_the_numbers_say(results: list[Result], tmp_path: Path) -> None:
    played, lost = Played(results), losses(results, list(BIN_RULES))
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- decisions -->\nold\n<!-- /decisions -->\nafter\n", encoding="utf-8")
    decision_page.write(page, PLAN, played, lost, COST_ROWS)
    text = page.read_text(encoding="utf-8")
    assert text.startswith("before\n<!-- decisions -->\n\nThere are too few runs to compare.")
    assert "Played: 2 to 3 of 3 runs of each of 3 cells at +0 dB; nothing yet at -3 dB; nothing yet at -6 dB." in text
    assert text.endswith("<!-- /decisions -->\nafter\n")
    for table in decision_page.tables(played, lost, COST_ROWS):
        assert markdown(table) in text


@pytest.mark.parametrize(("low", "high", "less", "more"), [(-0.2, -0.1, 1, 0), (-0.1, 0.1, 0, 0), (0.1, 0.2, 0, 1)])
def test_the_sentences_follow_the_numbers(
    low: float, high: float, less: int, more: int, results: list[Result], monkeypatch: pytest.MonkeyPatch
) -> None:
    played = Played(results)
    row = OWN._asdict() | {"rule": "mode", "runs": 9, "p_d": 0.5 * (low + high), "p_d_low": low, "p_d_high": high}
    oracle = row | {"rule": "oracle", "p_d": 0.01}
    monkeypatch.setattr(played, "differences", lambda snr_db: [row, oracle] if snr_db == 0.0 else [])
    verdict, basis = decision_page.words(PLAN, played, [OWN._asdict() | {"open": 0.004}], COST_ROWS)
    assert f"In {less} of 1 setting the most probable bin detects target 2 less often than the search" in verdict
    assert f"and in {more} more often;" in verdict
    assert "provably the best for 99.6 % of its decisions" in verdict
    assert re.search(r"\+0\.0100 \[.*\] by who knows the truth", verdict)
    assert basis.startswith("Played: ")
    assert "provably" not in decision_page.words(PLAN, played, [], COST_ROWS)[0]  # nothing was looked into yet


@pytest.mark.nightly
def test_the_command_from_nothing_to_a_page(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("<!-- decisions -->\n<!-- /decisions -->\n", encoding="utf-8")
    command = ["decisions", "--results", str(tmp_path / "d.jsonl"), "--into", str(page), "smoke"]
    small = ["--runs", "2", "--weak-runs", "2", "--belief-runs", "1", "--dwells", "3"]
    done = CliRunner().invoke(app, [*command, *small])
    assert done.exit_code == 0, done.output
    text = page.read_text(encoding="utf-8")
    assert "of 12 settings the most probable bin" in text
    again = CliRunner().invoke(app, [*command, *small])
    assert again.exit_code == 0, again.output
    assert CliRunner().invoke(app, [*command, "--as-is"]).exit_code == 0
