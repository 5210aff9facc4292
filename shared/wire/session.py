"""Sessions of Zenoh: connecting to a router, and being one."""

import json
import logging
import os
import re
import socket
import threading
import time
from collections.abc import Callable, Sequence

import zenoh

from shared.protocol.topics import EXPOSITION, TIMESTAMPS, Role
from shared.wire.timestamps import Timestamps

log = logging.getLogger(__name__)

Session = zenoh.Session

LEASE_MS = 2000  # a silent process counts as gone after this
RETRY_S = 0.1
PROBE_S = 1.0  # for a plain connection to where no router answered
OPEN_MS = 500  # per attempt: a blocking open would not notice a signal


def open_session(
    endpoints: Sequence[str],
    within_s: float | None,
    check: Callable[[], None],
    notify: Callable[[str], None] = lambda _: None,
) -> zenoh.Session:
    """Connect to one of the routers at `endpoints`, trying again until one is there.

    `check` is called between attempts and may raise to give up; `notify` is told once that, and why, it takes a while.
    Raises ConnectionError after `within_s`.
    """
    deadline = None if within_s is None else time.monotonic() + within_s
    where = ", ".join(endpoints)
    retry = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2}
    try:
        config = _config(
            "client", connect__endpoints=list(endpoints), connect__timeout_ms=OPEN_MS, connect__retry=retry
        )
    except zenoh.ZError:
        raise ConnectionError(f"{where}: not an endpoint, such as tcp/127.0.0.1:7447") from None
    log.info("looking for a router at %s", where)
    is_told = within_s is None
    while True:
        check()
        try:
            return zenoh.open(config)
        except zenoh.ZError:
            if not is_told:
                is_told = True
                why = ", ".join(dict.fromkeys(map(_why_no_answer, endpoints)))
                notify(f"no router at {where} yet ({why}); trying for {within_s:g} s")
            if deadline is not None and time.monotonic() > deadline:
                why = ", ".join(dict.fromkeys(map(_why_no_answer, endpoints)))
                raise ConnectionError(f"no Zenoh router at {where} within {within_s:g} s: {why}") from None
        time.sleep(RETRY_S)


def run_router(listen: str, stop: threading.Event, exposition: Callable[[], bytes] = bytes) -> None:
    """Be a Zenoh router until `stop` is set; raises ConnectionError if it cannot listen."""
    try:
        session = zenoh.open(_config("router", listen__endpoints=[listen]))
    except zenoh.ZError as error:
        raise ConnectionError(f"cannot listen on {listen}: {_reason(error)}") from None

    def serve(pattern: str, answer: Callable[[], bytes]) -> None:
        key = pattern.format(role=Role.ROUTER, name="router")

        def reply(query: zenoh.Query) -> None:
            with query:
                query.reply(key, answer())

        session.declare_queryable(key, reply, complete=True)

    with session:
        serve(TIMESTAMPS, lambda: Timestamps().of(""))  # the CPU time alone
        serve(EXPOSITION, exposition)
        log.info("listening on %s", listen)
        stop.wait()


def free_port() -> int:
    """A TCP port on the loopback interface that nobody listens on just now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def _why_no_answer(endpoint: str) -> str:
    """Why no router answered: what a plain connection comes to, since Zenoh says only that it timed out."""
    place = re.fullmatch(r"tcp/\[?(.+?)\]?:(\d+)", endpoint)
    if place is None:
        return "no answer"
    try:
        socket.create_connection((place[1], int(place[2])), PROBE_S).close()
    except UnicodeError:
        return "not the name of a host"
    except (OSError, OverflowError) as error:  # the latter: no port has this number
        return str(getattr(error, "strerror", None) or error).lower()
    return "what listens there is no Zenoh router"


def _reason(error: zenoh.ZError) -> str:
    """The system's own words if Zenoh's error has their number; else its first line, without places in its sources."""
    number = re.search(r"\(os error (\d+)\)", str(error))
    return os.strerror(int(number[1])).lower() if number else str(error).partition(" at /")[0].strip()


def _config(mode: str, **settings: object) -> zenoh.Config:
    """Configuration of a session: explicit endpoints only, no discovery, no shared memory."""
    config = zenoh.Config()
    fixed: dict[str, object] = {
        "mode": mode,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
        "transport/link/tx/lease": LEASE_MS,
        "transport/unicast/open_timeout": 1000,  # ms; with the next, leaving takes half a second even if nobody answers
        "transport/link/tx/queue/congestion_control/block/wait_before_close": 500_000,  # us
    }
    for key, value in {**fixed, **{key.replace("__", "/"): value for key, value in settings.items()}}.items():
        config.insert_json5(key, json.dumps(value))
    return config
