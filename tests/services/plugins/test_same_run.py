"""A user's own things, from a folder of hers: the same run everywhere."""

from pathlib import Path
from runpy import run_path
from typing import Any

import numpy as np
import pytest

import cogradar
from cogradar.services.planner.core import PlannerCore
from cogradar.services.planner.owned_track import snapshot_of
from cogradar.services.runs import in_process
from cogradar.services.runs.run import strategy_of
from cogradar.shared.power.rules import Requests
from cogradar.shared.protocol.messages import Plan, RunStart
from cogradar.shared.protocol.recovery import History, Snapshot
from cogradar.shared.scenario.files import ScenarioError, load
from cogradar.shared.scenario.plugins import sources
from cogradar.shared.wire.codec import encode
from tests.services.loop import checkpoint, play, scans
from tests.services.plugins.own import start_of


def test_a_run_names_its_sources_and_no_place(folder: Path) -> None:
    start = start_of(folder)
    said = start.model_dump_json()
    for name in ("rule.py:ahead#", "belief.py:Bootstrap#", "disturbance.py:BURSTS#", "strategy.py:strongest#"):
        assert name in said
    assert str(folder) not in said
    assert RunStart.model_validate_json(said) == start


def test_in_process_by_name_and_as_objects_it_is_the_same_run(folder: Path) -> None:
    digest = in_process.play(start_of(folder)).run["digest"]
    assert digest == in_process.play(start_of(folder), planners=2).run["digest"]
    assert digest != in_process.play(RunStart.of(load("smoke"), strategy_of("uniform"), 1, 12)).run["digest"]
    files = ("rule.py", "belief.py", "strategy.py", "disturbance.py")
    namespace: dict[str, Any] = {}  # as a notebook has them
    for file in files:
        namespace |= run_path(str(folder / file), run_name="__main__")
    result = cogradar.run(
        "smoke",
        strategy=namespace["strongest"],
        dwells=12,
        rule=namespace["ahead"],
        belief=namespace["Bootstrap"],
        disturbance=namespace["BURSTS"],
    )
    assert result.digest == digest
    assert result.strategy.startswith("__main__:strongest#")


def test_an_objective_and_a_file_beside_its_scenario(folder: Path) -> None:
    (folder / "mine.toml").write_text('extends = "smoke"\nradar.allocation.objective = "objective.py:equal_echoes"\n')
    with pytest.raises(ScenarioError, match=r"objective\.py: a scenario file names it, which by itself runs nothing"):
        load(str(folder / "mine.toml"))
    sources.allow(str(folder))
    scenario = load(str(folder / "mine.toml"))
    assert scenario.radar.allocation.objective.startswith("objective.py:equal_echoes#")
    by_file = cogradar.run(scenario, dwells=6)
    assert by_file.digest == cogradar.run("smoke", dwells=6, objective=f"{folder}/objective.py:equal_echoes").digest


def test_what_is_written_into_arguments_is_written_into_copies(folder: Path) -> None:
    """NaN in the particles of a belief would have ended the process: kernels index arrays by them."""
    rule = (
        "from cogradar.plugins import Choice\n\ndef f(problem, radar, rng, has_time=None):\n    %sreturn Choice(3, 0)\n"
    )
    strategy = "from cogradar.plugins import *\n\ndef f(radar, requests):\n    %sreturn Emission(*sent)\n"
    sent = "sent = 0.0, beam_factor(requests.nus[:, 0], [0.5, 0.5], 16), requests.nus[:, :1].copy(), [[0.5], [0.5]]; "
    digests = []
    for writes in (False, True):
        into = "problem.particles[:] = 0.0; " if writes else ""
        also = "requests.nus[:] = 0.25; requests.priorities[:] = 9.0; " if writes else ""
        (folder / "rule.py").write_text(rule % into)
        (folder / "strategy.py").write_text(strategy % (sent + also))
        result = cogradar.run("smoke", dwells=4, rule=f"{folder}/rule.py:f", strategy=f"{folder}/strategy.py:f")
        digests.append((result.estimates.tobytes(), result.detected.tobytes(), result.factors.tobytes()))
        assert Requests.of_single(*[np.ones(2)] * 3).priorities.tolist() == [1.0]
    assert digests[0] == digests[1]


def test_a_snapshot_of_a_belief_of_ones_own_has_all_of_it(folder: Path) -> None:
    """A planner that has nothing but snapshot and scans since says the same; one without the filter is told why."""
    start = start_of(folder, dwells=40)
    said = play(start)
    whole, later = PlannerCore("a"), PlannerCore("b")
    list(whole.handle(checkpoint(start)))
    plans, snapshots = list[Plan](), list[Snapshot]()
    for scan in scans(said):
        plans += [one for one in whole.handle(scan) if isinstance(one, Plan)]
        if scan.k == 20:
            tracks = whole._runs["r"]._tracks
            snapshots = [snapshot_of("r", tracks[m].state) for m in (0, 1)]
    assert {snapshot.belief.shape[1] for snapshot in snapshots} == {4}
    list(later.handle(checkpoint(start, k=21, t=next(scan.t for scan in scans(said) if scan.k == 20))))
    payloads = [encode(one) for one in snapshots]
    said_again = [
        *later.handle(History(run="r", to="b", topic="snapshot", k=20, payloads=payloads)),
        *(one for scan in scans(said) if scan.k > 20 for one in later.handle(scan)),
    ]
    again = [one for one in said_again if isinstance(one, Plan)]
    assert {(one.k, one.target) for one in again} == {(one.k, one.target) for one in plans if one.k > 20}
    assert all(one in plans for one in again)
