"""Whether a router still hears a process. After a reconnection on a busy machine a link was seen that was up on both
ends, kept alive, and carried nothing: the router knew no subscription and no token of the process any more.
"""

import time

import zenoh

from cogradar.shared.protocol.topics import ALIVE, LINK, Role

EVERY_S = 2.0  # from one question to the next, which has so long to be answered
UNHEARD = 8  # questions in a row, and the link is taken for broken: a busy router may miss some
SEEN, UNSEEN = b"seen", b"unseen"


class Link:
    """The link of one process, for the thread of its main loop, which asks the router whether it sees the process."""

    def __init__(self, session: zenoh.Session, role: Role, name: str) -> None:
        self._session, self._key = session, LINK.format(role=role, name=name)
        self._due_s = 0.0
        self._routers = frozenset[str]()
        self._is_seen = False  # since the last question
        self._is_known = False  # the router has said so once: another one than ours never does
        self._n_unheard = 0

    def is_broken(self) -> bool:
        """Ask, if it is time; whether many questions in a row were in vain while the link to a router was up."""
        now_s = time.monotonic()
        if now_s < self._due_s:
            return False
        self._due_s = now_s + EVERY_S
        before, self._routers = self._routers, frozenset(map(str, self._session.info.routers_zid()))
        is_same = bool(before) and self._routers == before
        self._n_unheard = self._n_unheard + 1 if self._is_known and is_same and not self._is_seen else 0
        self._is_seen = False
        if self._routers and self._n_unheard < UNHEARD:
            self._session.get(self._key, zenoh.handlers.Callback(self._on_reply, indirect=False), timeout=EVERY_S)
        return self._n_unheard >= UNHEARD

    def _on_reply(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None and reply.ok.payload.to_bytes() == SEEN:
            self._is_seen = self._is_known = True


def hear(session: zenoh.Session) -> None:
    """As a router, tell processes that ask whether their tokens are seen."""
    seen = set[str]()

    def on_token(sample: zenoh.Sample) -> None:
        note = seen.add if sample.kind == zenoh.SampleKind.PUT else seen.discard
        note(str(sample.key_expr))

    def on_query(query: zenoh.Query) -> None:
        with query:
            role, name = str(query.key_expr).split("/")[-2:]
            is_seen = any(key.endswith(f"/{role}/{name}") for key in list(seen))
            query.reply(query.key_expr, SEEN if is_seen else UNSEEN, encoding=zenoh.Encoding.TEXT_PLAIN)

    every = {"protocol": "*", "build": "*", "role": "*", "name": "*"}
    session.liveliness().declare_subscriber(ALIVE.format(**every), on_token, history=True)
    session.declare_queryable(LINK.format(role="*", name="*"), on_query, complete=True)
