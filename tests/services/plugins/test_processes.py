"""A user's own things in several processes: who has another source takes no part."""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from hashlib import sha256
from pathlib import Path

import pytest

import cogradar
from cogradar.services import kernels
from cogradar.services.allocator.core import AllocatorCore
from cogradar.services.campaigns import campaign as campaigns
from cogradar.services.campaigns import dask_pool
from cogradar.services.campaigns.campaign import Campaign
from cogradar.services.errors import BadInput, RunFailed
from cogradar.services.metrics.store import in_memory
from cogradar.services.planner.core import PlannerCore
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.recorded_run import HINDERED_S
from cogradar.services.runs import cluster, in_process
from cogradar.services.runs.launcher import Launcher, LocalProcesses
from cogradar.services.runs.run import Progress, as_played, strategy_of
from cogradar.shared.protocol.events import Membership, Tick
from cogradar.shared.protocol.messages import Plan, RunStart
from cogradar.shared.protocol.recovery import NoPlans, NoWaveforms
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.plugins import sources
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.wire.codec import decode
from cogradar.shared.wire.runner import TICK_S
from tests.services.campaigns.test_dask_pool import Cluster
from tests.services.loop import checkpoint, play, scans
from tests.services.plugins.own import NOBODY, forget, start_of, with_other_sources


def test_a_planner_with_another_source_says_so_and_the_others_plan(folder: Path, tmp_path: Path) -> None:
    start = start_of(folder)
    said = play(start)
    other = shutil.copytree(folder, tmp_path / "other")
    (other / "rule.py").write_text((folder / "rule.py").read_text() + "\n# changed\n")
    forget()
    sources.allow(str(other))
    (changed,) = PlannerCore("b").handle(checkpoint(start.model_copy(update={"run": "r"}), k=0))
    assert isinstance(changed, NoPlans)
    assert not changed.ends
    for text in (f"{other}/rule.py has source ", " here, the run has "):
        assert text in changed.reason
    forget()
    fit = PlannerCore("a")
    fit.handle(Membership("planner", ("a", "b")))
    sources.allow(str(folder))
    list(fit.handle(checkpoint(start)))
    mine = [plan for scan in scans(said) for plan in fit.handle(scan) if isinstance(plan, Plan)]
    assert len({plan.target for plan in mine}) == 1
    both = [*mine, *(plan for plan in fit.handle(changed) if isinstance(plan, Plan))]
    assert {(plan.target, plan.k) for plan in both} == {(m, scan.k) for m in (0, 1) for scan in scans(said)}


def test_what_a_process_was_not_allowed_it_does_not_load(folder: Path) -> None:
    start = start_of(folder)
    forget()
    (answer,) = PlannerCore("p").handle(checkpoint(start))
    assert isinstance(answer, NoPlans)
    assert "rule.py: not here, or not allowed: this process loads no plug-ins" in answer.reason
    (refused,) = AllocatorCore("a").handle(checkpoint(start))
    assert isinstance(refused, NoWaveforms)
    assert refused.ends  # a run that begins
    (waits,) = AllocatorCore("a").handle(checkpoint(start, k=7, t=3))
    assert isinstance(waits, NoWaveforms)
    assert not waits.ends


def test_the_journal_says_what_a_run_is_hindered_by(folder: Path) -> None:
    start, journal = start_of(folder), Journal(":memory:")
    core = RecorderCore(journal)
    core.handle(start)
    hindered = NoPlans(run="r", process="b", reason="rule.py: not here", ends=False)
    assert not core.handle(hindered)
    core.handle(hindered.model_copy(update={"process": "a"}))
    (row,) = journal.read("SELECT status, reason FROM run")
    assert (row["status"], row["reason"]) == ("running", "a: rule.py: not here; b: rule.py: not here")
    ticks = round(HINDERED_S / TICK_S) + 1
    for i in range(ticks):  # one says so again, the other can do its part by now
        core.handle(Tick(i * TICK_S))
        core.handle(hindered)
    assert journal.read("SELECT reason FROM run") == [{"reason": "b: rule.py: not here"}]
    journal.commit()
    again = RecorderCore(journal, resume=True)
    assert journal.read("SELECT reason FROM run") == [{"reason": ""}]
    again.handle(hindered)
    assert journal.read("SELECT reason FROM run") == [{"reason": "b: rule.py: not here"}]
    core = again
    (ended,) = core.handle(NoWaveforms(run="r", process="x", reason="strategy.py: raised", ends=True))[:1]
    assert ended.model_dump()["ended"]
    (row,) = journal.read("SELECT status, reason FROM run")
    assert (row["status"], row["reason"]) == ("failed", "x: strategy.py: raised")
    journal.close()


@pytest.mark.zenoh
def test_over_zenoh_a_planner_with_another_source_takes_no_part(folder: Path, tmp_path: Path) -> None:
    """Of three planners one has another rule, and the run is that of one process; who has none of it at all says so."""
    kernels.compile_all(lambda _: None)
    other = shutil.copytree(folder, tmp_path / "other")
    (other / "rule.py").write_text((folder / "rule.py").read_text() + "\n# changed\n")
    start = start_of(folder, dwells=1000)  # which takes longer than to be asked for a few times
    expected = in_process.play(start).run["digest"]
    told: list[str] = []

    def kill_one(now: Progress) -> None:
        """Of the two that play; the other one goes on from the snapshots of its tracks."""
        if now.t > 400 and (planner := launcher.processes["planner-0"]) not in killed:
            killed.append(planner)
            launcher.signal("planner-0", signal.SIGKILL)

    killed: list[int] = []
    with Launcher(LocalProcesses(2), threading.Event()) as launcher:
        environment = os.environ | {sources.VARIABLE: str(other)}
        command = [sys.executable, "-m", "cogradar", "service", "planner", "--name", "stranger", "--with-parent"]
        command += ["--connect", launcher.endpoint]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment) as stranger:
            try:
                cluster.wait_until_up(launcher.endpoint, [*launcher.names, "stranger"], launcher.check)
                given = NOBODY | {"notify": told.append}
                done = cluster.play_on(launcher.endpoint, start, **given | {"report": kill_one})
                assert killed
                assert done.run["digest"] == expected
                nobodys = start_of(with_other_sources(shutil.copytree(folder, tmp_path / "third")), run="nobodys")
                with pytest.raises(RunFailed, match=r"(strategy.py:strongest|disturbance.py:BURSTS): .* has source"):
                    cluster.play_on(launcher.endpoint, nobodys, **given)
            finally:
                stranger.terminate()
    assert [text for text in told if text.startswith("hindered: stranger: rule.py:ahead: ")]


def _received(folder: Path) -> tuple[RunStart, str]:
    """A run with a front end of her own, which leaves no room for a disturbance, and its name."""
    own = [f"radar.planner.rule={folder}/rule.py:ahead", f"radar.belief.filter={folder}/belief.py:Bootstrap"]
    front_end = f"{folder}/front_end.py:Receiver"
    return RunStart.of(as_played(load("smoke", own), front_end), strategy_of("power-aware"), 1, 12), front_end


def test_each_scan_names_the_front_end_that_measured_it(folder: Path, tmp_path: Path) -> None:
    start, front_end = _received(folder)
    digests = []
    for text in ("", "\n# changed\n"):
        (folder / "front_end.py").write_text((folder / "front_end.py").read_text() + text)
        store = in_memory()
        digests.append(in_process.play(start, front_end=front_end, store=store).run["digest"])
        rows = store.read("SELECT payload FROM message WHERE topic = 'scan'")
        (name,) = {decode(row["payload"]).model_dump()["front_end"] for row in rows}
        assert name == f"front_end.py:Receiver#{sha256((folder / 'front_end.py').read_bytes()).hexdigest()[:16]}"
        store.journal.copy_to(str(tmp_path / f"{len(digests)}.db"))
    assert digests[0] != digests[1]
    recorded = in_process.play(start, front_end=f"recorded:{tmp_path}/2.db")
    assert recorded.run["digest"] == digests[1]
    simulated = cogradar.run("smoke", dwells=2)
    assert {dwell.front_end for dwell in simulated.dwells()} == {None}


@pytest.mark.zenoh
def test_over_zenoh_a_front_end_of_ones_own_gives_the_same_run(folder: Path) -> None:
    kernels.compile_all(lambda _: None)
    start, front_end = _received(folder)
    expected = in_process.play(start, front_end=front_end).run["digest"]
    with Launcher(LocalProcesses(2, front_end=front_end), threading.Event()) as launcher:
        cluster.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
        assert cluster.play_on(launcher.endpoint, start, **NOBODY).run["digest"] == expected


def test_campaigns_play_them_in_processes_and_replays_need_the_source(folder: Path) -> None:
    def cogradar_(*arguments: str, code: int = 0, **more: str) -> str:
        command = [sys.executable, "-m", "cogradar", *arguments]
        environment = os.environ | {"PYTHONPATH": str(Path.cwd())} | more
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=200, check=False, cwd=folder, env=environment
        )
        assert done.returncode == code, done.stderr
        return done.stdout + done.stderr

    digest = in_process.play(start_of(folder)).run["digest"]
    own = ["--rule", "rule.py:ahead", "--set", "world.disturbance.model=disturbance.py:BURSTS", "--dwells", "12"]
    own += ["--set", "radar.belief.filter=belief.py:Bootstrap"]
    campaign = ("--runs", "2", "--workers", "2", "--strategies", "strategy.py:strongest,uniform")
    cogradar_("campaign", "smoke", *own, *campaign, "--store", "c.db")
    (row,) = [
        row
        for row in json.loads(
            cogradar_("query", "runs", "--store", "c.db", "--json", "--strategy", "strategy.py:strongest")
        )
        if row["seed"] == 1
    ]
    assert row["digest"] == digest
    cogradar_("run", "smoke", "--in-process", *own, "--strategy", "strategy.py:strongest", "--store", "r.db")
    assert "agree bit for bit" in cogradar_(
        "replay", "--store", "r.db", "--to", "planner", COGRADAR_PLUGINS=str(folder)
    )
    refused = cogradar_("replay", "--store", "r.db", "--to", "planner", code=2)
    assert "rule.py: not here, or not allowed" in refused
    with_other_sources(folder)
    refused = cogradar_("replay", "--store", "r.db", "--to", "planner", "--plugins", ".", code=2)
    assert "rule.py:ahead: " in refused
    assert "has source" in refused


@pytest.mark.slow
def test_workers_of_a_dask_cluster_play_them_or_are_named(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    start, stop, nothing = start_of(folder), threading.Event(), lambda *_: None
    digest = in_process.play(start).run["digest"]
    asked = Campaign((Scenario.model_validate(start.scenario),), (start.strategy,), 1, 1, 12)
    workers = Cluster(tmp_path)
    other = with_other_sources(shutil.copytree(folder, tmp_path / "other"))
    try:
        workers.start("scheduler", "--host", "127.0.0.1", "--port", workers.address.rpartition(":")[2])
        monkeypatch.setenv(sources.VARIABLE, str(folder))
        workers.start_worker("--name", "fit")
        workers.wait_for_workers(1)
        store = in_memory()
        with dask_pool.cluster(workers.address, start, notify=nothing, check=nothing) as pool:
            campaigns.play(asked, store, pool, stop=stop)
        assert [row["digest"] for row in store.read("SELECT digest FROM run")] == [digest]
        monkeypatch.setenv(sources.VARIABLE, str(other))
        workers.start_worker("--name", "changed")
        workers.wait_for_workers(2)
        monkeypatch.setenv(sources.VARIABLE, str(folder))
        with (
            pytest.raises(BadInput, match=r"\(changed\): cannot make runs: .*\.py:\w+: .* has source"),
            dask_pool.cluster(workers.address, start, notify=nothing, check=nothing),
        ):
            pass
    finally:
        for process in workers.processes:
            process.kill()
            process.wait()
