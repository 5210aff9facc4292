"""Results of pure functions that are remembered, for who plays the same run many thousand times; else nothing is.

Exact: the key is a digest of all that went in, arrays bit for bit. What is remembered cannot be written to any more.
"""

import dataclasses
import hashlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import numpy as np
from pydantic import BaseModel

P = ParamSpec("P")
T = TypeVar("T")


class _Memory:
    """Results by key, and digests of objects; all are forgotten when there are too many."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._results: dict[bytes, Any] = {}
        self._digests: dict[int, tuple[object, bytes]] = {}  # of objects that do not change, which stay alive here

    def result(self, function: Callable[..., T], args: tuple[Any, ...]) -> T:
        """The result of a function, computed at most once for these arguments."""
        key = hashlib.blake2b(function.__qualname__.encode(), digest_size=16)
        for value in args:
            self._add(key, value)
        if key.digest() in self._results:
            known: T = self._results[key.digest()]
            return known
        if len(self._results) >= self._most:
            self._results.clear()
        made = function(*args)
        _freeze(made)
        self._results[key.digest()] = made
        return made

    def _add(self, key: Any, value: Any) -> None:
        match value:
            case np.ndarray():
                key.update(f"{value.dtype.str}{value.shape}".encode())
                key.update(value.tobytes())
            case bytes():
                key.update(b"%d:" % len(value) + value)
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
            case _:
                key.update(f"{value!r},".encode())

    def _digest(self, value: Any) -> bytes:
        """Of an object of named fields, none of which is ever set anew."""
        if (known := self._digests.get(id(value))) is not None:
            return known[1]
        names = (
            type(value).model_fields
            if isinstance(value, BaseModel)
            else [field.name for field in dataclasses.fields(value)]
        )
        key = hashlib.blake2b(type(value).__qualname__.encode(), digest_size=16)
        for name in names:
            self._add(key, getattr(value, name))
        if len(self._digests) >= self._most:
            self._digests.clear()
        self._digests[id(value)] = value, key.digest()
        return key.digest()


_memory: _Memory | None = None


@contextmanager
def remembering(most: int) -> Iterator[None]:
    """Remember results of this process meanwhile, at most so many."""
    global _memory  # noqa: PLW0603 - of the process, as the compiled kernels are
    before, _memory = _memory, _Memory(most)
    try:
        yield
    finally:
        _memory = before


def remembered(function: Callable[P, T]) -> Callable[P, T]:
    """A pure function whose result may be remembered."""

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        if _memory is None or kwargs:
            return function(*args, **kwargs)
        return _memory.result(function, args)

    return call


def _freeze(value: Any) -> None:
    match value:
        case np.ndarray():
            value.flags.writeable = False
        case tuple() | list():
            for one in value:
                _freeze(one)
        case BaseModel():
            for name in type(value).model_fields:
                _freeze(getattr(value, name))
        case _ if dataclasses.is_dataclass(value):
            for field in dataclasses.fields(value):
                _freeze(getattr(value, field.name))
        case _:
            pass
