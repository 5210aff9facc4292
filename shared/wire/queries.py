"""Queries through the router: asking them, and answering them."""

import logging
import re
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote, unquote

import zenoh

from cogradar.shared.protocol.build import difference
from cogradar.shared.protocol.topics import ALIVE, CLAIM, EXPOSITION, PROTOCOL, QUERY, QUERYABLES, Role

log = logging.getLogger(__name__)

MAX_QUESTION = 4096  # characters of a question's parameters
STAYS_S = 1.0  # for which a later claim must be there: one that is only about to withdraw is gone by then
LATEST_NS = 10**20 - 1  # since 1970, of a claim
POLL_S = 0.002  # for the replies to a query
LOOK_S = 1.0  # for all tokens; an answer that takes as long was cut off, and may lack some

ENCODINGS = {queryable.key: zenoh.Encoding(queryable.encoding) for queryable in QUERYABLES}  # of answers
REFUSAL = zenoh.Encoding.TEXT_PLAIN

Answer = Callable[[str, Mapping[str, str]], bytes]  # of a metric, with parameters


class NoAnswer(RuntimeError):
    """No process answered a query in time."""


class BadRequest(RuntimeError):
    """The answer to a query is that it cannot be answered; the text is the answerer's."""


def ask(
    session: zenoh.Session,
    metric: str,
    parameters: Mapping[str, str],
    timeout_s: float,
    check: Callable[[], None] = lambda: None,
) -> bytes:
    """Answer of the metrics service to a query.

    An empty reply is asked again until the time is over, since a service that has just started gives one. `check` is
    called all the while and may raise to give up. Raises NoAnswer, or BadRequest with the service's reason.
    """
    if not re.fullmatch(r"[A-Za-z0-9_-]+", metric):
        raise BadRequest(f"metric = {metric!r}: not a name")
    selector = zenoh.Selector(QUERY.format(metric=metric), ";".join(f"{k}={quote(v)}" for k, v in parameters.items()))
    deadline = time.monotonic() + timeout_s
    while (left := deadline - time.monotonic()) > 0:
        for reply in _replies(session.get(selector, timeout=left), check):
            if reply.ok is not None:
                return reply.ok.payload.to_bytes()
            if reply.err is not None and (text := reply.err.payload.to_string()) != "Timeout":
                raise BadRequest(text)
        time.sleep(POLL_S)
    raise NoAnswer(f"no process answered {metric} within {timeout_s:g} s")


def ask_expositions(session: zenoh.Session, timeout_s: float, most: int) -> Iterator[tuple[tuple[str, str], bytes]]:
    """The metrics of every process that answers in time, by its role and name; of one that is longer than `most` bytes
    the first ones, and one more.
    """
    selector = EXPOSITION.format(role="*", name="*")
    try:
        replies = session.get(selector, target=zenoh.QueryTarget.ALL, timeout=timeout_s)
    except zenoh.ZError:  # the session was closed: this process ends, while a page still asks
        return
    for reply in replies:
        if reply.ok is not None:
            role, name = str(reply.ok.key_expr).split("/")[-2:]
            payload = reply.ok.payload
            yield (role, name), payload.to_bytes() if len(payload) <= most else bytes(most + 1)


@dataclass(frozen=True)
class Alive:
    """Processes that show themselves alive behind a router."""

    build: str  # of the system: its recorder's; else the build of this process
    names: dict[Role, list[str]]  # by role, of that build
    strangers: list[str]  # processes of another build or protocol: what each runs


def alive(session: zenoh.Session, own: str) -> Alive:
    """Processes that show themselves alive; `own` is the build of this one."""
    found = _tokens(session, ALIVE.format(protocol="*", build="*", role="*", name="*"))
    system = next((build for _, build, role, _ in found if role == Role.RECORDER), own)
    names: dict[Role, list[str]] = {}
    strangers = dict[str, str]()  # one line for each name: a process can show as many builds as it likes
    for protocol, build, role, name in found:
        if protocol != str(PROTOCOL):
            strangers[name] = f"{name} speaks protocol {protocol}, this program {PROTOCOL}"
        elif build != system and role != Role.OPERATOR:
            strangers[name] = f"{name} {difference(build, system)}"
        elif role in set(Role):
            names.setdefault(Role(role), []).append(name)
    return Alive(system, names, list(strangers.values()))


def names_alive(session: zenoh.Session, build: str, role: Role, name: str = "*") -> list[str]:
    """Names of the live processes of one role and build, or of one name."""
    return [found for *_, found in _tokens(session, ALIVE.format(protocol=PROTOCOL, build=build, role=role, name=name))]


class Claim:
    """Of a process that wants to be the only one of its role, or of its role and name: shown until it is dropped.

    A process that shows one, and then sees no other, is alone: another one that shows its own later sees this one. So
    clocks decide nothing but which of several that see each other withdraws.
    """

    def __init__(
        self, session: zenoh.Session, role: Role, name: str, *, is_of_name: bool = False, epoch: int = 0
    ) -> None:
        """It is not shown yet.

        is_of_name : there may be others of the role, under other names
        epoch      : of the journal that the process leads, by which a successor is later whatever its clock says
        """
        self._session, self._role, self._name, self._is_of_name = session, role, name, is_of_name
        self._moment = f"{min(1000 * epoch or time.time_ns(), LATEST_NS):020d}-{uuid.uuid4().hex[:8]}"
        self._token: zenoh.LivelinessToken | None = None
        self._later: dict[str, tuple[str, float]] = {}  # claims: whose, and since when they are seen
        self._watch: Any = None

    @property
    def is_shown(self) -> bool:
        """Whether others see it."""
        return self._token is not None

    def show(self) -> None:
        """Show it to others, before they are looked for."""
        self._token = self._session.liveliness().declare_token(self._key(self._moment, self._name))

    def rivals(self) -> tuple[list[str], bool, bool]:
        """Names of the processes of this role that are there, of any build, or show a claim; whether one of the claims
        is earlier; and whether these are all: an answer may be cut off.
        """
        name = self._name if self._is_of_name else "*"
        shown, has_claims = look(self._session, self._others)
        alive, has_alive = look(self._session, ALIVE.format(protocol=PROTOCOL, build="*", role=self._role, name=name))
        claims = dict(key.split("/")[-2:] for key in shown)
        claims.pop(self._moment, None)
        there = {*(key.split("/")[-1] for key in alive), *claims.values()}
        return sorted(there), min(claims, default=self._moment) < self._moment, has_claims and has_alive

    def watch(self) -> None:
        """From now on see other claims of the role."""

        def on_token(sample: zenoh.Sample) -> None:
            moment, name = str(sample.key_expr).split("/")[-2:]
            if sample.kind == zenoh.SampleKind.PUT and moment > self._moment:
                self._later.setdefault(moment, (name, time.monotonic()))
            else:
                self._later.pop(moment, None)

        self._watch = self._session.liveliness().declare_subscriber(self._others, on_token, history=True)

    def successor(self) -> str:
        """Name of a process that took the role over while this one was not seen; "": there is none.

        It would not have claimed a role of which it saw the process. The later one of two stays.
        """
        before_s = time.monotonic() - STAYS_S
        return min((name for name, since_s in list(self._later.values()) if since_s < before_s), default="")

    def drop(self) -> None:
        """Leave the role to others."""
        if self._watch is not None:
            self._watch.undeclare()
            self._watch = None
        if self._token is not None:
            self._token.undeclare()
            self._token = None

    @property
    def _others(self) -> str:
        return self._key("*", self._name if self._is_of_name else "*")

    def _key(self, moment: str, name: str) -> str:
        return CLAIM.format(protocol=PROTOCOL, role=self._role, moment=moment, name=name)


def _tokens(session: zenoh.Session, pattern: str) -> list[tuple[str, str, str, str]]:
    """Protocol, build, role and name of each."""
    keys = [key.split("/")[-4:] for key in look(session, pattern)[0]]
    return sorted((protocol, build, role, name) for protocol, build, role, name in keys)


def look(session: zenoh.Session, pattern: str) -> tuple[list[str], bool]:
    """Keys of the tokens that are shown, and whether these are all: what comes too late is missing."""
    began_s = time.monotonic()
    replies = session.liveliness().get(pattern, timeout=LOOK_S)
    keys = [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]
    return keys, time.monotonic() - began_s < LOOK_S


def _replies(channel: Any, check: Callable[[], None]) -> Iterator[zenoh.Reply]:
    """Replies as they come. A blocking read of the channel would not let the asker give up."""
    while True:
        check()
        try:
            reply = channel.try_recv()
        except zenoh.ZError:  # empty, and no more will come
            return
        if reply is None:
            time.sleep(POLL_S)
        else:
            yield reply


class NotNow(Exception):
    """There is no answer at present; the asker hears nothing, as from a process that is not there, and asks again."""


def reply(query: zenoh.Query, answer: Answer) -> str:
    """Reply with an answer, or with the reason why there is none; what it came to: answered, refused or failed."""
    try:
        if len(str(query.parameters)) > MAX_QUESTION:
            raise ValueError(f"a question longer than {MAX_QUESTION} characters")
        document = answer(str(query.key_expr).split("/")[-1], parameters(query))
    except NotNow as reason:
        log.warning("query %s is not answered: %s", query.selector, reason)
        return "failed"
    except ValueError as error:
        query.reply_err(str(error).encode(), encoding=REFUSAL)
        return "refused"
    except Exception as error:
        log.exception("query %s failed", query.selector)
        query.reply_err(f"{type(error).__name__}: {error}".encode(), encoding=REFUSAL)
        return "failed"
    query.reply(query.key_expr, document, encoding=ENCODINGS[QUERY])
    return "answered"


def parameters(query: zenoh.Query) -> dict[str, str]:
    """Parameters of a query, by name."""
    pairs = (pair.partition("=") for pair in str(query.parameters).split(";") if pair)
    return {key: unquote(value) for key, _, value in pairs}
