"""What a planning problem is to the search: a type with four functions.

A problem is a NamedTuple of scalars and arrays, declared with its functions in one importable module, which `implement`
registers; they are chosen by the problem's type, in Python and in the compiled search alike. Where they cannot raise
(a division by a variable can, unless it is checked for zero), the compiler drops the reference counting of the
problem's arrays, a quarter of a rollout's time.
"""

from collections.abc import Callable
from functools import singledispatch
from typing import Any

import numpy as np
from numba import types
from numba.extending import overload


@singledispatch
def sample_state(problem: Any, rng: np.random.Generator) -> Any:
    """A state drawn from the belief at the root."""
    raise NotImplementedError


@singledispatch
def step(problem: Any, state: Any, action: int, rng: np.random.Generator) -> tuple[Any, int, float, bool]:
    """Generator G(s, a): next state, observation (an integer in 0 .. 2^31 - 1), reward, whether the episode ends."""
    raise NotImplementedError


@singledispatch
def random_action(problem: Any, rng: np.random.Generator) -> int:
    """Action of the rollout policy; need not be one of the search's legal actions."""
    raise NotImplementedError


@singledispatch
def mean_rollout(problem: Any, n_level: int, gamma: float) -> float:
    """Exact expected return of n_level levels of the rollout policy, where it is the same in all states."""
    raise NotImplementedError


def implement(problem: type, *functions: Callable[..., Any]) -> None:
    """Register a problem's versions of the generic functions, each named like its generic one.

    Raises ValueError for a function from another module: only a change of the problem's own file compiles it anew.
    """
    every: tuple[Any, ...] = (sample_state, step, random_action, mean_rollout)
    generics = {generic.__name__: generic for generic in every}
    for function in functions:
        if function.__module__ != problem.__module__:
            raise ValueError(f"{function.__name__} of {function.__module__} for a problem of {problem.__module__}")
        generic = generics[function.__name__]
        generic.register(problem)(function)
        overload(generic, strict=False, inline="always")(_chooser(problem, function))


def _chooser(problem: type, function: Callable[..., Any]) -> Callable[..., Any]:
    def choose(argument: Any, *_: Any) -> Callable[..., Any] | None:
        chosen = isinstance(argument, types.BaseNamedTuple) and argument.instance_class is problem
        return function if chosen else None

    return choose
