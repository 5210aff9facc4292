"""Senders and readers, on which keys and how, as AsyncAPI 3.0."""

import re
from typing import Any

from cogradar.shared.protocol.messages import Message
from cogradar.shared.protocol.permissions import Act, expression, holders
from cogradar.shared.protocol.topics import (
    ALIVE,
    CLAIM,
    PARTS_OF_KEYS,
    PROTOCOL,
    QUERYABLES,
    SHARE,
    TOPICS,
    Exchange,
    Queryable,
    Topic,
    encoding_of,
)
from cogradar.shared.wire.codec import MAX_BYTES, MAX_LOT
from cogradar.shared.wire.contract.json_schema import described, envelope
from cogradar.shared.wire.front_ends.line import MAX_DATA
from cogradar.shared.wire.zenoh_bus import QUALITY

Document = dict[str, Any]
DATA = "data"  # an answer whose payload is no message
_SHARED = "#/components/schemas/{model}"
TOKENS = {
    "alive": (ALIVE, "Liveliness token of a process."),
    "claim": (
        CLAIM,
        "Liveliness token of a process that wants to be the only one of its role. The lowest moment stays.",
    ),
    "share": (
        SHARE,
        "Liveliness token of a process of a pool, for each shard that it serves. The lowest moment of a shard stays.",
    ),
}


def document() -> Document:
    """The whole contract."""
    channels: dict[str, Document] = {}
    operations: dict[str, Document] = {}
    messages: dict[str, Document] = {}
    shared: dict[str, Document] = {}
    for topic in TOPICS:
        body, parts = described(topic.message, _SHARED)
        shared |= {topic.message.__name__: body} | parts
        messages[topic.name] = _of_message(topic.message)
        channels[topic.name] = _of_topic(topic)
        operations |= _of_roles(topic)
    for queryable in QUERYABLES:
        name = _name(queryable.key)
        asked: Document = {"summary": "A query without a payload.", "payload": {"type": "null"}}
        answered: Document = {"contentType": queryable.encoding, "summary": queryable.meaning}
        if isinstance(queryable, Exchange):
            for kind in (queryable.question, queryable.answer):
                body, parts = described(kind, _SHARED)
                shared |= {kind.__name__: body} | parts
            asked, answered = _of_message(queryable.question), _of_message(queryable.answer)
        messages |= {f"{name}.question": asked, f"{name}.answer": answered}
        if isinstance(queryable, Exchange) and queryable.has_data:
            messages[f"{name}.{DATA}"] = _of_data(f"{name}.answer")
        channels[name] = _of_queryable(queryable)
        operations |= _of_answerers(queryable)
    channels |= {name: _of_token(key, text) for name, (key, text) in TOKENS.items()}
    return {
        "asyncapi": "3.0.0",
        "info": {
            "title": "cogradar",
            "version": f"{PROTOCOL}.0.0",
            "description": (
                "Messages of a distributed radar over Zenoh. A channel's address is a key. x-zenoh says how a sample is"
                " put, which expression a reader subscribes to, which holders of certificates may do what, and what"
                " happens to a message that is lost."
            ),
        },
        "servers": {
            "router": {"host": "127.0.0.1:7447", "protocol": "zenoh", "description": "The router of all processes."}
        },
        "defaultContentType": "application/msgpack",
        "channels": channels,
        "operations": operations,
        "components": {"messages": messages, "schemas": shared},
    }


def _of_message(kind: type[Message]) -> Document:
    summary = (kind.__doc__ or "").strip().splitlines()[0]
    return {"contentType": encoding_of(kind), "summary": summary, "payload": envelope(kind, _SHARED)}


def _of_data(answer: str) -> Document:
    return {
        "contentType": "application/octet-stream",
        "summary": "Y, complex64 little-endian, row by row, (range cells, n_tx, n_rx); the answer is its attachment.",
        "payload": {"type": "string", "format": "binary"},
        "x-zenoh": {"attachment": {"$ref": f"#/components/messages/{answer}"}, "maxBytes": MAX_DATA},
    }


def _of_topic(topic: Topic) -> Document:
    pattern = topic.pattern("*")
    return {
        **_addressed(topic.key),
        "messages": {topic.name: {"$ref": f"#/components/messages/{topic.name}"}},
        "x-zenoh": {
            "kind": "samples",
            "expression": pattern,
            "encoding": topic.encoding,
            "maySend": list(holders(Act.SEND, pattern)),
            "mayRead": list(holders(Act.READ, pattern)),
            "givesWay": topic.gives_way,
            "maxBytes": MAX_BYTES,
            "maxMessages": MAX_LOT,
            "acknowledgement": topic.delivery.until,
            "lateJoiner": topic.delivery.late,
            "reliability": "reliable",
            "congestionControl": _word(QUALITY["congestion_control"]),
            "priority": _word(QUALITY["priority"]),
            "express": QUALITY["express"],
        },
    }


def _of_queryable(queryable: Queryable) -> Document:
    name = _name(queryable.key)
    return {
        **_addressed(queryable.key),
        "messages": {
            kind: {"$ref": f"#/components/messages/{name}.{kind}"} for kind in ("question", *_answers(queryable))
        },
        "x-zenoh": {
            "kind": "queryable",
            "expression": expression(queryable.key),
            "mayAsk": list(holders(Act.ASK, expression(queryable.key))),
            "mayAnswer": list(queryable.answerers),
            **({"maxBytes": MAX_BYTES} if isinstance(queryable, Exchange) else {}),
            "refusal": "text/plain",
        },
    }


def _of_token(key: str, text: str) -> Document:
    return {
        **_addressed(key),
        "description": text,
        "messages": {},
        "x-zenoh": {
            "kind": "liveliness token",
            "expression": expression(key),
            "maySee": list(holders(Act.SEE, expression(key))),
        },
    }


def _of_roles(topic: Topic) -> dict[str, Document]:
    about = {
        "channel": {"$ref": f"#/channels/{topic.name}"},
        "messages": [{"$ref": f"#/channels/{topic.name}/messages/{topic.name}"}],
    }
    sends = {f"{topic.producer}.sends.{topic.name}": {"action": "send", **about, "x-role": topic.producer}}
    return sends | {
        f"{reader}.receives.{topic.name}": {"action": "receive", **about, "x-role": reader} for reader in topic.readers
    }


def _of_answerers(queryable: Queryable) -> dict[str, Document]:
    name = _name(queryable.key)
    channel = {"$ref": f"#/channels/{name}"}
    question, answer = (
        [{"$ref": f"#/channels/{name}/messages/{kind}"} for kind in kinds]
        for kinds in (("question",), _answers(queryable))
    )
    return {
        f"{role}.answers.{name}": {
            "action": "receive",
            "channel": channel,
            "messages": question,
            "reply": {"channel": channel, "messages": answer},
            "x-role": role,
        }
        for role in queryable.answerers
    }


def _answers(queryable: Queryable) -> tuple[str, ...]:
    """Kinds of its answers."""
    return ("answer", DATA) if isinstance(queryable, Exchange) and queryable.has_data else ("answer",)


def _addressed(key: str) -> Document:
    """Address and parameters of a channel."""
    names = re.findall(r"\{(\w+)\}", key)
    return {"address": key, "parameters": {name: {"description": PARTS_OF_KEYS[name]} for name in names}}


def _word(chosen: object) -> str:
    """What Zenoh calls one of its settings."""
    return str(chosen).rpartition(".")[2].lower()


def _name(key: str) -> str:
    """The parts of a key that say what it is for."""
    return "-".join(part for part in key.split("/")[2:] if not part.startswith("{"))
