"""Being one process of the system: connect, say that it is alive, serve until told to stop."""

import atexit
import gc
import logging
import os
import sys
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from copy import copy
from dataclasses import replace
from functools import partial
from typing import Any, NoReturn, Protocol, runtime_checkable

from cogradar.services.certs.own import process_name
from cogradar.services.certs.validity import Validity
from cogradar.services.errors import BadInput, Deposed, Interrupted, InUse, NoStoreYet, StoreFailed, Unheard, check_stop
from cogradar.services.health import Heartbeat, Troubled
from cogradar.services.recorder.store.address import unsaid
from cogradar.services.topology import SERVICES, Service, Start
from cogradar.shared.protocol.build import build, difference
from cogradar.shared.protocol.topics import Role, topics_read_by
from cogradar.shared.scenario.faults import printable, printable_lines
from cogradar.shared.wire.meter import Measured, Measures
from cogradar.shared.wire.pool.members import Pool
from cogradar.shared.wire.pool.tokens import ZenohTokens
from cogradar.shared.wire.queries import Claim, alive, names_alive
from cogradar.shared.wire.runner import Answering, Closing, Core, Leading, Sharing, serve
from cogradar.shared.wire.session import BadConfig, Link, Session, open_session, run_router
from cogradar.shared.wire.zenoh_bus import ZenohBus

HOLDER_WITHIN_S = 5.0  # for the token of a process that was killed to be gone; a lease is two seconds
HOLDER_POLL_S = 0.1
SETTLE_S = 0.1  # until a claim that is shown at another router is seen, too
NICENESS = 5  # of a process that the others need not wait for
log = logging.getLogger(__name__)


class _Printable(logging.Formatter):
    """What others sent and a line of the log quotes holds no control characters, and begins no line of its own."""

    def format(self, record: logging.LogRecord) -> str:
        """The line of a record, and below it where an error came from."""
        said = copy(record)
        said.msg, said.args = printable(unsaid(record.getMessage())), None
        return printable_lines(super().format(said))


@runtime_checkable
class Gathering(Protocol):
    """A core that shows what all processes count, in threads of its own."""

    gather: Callable[[], Any] | None


@runtime_checkable
class Beginning(Protocol):
    """A core that begins runs, for which a recorder must be there."""

    has_recorder: Callable[[], bool]


def be(role: Role, start: Start, *, connect: str, listen: str, stop: threading.Event, allow: str | None = None) -> None:
    """Serve as `role` until `stop` is set; as a router for the certificates that the file `allow` lists, or for all.

    Raises BadInput; so it does if the certificate is another role's.
    """
    where, side = (listen, "listen") if role is Role.ROUTER else (connect, "connect")
    start = replace(start, name=process_name(role, start.name, where), connect=connect)
    validity = Validity.at(where, side)
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_Printable(f"%(asctime)s {start.name} %(levelname)s %(message)s"))
    logging.basicConfig(level=logging.INFO, handlers=[handler])
    if role is Role.ROUTER:
        from cogradar.services.certs import access, names
        from cogradar.shared.wire.exposition import Exposition

        rules = None if allow is None else access.access_control(names.allowed(allow))
        try:
            run_router(listen, stop, Exposition(validity.measures).text, rules, beat=_both(Heartbeat(), validity.tell))
        except BadConfig as error:
            raise BadInput(str(error)) from None
    else:
        _serve(SERVICES[role], start, connect, stop, validity)


def _serve(service: Service, start: Start, connect: str, stop: threading.Event, validity: Validity) -> None:
    if service.core is None:
        raise ValueError(f"{service.role} has no core")
    check = partial(check_stop, stop)
    with ExitStack() as closing, suppress(Interrupted):
        if service.kernels:
            from cogradar.services.kernels import compile_all, load_planner, say_late

            compile_all(log.info, stop)
            if service.role is Role.PLANNER:
                load_planner()
        if service.yields and hasattr(os, "nice"):
            os.nice(NICENESS)  # and so for the threads that its core and the session will start
        core = _made(service.core, replace(start, check=check))
        if isinstance(core, Closing):
            closing.callback(core.close)
        gc.collect()
        gc.freeze()  # libraries and compiled code live as long as the process: no dwell waits while they are searched,
        # ... nor now, when others see this process and leave a part to it
        session = open_session(connect.split(","), None, check=check)
        closing.callback(session.close)
        epoch = core.epoch if isinstance(core, Leading) else 0
        claim = _check_others(service, start, session, check, epoch)  # shown until the session is closed
        pool = _joined(service.role, start, core, session, check) if isinstance(core, Sharing) else None
        bus = ZenohBus(session, service.role, start.name, pool=pool)
        closing.callback(_close, bus)
        if isinstance(core, Answering):
            bus.serve_queries(core.answer)
        bus.serve_timestamps(service.role, start.name)
        if isinstance(core, Gathering):
            from cogradar.services.metrics.processes import gather

            core.gather = partial(gather, session)
        if isinstance(core, Beginning):
            core.has_recorder = lambda: bool(names_alive(session, "*", Role.RECORDER))  # an operator is heard by all
        bus.serve_exposition(service.role, start.name, _exposition(service.role, core, bus, validity))
        gc.freeze()  # what was loaded since, too
        log.info("connected to %s", connect)
        heartbeat = _both(
            _heard(Link(session, service.role, start.name), start.name), Heartbeat(bus.is_connected, core)
        )
        if service.kernels:
            closing.enter_context(say_late())
        if isinstance(core, Leading):
            bus.publish(*core.lead())
        serve(core, bus, stop, bus.meter, _beat(_both(heartbeat, validity.tell), service.role, claim))
        if isinstance(core, Troubled) and core.trouble:
            raise StoreFailed(core.trouble)


def _made(make: Callable[[Start], Core], start: Start) -> Core:
    """The core of a process; of a recorder whose journal another one has, when it is free. Raises BadInput."""
    beat, told, is_lost = Heartbeat(core=_StandsBy()), "", None
    while True:
        if is_lost is not None and is_lost():  # its recorder holds all runs until the file is back
            why = f"{start.store} was removed; this one stands by until it is there again"
        else:
            try:
                return make(start)
            except InUse as error:
                if not start.stands_by:
                    raise
                is_lost = is_lost or _watched(start.store)
                why = f"{error}; this one stands by, and takes over when it is gone"
            except NoStoreYet as error:
                if not told:
                    raise
                why = f"{error}; this one stands by until it answers again"
        if why != told:
            log.warning("%s", why)
        told = why
        beat()
        start.check()
        time.sleep(HOLDER_POLL_S)


def _watched(store: str) -> Callable[[], bool]:
    from cogradar.services.recorder.store.followed import Followed

    return Followed(store).is_lost


class _StandsBy:
    """What a process that only waits says of itself."""

    trouble = "stands by: another recorder has the journal"


def _both(first: Callable[[], None], second: Callable[[], None]) -> Callable[[], None]:
    def both() -> None:
        first()
        second()

    return both


def _heard(link: Link, name: str) -> Callable[[], None]:
    """Raises Unheard if the router does not hear this process any more."""

    def check() -> None:
        if link.is_broken():
            raise Unheard(f"the router does not see {name} any more, though the link to it is up: {name} ends")

    return check


def _beat(heartbeat: Callable[[], None], role: Role, claim: Claim | None) -> Callable[[], None]:
    """The heartbeat of a process, which raises Deposed if another one has its role."""
    if claim is None:
        return heartbeat
    claim.watch()

    def beat() -> None:
        heartbeat()
        if name := claim.successor():
            raise Deposed(
                f"{name} is {role} now, in another process: this one was frozen or cut off while the other one took"
                " over, and ends"
            )

    return beat


def _close(bus: ZenohBus) -> None:
    bus.close()
    for key, n in bus.inbox.bad.most_common():
        log.warning("dropped %d messages on %s", n, key)


def _check_others(
    service: Service, start: Start, session: Session, check: Callable[[], None], epoch: int = 0
) -> Claim | None:
    """Raise BadInput if one process alone plays a role, or has a name, and another one does; name other builds.

    Two recorders would keep two journals of one run, two front ends transmit, two planners of one name be taken for
    one. Returns the claim of the process, which must be shown as long as it lives.
    """
    claim = None
    if service.role is not Role.OPERATOR:  # there may be many operators
        claim = Claim(session, service.role, start.name, is_of_name=service.scalable, epoch=epoch)
        _settle(claim, service, start.name, check)
    there = alive(session, build())
    for stranger in there.strangers:
        log.warning("%s: they do not hear each other", stranger)
    if there.build != build():
        log.warning("%s %s: it takes part in nothing", start.name, difference(build(), there.build))
    return claim


def _settle(claim: Claim, service: Service, name: str, check: Callable[[], None]) -> None:
    """Show a claim until no rival is left. A process that was killed seems alive for its lease. Raises BadInput.

    Each looks before it shows its claim, too: one that is shown already is not asked to withdraw. Of several that show
    theirs at once all but the earliest withdraw, and the earliest is there once it sees no other.
    """
    begun, shown, told = time.monotonic(), 0.0, False
    try:
        while True:
            rivals, is_later, are_all = claim.rivals()
            if not are_all and not told:
                log.warning("the router answers late: who else is there is asked until it answers in time")
                told = True
            is_alone = are_all and not rivals
            if is_alone and claim.is_shown and time.monotonic() >= shown + SETTLE_S:
                return
            if is_alone and not claim.is_shown:
                claim.show()
                shown = time.monotonic()
            elif is_later:
                claim.drop()
            check()
            if rivals and time.monotonic() > begun + HOLDER_WITHIN_S:
                who = f"another {service.role} is there already"
                if service.scalable:
                    raise BadInput(f"{who} under the name {name}: use another --name or certificate")
                raise BadInput(f"{who}: {', '.join(rivals)}; stop it first")
            time.sleep(min(HOLDER_POLL_S, SETTLE_S) if claim.is_shown else HOLDER_POLL_S)
    except BaseException:
        claim.drop()
        raise


def _joined(role: Role, start: Start, core: Sharing, session: Session, check: Callable[[], None]) -> Pool:
    """The part of a process in the pool of its role and build. Raises BadInput if the others have another front end."""
    tokens, begun = ZenohTokens(session, role, start.name, build()), time.monotonic()
    pool = Pool(tokens, lambda: core.busy, kind=start.front_end, is_spread=start.is_spread)
    while others := pool.others():
        if time.monotonic() > begun + HOLDER_WITHIN_S:
            raise BadInput(f"--front-end: {', '.join(others)} has another one; all of a system have the same")
        check()
        time.sleep(HOLDER_POLL_S)
    pool.join(check)
    if others := pool.others(is_shown=True):  # one that began at the same time, and a little earlier
        pool.close()
        raise BadInput(f"--front-end: {', '.join(others)} has another one; all of a system have the same")
    return pool


def _exposition(role: Role, core: Core, bus: ZenohBus, validity: Validity) -> Callable[[], bytes]:
    """What the process shows of itself: what its core knows, and what passed."""
    from cogradar.shared.wire.exposition import Exposition

    def measures() -> Measures:
        own = dict(core.measures()) if isinstance(core, Measured) else {}
        if bus.pool is not None:
            own["shards_held"] = len(bus.pool.held)
        dropped = dict.fromkeys((topic.name for topic in topics_read_by(role)), 0) | bus.inbox.bad_of_topic
        return {**bus.meter.measures(), "messages_dropped": dropped, **validity.measures(), **own}

    return Exposition(measures).text


def leave() -> NoReturn:
    """End this process with exit code 0, after what is registered for its end.

    The interpreter would free each of a million objects first. That is 0.2 s of processor time, which took 2.5 s at a
    load of 18, and on a busier machine more than a container is given to stop. The processes of `multiprocessing` end
    in the same way.
    """
    threading._shutdown()  # type: ignore[attr-defined]  # waits for threads that are not daemons
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # its reader is gone
            stream.flush()
    os._exit(0)


def stop_with_parent(stop: threading.Event) -> None:
    """Set `stop` when standard input closes: the process that started this one is gone."""

    def wait() -> None:
        sys.stdin.read()
        stop.set()

    threading.Thread(target=wait, daemon=True).start()
