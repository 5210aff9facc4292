"""Sessions of Zenoh: connecting to a router, and being one.

What Zenoh can do beyond what we need (certificates, other links, quality of service) is told by a file of its own
settings; ours come on top of them.
"""

import json
import logging
import os
import re
import socket
import threading
import time
from base64 import b64decode
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import zenoh

from cogradar.shared.protocol.topics import ALIVE, EXCHANGES, EXPOSITION, LINK, QUERY, TIMESTAMPS, Role
from cogradar.shared.wire.codec import MAX_BYTES
from cogradar.shared.wire.pool.live_names import LEASE_S
from cogradar.shared.wire.queries import ENCODINGS
from cogradar.shared.wire.timestamps import Timestamps

log = logging.getLogger(__name__)

Session = zenoh.Session

LEASE_MS = round(1000 * LEASE_S)  # a silent process counts as gone after this
BEAT_S = 1.0  # of a router, which has no ticks
RETRY_S = 0.1
PROBE_S = 1.0  # for a plain connection to where no router answered
OPEN_MS = 500  # per attempt: a blocking open would not notice a signal
ASK_S = 2.0  # from one question whether a router sees a process to the next
UNSEEN_ASKS = 8  # in a row with the answer that it does not, and the link is taken for broken
SILENT_ASKS = 24  # in a row without an answer: a router may be busy, and a link slow
SEEN, UNSEEN = "seen", "unseen"  # and the router that says so
CONFIG_VARIABLE = "COGRADAR_ZENOH"  # the file of every session of a process, and of those that it starts
ENCRYPTED = ("tls/", "quic/")
TLS = "transport/link/tls"  # where Zenoh's settings have certificates
_SHORT = [re.sub(r"\{\w+\}", "*", key) for key in (QUERY, TIMESTAMPS, EXPOSITION, LINK)]
SIZES = [  # bytes that a router passes on; of other questions it passes on none
    {"id": name, "messages": [kind], "flows": ["ingress"], "key_exprs": keys, "size_limit": most}
    for name, kind, keys, most in (
        ("put", "put", ["**"], MAX_BYTES),
        ("query", "query", _SHORT, 4096),
        ("front-end", "query", [exchange.key_of("*") for exchange in EXCHANGES], MAX_BYTES),
    )
]


class BadConfig(ConnectionError):
    """A file of settings that Zenoh does not take; the text is one line."""


def open_session(
    endpoints: Sequence[str],
    within_s: float | None,
    check: Callable[[], None],
    notify: Callable[[str], None] = lambda _: None,
    file: str = "",
    *,
    shares_memory: bool = False,
) -> zenoh.Session:
    """Connect to one of the routers at `endpoints`, trying again until one is there.

    `check` is called between attempts and may raise to give up; `notify` is told once that, and why, it takes a while.
    `file` has settings of Zenoh's own; empty: the one that COGRADAR_ZENOH names, if any. With `shares_memory` long
    payloads go through the memory of this machine, if the other end does the same. Raises ConnectionError after
    `within_s`, and BadConfig.
    """
    deadline = None if within_s is None else time.monotonic() + within_s
    where = ", ".join(endpoints)
    retry = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2}
    shared = {"transport__shared_memory__enabled": True} if shares_memory else {}
    try:
        config = _config(
            "client",
            file,
            connect__endpoints=list(endpoints),
            connect__timeout_ms=OPEN_MS,
            connect__retry=retry,
            **shared,
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


class Link:
    """The link of one process, for the thread of its main loop: it asks the router whether it still sees the process.

    After a reconnection on a busy machine a link was seen that was up on both ends, kept alive, and carried nothing.
    The router knew no subscription and no token of the process any more.
    """

    def __init__(self, session: zenoh.Session, role: Role, name: str) -> None:
        self._session, self._key = session, LINK.format(role=role, name=name)
        self._due_s = 0.0
        self._routers = frozenset[str]()
        self._said: set[str] = set()  # since the last question
        self._known = ""  # the router that said last that it sees the process: a router of others never does
        self._n_unseen = self._n_silent = 0

    def is_broken(self) -> bool:
        """Ask, if it is time; whether many questions in a row were in vain while the link to a router was up."""
        now_s = time.monotonic()
        if now_s < self._due_s:
            return False
        self._due_s = now_s + ASK_S
        before, self._routers = self._routers, frozenset(map(str, self._session.info.routers_zid()))
        said, self._said = self._said, set()
        if SEEN in said or not self._known or not before or self._routers != before:
            self._n_unseen = self._n_silent = 0
        elif UNSEEN in said:
            self._n_unseen += 1
        elif self._known in self._routers:
            self._n_silent += 1
        if self._routers:  # a slow answer is one, too: some questions are under way at a time
            answer = zenoh.handlers.Callback(self._on_reply, indirect=False)
            self._session.get(self._key, answer, timeout=UNSEEN_ASKS * ASK_S, express=True)
        return self._n_unseen >= UNSEEN_ASKS or self._n_silent >= SILENT_ASKS

    def _on_reply(self, reply: zenoh.Reply) -> None:
        if reply.ok is None:
            return
        word, _, router = reply.ok.payload.to_string().partition(" ")
        self._said.add(word)
        if word == SEEN:
            self._known = router


def listen_session(endpoint: str, *, shares_memory: bool) -> zenoh.Session:
    """A session to which one other connects directly. Raises ConnectionError if it cannot listen."""
    try:
        return zenoh.open(
            _config("peer", listen__endpoints=[endpoint], transport__shared_memory__enabled=shares_memory)
        )
    except zenoh.ZError as error:
        raise ConnectionError(f"cannot listen on {endpoint}: {_reason(error)}") from None


def run_router(
    listen: str,
    stop: threading.Event,
    exposition: Callable[[], bytes] = bytes,
    access: Mapping[str, object] | None = None,
    file: str = "",
    beat: Callable[[], None] = lambda: None,
) -> None:
    """Be a Zenoh router until `stop` is set, and `beat` now and then; raises ConnectionError if it cannot listen.

    `access` is Zenoh's access control, which needs peers with certificates, and then what is too long is not passed on;
    None: as in `file`, if any, which is as in `open_session`.
    """
    rules = {} if access is None else {"access_control": access, "low_pass_filter": SIZES}
    try:
        config = _config("router", file, listen__endpoints=listen.split(","), **rules)
        _check_certificates(config, listen, is_needed=access is not None)
        session = zenoh.open(config)
    except zenoh.ZError as error:
        raise ConnectionError(f"cannot listen on {listen}: {_reason(error)}") from None

    def serve(pattern: str, answer: Callable[[], bytes]) -> None:
        key = pattern.format(role=Role.ROUTER, name="router")

        def reply(query: zenoh.Query) -> None:
            with query:
                query.reply(key, answer(), encoding=ENCODINGS[pattern])

        session.declare_queryable(key, reply, complete=True)

    with session:
        serve(TIMESTAMPS, lambda: Timestamps().of(""))  # the CPU time alone
        serve(EXPOSITION, exposition)
        _hear(session)
        log.info("listening on %s", listen)
        if not (_asks_for_certificates(config, listen) or _is_true(config, "access_control/enabled")):
            log.warning("%s is open: any client may read and send everything (docs/howto/secure.md)", listen)
        while not stop.wait(BEAT_S):
            beat()


def _hear(session: zenoh.Session) -> None:
    """As a router, tell processes that ask whether their tokens are seen."""
    seen = set[str]()

    def on_token(sample: zenoh.Sample) -> None:
        note = seen.add if sample.kind == zenoh.SampleKind.PUT else seen.discard
        note(str(sample.key_expr))

    def on_query(query: zenoh.Query) -> None:
        with query:
            role, name = str(query.key_expr).split("/")[-2:]
            if "*" in f"{role}{name}":
                return  # it is asked for one process
            is_seen = any(key.endswith(f"/{role}/{name}") for key in list(seen))
            answer = f"{SEEN if is_seen else UNSEEN} {session.info.zid()}"
            query.reply(query.key_expr, answer, encoding=zenoh.Encoding.TEXT_PLAIN)

    every = {"protocol": "*", "build": "*", "role": "*", "name": "*"}
    session.liveliness().declare_subscriber(ALIVE.format(**every), on_token, history=True)
    session.declare_queryable(LINK.format(role="*", name="*"), on_query, complete=True)


def check_config(file: str) -> None:
    """Raise BadConfig if Zenoh does not take a file's settings."""
    _config("client", file)


def own_certificate(endpoints: Sequence[str], side: str) -> bytes | None:
    """The certificate, PEM, by which a session of this process is known at these endpoints; None: by none of a file.

    side : "connect" or "listen". Raises BadConfig.
    """
    file = os.environ.get(CONFIG_VARIABLE, "")
    config = _of_file(file)
    # Behind # an endpoint may have settings of its own.
    is_shown = any(endpoint.startswith(ENCRYPTED) and "#" not in endpoint for endpoint in endpoints)
    if not (is_shown and _is_true(config, f"{TLS}/enable_mtls")):
        return None
    key = f"{TLS}/{side}_certificate"
    encoded, path = (json.loads(config.get_json(name)) for name in (f"{key}_base64", key))
    try:
        return b64decode(encoded, validate=True) if encoded else Path(path).read_bytes() if path else None
    except OSError as error:
        raise BadConfig(f"{file}: {key} = {path}: {(error.strerror or str(error)).lower()}") from None
    except ValueError as error:  # no Base64, no path
        raise BadConfig(f"{file}: {key}: {error}") from None


def _asks_for_certificates(config: zenoh.Config, listen: str) -> bool:
    """Whether only clients with a certificate get in, wherever a router listens."""
    is_encrypted = all(endpoint.startswith(ENCRYPTED) for endpoint in listen.split(","))
    return is_encrypted and _is_true(config, f"{TLS}/enable_mtls")


def _check_certificates(config: zenoh.Config, listen: str, *, is_needed: bool) -> None:
    if is_needed and not _asks_for_certificates(config, listen):
        raise BadConfig(
            f"cannot listen on {listen}: rights are told by certificates, so it must be tls/HOST:PORT,"
            " with transport/link/tls/enable_mtls in the file of --zenoh-config"
        )


def _is_true(config: zenoh.Config, key: str) -> bool:
    return bool(json.loads(config.get_json(key)))


def free_port() -> int:
    """A TCP port on the loopback interface that is free just now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def _why_no_answer(endpoint: str) -> str:
    """Why no router answered: what a plain connection comes to, since Zenoh says only that it timed out."""
    place = re.fullmatch(r"(?:tcp|tls)/\[?(.+?)\]?:(\d+)(?:[?#].*)?", endpoint)
    if place is None:
        return "no answer"
    try:
        socket.create_connection((place[1], int(place[2])), PROBE_S).close()
    except UnicodeError:
        return "not the name of a host"
    except (OSError, OverflowError) as error:  # the latter: no port has this number
        return str(getattr(error, "strerror", None) or error).lower()
    if endpoint.startswith("tls/"):
        return "what listens there has no certificate for this name, or wants another one of us, or is no Zenoh router"
    return "what listens there is no Zenoh router"


def _reason(error: zenoh.ZError) -> str:
    """The system's own words if Zenoh's error has their number; else its first line, without places in its sources."""
    number = re.search(r"\(os error (\d+)\)", str(error))
    return os.strerror(int(number[1])).lower() if number else str(error).partition(" at /")[0].strip()


def _config(mode: str, file: str = "", **settings: object) -> zenoh.Config:
    """Configuration of a session: explicit endpoints only, no discovery, no shared memory unless `settings` has it; the
    rest is a file's.
    """
    config = _of_file(file or os.environ.get(CONFIG_VARIABLE, ""))
    fixed: dict[str, object] = {
        "mode": mode,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
        "transport/link/tx/lease": LEASE_MS,
        "transport/unicast/open_timeout": 1000,  # ms; with the next, leaving takes half a second even without an answer
        "transport/link/tx/queue/congestion_control/block/wait_before_close": 500_000,  # us
    }
    for key, value in {**fixed, **{key.replace("__", "/"): value for key, value in settings.items()}}.items():
        config.insert_json5(key, json.dumps(value))
    return config


def _of_file(file: str) -> zenoh.Config:
    """The settings of a file, as Zenoh reads JSON5. Raises BadConfig."""
    if not file:
        return zenoh.Config()
    try:
        return zenoh.Config.from_json5(Path(file).read_text(encoding="utf-8"))
    except OSError as error:
        raise BadConfig(f"{file}: {(error.strerror or str(error)).lower()}") from None
    except UnicodeDecodeError:
        raise BadConfig(f"{file}: not a text file") from None
    except zenoh.ZError as error:
        place = re.search(r"--> (\d+):(\d+)(?:.*= ([^\n]+))?", str(error), re.DOTALL)
        what = f"line {place[1]}, column {place[2]}: {place[3]}" if place else _reason(error).splitlines()[0]
        raise BadConfig(f"{file}: not a configuration of Zenoh: {what}") from None
