"""A reader and a writer of messages that know MessagePack and nothing of cogradar.

Content is as JSON has it: an array is {"dtype", "shape", "values"}, of complex numbers real and imaginary parts in
turn; bytes are {"base64"}. A float has a decimal point in JSON, a whole number has none.
"""

import base64
import math
import struct
from typing import Any

import msgpack

ELEMENTS = {"i4": ("i", 1), "f8": ("d", 1), "c8": ("f", 2)}  # code of struct; numbers in an element


def read(payload: bytes) -> Any:
    """Content of an encoded message."""
    return _named(msgpack.unpackb(payload, ext_hook=_array))


def written(content: Any) -> bytes:
    """An encoded message."""
    payload: bytes = msgpack.packb(_sent(content))
    return payload


def _array(code: int, data: bytes) -> dict[str, Any]:
    dtype, n_axis = data[:2].decode(), data[2]
    shape = struct.unpack_from(f"<{n_axis}I", data, 3)
    element, n = ELEMENTS[dtype]
    values = struct.unpack(f"<{n * math.prod(shape)}{element}", data[3 + 4 * n_axis :])
    assert code == 1
    return {"dtype": dtype, "shape": list(shape), "values": list(values)}


def _named(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _named(part) for key, part in value.items()}
    if isinstance(value, list):
        return [_named(part) for part in value]
    return {"base64": base64.b64encode(value).decode()} if isinstance(value, bytes) else value


def _sent(content: Any) -> Any:
    if isinstance(content, list):
        return [_sent(part) for part in content]
    if not isinstance(content, dict):
        return content
    if content.keys() == {"base64"}:
        return base64.b64decode(content["base64"])
    if content.keys() == {"dtype", "shape", "values"}:
        head = struct.pack(
            f"<2sB{len(content['shape'])}I", content["dtype"].encode(), len(content["shape"]), *content["shape"]
        )
        element, _ = ELEMENTS[content["dtype"]]
        return msgpack.ExtType(1, head + struct.pack(f"<{len(content['values'])}{element}", *content["values"]))
    return {key: _sent(part) for key, part in content.items()}
