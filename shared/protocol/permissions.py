"""What a process may do on the network, by its role: drawn from the topics; whatever is not here is denied."""

import re
from enum import StrEnum

from cogradar.shared.protocol.messages import Command, EmulatorCheckpoint, RunStart, Truth
from cogradar.shared.protocol.slots import ALL_SLOTS
from cogradar.shared.protocol.topics import (
    ALIVE,
    CLAIM,
    EXCHANGES,
    EXPOSITION,
    FRONT_END,
    LINK,
    QUERY,
    SHARE,
    TIMESTAMPS,
    TOPICS,
    Role,
    Topic,
    topics_read_by,
)

OBSERVER = "observer"  # no process of the system: it reads and asks, and sends nothing
COMMANDER = "commander"  # an observer that may also command runs
WATCHING = (OBSERVER, COMMANDER)
HOLDERS = (*Role, *WATCHING, FRONT_END)  # of certificates
COMMANDING = (Role.OPERATOR, Role.METRICS, COMMANDER)  # metrics for those who ask it over HTTP
OF_THE_WORLD = (RunStart, EmulatorCheckpoint, Truth)  # from which the truth is known, or could be drawn

_ASKED: dict[str, tuple[str, ...]] = {
    Role.EMULATOR: tuple(exchange.key_of("*") for exchange in EXCHANGES),
    Role.OPERATOR: (QUERY, TIMESTAMPS),
    Role.METRICS: (QUERY, EXPOSITION),
    OBSERVER: (QUERY,),
    COMMANDER: (QUERY,),
}


class Act(StrEnum):
    """What can be done with a key."""

    SEND = "send"
    READ = "read"
    ASK = "ask"
    HEAR = "hear"  # questions to several
    ANSWER = "answer"
    SHOW = "show"  # oneself alive
    SEE = "see"  # which processes are alive


def may_send(holder: str, topic: Topic) -> bool:
    """Whether a holder of a certificate may send on a topic."""
    return holder == topic.producer or (topic.message is Command and holder in COMMANDING)


def permitted(holder: str, limit: str = ALL_SLOTS, name: str = "*") -> dict[Act, tuple[str, ...]]:
    """Key expressions with which a holder of a certificate may do what.

    limit : of a planner its slots; of a front end its name. A planner without a limit may speak of all slots.
    name  : of the process, under which alone it shows itself and answers for itself; all names if left out
    """
    if holder == FRONT_END:
        asked = tuple(exchange.key_of(limit) for exchange in EXCHANGES)
        return {Act.HEAR: asked, Act.ANSWER: asked}
    limited = "*" if limit == ALL_SLOTS else limit
    sent = tuple(topic.pattern("*", slots=limited) for topic in TOPICS if may_send(holder, topic))
    if holder in WATCHING:
        read = tuple(topic.pattern("*") for topic in TOPICS if topic.message not in OF_THE_WORLD)
    else:
        read = tuple(topic.pattern("*") for topic in topics_read_by(Role(holder)))
    is_process = holder not in {*WATCHING, Role.ROUTER}  # the router says itself what it has to say
    own = (TIMESTAMPS, EXPOSITION, *((QUERY,) if holder == Role.METRICS else ())) if is_process else ()
    asked = (*_ASKED.get(holder, ()), *((LINK,) if is_process else ()))
    found = {
        Act.SEND: sent,
        Act.READ: read,
        Act.ASK: tuple(expression(key) for key in asked),
        Act.HEAR: tuple(expression(key) for key in own),
        Act.ANSWER: tuple(expression(key, holder, name) for key in own),
        Act.SHOW: tuple(expression(key, holder, name) for key in (ALIVE, CLAIM, SHARE)) if is_process else (),
        Act.SEE: tuple(expression(key) for key in (ALIVE, CLAIM, SHARE)),
    }
    return {act: keys for act, keys in found.items() if keys}


def holders(act: Act, expression: str) -> tuple[str, ...]:
    """Holders of certificates that may do something with all keys of an expression."""
    return tuple(holder for holder in HOLDERS if expression in permitted(holder).get(act, ()))


def expression(key: str, role: str = "*", name: str = "*") -> str:
    """Key expression for all keys of a form, or of a role, or of one process of it."""
    return re.sub(r"\{\w+\}", "*", key.replace("{role}", role).replace("{name}", name))
