"""Checks of things of somebody's own: whether a run may have them, and what they cost."""

import inspect
import random
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from cogradar.services.errors import BadInput
from cogradar.services.plugins.trials import Trial, trial_of
from cogradar.shared.scenario.plugins.kinds import BELIEF, DISTURBANCE, FEED, FRONT_END, OBJECTIVE, RULE, STRATEGY, Kind
from cogradar.shared.scenario.plugins.names import Name, PluginError, PluginFailed
from cogradar.shared.scenario.plugins.resolver import module_of, resolve
from cogradar.shared.scenario.plugins.sources import settled

CALLS = 20  # of which the middle one's cost is shown
KINDS = {kind.name: kind for kind in (RULE, BELIEF, STRATEGY, OBJECTIVE, DISTURBANCE, FRONT_END, FEED)}
METHODS = {  # by which a thing is known
    BELIEF: ("begin", "predict", "update", "states"),
    DISTURBANCE: ("draw", "power_spectrum"),
    FRONT_END: ("transmit", "close"),
    FEED: ("encode",),
}


class Finding(NamedTuple):
    """A row of the report."""

    name: str  # of the thing
    check: str
    found: str
    ok: bool


def check(text: str, kind: str | None = None, report: Callable[[str], None] = lambda _: None) -> list[Finding]:
    """What is found of FILE.py, all that is in it, or of FILE.py:NAME, package.module:NAME. Raises BadInput.

    report : is told which thing is tried, which may take long: a receiver has to be opened
    """
    if kind is not None and kind not in KINDS:
        raise BadInput(f"{kind}: must be one of {', '.join(KINDS)}")
    try:
        things = _things(text, kind)
    except PluginError as error:
        raise BadInput(str(error)) from None
    found = list[Finding]()
    for name, of in things:
        report(f"{of.name} {name} is tried")
        found += _checked(name, of)
    return found


def _things(text: str, kind: str | None) -> list[tuple[str, Kind]]:
    """What is to be checked, by its name: what was asked for, or what a file has of each kind."""
    given = None if kind is None else KINDS[kind]
    if not text.endswith(".py"):
        return [(text, given or _kind_of(text))]
    module = module_of(Path(text))
    found = [(name, given or _kind(thing)) for name, thing in vars(module).items() if _is_own(name, thing, module)]
    things = [(f"{text}:{name}", of) for name, of in found if of is not None]
    if not things:
        raise BadInput(f"{text}: has nothing of {', '.join(KINDS)}; name one, {text}:NAME, with --kind")
    return things


def _is_own(name: str, thing: Any, module: ModuleType) -> bool:
    """Whether a file's thing was made there; a class only if nothing there is one of it."""
    made = thing if hasattr(thing, "__qualname__") else type(thing)
    others = [one for other, one in vars(module).items() if other != name]
    is_used = isinstance(thing, type) and any(thing in type(one).__mro__ for one in others)
    return not name.startswith("_") and getattr(made, "__module__", "") == module.__name__ and not is_used


def _kind(thing: Any) -> Kind | None:
    """What a thing seems to be, by what it has or by its arguments; None: nothing that is known."""
    for kind, methods in METHODS.items():
        if all(hasattr(thing, method) for method in methods):
            return kind
    try:
        n = len(inspect.signature(thing).parameters) if callable(thing) else 0
    except (TypeError, ValueError):
        n = 0
    return {2: STRATEGY, 3: RULE, 4: RULE}.get(n)


def _kind_of(text: str) -> Kind:
    """What a thing of this name seems to be. Raises PluginError or BadInput."""
    refused: PluginError | None = None
    for kind in (*METHODS, RULE, STRATEGY):
        try:
            resolve(kind, settled(kind, text, Path()))
        except PluginError as error:
            refused = refused or error
            continue
        name = Name.of(text)
        module = module_of(Path(name.source)) if name.is_file else sys.modules.get(name.source)
        return _kind(getattr(module, name.attribute, None)) or kind
    raise refused or BadInput(f"{text}: of which kind is it? Say it with --kind")


def _checked(text: str, kind: Kind) -> Iterator[Finding]:
    short = Name.of(text).attribute
    try:
        name = settled(kind, text, Path())
        thing, trial = resolve(kind, name), trial_of(kind)
    except PluginError as error:
        yield Finding(short, "loads", str(error), ok=False)
        return
    yield Finding(short, "loads", f"as {kind.name} {name}", ok=True)
    try:
        yield from _behaviour(short, thing, trial)
        if trial.more is not None:
            found, ok = trial.more(thing)
            yield Finding(short, trial.called, found, ok)
    except PluginFailed as error:
        yield Finding(short, "answers", str(error), ok=False)
        return
    cost = f"{_cost_ms(thing, trial):.3g} ms a call"
    if trial.beside:
        cost += f", {trial.beside}: {_cost_ms(resolve(kind, trial.beside), trial):.3g} ms"
    yield Finding(short, "cost", cost, ok=True)


def _behaviour(short: str, thing: Any, trial: Trial) -> Iterator[Finding]:
    """Answers that make sense, that depend on the arguments alone, and leave these as they were."""
    first = [_plain(trial.call(thing, *case())) for _, case in trial.cases]
    yield Finding(short, "answers", f"make sense; cases tried: {len(first)}", ok=True)
    random.seed(1)
    np.random.seed(1)  # noqa: NPY002 - to find out a thing that draws from it
    before = random.getstate(), np.random.get_state()  # noqa: NPY002
    again = [_plain(trial.call(thing, *case())) for _, case in reversed(trial.cases)][::-1]
    differs = [words for (words, _), a, b in zip(trial.cases, first, again, strict=True) if a != b]
    said = f"another answer when asked again: {', '.join(differs)}" if differs else "the same answer when asked again"
    if trial.repeats:
        yield Finding(short, "determinism", said, not differs)
    after = random.getstate(), np.random.get_state()  # noqa: NPY002
    uses = _plain(before) != _plain(after)
    said = "draws from Python's or NumPy's global generator" if uses else "no global random state is used"
    yield Finding(short, "random numbers", said, not uses)
    if trial.copies:
        return
    changed = [words for words, case in trial.cases if _changes(thing, trial, case())]
    said = f"changes its arguments: {', '.join(changed)}" if changed else "are left as they are"
    yield Finding(short, "arguments", said, not changed)


def _changes(thing: Any, trial: Trial, arguments: tuple[Any, ...]) -> bool:
    """Whether a call changes what it is given, but for the generator."""
    given = [one for one in arguments if not isinstance(one, np.random.Generator)]
    before = _plain(given)
    trial.call(thing, *arguments)
    return bool(_plain(given) != before)


def _plain(value: Any) -> Any:
    """A value in a form that can be compared bit for bit."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, tuple | list):
        return [_plain(one) for one in value]
    return repr(value)


def _cost_ms(thing: Any, trial: Trial) -> float:
    """The median cost of a call of the last case but one, whose searches are not cut short, ms."""
    case = trial.cases[max(len(trial.cases) - 2, 0)][1]
    trial.call(thing, *case())
    taken = []
    for _ in range(CALLS):
        arguments = case()
        began = time.perf_counter()
        trial.call(thing, *arguments)
        taken.append(time.perf_counter() - began)
    return 1e3 * float(np.median(taken))
