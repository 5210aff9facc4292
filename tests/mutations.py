"""Messages that are broken at random: bytes, and fields of what still is MessagePack."""

import struct
from collections.abc import Sequence
from copy import deepcopy
from typing import Any

import msgpack
import numpy as np

INTS = (0, 1, -1, 2, 255, 4096, 4097, 2**31 - 1, 2**31, 2**53, 2**63 - 1, -(2**63))
FLOATS = (
    0.0,
    -0.0,
    1.0,
    -1.0,
    0.5,
    1e-300,
    5e-324,
    1e9,
    1e155,
    1e308,
    -1e308,
    float("nan"),
    float("inf"),
    -float("inf"),
)
TEXTS = ("", "r", "r2", "x" * 65, "*", "a/b", "..", "\u202e", "power-aware", "ended", "unknown")
OTHERS: tuple[Any, ...] = (
    None,
    True,
    False,
    b"",
    b"\x00" * 9,
    [],
    {},
    [[]] * 3,
    {"a": 1},
    *TEXTS[:3],
    *INTS[:4],
    *FLOATS[-4:],
)
NAMES = {b"i4": "<i4", b"f8": "<f8", b"c8": "<c8"}


def mutated(payload: bytes, others: Sequence[bytes], rng: np.random.Generator) -> bytes:
    """A payload with something wrong; now and then with nothing that anybody could tell from the truth."""
    if rng.random() < 0.25:
        return _bytes(payload, others, rng)
    envelope = msgpack.unpackb(payload)
    for _ in range(1 + int(rng.integers(3)) * int(rng.integers(2))):
        _field(envelope if rng.random() < 0.05 else envelope.get("body"), rng)
    return bytes(msgpack.packb(envelope))


def _bytes(payload: bytes, others: Sequence[bytes], rng: np.random.Generator) -> bytes:
    at = int(rng.integers(len(payload)))
    match rng.integers(4):
        case 0:
            return payload[:at]
        case 1:
            other = others[int(rng.integers(len(others)))]
            return payload[:at] + other[int(rng.integers(len(other))) :]
        case 2:
            return payload[:at] + rng.bytes(int(rng.integers(1, 9))) + payload[at:]
        case _:
            changed = bytearray(payload)
            for place in rng.integers(len(payload), size=int(rng.integers(1, 5))):
                changed[place] ^= 1 << int(rng.integers(8))
            return bytes(changed)


def _field(body: Any, rng: np.random.Generator) -> None:
    """Change, drop or add one field, however deep."""
    while isinstance(body, dict | list) and body:
        key = list(body)[rng.integers(len(body))] if isinstance(body, dict) else int(rng.integers(len(body)))
        inner = body[key]
        if isinstance(inner, dict | list) and inner and rng.random() < 0.9:
            body = inner
            continue
        chance = rng.random()
        if chance < 0.05:
            del body[key]
        elif chance < 0.1 and isinstance(body, dict):
            body[f"{key}x"] = inner
        else:
            body[key] = _value(inner, rng)
        return


def _value(value: Any, rng: np.random.Generator) -> Any:  # noqa: PLR0911 - one for each kind
    if rng.random() < 0.1:
        return deepcopy(OTHERS[rng.integers(len(OTHERS))])
    match value:
        case bool():
            return not value
        case int():
            near = (max(value - 1, -(2**63)), min(value + 1, 2**63), value % 7)
            return (*INTS, *near)[rng.integers(len(INTS) + len(near))]
        case float():
            near_by = (value * (1.0 + float(rng.normal())), -value, value * 10.0 ** int(rng.integers(-12, 13)))
            return float((*FLOATS, *near_by)[rng.integers(len(FLOATS) + len(near_by))])
        case str():
            return TEXTS[rng.integers(len(TEXTS))]
        case msgpack.ExtType():
            return msgpack.ExtType(value.code, _array(value.data, rng))
        case bytes():
            return _bytes(value, [value], rng) if value else b"\x00"
        case _:
            return deepcopy(OTHERS[rng.integers(len(OTHERS))])


def _array(data: bytes, rng: np.random.Generator) -> bytes:
    """Other elements, another shape or another kind of an array on the wire."""
    name, n_axis = data[:2], data[2]
    start = 3 + 4 * n_axis
    shape = struct.unpack_from(f"<{n_axis}I", data, 3)
    array = np.frombuffer(data[start:], NAMES[name]).reshape(shape).copy()
    chance = rng.random()
    if chance < 0.7 and array.size:
        kind = array.dtype.kind
        extremes = [i for i in INTS if -(2**31) <= i < 2**31] if kind == "i" else FLOATS
        chosen = extremes[rng.integers(len(extremes))]
        where = slice(None) if rng.random() < 0.2 else int(rng.integers(array.size))
        with np.errstate(over="ignore", invalid="ignore"):
            array.flat[where] = array.flat[where] + chosen if rng.random() < 0.2 and kind != "i" else chosen
    elif chance < 0.8 and array.ndim == 2:
        array = array.T
    elif chance < 0.9:
        array = np.concatenate([array, array]) if rng.random() < 0.5 else array[: int(rng.integers(len(array) + 1))]
    else:
        kinds = list(NAMES)
        name = kinds[rng.integers(3)]
        with np.errstate(all="ignore"):
            array = array.real.astype(NAMES[name])
    head = struct.pack(f"<2sB{array.ndim}I", name, array.ndim, *array.shape)
    return head + array.tobytes()
