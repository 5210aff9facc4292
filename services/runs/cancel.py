"""Cancelling runs on services that are up. Any message may be lost, so it is sent until metrics shows its effect."""

import json
import logging
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from math import inf

from cogradar.services.certs import own
from cogradar.services.errors import BadInput, Interrupted, NoMetrics, RunFailed
from cogradar.services.metrics.client import CONNECT_WITHIN_S
from cogradar.services.metrics.selection import LISTING
from cogradar.shared.protocol.messages import BY_USER, MAX_REASON, RunCancel
from cogradar.shared.protocol.topics import Role
from cogradar.shared.scenario.faults import printable
from cogradar.shared.wire.bus import Bus
from cogradar.shared.wire.queries import NoAnswer, ask
from cogradar.shared.wire.session import Session, open_session
from cogradar.shared.wire.zenoh_bus import ZenohBus

log = logging.getLogger(__name__)

WITHIN_S = 3.0
ANSWER_WITHIN_S = 1.0
POLL_S = 0.1


def cancel_on(endpoint: str, run: str) -> None:
    """Cancel a run on services that are up.

    Raises NoMetrics if no metrics service answers, BadInput if there is no such run, it is over, or the certificate is
    another role's, RunFailed without a confirmation.
    """
    name = own.operator_name(endpoint)
    try:
        session = open_session(endpoint.split(","), CONNECT_WITHIN_S, check=lambda: None)
    except ConnectionError as error:
        raise NoMetrics(f"no metrics service: {error}") from None
    bus = ZenohBus(session, Role.OPERATOR, name, reads=False)
    try:
        check_running(session, run)
        if cancel(session, bus, [run]):
            raise RunFailed(_unconfirmed(session, run))
    except NoAnswer:
        raise NoMetrics(f"no metrics service answers at {endpoint}") from None
    finally:
        bus.close()


def _unconfirmed(session: Session, run: str) -> str:
    try:
        status(session, run)
    except NoAnswer:  # as the processes of `cogradar run`, which end with their run
        return f"{run}: its services have ended since it was to be stopped, or no longer answer"
    return f"no answer within {WITHIN_S:.0f} s says that {run} is stopped: it may go on"


def check_running(session: Session, run: str) -> None:
    """Raises BadInput unless a run goes on."""
    if (found := status(session, run)) == "unknown":
        raise BadInput(f"{run}: no such run; {LISTING}")
    if found != "running":
        raise BadInput(f"{run}: has ended already ({found})")


def cancel(session: Session, bus: Bus, runs: Collection[str], reason: str = BY_USER) -> list[str]:
    """Cancel these runs; returns the runs whose end was not confirmed within some seconds."""
    left, deadline = list(runs), time.monotonic() + WITHIN_S
    while left and time.monotonic() < deadline:
        for run in left:
            bus.publish(RunCancel(run=run, reason=reason))
        try:
            left = [run for run in left if status(session, run, deadline) in {"unknown", "running"}]
        except NoAnswer:
            continue
        time.sleep(POLL_S if left else 0.0)
    return left


def status(session: Session, run: str, deadline: float = inf) -> str:
    """What metrics says of a run, or "unknown"; `deadline` is a reading of time.monotonic(). Raises NoAnswer."""
    rows = json.loads(ask(session, "runs", {"run": run}, min(ANSWER_WITHIN_S, deadline - time.monotonic())))
    return str(rows[0]["status"]) if rows else "unknown"


@contextmanager
def cancelled_unless_over(session: Session, bus: Bus, runs: Callable[[], Collection[str]]) -> Iterator[None]:
    """Whatever ends this block before its runs are over ends them, too; an interrupt's text then says so."""
    try:
        yield
    except Exception as error:
        names, said = runs(), printable(str(error).partition("\n")[0]) or type(error).__name__
        reason = BY_USER if isinstance(error, Interrupted) else f"as it failed: {said}"
        try:
            left = cancel(session, bus, names, reason[:MAX_REASON])
        except Exception:  # what ended the block is what the user must hear of
            log.exception("cancelling failed")
            left = list(names)
        if isinstance(error, Interrupted) and names:
            raise Interrupted(f"{error}; {_outcome(names, left)}") from None
        raise


def _outcome(names: Collection[str], left: Collection[str]) -> str:
    if left:
        are, they = ("is", "it") if len(left) == 1 else ("are", "they")
        return f"no confirmation that {', '.join(left)} {are} stopped: {they} may go on"
    return f"{next(iter(names))} is stopped" if len(names) == 1 else f"its {len(names)} runs are stopped"
