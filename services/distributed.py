"""A whole run over Zenoh: start every process on this machine, play, ask metrics for the result."""

import json
import tempfile
import threading
import time
from collections.abc import Callable, Collection
from functools import partial
from pathlib import Path

from services.answers import Rows
from services.launcher import Faults, Launcher
from services.runs import Ask, Interrupted, Progress, Result, RunFailed, progress, result
from services.topology import TOPOLOGY
from shared.messages import RunStart
from shared.topics import Role
from shared.wire.session import NoAnswer, Session, ask, open_session
from shared.wire.zenoh_bus import ZenohBus

CONNECT_WITHIN_S = 15.0
START_WITHIN_S = 90.0
ANSWER_WITHIN_S = 10.0
POLL_S = 0.25
ASKING_SHARE = 4.0  # a wait is so many times as long as the answer took: to watch a run must not slow it
STALL_S = 60.0  # without a new dwell: the loop hangs
ROLES = tuple(service.role for service in TOPOLOGY if service.core is not None)


def play(
    start: RunStart,
    *,
    planners: int,
    store: str | None,
    report: Callable[[Progress], None],
    say: Callable[[str], None],
    stop: threading.Event,
    chaos: Faults | None = None,
) -> Result:
    """Play one run over Zenoh on this machine: start every process, and end it afterwards; `chaos` kills some of them.

    A process that ends is started again. Raises RunFailed if too many do or the loop hangs, Interrupted if `stop` is
    set meanwhile.
    """
    with (
        tempfile.TemporaryDirectory(prefix="cogradar-") as scratch,
        Launcher(planners, store or str(Path(scratch) / "store.db"), stop, say, chaos) as launcher,
    ):

        def running() -> None:
            launcher.under_fire = True

        return _play(launcher.endpoint, start, launcher.names, launcher.check, report, say, running)


def play_on(
    endpoint: str,
    start: RunStart,
    *,
    report: Callable[[Progress], None],
    say: Callable[[str], None],
    stop: threading.Event,
) -> Result:
    """Play one run on services that are up already, behind the router at `endpoint`.

    Raises RunFailed if a role is missing or the loop hangs, Interrupted if `stop` is set meanwhile.
    """

    has_begun = threading.Event()

    def check() -> None:
        if stop.is_set():
            raise Interrupted(
                f"interrupted; the services go on with {start.run}" if has_begun.is_set() else "interrupted"
            )

    return _play(endpoint, start, (), check, report, say, has_begun.set)


def _play(
    endpoint: str,
    start: RunStart,
    expected: Collection[str],
    check: Callable[[], None],
    report: Callable[[Progress], None],
    say: Callable[[str], None],
    running: Callable[[], None] = lambda: None,
) -> Result:
    session = open_session(endpoint.split(","), within_s=CONNECT_WITHIN_S, check=check)
    bus = ZenohBus(session, Role.OPERATOR, f"operator-{start.run}")
    try:
        wait_until_alive(bus.alive, expected, check, say)
        say(f"running; ask it questions with: cogradar query p_d --connect {endpoint} --run {start.run}")
        began = time.monotonic()
        bus.publish(start)
        running()
        return _watch(partial(_query, session, check), start, began, check, report, partial(bus.publish, start))
    finally:
        bus.close()


def wait_until_alive(
    alive: Callable[[], dict[Role, list[str]]],
    expected: Collection[str],
    check: Callable[[], None],
    say: Callable[[str], None],
) -> None:
    """Wait for every expected process, and for one of each role in any case; name those that are missing."""
    deadline, said = time.monotonic() + START_WITHIN_S, ""
    while True:
        check()
        there = alive()
        names = {name for role_names in there.values() for name in role_names}
        missing = [name for name in expected if name not in names]
        missing += [role for role in ROLES if not there.get(role) and not expected]
        if not missing:
            return
        if time.monotonic() > deadline:
            raise RunFailed(f"not alive within {START_WITHIN_S:.0f} s: {', '.join(missing)}")
        if (text := f"waiting for {', '.join(missing)}") != said:
            say(text)
            said = text
        time.sleep(0.05)


def _query(session: Session, check: Callable[[], None], metric: str, parameters: dict[str, str]) -> Rows:
    rows: Rows = json.loads(ask(session, metric, parameters, ANSWER_WITHIN_S, check))
    return rows


def _watch(
    query: Ask,
    start: RunStart,
    began: float,
    check: Callable[[], None],
    report: Callable[[Progress], None],
    say_again: Callable[[], None],
) -> Result:
    latest, changed = None, began
    while True:
        check()
        asked, now, done = time.monotonic(), None, None
        try:
            now = progress(query, start)
            done = result(query, start, began) if now is not None and now.complete else None
            if now is None:
                say_again()  # metrics does not know the run: it was not there, or the start was lost
        except NoAnswer:
            pass
        took = time.monotonic() - asked
        if now is not None:
            report(now)
        if done is not None:
            return done
        if now is not None and (latest is None or now.k != latest.k):
            latest, changed = now, time.monotonic()
        if time.monotonic() - changed > STALL_S:
            waiting = latest.waiting_for if latest is not None else "metrics to hear of the run"
            raise RunFailed(f"no progress for {STALL_S:.0f} s, waiting for {waiting}")
        time.sleep(max(POLL_S, ASKING_SHARE * took))
