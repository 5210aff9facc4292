"""A cache of the results of pure functions, since a simulation plays the same runs many thousand times.

Exact: the key is a digest of all arguments, arrays bit for bit. Cached results are read-only. Now and then a result is
computed again, so that a function that is not pure is found. A message that is encoded is known only as the same
object: to tell an equal one takes longer than to encode it.
"""

import dataclasses
import hashlib
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import wraps
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel

from cogradar.services.allocator.track_update import updated
from cogradar.services.allocator.waveform import waveform
from cogradar.services.emulator.cycle import scan_message, transmission
from cogradar.services.planner.decision import decide
from cogradar.services.planner.owned_track import born_of, detections_of
from cogradar.services.simulation.front_end import simulated
from cogradar.shared.scenario.files import parse, parse_radar, parse_world
from cogradar.shared.tracking.track import observe, start
from cogradar.shared.wire.codec import decode, encode

T = TypeVar("T")
PACKAGES = ("cogradar.services.", "cogradar.shared.")
# Functions whose stored result saves more time than its key takes to compute. Not what a run warms up with: a decision
# of one simulation, taken in each run, is what shows a search that is not pure.
FUNCTIONS: tuple[Callable[..., Any], ...] = (
    born_of,
    decode,
    decide,
    detections_of,
    encode,
    observe,
    parse,
    parse_radar,
    parse_world,
    scan_message,
    simulated,
    start,
    transmission,
    updated,
    waveform,
)


AGAIN = 100  # results that are taken as they are known, before one is computed again and compared


class Impure(AssertionError):
    """A function whose result depends on more than its arguments."""


_PLAIN = frozenset({bool, float, int, str, type(None)})  # most of what is within arguments
_FIELDS = "_fields"  # what only named tuples have
_MISSING = object()
_NONE: Mapping[str, Any] = MappingProxyType({})


class Memory:
    """Results by key, and digests of objects; all are forgotten when there are too many."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._results: dict[object, Any] = {}
        self._digests: dict[int, tuple[object, bytes]] = {}  # of objects that do not change, which stay alive here
        self._encoded: dict[int, tuple[object, Any]] = {}  # likewise
        self._n_known = 0  # results that were asked for and known

    def result(self, function: Callable[..., T], args: tuple[Any, ...], named: Mapping[str, Any] = _NONE) -> T:
        """The result of a function of these arguments, computed once as a rule. Raises Impure."""
        key = self._key(function, (*args, *named.items()))
        known = self._results.get(key, _MISSING)
        if known is not _MISSING:
            found: T = known
            self._n_known += 1
            if self._n_known % AGAIN == 0:
                self._compare(function, found, function(*args, **named))
            return found
        if len(self._results) >= self._most:
            self._results.clear()
        made = function(*args, **named)
        _freeze(made)
        self._results[key] = made
        return made

    def encoded(self, function: Callable[..., T], args: tuple[Any, ...], _named: Mapping[str, Any] = _NONE) -> T:
        """The result of a function, computed at most once for this object."""
        (value,) = args
        if (known := self._encoded.get(id(value))) is not None:
            found: T = known[1]
            return found
        if len(self._encoded) >= self._most:
            self._encoded.clear()
        made = function(value)
        self._encoded[id(value)] = value, made
        return made

    def _compare(self, function: Callable[..., T], found: T, again: T) -> None:
        keys = [hashlib.blake2b(digest_size=16) for _ in range(2)]
        for key, value in zip(keys, (found, again), strict=True):
            self._add(key, value)
        if keys[0].digest() != keys[1].digest():
            raise Impure(f"{function.__qualname__}: two results of the same arguments")

    def _key(self, function: Callable[..., T], args: tuple[Any, ...]) -> object:
        if len(args) == 1 and type(args[0]) is bytes:
            return function.__qualname__, args[0]
        key = hashlib.blake2b(function.__qualname__.encode(), digest_size=16)
        for value in args:
            self._add(key, value)
        return key.digest()

    def _add(self, key: Any, value: Any) -> None:
        if type(value) in _PLAIN:
            key.update(f"{value!r},".encode())
        elif (known := self._digests.get(id(value))) is not None:
            key.update(known[1])
        else:
            self._add_other(key, value)

    def _add_other(self, key: Any, value: Any) -> None:
        match value:
            case np.ndarray():
                key.update(f"{value.dtype.str}{value.shape}".encode())
                key.update(value.tobytes())
            case bytes():
                key.update(b"%d:" % len(value) + value)
            case tuple() if hasattr(value, _FIELDS):
                key.update(self._digest(value))
            case tuple() | list():
                key.update(b"(%d" % len(value))
                for one in value:
                    self._add(key, one)
            case Mapping():
                key.update(repr(value).encode())
            case BaseModel():
                key.update(self._digest(value))
            case _ if dataclasses.is_dataclass(value):
                key.update(self._digest(value))
            case _ if callable(value):  # whether there is time: where results are remembered, it stands still meanwhile
                key.update(repr(value()).encode())
            case _ if repr(value).endswith(f" at {id(value):#x}>"):  # an address, which equal values do not share
                if getattr(value, "__dict__", None):
                    raise TypeError(f"{type(value).__qualname__} cannot be told by its value")
                key.update(f"{type(value).__qualname__},".encode())
            case _:
                key.update(f"{value!r},".encode())

    def _digest(self, value: Any) -> bytes:
        """Of an object of named fields, none of which is ever set anew."""
        if (known := self._digests.get(id(value))) is not None:
            return known[1]
        key = hashlib.blake2b(type(value).__qualname__.encode(), digest_size=16)
        for name in _names(value):
            self._add(key, getattr(value, name))
        if len(self._digests) >= self._most:
            self._digests.clear()
        self._digests[id(value)] = value, key.digest()
        return key.digest()


_NAMES: dict[type, tuple[str, ...]] = {}


def _names(value: Any) -> tuple[str, ...]:
    """Fields of a message, a named tuple, or a dataclass."""
    kind = type(value)
    if (known := _NAMES.get(kind)) is not None:
        return known
    if isinstance(value, BaseModel):
        names = tuple(type(value).model_fields)
    elif isinstance(value, tuple):
        names = tuple(getattr(value, _FIELDS))
    else:
        names = tuple(one.name for one in dataclasses.fields(value))
    return _NAMES.setdefault(kind, names)


@contextmanager
def remembering(most: int) -> Iterator[None]:
    """Cache results of FUNCTIONS in this process, at most so many.

    A function is replaced in every module that has it, since the product neither knows nor needs the cache.
    """
    memory = Memory(most)
    cached = [(function, _cached(memory, function)) for function in FUNCTIONS]
    _replace(cached)
    try:
        yield
    finally:
        _replace([(wrapper, function) for function, wrapper in cached])


def _cached(memory: Memory, function: Callable[..., T]) -> Callable[..., T]:
    result = memory.encoded if function is encode else memory.result

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> T:
        return result(function, args, kwargs)

    return call


def _replace(pairs: Sequence[tuple[Callable[..., Any], Callable[..., Any]]]) -> None:
    """Replace functions by others, in all modules of the program."""
    by_id = {id(old): new for old, new in pairs}
    for module in [module for name, module in sys.modules.items() if name.startswith(PACKAGES)]:
        for name, value in list(vars(module).items()):
            if module.__name__ != __name__ and id(value) in by_id:
                setattr(module, name, by_id[id(value)])


def _freeze(value: Any) -> None:
    if type(value) in _PLAIN:
        return
    if isinstance(value, np.ndarray):
        value.flags.writeable = False
    elif isinstance(value, tuple | list):
        for one in value:
            _freeze(one)
    elif isinstance(value, BaseModel) or dataclasses.is_dataclass(value):
        for name in _names(value):
            _freeze(getattr(value, name))
