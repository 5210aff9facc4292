"""Messages with something wrong, drawn from keyed seeds: most of them still are MessagePack, and many a message."""

from collections.abc import Callable, Sequence
from typing import Any

import msgpack
import numpy as np

from cogradar.shared.wire.codec import BadMessage, _packed, _unpack_array, decode, encode

Rng = np.random.Generator
FLOATS = (np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324, -5e-324, 0.0, -0.0, -1.0, 1.0, 0.5, -0.5, 1e-300, 1e9, 1e18)
WHOLE = (-(2**63), -(2**31), -2, -1, 0, 1, 2, 3, 7, 15, 16, 255, 4096, 10**6, 2**31 - 1, 2**31, 2**63 - 1, 2**64 - 1)
OTHERS: tuple[Any, ...] = (None, True, False, "", "x", "another-run", "a/b", "*", b"", b"\x00", [], {}, [0], {"k": 0})
FACTORS = (0.0, -1.0, 1e-12, 0.5, 0.999, 1.001, 2.0, 1e12, 1e300)
DTYPES = ("<i4", "<f8", "<c8")


def mutant(rng: Rng, payloads: Sequence[bytes]) -> bytes:
    """One of these messages, changed: its bytes now and then, else one or two of its fields."""
    payload = payloads[int(rng.integers(len(payloads)))]
    if rng.random() < 0.15:
        return _BYTES[int(rng.integers(len(_BYTES)))](rng, payload, payloads[int(rng.integers(len(payloads)))])
    envelope = msgpack.unpackb(payload, ext_hook=_unpack_array)
    for _ in range(1 + int(rng.random() < 0.3)):
        inside = rng.random() < 0.97
        _change(rng, envelope["body"] if inside and isinstance(envelope.get("body"), dict) else envelope)
    try:
        packed: bytes = msgpack.packb(envelope, default=_packed)
    except (ValueError, OverflowError, TypeError):  # what cannot even be packed is nobody's message
        return payload[:-1]
    return packed


# Bytes.


def _flipped(rng: Rng, payload: bytes, _other: bytes) -> bytes:
    changed = bytearray(payload)
    for _ in range(1 + int(rng.integers(4))):
        changed[rng.integers(len(changed))] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def _truncated(rng: Rng, payload: bytes, _: bytes) -> bytes:
    return payload[: int(rng.integers(len(payload)))]


def _spliced(rng: Rng, payload: bytes, other: bytes) -> bytes:
    return payload[: rng.integers(len(payload))] + other[rng.integers(len(other)) :]


def _repeated(rng: Rng, payload: bytes, _: bytes) -> bytes:
    at, size = int(rng.integers(len(payload))), int(rng.integers(64))
    return payload[:at] + size * payload[at : at + 1] + payload[at:]


_BYTES: tuple[Callable[[Rng, bytes, bytes], bytes], ...] = (_flipped, _truncated, _spliced, _repeated)


# Fields.


def _change(rng: Rng, where: Any) -> None:
    """Change a map or list in place: in one of its places, or further within."""
    places: list[Any] = list(where) if isinstance(where, dict) else list(range(len(where)))
    if not places or rng.random() < 0.02:
        _reshape(rng, where)
        return
    place = places[rng.integers(len(places))]
    value = where[place]
    if isinstance(value, dict | list) and value and rng.random() < 0.9:
        _change(rng, value)
    else:
        where[place] = _other(rng, value)


def _reshape(rng: Rng, where: Any) -> None:
    """Something more, or something less."""
    if isinstance(where, dict):
        if where and rng.random() < 0.5:
            del where[list(where)[rng.integers(len(where))]]
        else:
            where["more"] = OTHERS[rng.integers(len(OTHERS))]
    elif where and rng.random() < 0.5:
        del where[rng.integers(len(where))]
    else:
        where.append(where[0] if where else 0)


def _other(rng: Rng, value: Any) -> Any:  # noqa: PLR0911 - a case each
    """Another value: mostly of the same kind."""
    if rng.random() < 0.1:
        return OTHERS[rng.integers(len(OTHERS))]
    match value:
        case np.ndarray():
            return _array(rng, value)
        case bool():
            return not value
        case int():
            return value + int(rng.integers(-3, 4)) if rng.random() < 0.5 else WHOLE[rng.integers(len(WHOLE))]
        case float():
            scaled = rng.random() < 0.4
            return value * FACTORS[rng.integers(len(FACTORS))] if scaled else FLOATS[rng.integers(len(FLOATS))]
        case bytes():
            return _inner(rng, value)
        case str():
            return (value[:-1], value + "x", value.upper(), 100 * value)[rng.integers(4)]
        case _:
            return OTHERS[rng.integers(len(OTHERS))]


def _inner(rng: Rng, payload: bytes) -> bytes:
    """A message within a message."""
    try:
        return mutant(rng, [encode(decode(payload))])
    except BadMessage:
        return payload


def _array(rng: Rng, value: Any) -> Any:  # noqa: PLR0911 - a case each
    """An array with something wrong."""
    match rng.integers(6):
        case 0:  # of another length
            axis = int(rng.integers(max(value.ndim, 1)))
            if value.ndim and value.shape[axis] and rng.random() < 0.5:
                return np.ascontiguousarray(np.delete(value, rng.integers(value.shape[axis]), axis))
            return np.concatenate((value, value[-1:])) if value.ndim else value
        case 1:  # of another type
            with np.errstate(all="ignore"):
                return value.real.astype(DTYPES[rng.integers(3)])
        case 2:  # of another shape
            return value.reshape(value.shape[::-1]) if rng.random() < 0.5 else value.reshape(-1)
        case 3 if value.dtype.kind != "i":  # of another size
            with np.errstate(all="ignore"):
                return (value * FACTORS[rng.integers(len(FACTORS))]).astype(value.dtype)
        case 4 if value.ndim and value.size > 1:  # in another order, or all the same
            flat = value.reshape(-1)
            return (flat[::-1] if rng.random() < 0.5 else np.full_like(flat, flat[0])).reshape(value.shape).copy()
        case _:
            changed = value.copy()
            if changed.size:
                extremes = WHOLE if value.dtype.kind == "i" else FLOATS
                with np.errstate(all="ignore"):
                    extreme = np.asarray(extremes[rng.integers(len(extremes))], dtype=object)
                    kept = int(extreme) % 2**31 if value.dtype.kind == "i" else extreme
                    if rng.random() < 0.2:
                        changed[...] = kept
                    else:
                        changed.reshape(-1)[rng.integers(changed.size)] = kept
            return changed
