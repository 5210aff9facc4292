"""The rules compared: the runs there are to be, what they show, and the page."""

import json
import re
import threading
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from services.analysis.tables import markdown
from services.campaigns.pool import LocalPool, play_one
from services.cli.app import app
from services.cli.decisions import COSTS
from services.errors import BadInput, Interrupted
from services.metrics.store import Store, in_memory
from services.sweeps import beliefs, decision_page
from services.sweeps.decisions import SETTINGS, Plan, Played, Setting, campaigns, variant
from shared.protocol.build import build
from shared.protocol.messages import RunStart
from shared.scenario.radar_config import Strategy
from shared.scenario.tables import BIN_RULES, RULES

OWN = Setting(0.0, "robust", 0.004)
DWELLS = 30
COST_ROWS = [{"case": name, "what": "", "median_ms": 1.0, "loops": i + 1.0} for i, name in enumerate(COSTS)]


def _start(rule: str, seed: int, setting: Setting = OWN) -> RunStart:
    return RunStart.of(variant("smoke", setting, rule), Strategy.POWER_AWARE, seed, DWELLS)


@pytest.fixture(scope="module")
def store() -> Store:
    """Three rules at the scenario's own setting, two seeds; one of them a third."""
    kept = in_memory()
    starts = [_start(rule, seed) for rule in ("pomcp", "mean", "oracle") for seed in (1, 2)]
    for place, start in enumerate([*starts, _start("mean", 3)], 1):
        kept.journal.add_recording(play_one(start, build())[0], place)
    return kept


@pytest.fixture(scope="module")
def counts() -> beliefs.Counts:
    return beliefs.count(_start("pomcp", 1))


def test_every_rule_is_played_in_every_setting() -> None:
    asked = campaigns(Plan("paper", 100, 30, 3, None), "build/d.db")
    assert list(asked) == ["build/d.db", "build/d-weak.db"]
    assert [len(one.starts()) for one in asked.values()] == [100 * 4 * len(RULES), 30 * 8 * len(RULES)]
    scenarios = [scenario for one in asked.values() for scenario in one.scenarios]
    assert len({scenario.name for scenario in scenarios}) == len(scenarios) == len(SETTINGS) * len(RULES)
    weak = variant("paper", Setting(-6.0, "paper", 0.03), "mode")
    assert (weak.radar.echo.amplitude_db, weak.simulated.echo.amplitude_db) == (54.0, 54.0)
    assert (weak.radar.motion.sigma_s_km_s2, weak.simulated.motion.sigma_s_km_s2) == (0.03, 0.03)
    assert (weak.radar.fidelity, weak.radar.planner.rollout, weak.radar.planner.rule) == ("paper", "random", "mode")
    assert list(campaigns(Plan("paper", 0, 1, 3, None), "d.db")) == ["d-weak.db"]


def test_a_row_has_what_the_runs_of_a_rule_detected(store: Store) -> None:
    played = Played("smoke", [store])
    rows = {row["rule"]: row for row in played.detection(0.0)}
    assert list(rows) == ["pomcp", "mean", "oracle"]
    assert rows["oracle"]["name"] == "oracle (knows the truth)"
    assert [row["runs"] for row in rows.values()] == [2, 3, 2]
    for rule, row in rows.items():
        hits = store.read(
            "SELECT AVG(detected) AS p FROM score JOIN run USING (run) WHERE json_extract(document,"
            " '$.radar.planner.rule') = ? GROUP BY target ORDER BY target",
            [rule],
        )
        p_d = [hit["p"] for hit in hits]
        assert row["p_d"] == pytest.approx(p_d[1])
        assert row["p_d_worst"] == pytest.approx(min(p_d))
        assert p_d[row["worst"] - 1] == min(p_d)
    assert played.detection(-3.0) == []


def test_differences_are_taken_within_seeds(store: Store) -> None:
    played = Played("smoke", [store])
    rows = {row["rule"]: row for row in played.differences(0.0)}
    assert list(rows) == ["mean", "oracle"]
    assert [row["runs"] for row in rows.values()] == [2, 2]
    of_rules = {
        rule: [
            store.read(
                "SELECT AVG(detected) AS p FROM score JOIN run USING (run) WHERE target = 2 AND seed = ? AND"
                " json_extract(document, '$.radar.planner.rule') = ?",
                [seed, rule],
            )[0]["p"]
            for seed in (1, 2)
        ]
        for rule in ("pomcp", "mean")
    }
    expected = np.subtract(of_rules["mean"], of_rules["pomcp"])
    assert rows["mean"]["p_d"] == pytest.approx(expected.mean())
    assert (rows["mean"]["p_d_low"], rows["mean"]["p_d_high"]) == pytest.approx((expected.min(), expected.max()))


def test_the_decisions_of_a_run_are_looked_into(counts: beliefs.Counts) -> None:
    assert counts["decisions"] == 2 * (DWELLS + 1)  # with those after the acquisition
    assert 0 <= counts["open"] <= counts["open_any"] < counts["decisions"]
    assert counts["loss"]["exact"] == 0.0
    assert set(counts["loss"]) == set(BIN_RULES)
    for rule in BIN_RULES:
        assert 0.0 <= counts["loss_open"][rule] <= counts["loss"][rule] + 1e-12
    assert counts["loss"]["mode"] == pytest.approx(counts["loss_open"]["mode"])  # elsewhere it is the best
    name = " ".join(map(str, (*OWN, 1)))
    rows = beliefs.rows({name: counts})
    assert [row["rule"] for row in rows] == list(BIN_RULES)
    assert rows[0]["open"] == counts["open"] / counts["decisions"]


def test_looking_goes_on_where_it_was(tmp_path: Path, counts: beliefs.Counts) -> None:
    plan, file, stop = Plan("smoke", 1, 1, 1, 2), tmp_path / "b.json", threading.Event()
    asked = beliefs.starts(plan)
    done = dict.fromkeys(list(asked)[:-1], counts)
    header = {"scenario": "smoke", "dwells": 2, "program": build()}
    file.write_text(json.dumps({"of": header, "runs": done}), encoding="utf-8")
    before = tmp_path / "before.json"
    before.hardlink_to(file)
    found = beliefs.play(plan, file, LocalPool(1), report=lambda _: None, stop=stop)
    assert beliefs.read(before)["runs"] == done  # replaced at once, never rewritten in place
    assert {entry.name for entry in tmp_path.iterdir()} == {file.name, before.name}
    assert list(found) == list(asked)
    assert found[list(asked)[-1]]["decisions"] == 6
    assert beliefs.read(file)["runs"] == found
    with pytest.raises(BadInput, match="another scenario or program"):
        beliefs.play(plan._replace(dwells=3), file, LocalPool(1), report=lambda _: None, stop=stop)
    stop.set()
    file.unlink()
    with pytest.raises(Interrupted):
        beliefs.play(plan, file, LocalPool(1), report=lambda _: None, stop=stop)


def test_the_page_says_what_the_numbers_say(store: Store, counts: beliefs.Counts, tmp_path: Path) -> None:
    played, losses = Played("smoke", [store]), beliefs.rows({" ".join(map(str, (*OWN, 1))): counts})
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- decisions -->\nold\n<!-- /decisions -->\nafter\n", encoding="utf-8")
    decision_page.write(page, played, losses, COST_ROWS)
    text = page.read_text(encoding="utf-8")
    assert text.startswith("before\n<!-- decisions -->\n\nThere are too few runs to compare.")
    assert "Played: 2 to 3 runs of each of 3 cells at +0 dB; nothing yet at -3 dB; nothing yet at -6 dB." in text
    assert text.endswith("<!-- /decisions -->\nafter\n")
    for table in decision_page.tables(played, losses, COST_ROWS):
        assert markdown(table) in text


@pytest.mark.parametrize(("low", "high", "less", "more"), [(-0.2, -0.1, 1, 0), (-0.1, 0.1, 0, 0), (0.1, 0.2, 0, 1)])
def test_the_sentences_follow_the_numbers(
    low: float, high: float, less: int, more: int, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    played = Played("smoke", [store])
    row = OWN._asdict() | {"rule": "mode", "runs": 9, "p_d": 0.5 * (low + high), "p_d_low": low, "p_d_high": high}
    oracle = row | {"rule": "oracle", "p_d": 0.01}
    monkeypatch.setattr(played, "differences", lambda snr_db: [row, oracle] if snr_db == 0.0 else [])
    losses = [OWN._asdict() | {"open": 0.004}]
    verdict, basis = decision_page.words(played, losses, COST_ROWS)
    assert f"In {less} of 1 setting the most probable bin detects target 2 less often than the search" in verdict
    assert f"and in {more} more often;" in verdict
    assert "provably the best for 99.6 % of its decisions" in verdict
    assert re.search(r"\+0\.0100 \[.*\] by who knows the truth", verdict)
    assert basis.startswith("Played: ")
    assert "provably" not in decision_page.words(played, [], COST_ROWS)[0]  # nothing was looked into yet


@pytest.mark.nightly
def test_the_command_from_nothing_to_a_page(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("<!-- decisions -->\n<!-- /decisions -->\n", encoding="utf-8")
    command = ["decisions", "--store", str(tmp_path / "d.db"), "--into", str(page), "smoke"]
    small = ["--runs", "2", "--weak-runs", "2", "--belief-runs", "1", "--dwells", "3"]
    done = CliRunner().invoke(app, [*command, *small])
    assert done.exit_code == 0, done.output
    text = page.read_text(encoding="utf-8")
    assert "of 12 settings the most probable bin" in text
    again = CliRunner().invoke(app, [*command, *small, "--resume"])
    assert again.exit_code == 0, again.output
    assert CliRunner().invoke(app, [*command, "--as-is"]).exit_code == 0
