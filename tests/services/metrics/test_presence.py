"""A run in which targets come and go: what is scored is only those dwells in which a target is there."""

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cogradar.services.analysis.arrays.result import Result as Arrays
from cogradar.services.analysis.drawing.figures import accuracy, power_shares, tracks
from cogradar.services.analysis.export.tables import scores
from cogradar.services.analysis.report import report
from cogradar.services.analysis.results import read_results
from cogradar.services.analysis.stored_run import StoredRun
from cogradar.services.cli.display import run_caption, run_tables
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.experiments import experiments
from cogradar.services.metrics.selection import Selection
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.runs.in_process import play
from cogradar.services.runs.run import Result
from cogradar.services.web.views.course import Course
from cogradar.services.web.views.dwells import Encoded, between
from cogradar.services.web.views.radar import facts
from cogradar.shared.protocol.messages import RunStart, Truth
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.codec import decode

DWELLS, BORN, GONE, LEFT = 20, 6, 11, 4
# The second leaves in dwell 5; the third is there in dwells 6 to 11, the fourth from 8 on, the last never.
TARGETS = f"""world.targets=[
 {{state=[40.0, 0.1, -30.0, 0.05]}},
 {{state=[0.45, -0.1, 20.0, 0.05], rcs_db=-10.0, sigma_s_km_s2=0.0}},
 {{state=[30.0, 0.1, 20.0, 0.05], born_s={BORN}.0, gone_s={GONE}.0, rcs="swerling1"}},
 {{trajectory=[[7.5, 30.0, 0.0], [12.0, 31.0, 1.0], [60.0, 30.0, 5.0]]}},
 {{state=[30.0, 0.1, 20.0, 0.05], born_s=500.0}}]""".replace("\n", "")
THERE = [range(1, DWELLS + 1), range(1, LEFT + 1), range(BORN, GONE + 1), range(8, DWELLS + 1), range(0)]


@pytest.fixture(scope="module")
def played() -> tuple[Store, Result]:
    store = in_memory()
    return store, play(RunStart.of(load("smoke", [TARGETS]), Strategy.POWER_AWARE, 1, DWELLS), store=store)


def rows_of(store: Store, target: int) -> list[dict[str, Any]]:
    return answer(store, "tracks", {"target": str(target)})


def test_truth_says_who_is_there(played: tuple[Store, Result]) -> None:
    store, result = played
    truths = [decode(payload) for payload in store.journal.messages(result.run["run"], ("truth",))]
    seen = {truth.t: truth for truth in truths if isinstance(truth, Truth)}
    for t in range(1, DWELLS + 1):
        assert (seen[t].bins >= 0).tolist() == [t in there for there in THERE]
    assert not seen[DWELLS].states[1].any()
    with pytest.raises(ValueError, match="whose states must be 0"):
        Truth.model_validate({**vars(seen[1]), "bins": np.full(5, -1, np.int32)})


def test_scores_are_of_the_dwells_with_the_target(played: tuple[Store, Result]) -> None:
    store, result = played
    for m, there in enumerate(THERE):
        rows = rows_of(store, m + 1)
        assert len(rows) == DWELLS
        assert [row["t"] for row in rows if row["detected"] is not None] == list(there)
        for row in rows:
            of_truth = [row[name] for name in ("true_bin", "x", "vx", "y", "vy", "snr_db", "hit")]
            assert all(value is not None for value in of_truth) == (row["t"] in there)
            assert any(value is not None for value in of_truth) == (row["t"] in there)
            assert (row["outage"] is not None) == (row["t"] in there and row["track"] is not None)
        (p_d,) = answer(store, "p_d", {"target": str(m + 1)})
        hits = [row["detected"] for row in rows if row["t"] in there]
        assert (p_d["n"], p_d["detections"]) == (len(there), sum(hits))
        assert p_d["p_d"] == (sum(hits) / len(there) if there else None)
    tracked = rows_of(store, 2)
    assert (tracked[-1]["track"], tracked[-1]["x_hat"] is not None) == (2, True)  # its track goes on without it
    assert (result.run["targets"], result.run["tracks"]) == (5, 2)
    assert result.false_tracks == 0
    assert [row["lost"] for row in result.targets] == [False, False, None, None, None]
    assert [row["outage"] is None for row in result.targets] == [False, False, True, True, True]
    assert [row["p_d"] is None for row in result.targets] == [*4 * [False], True]
    squares = [(r["x"] - r["x_hat"]) ** 2 + (r["y"] - r["y_hat"]) ** 2 for r in tracked if r["x"] is not None]
    assert result.targets[1]["position_rmse_km"] == pytest.approx(math.sqrt(sum(squares) / LEFT))


def test_a_summary_takes_one_statement_however_many_targets(
    played: tuple[Store, Result], monkeypatch: pytest.MonkeyPatch
) -> None:
    store, _ = played
    statements, read = list[str](), store.read

    def counted(query: str, parameters: Sequence[Any] = ()) -> list[dict[str, Any]]:
        statements.append(query)
        return read(query, parameters)

    monkeypatch.setattr(store, "read", counted)
    answer(store, "summary", {"target": "1"})
    n = len(statements)
    assert len(answer(store, "summary", {})) == len(THERE)
    assert len(statements) == 2 * n


@pytest.mark.parametrize("dwells", ["1:3", "3:7", "5:9", "17:18"])
def test_any_dwells_can_be_asked_about(dwells: str, played: tuple[Store, Result]) -> None:
    first, last = map(int, dwells.split(":"))
    for row, there in zip(answer(played[0], "summary", {"dwells": dwells}), THERE, strict=True):
        assert row["n"] == len([t for t in there if first <= t <= last])


def test_the_terminal_shows_who_came_later(played: tuple[Store, Result]) -> None:
    _, result = played
    titles = [one.title for one in run_tables(result)]
    assert [("acquired" in title, "not tracked" in title) for title in titles] == [
        *2 * [(True, False)],
        *2 * [(False, True)],
    ]
    assert "Wilson" in run_caption(result)


def test_the_terminal_says_how_long_a_run_without_an_end_was(played: tuple[Store, Result]) -> None:
    ended = replace(played[1], run=played[1].run | {"dwells": None, "rate_hz": 4.0})
    assert f" {DWELLS} dwells in " in run_caption(ended)
    assert f"of {DWELLS} dwells stored" in run_caption(ended)
    assert run_tables(ended)[0].rows[-1]["span"] == f"all {DWELLS}"


def test_arrays_and_tables_leave_out_who_is_not_there(played: tuple[Store, Result]) -> None:
    store, result = played
    arrays = Arrays(StoredRun(lambda metric, asked: answer(store, metric, asked), result.run["run"]))
    there = np.array([[t in there for there in THERE] for t in range(1, DWELLS + 1)])
    assert (arrays.present == there).all()
    assert (np.isnan(arrays.true_states).any(axis=-1) == ~there).all()
    assert ((arrays.true_bins >= 0) == there).all()
    assert np.isnan(arrays.measured.statistic[~there]).all()
    np.testing.assert_array_equal(arrays.p_d, [np.nan if row["p_d"] is None else row["p_d"] for row in result.targets])
    columns = scores(arrays)
    assert (np.isnan(columns["angle_deg"]) == ~there.ravel()).all()
    assert not columns["in_bin"][~there.ravel()].any()


def test_reports_and_figures_are_of_who_is_there(played: tuple[Store, Result]) -> None:
    store, result = played
    (experiment,) = experiments(store, Selection.of({}))
    found = report(store, experiment)
    p_ds = {row["target"]: row["p_d"] for row in found["windows"] if row["last_dwell"] == DWELLS}
    assert p_ds == {row["target"]: pytest.approx(row["p_d"]) for row in result.targets}
    assert [row["lost"] for row in found["lost"]] == [0, 0, None, None, None]
    (overall,) = found["overall"]
    assert (overall["lost"], overall["tracks"], overall["share"]) == (0, 2, 0.0)
    results = read_results(store, experiment)
    for figure in (accuracy(results), tracks(results), power_shares(results)):
        assert len(figure.axes) >= 1
    assert np.isnan(results.floor("power-aware", 1).position_km).all()  # of a target that goes


def test_the_page_is_told_who_is_there(played: tuple[Store, Result]) -> None:
    store, result = played
    known = facts(store, result.run["run"])
    for t, data in between(store, known, Encoded(), 1, DWELLS, DWELLS):
        dwell = json.loads(data)
        assert [one["detected"] is not None for one in dwell["targets"]] == [t in there for there in THERE]
        held = {one["true_bin"] for one in dwell["targets"]}
        assert held.isdisjoint(dwell["false_alarms"])
    for m, there in enumerate(THERE):
        course = Course(known)
        course.extend(store, m + 1, DWELLS)
        p_d = course.at([DWELLS])[0][0]
        assert p_d == pytest.approx(result.targets[m]["p_d"]) if there else math.isnan(p_d or 0.0)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        (
            "world.targets.2.born_s=1.0",
            "radar.tracks = 2: must be the number of world.targets that are there at the start, 1",
        ),
        ("world.targets.3.gone_s=2.0", "is there from 6 s to 2 s, must end after it begins"),
        ("world.targets.4.stays=true", "stays: means nothing with a trajectory"),
        ("world.targets.4.state=[1.0,0.0,1.0,0.0]", "must have state or trajectory, has both"),
        ("world.targets.4.trajectory=[[1.0,2.0,3.0],[1.0,2.0,3.0]]", "row 2: t_s = 1 must be above 1, the time of row"),
        ("world.targets.4.trajectory=nix.csv", "nix.csv: no such file"),
        ("world.targets.3.turns=[{from_s=1.0,to_s=2.0}]", "must have one of g, rate_deg_s, speed_km_s"),
        ("world.targets.3.turns=[{from_s=1.0,to_s=2.0,g=1.0,rate_deg_s=1.0}]", "must have g or rate_deg_s, not both"),
    ],
)
def test_what_makes_no_sense_is_said_in_a_line(setting: str, words: str) -> None:
    with pytest.raises(ValueError, match=r"^[^\n]*$") as caught:
        load("smoke", [TARGETS, setting])
    assert words in str(caught.value)
