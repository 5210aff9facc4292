"""A run that stands still ends with what it waits for, and with the planners that are there to bring it."""

import json
import re
import signal
import threading
import time
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from cogradar.services import kernels
from cogradar.services.recorder.full_disk import Recorder
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.recorded_run import HINDERED_S, OVERDUE_S, UNPLANNED
from cogradar.services.runs import cluster, in_process
from cogradar.services.runs.launcher import Launcher, LocalProcesses
from cogradar.shared.protocol.build import build
from cogradar.shared.protocol.events import Membership, Tick
from cogradar.shared.protocol.messages import Plan
from cogradar.shared.protocol.recovery import NoPlans
from cogradar.shared.protocol.topics import ALIVE, PROTOCOL, Role
from cogradar.shared.wire.queries import NoAnswer, ask
from cogradar.shared.wire.runner import TICK_S
from cogradar.shared.wire.session import Session, open_session
from cogradar.shared.wire.zenoh_bus import ZenohBus
from tests.services.loop import play, scans, smoke_start

SENDER = cast("Any", SimpleNamespace(publish=lambda *_: None))
OVERDUE_TICKS = round(OVERDUE_S / TICK_S)


def _nothing(*_: object) -> None:
    """Nobody stops it, reads it or is told."""


@pytest.mark.zenoh
def test_a_run_says_which_planner_it_waits_for(tmp_path: Path) -> None:
    """The only one is frozen, and the router still shows its token. It was not named, as no other planner was there to
    say so.
    """
    start = smoke_start(dwells=400, run="waits")
    kernels.compile_all(lambda _: None)
    with Launcher(LocalProcesses(1, str(tmp_path / "runs.db")), threading.Event()) as launcher:
        cluster.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
        session = open_session([launcher.endpoint], 10.0, lambda: None)
        with closing(ZenohBus(session, Role.OPERATOR, "test")) as bus:
            bus.publish(start)
            _until(session, lambda row: row["k"] > 16)
            key = ALIVE.format(protocol=PROTOCOL, build=build(), role=Role.PLANNER, name="planner-0")
            token = session.liveliness().declare_token(key)
            launcher.signal("planner-0", signal.SIGSTOP)
            row = _until(session, lambda row: "planners present: planner-0" in row["waiting_for"])
            late = "no plans of track (1|2|1, 2); planners present: planner-0"  # it may have planned one of them
            assert re.match(late, row["reason"])
            assert re.search(f"waits: {late}", launcher._tail("recorder-0"))
            launcher.signal("planner-0", signal.SIGCONT)
            row = _until(session, lambda row: row["status"] != "running")
            token.undeclare()
    assert (row["status"], row["reason"], row["digest"]) == ("complete", "", in_process.play(start).run["digest"])


def _until(session: Session, is_so: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
    until_s = time.monotonic() + 120.0
    while time.monotonic() < until_s:
        with suppress(NoAnswer):
            for row in json.loads(ask(session, "runs", {"run": "waits"}, 5.0)):
                if is_so(row | {"k": row["k"] or 0}):
                    return dict(row)
        time.sleep(0.25)
    raise AssertionError(row)


@pytest.mark.parametrize(("n", "said"), [(0, "none"), (2, "p0, p1"), (200, "p0, p1, p2, p3, p4 and 195 more")])
def test_it_names_the_planners(n: int, said: str, tmp_path: Path) -> None:
    sent = play(smoke_start(dwells=4))
    with closing(Journal(str(tmp_path / "runs.db"), owner="recorder")) as journal:
        core = Recorder(journal)
        core.handle(Membership(Role.PLANNER, tuple(f"p{i}" for i in range(n))))
        for message in (sent[0], scans(sent)[0]):
            core.handle(message)
        for tick in range(2 * OVERDUE_TICKS):
            core.handle(Tick(tick / 4, drained=True))
        assert journal.rows("SELECT reason FROM run")[0][0] == ""  # before its first plan a planner may be loading
        for tick in range((UNPLANNED - 2) * OVERDUE_TICKS + 2):
            core.handle(Tick(tick / 4, drained=True))
        ((reason,),) = journal.rows("SELECT reason FROM run")
        assert reason == f"no plans of track 1, 2; planners present: {said}"
        for tick in range(200):
            core.handle(Tick(tick / 4, drained=True))
        assert journal.rows("SELECT reason FROM run")[0][0] == reason
        late = NoPlans.of(sent[0].run, "p1", "p0: no plans; others take their tracks", ends=False)
        core.handle(late.model_copy(update={"late": True}))
        assert journal.rows("SELECT reason FROM run")[0][0] == late.reason
        for message in sent:
            if isinstance(message, Plan) and message.k == 0:
                core.handle(message)
        for tick in range(round(2 * HINDERED_S / TICK_S)):
            core.handle(Tick(tick / 4, drained=True))
        assert journal.rows("SELECT reason FROM run")[0][0] == ""  # it waits for the waveform


def test_a_run_that_went_on_is_left_alone_while_metrics_is_away(monkeypatch: pytest.MonkeyPatch) -> None:
    """A command that watched a run cancelled it when metrics was away for a minute."""
    row = {"status": "running", "waiting_for": "", "confirmed": None, "reason": "", "fault": None, "t": 1}
    answers: list[list[dict[str, Any]]] = [[row | {"k": 1}], [], *([[]] * 12), [row | {"k": 2}], [row | {"k": 2}]]
    told, asked = list[str](), iter(answers)

    def query(_: object, __: object, metric: str, ___: object) -> list[dict[str, Any]]:
        if metric == "runs" and (rows := next(asked)):
            return rows
        raise NoAnswer

    clock = iter(range(0, 10_000, 2))
    monkeypatch.setattr(cluster, "_query", query)
    monkeypatch.setattr(cluster, "time", SimpleNamespace(monotonic=lambda: float(next(clock)), sleep=_nothing))
    with pytest.raises(StopIteration):
        cluster._play("tcp/x:1", cast("Any", None), SENDER, smoke_start(), _nothing, _nothing, told.append)
    assert [text for text in told if "metrics" in text] == [
        "metrics does not answer: how far the run is will be seen once it does"
    ]
