"""A kernel as plain Python: the oracle of its compiled form."""

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

P = ParamSpec("P")
T = TypeVar("T")


def plain(kernel: Callable[P, T]) -> Callable[P, T]:
    """The function that a kernel was compiled from; those that it calls stay compiled."""
    return cast(Callable[P, T], cast(Any, kernel).py_func)
