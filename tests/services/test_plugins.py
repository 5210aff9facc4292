"""A user's own things, from a folder of hers: the same run everywhere; who has another source takes no part."""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
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
from cogradar.services.planner.owned_track import snapshot_of
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.recorded_run import HINDERED_S
from cogradar.services.runs import cluster, in_process
from cogradar.services.runs.launcher import Launcher, LocalProcesses
from cogradar.services.runs.run import Progress, as_played, strategy_of
from cogradar.shared.power.rules import Requests
from cogradar.shared.protocol.events import Membership, Tick
from cogradar.shared.protocol.messages import Plan, RunStart
from cogradar.shared.protocol.recovery import History, NoPlans, NoWaveforms, Snapshot
from cogradar.shared.scenario.files import ScenarioError, load
from cogradar.shared.scenario.plugins import resolver, sources
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.wire.codec import decode, encode
from cogradar.shared.wire.runner import TICK_S
from tests.services.campaigns.test_dask_pool import Cluster
from tests.services.loop import checkpoint, play, scans

TEMPLATES = Path("deploy/plugins").resolve()
NOBODY: dict[str, Any] = {"report": lambda _: None, "notify": lambda _: None, "stop": threading.Event()}


@pytest.fixture(autouse=True)
def _allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a test allows this process to load is forgotten after it."""
    monkeypatch.setattr(sources, "_allowed", sources._Allowed())
    monkeypatch.setattr(resolver, "_found", {})
    monkeypatch.delenv(sources.VARIABLE, raising=False)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with one thing of each kind."""
    return shutil.copytree(TEMPLATES, tmp_path / "own", ignore=shutil.ignore_patterns("__pycache__"))


def _forget() -> None:
    """Be a process that was told nothing."""
    sources._allowed.places.clear()
    resolver._found.clear()


def _start(folder: Path, *settings: str, dwells: int = 12, run: str = "r") -> RunStart:
    """A run with all of them."""
    own = [
        f"radar.planner.rule={folder}/rule.py:ahead",
        f"radar.belief.filter={folder}/belief.py:Bootstrap",
        f"world.disturbance.model={folder}/disturbance.py:BURSTS",
        *settings,
    ]
    strategy = strategy_of(f"{folder}/strategy.py:strongest")
    return RunStart.of(load("smoke", own), strategy, 1, dwells).model_copy(update={"run": run})


def _failing(folder: Path, file: str, name: str, body: str) -> str:
    """A file with a function that does something else."""
    (folder / file).write_text(f"def {name}(*_):\n    {body}\n", encoding="utf-8")
    return f"{folder / file}:{name}"


def test_a_run_names_its_sources_and_no_place(folder: Path) -> None:
    start = _start(folder)
    said = start.model_dump_json()
    for name in ("rule.py:ahead#", "belief.py:Bootstrap#", "disturbance.py:BURSTS#", "strategy.py:strongest#"):
        assert name in said
    assert str(folder) not in said
    assert RunStart.model_validate_json(said) == start


def test_in_process_by_name_and_as_objects_it_is_the_same_run(folder: Path) -> None:
    digest = in_process.play(_start(folder)).run["digest"]
    assert digest == in_process.play(_start(folder), planners=2).run["digest"]
    assert digest != in_process.play(RunStart.of(load("smoke"), strategy_of("uniform"), 1, 12)).run["digest"]
    files = ("rule.py", "belief.py", "strategy.py", "disturbance.py")
    namespace: dict[str, Any] = {}  # as a notebook has them
    exec("\n".join((folder / file).read_text() for file in files), namespace)  # noqa: S102 - they are ours
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


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("return 1 / 0", "bad.py, line 2: ZeroDivisionError: division by zero"),
        ("return 3", "bad.py:f returned 3: must be a Choice of a bin and a number of simulations"),
        ("return 16, 0", "bad.py:f returned bin 16: must be a whole number from 0 to 15"),
        ("return 2.0, 0", "bad.py:f returned bin 2.0: must be a whole number from 0 to 15"),
        ("return 2, -1", "bad.py:f returned n_sim -1: must be a whole number from 0 to 2147483647"),
    ],
)
def test_a_rule_that_fails_fails_its_run(folder: Path, body: str, said: str) -> None:
    scenario = load("smoke", [f"radar.planner.rule={_failing(folder, 'bad.py', 'f', body)}"])
    with pytest.raises(RunFailed, match=r"planner-0: bad\.py:f") as failure:
        in_process.play(RunStart.of(scenario, strategy_of("power-aware"), 1, 4))
    assert said in str(failure.value)


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("raise KeyError('x')", "bad.py, line 2: KeyError: 'x'"),
        ("return None", "bad.py:f returned None: must be an Emission"),
        ("return E(1.0, Z((15, 1)), Z((2, 1)), Z((2, 1)))", "a factor of shape (15, 1): must be (16, r)"),
        ("return E(1.0, Z((16, 0)), Z((3, 1)), Z((3, 1)))", "nus of shape (3, 1): must be (2, L), a row of each track"),
        ("return E(1.0, Z((16, 0)), Z((2, 1)), Z((2, 2)))", "shares of shape (2, 2): must be (2, 1), as nus"),
        ("return E(float('nan'), Z((16, 0)), Z((2, 1)), Z((2, 1)))", "that are not finite"),
        ("return E(1.0, Z((16, 0)), Z((2, 1)) + 0.6, Z((2, 1)))", "nus beyond -0.5 .. 0.5"),
        ("return E(1.0, Z((16, 0)), Z((2, 1)), Z((2, 1)) - 1.0)", "an isotropic power or shares below 0"),
        ("return E(1.0, Z((16, 0)), Z((2, 1)), Z((2, 1)), 'good')", "status 'good': must be one of fixed"),
        ("return E(1.5, Z((16, 0)), Z((2, 1)), Z((2, 1)))", "a power of 1.5: must be at most 1"),
        (
            "return E(1.0, Z((16, 0)), Z((2, 2)), Z((2, 2)))",
            "no waveform can be: the cells of a track must all be differ",
        ),
        (
            "return E(1.0, Z((16, 0)), Z((2, 1)) + float('nan'), Z((2, 1)))",
            "no waveform can be: some beams must be >= 0",
        ),
        ("return E('much', Z((16, 0)), Z((2, 1)), Z((2, 1)))", "an Emission that is none"),
    ],
)
def test_a_strategy_that_fails_fails_its_run(folder: Path, body: str, said: str) -> None:
    body = f"from numpy import zeros as Z; from cogradar.plugins import Emission as E\n    {body}"
    strategy = strategy_of(_failing(folder, "bad.py", "f", body))
    with pytest.raises(RunFailed, match=r"allocator-0: bad\.py:f") as failure:
        in_process.play(RunStart.of(load("smoke"), strategy, 1, 4))
    assert said.replace("line 2", "line 3") in str(failure.value)


@pytest.mark.parametrize(
    ("method", "body", "said"),
    [
        ("begin", "return 1 / 0", "bad.py, line 8: ZeroDivisionError"),
        ("begin", "return states[0]", "bad.py:B returned float64 of shape (4,) of begin: must be (n, m) numbers"),
        ("begin", "return np.zeros((1, 200_001))", "at most 200000 numbers, 50000 on an axis"),
        ("predict", "return [[1.0], [1.0, 2.0]]", "bad.py:B returned no array of predict: "),
        ("update", "return belief, 1j", "returned evidence 1j of update: must be a finite number from 0"),
        ("predict", "return belief + float('nan')", "numbers of predict that are not finite, or beyond 1e+09"),
        ("predict", "return 2e9 * belief", "numbers of predict that are not finite, or beyond 1e+09"),
        ("update", "return belief", "returned ndarray of update: must be (belief, evidence)"),
        ("update", "return belief, -1.0", "returned evidence -1.0 of update: must be a finite number from 0"),
        ("update", "return belief, seen.likelihood(belief[:, :2]).sum()", "likelihood of states of shape"),
        ("states", "return belief[:3]", "states of shape (3, 4), x from"),
        ("states", "return -belief", "must be (n, 4), n from 5 to 50000, x from 0"),
    ],
)
def test_a_belief_that_fails_fails_its_run(folder: Path, method: str, body: str, said: str) -> None:
    head = (
        "import importlib.util as u, numpy as np\ns = u.spec_from_file_location('t', {!r})\nm = u.module_from_spec(s)\n"
    )
    arguments = {
        "begin": "radar, states, rng",
        "predict": "radar, belief, rng",
        "update": "radar, belief, seen, rng",
        "states": "radar, belief",
    }[method]
    text = f"s.loader.exec_module(m)\n\nclass B(m.Bootstrap):\n    def {method}(self, {arguments}):\n        {body}\n"
    (folder / "bad.py").write_text(head.format(f"{folder}/belief.py") + text)
    scenario = load("smoke", [f"radar.belief.filter={folder}/bad.py:B"])
    with pytest.raises(RunFailed, match=r"planner-0: bad\.py:B") as failure:
        in_process.play(RunStart.of(scenario, strategy_of("uniform"), 1, 4))
    assert said in str(failure.value)


def test_a_snapshot_of_a_belief_of_ones_own_has_all_of_it(folder: Path) -> None:
    """A planner that has nothing but snapshot and scans since says the same; one without the filter is told why."""
    start = _start(folder, dwells=40)
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


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("return 1 / 0", "line 3: ZeroDivisionError"),
        ("return [0.0] * (n - 1)", "drew float64 of shape (255,): must be (256,) complex numbers, all finite"),
        ("return [float('inf')] * n", "drew float64 of shape (256,)"),
        ("return ['a'] * n", "drew <U1 of shape (256,)"),
    ],
)
def test_a_disturbance_that_fails_fails_its_run(folder: Path, body: str, said: str) -> None:
    text = (
        f"class D:\n    def draw(self, n, rng):\n        {body}\n    def power_spectrum(self, nu):\n        return nu\n"
    )
    (folder / "bad.py").write_text(text)
    scenario = load("smoke", [f"world.disturbance.model={folder}/bad.py:D"])
    with pytest.raises(RunFailed, match=r"front end: world.disturbance.model: bad.py:D") as failure:
        in_process.play(RunStart.of(scenario, strategy_of("uniform"), 1, 4))
    assert said in str(failure.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("raise OSError('no device')", "cannot be imported: {file}, line 1: OSError: no device"),
        ("f =", "cannot be imported: {file}, line 1: SyntaxError"),
        ("import sys; sys.exit(3)", "cannot be imported: {file}, line 1: SystemExit: 3"),
        ("import no_such_module", "ModuleNotFoundError: No module named 'no_such_module'"),
        ("g = 1", "there is no f in {file}"),
        ("f = 1", "must be a function (problem, radar, rng, has_time) -> Choice"),
    ],
)
def test_what_cannot_be_loaded_is_said_before_a_run(tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "bad.py"
    file.write_text(text)
    scenario = load("smoke", [f"radar.planner.rule={file}:f"])
    with pytest.raises(BadInput) as failure:
        in_process.play(RunStart.of(scenario, strategy_of("uniform"), 1, 4))
    assert said.format(file=file) in str(failure.value)


def test_a_planner_with_another_source_says_so_and_the_others_plan(folder: Path, tmp_path: Path) -> None:
    start = _start(folder)
    said = play(start)
    other = shutil.copytree(folder, tmp_path / "other")
    (other / "rule.py").write_text((folder / "rule.py").read_text() + "\n# changed\n")
    _forget()
    sources.allow(str(other))
    (changed,) = PlannerCore("b").handle(checkpoint(start.model_copy(update={"run": "r"}), k=0))
    assert isinstance(changed, NoPlans)
    assert not changed.ends
    for text in (f"{other}/rule.py has source ", " here, the run has "):
        assert text in changed.reason
    _forget()
    fit = PlannerCore("a")
    fit.handle(Membership("planner", ("a", "b")))
    sources.allow(str(folder))
    list(fit.handle(checkpoint(start)))
    mine = [plan for scan in scans(said) for plan in fit.handle(scan) if isinstance(plan, Plan)]
    assert len({plan.target for plan in mine}) == 1
    both = [*mine, *(plan for plan in fit.handle(changed) if isinstance(plan, Plan))]
    assert {(plan.target, plan.k) for plan in both} == {(m, scan.k) for m in (0, 1) for scan in scans(said)}


def test_what_a_process_was_not_allowed_it_does_not_load(folder: Path) -> None:
    start = _start(folder)
    _forget()
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
    start, journal = _start(folder), Journal(":memory:")
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
    start = _start(folder, dwells=1000)  # which takes longer than to be asked for a few times
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
                nobodys = _start(_changed(shutil.copytree(folder, tmp_path / "third")), run="nobodys")
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


def _changed(folder: Path) -> Path:
    """The same folder, with other sources."""
    for file in folder.glob("*.py"):
        file.write_text(file.read_text() + "\n# changed later\n")
    return folder


def test_campaigns_play_them_in_processes_and_replays_need_the_source(folder: Path) -> None:
    def cogradar_(*arguments: str, code: int = 0, **more: str) -> str:
        command = [sys.executable, "-m", "cogradar", *arguments]
        environment = os.environ | {"PYTHONPATH": str(Path.cwd())} | more
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=200, check=False, cwd=folder, env=environment
        )
        assert done.returncode == code, done.stderr
        return done.stdout + done.stderr

    digest = in_process.play(_start(folder)).run["digest"]
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
    _changed(folder)
    refused = cogradar_("replay", "--store", "r.db", "--to", "planner", "--plugins", ".", code=2)
    assert "rule.py:ahead: " in refused
    assert "has source" in refused


@pytest.mark.slow
def test_workers_of_a_dask_cluster_play_them_or_are_named(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    start, stop, nothing = _start(folder), threading.Event(), lambda *_: None
    digest = in_process.play(start).run["digest"]
    asked = Campaign((Scenario.model_validate(start.scenario),), (start.strategy,), 1, 1, 12)
    workers = Cluster(tmp_path)
    other = _changed(shutil.copytree(folder, tmp_path / "other"))
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
