"""MessagePack on the wire: an envelope with schema and topic, arrays as an extension type. Nothing is ever pickled."""

import struct
from typing import Any

import msgpack
import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from shared.messages import SCHEMA, Message
from shared.topics import BY_MESSAGE, BY_NAME

MAX_BYTES = 16 * 2**20  # of one message; the largest, a scan of 1024 cells, has 40 kB
_ARRAY = 1  # extension type: dtype (2 bytes), number of axes, shape, raw little-endian data
_DTYPES: dict[bytes, np.dtype[Any]] = {name: np.dtype(f"<{name.decode()}") for name in (b"i4", b"f8", b"c8")}
_NAMES = {dtype: name for name, dtype in _DTYPES.items()}


class BadMessage(ValueError):
    """Bytes that are not a valid message; the text says why, in one line."""


def encode(message: Message) -> bytes:
    """Bytes of a message; equal messages give equal bytes."""
    body = {name: getattr(message, name) for name in type(message).model_fields}
    envelope = {"v": SCHEMA, "topic": BY_MESSAGE[type(message)].name, "body": body}
    packed: bytes = msgpack.packb(envelope, default=_pack_array)
    return packed


def decode(payload: bytes) -> Message:
    """Message of some bytes, validated; raises BadMessage for anything else."""
    if len(payload) > MAX_BYTES:
        raise BadMessage(f"{len(payload)} bytes, at most {MAX_BYTES} are allowed")
    try:
        envelope = msgpack.unpackb(payload, ext_hook=_unpack_array)
    except (ValueError, TypeError, OverflowError, msgpack.UnpackException) as error:
        raise BadMessage(f"not a message: {type(error).__name__} {error}".strip()) from None
    if not isinstance(envelope, dict) or set(envelope) != {"v", "topic", "body"}:
        raise BadMessage("not an envelope of v, topic and body")
    if envelope["v"] != SCHEMA:
        raise BadMessage(f"schema {envelope['v']!r}, this program speaks {SCHEMA}")
    topic = BY_NAME.get(envelope["topic"]) if isinstance(envelope["topic"], str) else None
    if topic is None:
        raise BadMessage(f"unknown topic {envelope['topic']!r:.80}")
    try:
        return topic.message.model_validate(envelope["body"])
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise BadMessage(f"{topic.name}: {where}: {first['msg']}"[:300]) from None


def _pack_array(value: Any) -> msgpack.ExtType:
    if not isinstance(value, np.ndarray) or value.dtype not in _NAMES:
        raise TypeError(f"cannot be sent: {type(value).__name__} {getattr(value, 'dtype', '')}")
    head = _NAMES[value.dtype] + struct.pack(f"<B{value.ndim}I", value.ndim, *value.shape)
    return msgpack.ExtType(_ARRAY, head + value.tobytes())


def _unpack_array(code: int, data: bytes) -> NDArray[Any]:
    if code != _ARRAY or len(data) < 3 or data[:2] not in _DTYPES:
        raise ValueError(f"extension type {code} or its array type is unknown")
    ndim = data[2]
    start = 3 + 4 * ndim
    if ndim > 2 or len(data) < start:
        raise ValueError("array header is broken")
    dtype, shape = _DTYPES[data[:2]], struct.unpack_from(f"<{ndim}I", data, 3)
    # A copy: aligned in memory, and independent of the buffer it came in.
    array: NDArray[Any] = np.frombuffer(data, dtype=dtype, offset=start).reshape(shape).copy()
    array.flags.writeable = False
    return array
