"""The rule that knows the truth: in one process only, and no planner is told."""

from functools import partial

import numpy as np
import pytest
from typer.testing import CliRunner

from cogradar.services.analysis.replay import replay
from cogradar.services.analysis.report import report
from cogradar.services.analysis.report_tables import caption, heading
from cogradar.services.analysis.stored_run import StoredRun
from cogradar.services.cli.app import app
from cogradar.services.errors import BadInput
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.experiments import experiments
from cogradar.services.metrics.selection import Selection
from cogradar.services.metrics.store import in_memory
from cogradar.services.planner.core import PlannerCore
from cogradar.services.runs.in_process import play
from cogradar.services.runs.oracle import Foresight
from cogradar.services.sweeps.grid import axis, variants
from cogradar.services.sweeps.results import labelled
from cogradar.services.topology import Start
from cogradar.shared.protocol.messages import Plan, Refused, RunStart
from cogradar.shared.scenario.files import load, parse
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.signal.array import angle_bin, in_plane, spatial_frequency
from tests.scenarios import varied
from tests.services.loop import checkpoint

ORACLE = load("smoke", ["radar.planner.rule=oracle"])


def _start(strategy: Strategy = Strategy.POWER_AWARE, rule: str = "oracle", dwells: int = 30) -> RunStart:
    return RunStart.of(load("smoke", [f"radar.planner.rule={rule}"]), strategy, 1, dwells)


def test_every_look_goes_to_the_true_bin() -> None:
    """Also where tracks, which are numbered by bins, are numbered otherwise than targets."""
    targets = ORACLE.simulated.model_dump()["targets"]
    for scenario in (ORACLE, varied(ORACLE, world={"targets": targets[::-1]})):
        store = in_memory()
        found = play(RunStart.of(scenario, Strategy.POWER_AWARE, 1, 30), store=store)
        assert [row["hit_rate"] for row in found.targets] == [1.0, 1.0]
        rows = answer(store, "tracks", {"run": found.run["run"]})
        assert len({row["true_bin"] for row in rows}) > 2  # they fly


def test_tracks_are_of_the_targets_that_they_are_scored_as() -> None:
    """Two targets of neighbouring bins, two tracks next to the first: one to one, whichever planner is heard first."""
    n_bin = ORACLE.radar.array.n_bin
    targets = [{"state": [60.0, 0.0, 60.0 * np.tan(bin_ * 2.0 / n_bin), 0.0]} for bin_ in (0.1, 1.1)]
    start = RunStart.of(varied(ORACLE, world={"targets": targets}), Strategy.POWER_AWARE, 1, 30)
    plans = [
        Plan(
            run=start.run,
            k=3,
            t=0,
            target=track,
            status="tracking",
            bins=np.array([40], dtype=np.int32),
            chances=np.ones(1),
            best_bin=40,
            estimate=np.array([60.0, 0.0, 60.0 * np.tan(bin_ * 2.0 / n_bin), 0.0]),
        )
        for track, bin_ in enumerate((0.1, 0.5))
    ]
    for order in ((0, 1), (1, 0)):
        foresight = Foresight(start, Start.front_end)
        assert foresight.corrected(plans[order[0]]) == []
        first, second = foresight.corrected(plans[order[1]])
        assert (first.target, second.target) == (0, 1)
        assert second.bins[0] == first.bins[0] + 1
        assert foresight.corrected(plans[1])[0].bins == second.bins


def test_tracks_of_high_targets_are_paired_where_the_array_measures_them() -> None:
    """On the ground both targets are in one direction; the array hears the high one nearer to boresight."""
    states, heights_km = np.array(2 * [[2.0, 0.0, 10.0, 0.0]]), np.array([20.0, 0.0])
    targets = [{"state": state, "height_km": height} for state, height in zip(states.tolist(), heights_km, strict=True)]
    start = RunStart.of(varied(ORACLE, world={"targets": targets}), Strategy.POWER_AWARE, 1, 30)
    measured = in_plane(states, heights_km)
    plans = [
        Plan(
            run=start.run,
            k=3,
            t=0,
            target=track,
            status="tracking",
            bins=np.array([5], dtype=np.int32),
            chances=np.ones(1),
            best_bin=5,
            estimate=states[target],
            covariance=np.eye(4),
            plane_estimate=measured[target],
            plane_covariance=np.eye(4),
        )
        for track, target in enumerate((1, 0))
    ]
    foresight = Foresight(start, Start.front_end)
    assert foresight.corrected(plans[0]) == []
    found = [int(plan.bins[0]) for plan in foresight.corrected(plans[1])]
    expected = angle_bin(spatial_frequency(measured[::-1]), ORACLE.radar.array.n_bin).tolist()
    assert found == expected
    assert found[0] - found[1] > 2


def test_the_digest_does_not_depend_on_the_number_of_planners() -> None:
    digests = {play(_start(), planners=planners).run["digest"] for planners in (1, 2, 5)}
    assert len(digests) == 1
    assert digests != {play(_start(rule="mode")).run["digest"]}


def test_who_tests_every_cell_has_nothing_to_know() -> None:
    orthogonal = [play(_start(Strategy.ORTHOGONAL, rule, 5)).run["digest"] for rule in ("oracle", "mode")]
    assert orthogonal[0] == orthogonal[1]


def test_no_planner_plays_it_by_itself() -> None:
    with pytest.raises(Refused, match="needs the truth, which no planner is told"):
        PlannerCore("p").handle(checkpoint(_start()))


@pytest.mark.parametrize(
    "arguments",
    [
        ["run", "smoke", "--rule", "oracle"],
        ["run", "smoke", "--rule", "oracle", "--connect", "tcp/127.0.0.1:1", "--detach"],
        ["chaos", "smoke", "--set", "radar.planner.rule=oracle"],
        ["service", "operator", "--scenario", "smoke", "--set", "radar.planner.rule=oracle"],
    ],
)
def test_it_is_refused_over_zenoh(arguments: list[str]) -> None:
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 2
    assert "radar.planner.rule = oracle: knows the truth, which no message may tell" in " ".join(done.output.split())


def test_it_needs_a_simulation() -> None:
    start = RunStart.of(ORACLE.model_copy(update={"world": None}), Strategy.POWER_AWARE, 1, 5)
    with pytest.raises(BadInput, match="must be simulated"):
        play(start)


def test_a_planner_alone_is_not_fed_such_a_run() -> None:
    store = in_memory()
    found = play(_start(dwells=3), store=store)
    with pytest.raises(BadInput, match="knows the truth, which a planner alone does not"):
        replay(StoredRun(partial(answer, store), found.run["run"]), "planner")
    assert replay(StoredRun(partial(answer, store), found.run["run"]), "allocator").difference is None


def test_whatever_names_such_runs_says_that_they_know_the_truth() -> None:
    assert ORACLE.title == load("smoke").title + " (knows the truth)"
    assert parse(ORACLE.model_dump(), "again") == ORACLE
    over = [axis("radar.planner.rule=mode,oracle"), axis("dwells=1,2")]
    titles = [variant.scenario.title for variant in variants("smoke", (), over)]
    assert [title.endswith("(knows the truth)") for title in titles] == [False, False, True, True]
    assert labelled(axis("radar.planner.rule=oracle"), "oracle") == "oracle (knows the truth)"
    store = in_memory()
    for rule in ("oracle", "mode"):
        play(_start(rule=rule, dwells=3), store=store)
    said = {one["rule"]: one for one in (report(store, e) for e in experiments(store, Selection.of({"run": "all"})))}
    for words in (heading, caption):
        assert "(knows the truth)" in words(said["oracle"]).splitlines()[0]
        assert "truth" not in words(said["mode"])
