"""The fields of messages: arrays of one kind and size, ids, counters; with what is allowed in each.

In JSON an array is its kind, its shape and its elements in C order; of a complex number two, real and imaginary part.
Bytes are an object with their Base64.
"""

import hashlib
import marshal
from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, Field, PlainValidator, WithJsonSchema

from cogradar.shared.scenario import limits
from cogradar.shared.scenario.files import parse_radar, parse_world
from cogradar.shared.scenario.plugins.names import MAX_NAME, PATTERN

MAX_SIDE = 4096  # longest axis of any array in a message, particles apart
# In a Snapshot: with twice as many and 100 misses over 1024 bins it still is a message.
MAX_PARTICLES = limits.MOST_STATES
MIN_RATE_HZ, MAX_RATE_HZ = 0.001, 1000.0
MAX_HISTORY = 256  # Messages of a History.
MAX_CELLS = limits.MAX_CELLS
MAX_BEAMS = 1024  # Beams of a track in a dwell: a look may be widened over the whole grid
MIXTURE = (3, 31)  # numbers of a belief of Gaussians: weight, mean and covariance of each mode of motion
MAX_UNSEEN = 64  # Newest dwells without a scan that a plan names.
FAR = limits.FAR
LARGEST = 1e60  # of any number in an array, so that products of several are finite; 1 / LARGEST: of a divisor the least


def is_any(condition: NDArray[np.bool_]) -> bool:
    """Whether any element is true, (...). Of few elements NumPy's own `any` takes ten times as long."""
    return bool(np.count_nonzero(condition))


def is_all(condition: NDArray[np.bool_]) -> bool:
    """Whether all elements are true, (...)."""
    return bool(np.count_nonzero(condition) == condition.size)


def are_among(values: NDArray[Any], others: NDArray[Any]) -> bool:
    """Whether each value is one of the others; (...), (...). NaN is none. As of `is_any` for `numpy.isin`."""
    return set(others.ravel().tolist()).issuperset(values.ravel().tolist())


def _is_small(value: NDArray[Any]) -> bool:
    """Whether all numbers are finite and at most LARGEST; `<=` is false of NaN, too, and no complex64 is larger.

    The sum of the squares tells it at a third of the cost, unless it is too large, or too large for a complex64.
    """
    parts = value.ravel()
    parts = parts.view(np.float32) if value.dtype.kind == "c" else parts
    if float(np.vdot(parts, parts)) <= LARGEST**2:
        return True
    return is_all(np.abs(value) <= LARGEST if value.dtype.kind == "f" else np.isfinite(value))


def _array(dtype: str, ndim: int, longest: int = MAX_SIDE) -> PlainValidator:
    expected = np.dtype(dtype)

    def check(value: Any) -> NDArray[Any]:
        if not isinstance(value, np.ndarray) or value.dtype != expected:
            raise ValueError(f"must be an array of {expected}")
        if value.ndim != ndim or max(value.shape) > longest:
            raise ValueError(f"must have {ndim} axes of at most {longest}, got shape {value.shape}")
        if expected.kind != "i" and not _is_small(value):
            raise ValueError(f"must be finite, at most {LARGEST:g} in size")
        return value

    return PlainValidator(check)


def _json(
    dtype: str,
    ndim: int,
    *,
    longest: int = MAX_SIDE,
    shape: tuple[int, ...] = (),
    size: float = LARGEST,
    low: float | None = None,
    only: str = "",
) -> WithJsonSchema:
    """JSON schema of an array.

    longest : of any axis; shape : fixed; size : of an element at most; low : of an element at least; only : in words
    """
    number = "integer" if dtype == "i4" else "number"
    limits = {} if dtype == "i4" and low is None else {"minimum": -size if low is None else low, "maximum": size}
    side = {"type": "integer", "minimum": 0, "maximum": longest}
    name = {"i4": "int32", "f8": "float64", "c8": "complex64"}[dtype]
    axes = str(shape) if shape else f"{ndim} {'axis' if ndim == 1 else 'axes'}"
    return WithJsonSchema(
        {
            "type": "object",
            "title": f"{name}, {axes}" + (f"; {only}" if only else ""),
            "properties": {
                "dtype": {"const": dtype},
                "shape": {"const": list(shape)}
                if shape
                else {"type": "array", "items": side, "minItems": ndim, "maxItems": ndim},
                "values": {"type": "array", "items": {"type": number, **limits}},
            },
            "required": ["dtype", "shape", "values"],
            "additionalProperties": False,
        }
    )


def _state(value: NDArray[np.float64]) -> NDArray[np.float64]:
    if value.shape != (4,) or max(map(abs, value.tolist())) > FAR:
        raise ValueError(f"must be one state [x, vx, y, vy] within {FAR:g} km and km/s")
    return value


def _measured(value: NDArray[np.float64]) -> NDArray[np.float64]:
    if is_any((value != 0.0) & (value < 1.0 / LARGEST)):
        raise ValueError(f"must be 0, or {1.0 / LARGEST:g} .. {LARGEST:g}")
    return value


def _within(value: NDArray[np.float64]) -> NDArray[np.float64]:
    if is_any(np.abs(value) > FAR):
        raise ValueError(f"must be states within {FAR:g} km and km/s")
    return value


def _covariance(value: NDArray[np.float64]) -> NDArray[np.float64]:
    if value.shape != (4, 4) or max(map(abs, value.ravel().tolist())) > FAR**2:
        raise ValueError(f"must be (4, 4), within {FAR**2:g} km^2 and km^2/s^2")
    if value.tolist() != value.T.tolist() or min(value.diagonal().tolist()) < 0.0:
        raise ValueError("must be symmetric, with variances of 0 or more")
    return value


def _cells(value: NDArray[np.int32]) -> NDArray[np.int32]:
    if value.size > MAX_CELLS or not all(0 <= b <= MAX_SIDE for b in value.tolist()):
        raise ValueError(f"must be at most {MAX_CELLS} bins, 0 .. {MAX_SIDE}")
    return value


def _beams(value: NDArray[np.int32]) -> NDArray[np.int32]:
    if not 1 <= value.shape[1] <= MAX_BEAMS:
        raise ValueError(f"must have 1 .. {MAX_BEAMS} columns, got {value.shape[1]}")
    is_lit = value != -1
    if is_any(is_lit[:, 1:] > is_lit[:, :-1]):
        raise ValueError("-1 must be behind the last cell of a row")
    return value


def are_divisors(value: NDArray[np.float64]) -> bool:
    """Whether numbers are 0, which nothing is divided by, or large enough that something can be."""
    return not is_any((value > 0.0) & (value < 1.0 / LARGEST))


def check_different(cells: NDArray[Any]) -> None:
    """ValueError unless the cells of each row, (M, L) with -1 for none, are all different."""
    if cells.shape[1] < 2:
        return
    ordered = np.sort(cells, axis=1)
    if is_any((ordered[:, 1:] == ordered[:, :-1]) & (ordered[:, 1:] != -1)):
        raise ValueError("the cells of a track must all be different")


def _chances(value: NDArray[np.float64]) -> NDArray[np.float64]:
    if not all(0.0 <= p <= 1.0 for p in value.tolist()):
        raise ValueError("must be 0 .. 1")
    return value


def _gate(value: NDArray[np.float64]) -> NDArray[np.float64]:
    if value.shape != (2,) or not 0.0 <= value[0] <= value[1] <= FAR:
        raise ValueError(f"must be two ranges, 0 <= low <= high <= {FAR:g} km")
    return value


def _rate(value: float) -> float:
    if 0.0 < value < MIN_RATE_HZ:
        raise ValueError(f"must be 0, or {MIN_RATE_HZ:g} .. {MAX_RATE_HZ:g}")
    return value


def _ascending(values: list[int]) -> list[int]:
    if values != sorted(set(values)):
        raise ValueError("must ascend")
    return values


def _different(values: list[int]) -> list[int]:
    if len(set(values)) < len(values):
        raise ValueError("must all be different")
    return values


Ints = Annotated[NDArray[np.int32], _array("i4", 1), _json("i4", 1)]
Beams = Annotated[NDArray[np.int32], _array("i4", 2), AfterValidator(_beams), _json("i4", 2, low=-1, size=2**31 - 1)]
Cells = Annotated[
    NDArray[np.int32],
    _array("i4", 1),
    AfterValidator(_cells),
    _json("i4", 1, longest=MAX_CELLS, low=0, size=MAX_SIDE, only=f"at most {MAX_CELLS}"),
]
Floats = Annotated[NDArray[np.float64], _array("f8", 1), _json("f8", 1)]
Measured = Annotated[
    NDArray[np.float64],
    _array("f8", 1),
    AfterValidator(_measured),
    _json("f8", 1, low=0.0, only=f"0, or {1.0 / LARGEST:g} .. {LARGEST:g}"),
]
FloatLists = Annotated[NDArray[np.float64], _array("f8", 2), _json("f8", 2)]
Chances = Annotated[
    NDArray[np.float64],
    _array("f8", 1),
    AfterValidator(_chances),
    _json("f8", 1, longest=MAX_CELLS, low=0.0, size=1.0, only="0 .. 1"),
]
Gate = Annotated[
    NDArray[np.float64], _array("f8", 1), AfterValidator(_gate), _json("f8", 1, shape=(2,), low=0.0, size=FAR)
]
State = Annotated[NDArray[np.float64], _array("f8", 1), AfterValidator(_state), _json("f8", 1, shape=(4,), size=FAR)]
States = Annotated[NDArray[np.float64], _array("f8", 2), _json("f8", 2)]
Covariance = Annotated[
    NDArray[np.float64], _array("f8", 2), AfterValidator(_covariance), _json("f8", 2, shape=(4, 4), size=FAR**2)
]
Particles = Annotated[
    NDArray[np.float64],
    _array("f8", 2, MAX_PARTICLES),
    AfterValidator(_within),
    _json("f8", 2, longest=MAX_PARTICLES, size=FAR),
]
# What a complex64 holds is less than LARGEST.
Complexes = Annotated[NDArray[np.complex64], _array("c8", 1), _json("c8", 1)]
Factor = Annotated[NDArray[np.complex64], _array("c8", 2), _json("c8", 2)]
_BYTES = {
    "type": "object",
    "title": "bytes",
    "properties": {"base64": {"type": "string", "contentEncoding": "base64"}},
    "required": ["base64"],
    "additionalProperties": False,
}
Payload = Annotated[bytes, WithJsonSchema(_BYTES)]

RunId = Annotated[
    str,
    Field(
        pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$",
        description="1 to 64 letters, digits, '.', '_' and '-', the first a letter or digit",
    ),
]
OwnName = Annotated[
    str, Field(pattern=PATTERN, max_length=MAX_NAME, description="a user's own thing: SOURCE:NAME#HASH")
]
PROCESS_NAME = r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}(@[0-9]{1,2}-[0-9]{1,2})?"
ProcessName = Annotated[
    str,
    Field(
        pattern=f"^{PROCESS_NAME}$",
        description="1 to 64 letters, digits, '.', '_' and '-', the first a letter or digit; of a planner with slots,"
        " @FIRST-LAST behind them",
    ),
]
Index = Annotated[int, Field(ge=0, le=2**31 - 1)]
UtcSeconds = Annotated[float, Field(ge=0, lt=7_258_118_400.0)]  # since 1970, before the year 2200, as `site.begin_utc`
Count = Annotated[int, Field(ge=0, lt=2**48)]  # of a run: up to MAX_SIDE things, twice in each of its dwells
Indices = Annotated[list[Index], Field(min_length=1, max_length=MAX_SIDE), AfterValidator(_different)]
Lacking = Annotated[list[Index], Field(max_length=MAX_SIDE)] | None  # tracks; None: more than of tracks
Skipped = Annotated[int, Field(ge=1, lt=2**31)]
Unseen = Annotated[list[Index], Field(min_length=1, max_length=MAX_UNSEEN), AfterValidator(_ascending)]
Size = Annotated[float, Field(ge=0, le=LARGEST)]
Product = Annotated[float, Field(ge=0, le=LARGEST**3)]  # of sizes
Rate = Annotated[float, Field(ge=0, le=MAX_RATE_HZ), AfterValidator(_rate)]  # of dwells a second; 0: in lockstep
MAX_EPOCH = 2**62
Epoch = Annotated[int, Field(ge=0, le=MAX_EPOCH)]
Revision = Annotated[int, Field(ge=0, le=MAX_EPOCH)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]


class _Complete:
    """Completes documents of a kind, each once: every checkpoint says them, and hundreds of targets take 10 ms."""

    def __init__(self, parse: Callable[[dict[str, Any], str], BaseModel], name: str) -> None:
        self._parse, self._name = parse, name
        self._known: dict[bytes, dict[str, Any]] = {}

    def __call__(self, document: dict[str, Any]) -> dict[str, Any]:
        try:
            key = hashlib.blake2b(marshal.dumps(document, _WITHOUT_REFERENCES)).digest()
        except ValueError:  # trajectories that were never encoded
            return self._parse(document, self._name).model_dump()
        if (known := self._known.get(key)) is not None:
            return known
        complete = self._parse(document, self._name).model_dump()
        while len(self._known) >= KEPT:
            del self._known[next(iter(self._known))]
        self._known[key] = complete
        return complete


KEPT = 4  # of a kind, of the runs that go on in a process
_WITHOUT_REFERENCES = 2  # version in which equal documents are equal bytes
World = Annotated[dict[str, Any], AfterValidator(_Complete(parse_world, "world"))]
Radar = Annotated[dict[str, Any], AfterValidator(_Complete(parse_radar, "radar"))]
