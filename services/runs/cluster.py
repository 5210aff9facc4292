"""A whole run over Zenoh: start every process on this machine, play, ask metrics for the result."""

import json
import threading
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

from cogradar.services.certs import own
from cogradar.services.errors import Failure, Interrupted, RunFailed, check_stop
from cogradar.services.metrics.answers import NO_ROOM, Rows
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.address import is_server, without_password
from cogradar.services.runs.cancel import cancelled_unless_over
from cogradar.services.runs.launcher import Launcher, LocalProcesses
from cogradar.services.runs.run import (
    Ask,
    Progress,
    Result,
    RunInterrupted,
    RunStopped,
    program,
    progress,
    result,
    so_far,
)
from cogradar.services.topology import TOPOLOGY, Start
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.protocol.orders import PAUSED
from cogradar.shared.protocol.topics import Role
from cogradar.shared.wire.queries import Alive, NoAnswer, ask
from cogradar.shared.wire.session import Session, open_session
from cogradar.shared.wire.zenoh_bus import ZenohBus

CONNECT_WITHIN_S = 15.0
START_WITHIN_S = 90.0  # for processes that this command starts, after it has compiled their kernels
ALIVE_WITHIN_S = 30.0  # for services that should be up already, or were started just now by hand
ANSWER_WITHIN_S = 10.0
LAST_ANSWER_S = 2.0  # for the results of a run that the user has interrupted: the prompt must come back soon
METRICS = "metrics to know the run"
QUIET_S = 5.0  # that processes may take to come up before anybody is told
POLL_S = 0.25
ASKING_SHARE = 4.0  # a wait is so many times as long as the answer took: to watch a run must not slow it
LONGEST_WAIT_S = 3.0  # the first answer is slow, while kernels are loaded
STALL_S = 60.0  # without a new dwell: the loop hangs
SILENT_S = 600.0  # without an answer about a run that went on: it may well do so, metrics alone is away or busy
EMULATOR = f"the {Role.EMULATOR}"
ROLES = tuple(service.role for service in TOPOLOGY if service.core is not None)


def play(
    start: RunStart,
    processes: LocalProcesses,
    *,
    report: Callable[[Progress], None],
    notify: Callable[[str], None],
    stop: threading.Event,
    keep: Callable[[Result, str, str | None], None] | None = None,
) -> Result:
    """Play one run over Zenoh on this machine: start every process, and end it afterwards.

    A process that ends is started again. `keep` gets the result, the router's endpoint and the address of HTTP while
    all processes are up, and they stay so until `stop` is set. Raises RunFailed if too many end or the loop hangs,
    Interrupted if `stop` is set before the run is over.
    """
    store = processes.store
    with (
        _tidied(store),
        Launcher(processes, stop, notify) as launcher,
        _connected(launcher.endpoint, launcher.check) as (session, bus),
    ):
        wait_until_alive(bus.alive, launcher.names, launcher.check, notify, START_WITHIN_S)
        launcher.under_fire = True
        # A store that outlives the processes must not hold a run that seems to go on: the next process that opens it
        # would continue it.
        kept = _cancelled_and_told(session, bus, start) if store else nullcontext()
        if launcher.url is not None:
            notify(f"watch it: {launcher.url}/?run={start.run}")
        with kept:
            done = _play(
                launcher.endpoint, session, bus, start, launcher.check, report, notify, front_end=processes.front_end
            )
        if keep is not None:
            keep(done, launcher.endpoint, launcher.url)
            with suppress(Interrupted):
                while True:
                    launcher.check()
                    time.sleep(POLL_S)
        return done


@contextmanager
def _cancelled_and_told(session: Session, bus: ZenohBus, start: RunStart) -> Iterator[None]:
    """Whatever ends this block before its run is over ends the run, too. An interrupt then has what it came to."""
    began = time.monotonic()
    try:
        with cancelled_unless_over(session, bus, lambda: [start.run]):
            yield
    except Interrupted as error:
        until = time.monotonic() + LAST_ANSWER_S  # all of the answers together

        def ask_soon(metric: str, parameters: dict[str, str]) -> Rows:
            return _query(session, lambda: None, metric, parameters, until - time.monotonic())

        with suppress(NoAnswer):
            if (found := so_far(ask_soon, start, began)) is not None:
                raise RunInterrupted(str(error), found) from None
        raise


@contextmanager
def _tidied(store: str | None) -> Iterator[None]:
    """Leave one file: metrics only reads, and if it closes a store last, what SQLite put beside it stays."""
    try:
        yield
    finally:
        if store is not None and not is_server(store) and Path(store).exists():
            with suppress(Failure):  # somebody else has it by now
                Journal(store, owner="cogradar run").close()


def play_on(
    endpoint: str,
    start: RunStart,
    *,
    report: Callable[[Progress], None],
    notify: Callable[[str], None],
    stop: threading.Event,
) -> Result:
    """Play one run on services that are up already, behind the router at `endpoint`.

    Raises RunFailed if a role is missing or the loop hangs, Interrupted if `stop` is set meanwhile; either cancels it.
    """
    check = partial(check_stop, stop)
    with _connected(endpoint, check, notify) as (session, bus):
        wait_until_alive(bus.alive, (), check, notify, ALIVE_WITHIN_S)
        with _cancelled_and_told(session, bus, start):
            return _play(endpoint, session, bus, start, check, report, notify)


def start_on(endpoint: str, start: RunStart, *, notify: Callable[[str], None], stop: threading.Event) -> None:
    """Begin a run on services that are up already, and leave it to them as soon as metrics knows it.

    Raises RunFailed if a role is missing or metrics does not answer, Interrupted if `stop` is set meanwhile.
    """
    check = partial(check_stop, stop)
    with _connected(endpoint, check, notify) as (session, bus):
        wait_until_alive(bus.alive, (), check, notify, ALIVE_WITHIN_S)
        deadline = time.monotonic() + ANSWER_WITHIN_S
        with cancelled_unless_over(session, bus, lambda: [start.run]):
            while time.monotonic() < deadline:
                bus.publish(start)
                with suppress(NoAnswer):
                    if _query(session, check, "runs", {"run": start.run}):
                        return
                time.sleep(POLL_S)
            raise RunFailed(f"metrics did not confirm within {ANSWER_WITHIN_S:.0f} s that {start.run} has begun")


def wait_until_up(endpoint: str, names: Collection[str], check: Callable[[], None]) -> None:
    """Wait for processes that were just started behind the router at `endpoint`."""
    with _connected(endpoint, check) as (_, bus):
        wait_until_alive(bus.alive, names, check, lambda _: None, START_WITHIN_S)


@contextmanager
def _connected(
    endpoint: str, check: Callable[[], None], notify: Callable[[str], None] = lambda _: None
) -> Iterator[tuple[Session, ZenohBus]]:
    """A session and, over it, the bus of a run's operator. Raises BadInput if it has another role's certificate."""
    name = own.operator_name(endpoint)
    session = open_session(endpoint.split(","), within_s=CONNECT_WITHIN_S, check=check, notify=notify)
    bus = ZenohBus(session, Role.OPERATOR, name, reads=False)
    try:
        yield session, bus
    finally:
        bus.close()


def _play(
    endpoint: str,
    session: Session,
    bus: ZenohBus,
    start: RunStart,
    check: Callable[[], None],
    report: Callable[[Progress], None],
    notify: Callable[[str], None],
    front_end: str = Start.front_end,
) -> Result:
    metric = "runs" if start.scenario["world"] is None else "p_d"  # without truth P_D is unknown
    notify(f"running; ask it questions with:\n  {program()} query {metric} --connect {endpoint} --run {start.run}")
    began = time.monotonic()
    bus.publish(start)
    asks, starts = partial(_query, session, check), partial(bus.publish, start)
    return _watch(asks, start, began, check, report, starts, notify, front_end)


def wait_until_alive(
    alive: Callable[[], Alive],
    expected: Collection[str],
    check: Callable[[], None],
    notify: Callable[[str], None],
    within_s: float,
) -> None:
    """Wait for every expected process, and for one of each role in any case; name those that are missing.

    A process of another build is none of the system; it is named beside those that are missing.
    """
    began, notified = time.monotonic(), ""
    while True:
        check()
        there = alive()
        names = {name for role_names in there.names.values() for name in role_names}
        missing = [name for name in expected if name not in names]
        missing += [role for role in ROLES if not there.names.get(role) and not expected]
        if not missing:
            return
        if (waited := time.monotonic() - began) > within_s:
            raise RunFailed("; ".join([f"not alive within {within_s:.0f} s: {', '.join(missing)}", *there.strangers]))
        if (
            waited > QUIET_S
            and (text := "; ".join([f"waiting for {', '.join(missing)}", *there.strangers])) != notified
        ):
            notify(text)
            notified = text
        time.sleep(0.05)


def _query(
    session: Session,
    check: Callable[[], None],
    metric: str,
    parameters: dict[str, str],
    within_s: float = ANSWER_WITHIN_S,
) -> Rows:
    rows: Rows = json.loads(ask(session, metric, parameters, within_s, check))
    return rows


def _watch(
    query: Ask,
    start: RunStart,
    began: float,
    check: Callable[[], None],
    report: Callable[[Progress], None],
    resend_start: Callable[[], None],
    notify: Callable[[str], None],
    front_end: str,
) -> Result:
    latest, before, changed, told = None, None, began, _Told(notify, front_end)
    while True:
        check()
        asked, now, done = time.monotonic(), None, None
        try:
            now = _progress(query, start, began, before)
            done = result(query, start, began) if now is not None and now.complete else None
            if now is None:
                resend_start()  # metrics does not know the run: it was not there, or the start was lost
        except NoAnswer:
            pass
        took = time.monotonic() - asked
        if now is not None:
            now = before = told.of(now, time.monotonic() - changed)
            report(now)
        if done is not None:
            return done
        if now is not None and (
            latest is None or now.k != latest.k or now.waiting_for == NO_ROOM or now.complete  # only its scores lack
        ):
            latest, changed = now, time.monotonic()
        quiet_s = time.monotonic() - changed
        if quiet_s > (SILENT_S if now is None and latest is not None else STALL_S):
            waiting = latest.waiting_for if now is not None and latest is not None else METRICS
            raise RunFailed(f"no progress for {quiet_s:.0f} s, waiting for {waiting}")
        told.silence(quiet_s if now is None and latest is not None else 0.0)
        until = time.monotonic() + max(POLL_S, min(ASKING_SHARE * took, LONGEST_WAIT_S))
        while (left := until - time.monotonic()) > 0.0:  # a process that ends meanwhile is started again at once
            check()
            time.sleep(min(POLL_S, left))


def _progress(query: Ask, start: RunStart, began: float, before: Progress | None) -> Progress | None:
    """Progress of a run. Raises RunStopped with what it came to, RunFailed."""
    try:
        return progress(query, start, before)
    except RunStopped as stopped:
        with suppress(NoAnswer):
            stopped.result = so_far(query, start, began)
        raise


class _Told:
    """What the user was told of a run that does not go on as it should."""

    def __init__(self, notify: Callable[[str], None], front_end: str) -> None:
        self._notify, self._front_end = notify, without_password(front_end)[0]
        self._hindered = self._silent = ""
        self._is_blind = False

    def silence(self, quiet_s: float) -> None:
        """Tell once that metrics has not answered for so long; 0: it answers."""
        if quiet_s > QUIET_S and not self._is_blind:
            self._notify("metrics does not answer: how far the run is will be seen once it does")
        self._is_blind = quiet_s > QUIET_S or (self._is_blind and quiet_s > 0.0)

    def of(self, now: Progress, quiet_s: float) -> Progress:
        """Tell what is new after so long without a dwell; the progress, which names the receiver that is waited for."""
        if now.hindered not in {"", self._hindered}:
            self._hindered = now.hindered
            self._notify(f"hindered: {now.hindered}")
        is_elsewhere = not now.waiting_for.startswith(EMULATOR) or PAUSED in now.waiting_for
        if self._front_end == Start.front_end or is_elsewhere:
            return now
        now = replace(now, waiting_for=f"front end {self._front_end}, for {now.waiting_for}")
        if quiet_s > QUIET_S and self._silent != now.waiting_for:
            from cogradar.services.front_ends import cure_of_silence

            self._silent = now.waiting_for
            self._notify(f"waiting for {now.waiting_for}, or the recorder{cure_of_silence(self._front_end)}")
        return now
