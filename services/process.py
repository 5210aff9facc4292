"""Being one process of the system: connect, say that it is alive, serve until told to stop."""

import gc
import logging
import os
import sys
import threading
from collections.abc import Callable
from functools import partial
from typing import Any, Protocol, runtime_checkable

from services.errors import Interrupted, check_stop
from services.topology import SERVICES, Service, Start
from shared.protocol.topics import Role, topics_read_by
from shared.wire.meter import Measured, Measures
from shared.wire.runner import Answering, Closing, Core, serve
from shared.wire.session import open_session, run_router
from shared.wire.zenoh_bus import ZenohBus

NICENESS = 5  # of a process that the others need not wait for
log = logging.getLogger(__name__)


@runtime_checkable
class Gathering(Protocol):
    """A core that shows what all processes count, in threads of its own."""

    gather: Callable[[], Any] | None


def be(role: Role, start: Start, *, connect: str, listen: str, stop: threading.Event) -> None:
    """Serve as `role` until `stop` is set."""
    line = f"%(asctime)s {start.name} %(levelname)s %(message)s"
    logging.basicConfig(level=logging.INFO, format=line, stream=sys.stderr)
    if role is Role.ROUTER:
        from shared.wire.exposition import Exposition

        run_router(listen, stop, Exposition(dict).text)
    else:
        _serve(SERVICES[role], start, connect, stop)


def _serve(service: Service, start: Start, connect: str, stop: threading.Event) -> None:
    if service.core is None:
        raise ValueError(f"{service.role} has no core")
    try:
        if service.kernels:
            from services.kernels import compile_all

            compile_all(log.info, stop)
        if service.yields:
            os.nice(NICENESS)  # and so for the threads that its core and the session will start
        core = service.core(start)
        session = open_session(connect.split(","), None, check=partial(check_stop, stop))
    except Interrupted:
        return
    bus = ZenohBus(session, service.role, start.name)
    try:
        if isinstance(core, Answering):
            bus.serve_queries(core.answer)
        bus.serve_timestamps(service.role, start.name)
        if isinstance(core, Gathering):
            from services.metrics.processes import gather

            core.gather = partial(gather, session)
        bus.serve_exposition(service.role, start.name, _exposition(service.role, core, bus))
        log.info("connected to %s", connect)
        others = [] if service.scalable else [name for name in bus.alive().get(service.role, ()) if name != start.name]
        if others:
            log.warning("another %s is there already, %s: one of them is too many", service.role, ", ".join(others))
        gc.collect()
        gc.freeze()  # libraries and compiled code live as long as the process: no dwell waits while they are searched
        serve(core, bus, stop, bus.meter)
    finally:
        bus.close()
        if isinstance(core, Closing):
            core.close()
        for key, n in bus.inbox.bad.most_common():
            log.warning("dropped %d messages on %s", n, key)


def _exposition(role: Role, core: Core, bus: ZenohBus) -> Callable[[], bytes]:
    """What the process shows of itself: what its core knows, and what passed."""
    from shared.wire.exposition import Exposition

    def measures() -> Measures:
        own = core.measures() if isinstance(core, Measured) else {}
        dropped = dict.fromkeys((topic.name for topic in topics_read_by(role)), 0) | bus.inbox.bad_of_topic
        return {**bus.meter.measures(), "messages_dropped": dropped, **own}

    return Exposition(measures).text


def stop_with_parent(stop: threading.Event) -> None:
    """Set `stop` when standard input closes: the process that started this one is gone."""

    def wait() -> None:
        sys.stdin.read()
        stop.set()

    threading.Thread(target=wait, daemon=True).start()
