"""Messages as bytes: MessagePack, arrays as an extension type, every message checked when it arrives."""

import math
import reprlib
import struct
from collections.abc import Container, Mapping, Sequence
from functools import cache
from types import MappingProxyType
from typing import Any, TypeVar

import msgpack
import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from cogradar.shared.protocol.messages import SCHEMA, Message
from cogradar.shared.protocol.roster import Compared
from cogradar.shared.protocol.topics import BY_NAME, name_of
from cogradar.shared.scenario.faults import printable
from cogradar.shared.scenario.limits import MAX_MESSAGE_BYTES, MAX_TARGETS, MAX_TURNS
from cogradar.shared.scenario.trajectories.rows import Rows

MAX_BYTES = MAX_MESSAGE_BYTES  # of one message; scenarios whose waveforms could be longer are refused
MAX_LOT = 64  # messages that travel together
# Of one message, beyond any that there is: what is more is refused before it is unpacked and checked, piece by piece.
MAX_KEYS = 128  # of a map
MAX_ARRAYS = MAX_TARGETS  # a trajectory of a target is one
MAX_MAPS = MAX_TURNS + MAX_TARGETS + 1000  # a turn, and a target, is one
MAX_LISTS = 5 * MAX_TARGETS  # a state of a target is one
MAX_ITEMS = 25 * MAX_TARGETS  # in all lists
ARRAY = 1  # extension type: dtype name, number of axes, length of each, elements in C order; little-endian
_ARRAYS = {*range(0x90, 0xA0), 0xDC, 0xDD}  # first bytes of a MessagePack array; a message is a map
DTYPES: dict[bytes, np.dtype[Any]] = {b"i4": np.dtype("<i4"), b"f8": np.dtype("<f8"), b"c8": np.dtype("<c8")}
NAMES = {dtype: name for name, dtype in DTYPES.items()}
_HEADS = [struct.Struct(f"<2sB{n_axis}I") for n_axis in range(3)]  # before the elements: see ARRAY

Parts = Mapping[type[Message], type[Message]]  # of kinds of messages, with some of their fields
WHOLE: Parts = MappingProxyType({})
Kind = TypeVar("Kind", bound=Message)


class BadMessage(ValueError):
    """Bytes that are no message of this schema; the text is one line."""


def encode(message: Message) -> bytes:
    """Encode a message; equal messages give equal bytes."""
    said = vars(message)
    body = {name: said[name] for name, is_required in _fields(type(message)) if is_required or said[name] is not None}
    envelope = {"v": SCHEMA, "topic": name_of(type(message)), "body": body}
    payload: bytes = msgpack.packb(envelope, default=_packed)
    if len(payload) > MAX_BYTES:
        raise ValueError(f"a {envelope['topic']} of {len(payload)} bytes is longer than {MAX_BYTES}")
    return payload


@cache
def _fields(message: type[Message]) -> tuple[tuple[str, bool], ...]:
    """Names of a message's fields in their order, and whether each is always sent."""
    return tuple((name, field.is_required()) for name, field in message.model_fields.items())


def decode(payload: bytes, parts: Parts = WHOLE) -> Message:
    """Decode and check a message. Raises BadMessage, and nothing else, for anything that is not one.

    parts : of messages of these kinds what is read; whatever else they have is not looked at
    """
    topic, body = _open(payload, keeps_packed=bool(parts))
    kind = parts.get(BY_NAME[topic].message)
    try:
        if kind is not None:
            read = {name: body[name] for name in kind.model_fields if name in body}
            arrays = {n: _unpack_array(*value) for n, value in read.items() if isinstance(value, tuple)}
            return kind.model_validate(read | arrays)
        return BY_NAME[topic].message.model_validate(_open(payload)[1] if parts else body)
    except ValidationError as error:
        raise _invalid(topic, error) from None


def decode_answer(payload: bytes, kind: type[Kind]) -> Kind:
    """Decode and check the answer to a question, which is on no topic. Raises BadMessage, and nothing else."""
    topic, body = _open(payload, known=(name_of(kind),))
    try:
        return kind.model_validate(body)
    except ValidationError as error:
        raise _invalid(topic, error) from None


def _invalid(topic: str, error: ValidationError) -> BadMessage:
    first = error.errors(include_url=False, include_context=False, include_input=False)[0]
    where = ".".join(str(part) for part in (topic, *first["loc"]))
    return BadMessage(_line(f"{where}: {first['msg'].removeprefix('Value error, ')}"))


def fields(payload: bytes) -> dict[str, Any]:
    """Fields of a message that was checked before it was stored: ten times faster than to decode it."""
    return _open(payload)[1]


def join(payloads: Sequence[bytes]) -> bytes:
    """Encoded messages as one payload; a single one stays as it is."""
    joined: bytes = payloads[0] if len(payloads) == 1 else msgpack.packb(list(payloads))
    return joined


def split(payload: bytes) -> list[bytes]:
    """Encoded messages of a payload, one or several. Raises BadMessage if it claims to be several and is not."""
    if not payload or payload[0] not in _ARRAYS:
        return [payload]
    if len(payload) > MAX_BYTES:
        raise BadMessage(f"{len(payload)} bytes, more than {MAX_BYTES}")
    try:
        payloads: list[bytes] = _unpacked(payload)
    except BadMessage:
        raise
    except (ValueError, OverflowError) as error:
        raise BadMessage(_line(f"not MessagePack: {error or type(error).__name__}")) from None
    if not 0 < len(payloads) <= MAX_LOT or not all(isinstance(one, bytes) for one in payloads):
        raise BadMessage(f"not a lot of 1 .. {MAX_LOT} messages")
    return payloads


def renamed(payload: bytes, run: str, name: str) -> bytes:
    """The encoding of the same message under another run's name: it is the first field of every body."""
    before, found, after = payload.partition(_run(run))
    if not found:
        raise ValueError(f"no message of {run}")
    return before + _run(name) + after


def _run(name: str) -> bytes:
    field: bytes = msgpack.packb("run") + msgpack.packb(name)
    return field


def _open(payload: bytes, *, keeps_packed: bool = False, known: Container[str] = BY_NAME) -> tuple[str, dict[str, Any]]:
    """Topic and body of an envelope of this schema; `keeps_packed`: its arrays as (type, bytes)."""
    if not isinstance(payload, bytes):  # SQLite keeps anything in any column
        raise BadMessage(f"{type(payload).__name__} instead of bytes")
    if len(payload) > MAX_BYTES:
        raise BadMessage(f"{len(payload)} bytes, more than {MAX_BYTES}")
    try:
        envelope = _unpacked(payload, keeps_packed=keeps_packed)
    except BadMessage:
        raise
    except (ValueError, OverflowError) as error:  # broken, truncated, nested too deeply, more than one object
        raise BadMessage(_line(f"not MessagePack: {error or type(error).__name__}")) from None
    if not isinstance(envelope, dict) or set(envelope) != {"v", "topic", "body"}:
        raise BadMessage("not an envelope of v, topic and body")
    version, topic, body = envelope["v"], envelope["topic"], envelope["body"]
    if type(version) is not int or version != SCHEMA:
        raise BadMessage(_line(f"schema {reprlib.repr(version)}, expected {SCHEMA}"))
    if not isinstance(topic, str) or topic not in known:
        raise BadMessage(_line(f"unknown topic {reprlib.repr(topic)}"))
    if not isinstance(body, dict):
        raise BadMessage(f"{topic}: the body is not a map")
    return topic, body


def _unpacked(payload: bytes, *, keeps_packed: bool = False) -> Any:
    """What a payload holds. Raises BadMessage, or an error of msgpack."""
    budget = _Budget()
    return msgpack.unpackb(
        payload,
        ext_hook=budget.packed if keeps_packed else budget.array,
        list_hook=budget.list,
        object_hook=budget.map,
        max_array_len=MAX_ITEMS,
        max_map_len=MAX_KEYS,
    )


class _Budget:
    """How much of one payload may still be unpacked."""

    __slots__ = ("arrays", "items", "lists", "maps")

    def __init__(self) -> None:
        self.arrays, self.maps, self.lists, self.items = MAX_ARRAYS, MAX_MAPS, MAX_LISTS, MAX_ITEMS

    def list(self, value: list[Any]) -> list[Any]:
        self.lists -= 1
        self.items -= len(value)
        if self.lists < 0 or self.items < 0:
            raise BadMessage(f"more than {MAX_LISTS} lists or {MAX_ITEMS} items of them")
        return value

    def map(self, value: dict[str, Any]) -> dict[str, Any]:
        self.maps -= 1
        if self.maps < 0:
            raise BadMessage(f"more than {MAX_MAPS} maps")
        return value

    def packed(self, code: int, data: bytes) -> tuple[int, bytes]:
        self.arrays -= 1
        if self.arrays < 0:
            raise BadMessage(f"more than {MAX_ARRAYS} arrays")
        return code, data

    def array(self, code: int, data: bytes) -> NDArray[Any]:
        return _unpack_array(*self.packed(code, data))


def _packed(value: object) -> msgpack.ExtType | dict[str, object]:
    """What stands for an array, or for a part of a message."""
    if isinstance(value, np.ndarray) and (name := NAMES.get(value.dtype)) is not None:
        return msgpack.ExtType(ARRAY, _HEADS[value.ndim].pack(name, value.ndim, *value.shape) + value.tobytes())
    if isinstance(value, Compared):
        return vars(value)
    if isinstance(value, Rows):
        return _packed(value.array)
    raise TypeError(f"{type(value).__name__} cannot be sent")


def _unpack_array(code: int, data: bytes) -> NDArray[Any]:
    """Array of an extension value. It is copied out of the payload.

    A view would be read-only and unaligned, for which Numba compiles every kernel once more and may round otherwise.
    """
    if code != ARRAY or len(data) < 3:
        raise BadMessage(f"extension type {code} of {len(data)} bytes is not an array")
    dtype, n_axis = DTYPES.get(data[:2]), data[2]
    start = 3 + 4 * n_axis
    if dtype is None or n_axis > 2 or len(data) < start:
        raise BadMessage("array of a kind that is never sent")
    _, _, *shape = _HEADS[n_axis].unpack_from(data)
    if len(data) != start + dtype.itemsize * math.prod(shape):
        raise BadMessage(f"array of shape {tuple(shape)} does not fit its {len(data)} bytes")
    return np.ndarray(shape, dtype, data, start).copy()


def _line(text: str) -> str:
    return printable(text[:200])
