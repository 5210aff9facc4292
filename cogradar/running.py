"""Playing runs in this process: `load`, `run`, and `play`, dwell by dwell."""

import json
import logging
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, closing, suppress
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypedDict, Unpack

import numpy as np
from pydantic import ValidationError

from cogradar.services.analysis.arrays.dwell import Dwell
from cogradar.services.analysis.arrays.result import Result
from cogradar.services.errors import BadInput, with_interrupts_after
from cogradar.services.runs.run import as_played, ending, strategy_of
from cogradar.services.topology import Start
from cogradar.shared.protocol.messages import Refused, RunStart
from cogradar.shared.scenario.faults import explain
from cogradar.shared.scenario.files import ScenarioError, parse
from cogradar.shared.scenario.files import load as load_file
from cogradar.shared.scenario.plugins.kinds import IN_SCENARIO, Kind
from cogradar.shared.scenario.plugins.names import PluginError
from cogradar.shared.scenario.plugins.resolver import held, hold, named
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.scenario import Scenario

if TYPE_CHECKING:
    from cogradar.plugins import BeliefFilter, BinRule, Disturbance, PowerRule
    from cogradar.services.runs.dwell import DwellMessages
    from cogradar.shared.protocol.messages import Waveform

log = logging.getLogger("cogradar")

Settings = Sequence[str] | Mapping[str, Any]  # as of `--set`, or by key


def load(name_or_path: str | Path, settings: Settings = ()) -> Scenario:
    """A scenario: the name of a built-in one, or the path of a TOML file. Raises BadInput if it cannot be used.

    settings : as of `--set`, ["radar.array.n_tx=32", "world.targets.2.state=[60.0, 0.2, 7.5, 0.1]"], or
               {"radar.array.n_tx": 32, "world.targets.2.state": [60.0, 0.2, 7.5, 0.1]}
    """
    try:
        return load_file(str(name_or_path), _texts(settings))
    except ScenarioError as error:
        raise BadInput(str(error)) from None


class Player:
    """A run that is played dwell by dwell: an iterator of `Dwell`, and its `result` once it is over.

    Closed before its end, as at the end of a `with` that is left earlier, the run is stopped. At its end, and when it
    fails, it is closed already.
    """

    _is_closed = True  # until it is begun
    _last: "DwellMessages | None"

    def __init__(self, start: RunStart, planners: int, store: str | Path | None, front_end: str) -> None:
        from cogradar.services import kernels
        from cogradar.services.metrics.store import Store, in_memory
        from cogradar.services.recorder.journal import Journal
        from cogradar.services.runs import in_process

        self.run, self.dwells = start.run, start.dwells
        self._scenario = Scenario.model_validate(start.scenario)
        self._own = held(start.scenario["radar"], start.strategy, start.scenario["world"])
        self._file, self._last = store, None
        self._store = in_memory() if store is None else Store(Journal(str(store), owner="cogradar.run"))
        try:
            with with_interrupts_after() as stop:
                kernels.compile_all(log.warning, stop)
            self._steps = in_process.steps(start, planners=planners, store=self._store, front_end=front_end)
        except BaseException:
            self._store.close()
            raise
        self._is_closed = False

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Dwell:
        return self.send(None)

    def send(self, waveform: "Waveform | None") -> Dwell:
        """The next dwell, with this waveform in place of the radar's own, `next` of the dwell before.

        Raises BadInput for one that cannot be radiated then, StopIteration after the last dwell.
        """
        if waveform is not None:
            self._check(waveform)
        hold(self._own)
        try:
            with with_interrupts_after():
                self._last = self._steps.send(waveform)
        except BaseException:
            self.close()
            raise
        return Dwell(self._last, self._scenario)

    def _check(self, waveform: "Waveform") -> None:
        from cogradar.services.emulator.cycle import check_waveform
        from cogradar.shared.wire.codec import decode, encode

        asked = None if self._last is None else self._last.next
        try:
            if asked is None or (waveform.run, waveform.k) != (asked.run, asked.k):
                raise Refused("must be a copy of `next` of the last dwell, with other values")
            decode(encode(waveform))
            check_waveform(waveform, self._scenario.radar, self.dwells)
        except (TypeError, ValueError) as error:
            raise BadInput(f"waveform: {error}") from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Cancel the run if it is not over, and close its file."""
        if self._is_closed:
            return
        self._is_closed = True
        try:
            self._steps.close()
        finally:
            if self._file is not None:
                self._store.close()

    def __del__(self) -> None:
        with suppress(Exception):  # a program that ends may have nothing left to close it with
            self.close()

    @property
    def result(self) -> Result:
        """The run as arrays; of one that goes on, what is acknowledged: the newest 15 dwells at most are missing."""
        from cogradar.services.analysis.stored_run import StoredRun
        from cogradar.services.metrics.answers import answer
        from cogradar.services.metrics.store import Store
        from cogradar.services.recorder.journal import Journal

        if self._file is None or not self._is_closed:
            save = None if self._file is not None else self._store.journal.copy_to
            return Result(StoredRun(partial(answer, self._store), self.run), save)
        with ExitStack() as opened:
            store = opened.enter_context(closing(Store(Journal(str(self._file), read_only=True))))
            return Result(StoredRun(partial(answer, store), self.run), close=opened.pop_all().close)


class Playing(TypedDict, total=False):
    """How a run is played.

    set         : settings as `--set` takes them, ["radar.array.n_tx=32"], or {"radar.array.n_tx": 32}
    strategy    : how the power is spread: "orthogonal", "uniform" or "power-aware", which is the default; or your own,
                  "PATH.py:NAME" or an object (`cogradar.plugins`), as of the next four
    rule        : action-selection policy, in place of `radar.planner.rule`
    objective   : in place of `radar.allocation.objective`
    disturbance : in place of `world.disturbance.model`
    belief      : in place of `radar.belief.filter`
    seed        : of all that is random, 0 .. 2^63 - 1; 1 if left out
    dwells      : tracking dwells, the scenario's number if left out
    planners    : how many share the tracks; they take turns, and the result is the same for any number
    front_end   : "simulated", "recorded:FILE", "PATH.py:NAME" or "package.module:NAME"
    store       : a file that keeps the run, as `cogradar run --store` writes it
    """

    set: Settings
    strategy: "str | PowerRule"
    rule: "str | BinRule | None"
    objective: "str | PowerRule | None"
    disturbance: "str | Disturbance | None"
    belief: "str | BeliefFilter | None"
    seed: int
    dwells: int | None
    planners: int
    front_end: str
    store: str | Path | None


def play(scenario: Scenario | str | Path, **how: Unpack[Playing]) -> Player:
    """Play a run in this process, dwell by dwell: `for dwell in cogradar.play("paper"): ...`.

    scenario : a Scenario, or what `load` takes
    how      : of `Playing`

    The dwells of the acquisition come first. Raises the same errors as `run`.
    """
    from cogradar.services.front_ends import settled

    known = sorted(Playing.__optional_keys__)
    if unknown := sorted(how.keys() - set(known)):
        meant = "".join(f" (did you mean {name}?)" for name in get_close_matches(unknown[0], known, n=1))
        raise BadInput(f"{unknown[0]}: no argument{meant}, must be one of {', '.join(known)}")
    loaded = _loaded(scenario, how)
    front_end = how.get("front_end", Start.front_end)
    strategy = strategy_of(how.get("strategy", Strategy.POWER_AWARE))
    seed, planners = _whole("seed", how.get("seed", 1)), _whole("planners", how.get("planners", 1))
    if planners < 1:
        raise BadInput(f"planners = {planners}: must be at least 1")
    start = run_start(loaded, strategy, seed, how.get("dwells"))
    return Player(ending(start), planners, how.get("store"), settled(front_end))


def run_start(scenario: Scenario, strategy: Strategy, seed: int, dwells: int | None) -> "RunStart":
    """What begins the run. Raises BadInput."""
    try:
        return RunStart.of(scenario, strategy, seed, None if dwells is None else _whole("dwells", dwells))
    except ValidationError as error:
        raise BadInput(explain(error, RunStart)) from None


def run(
    scenario: Scenario | str | Path,
    *,
    progress: Callable[[int, int], object] | None = None,
    callback: Callable[[Dwell], object] | None = None,
    **how: Unpack[Playing],
) -> Result:
    """Play one run in this process, as `cogradar run --in-process` does: the same digest for the same arguments.

    scenario : a Scenario, or what `load` takes
    progress : called after each dwell with the tracking dwells done and those to do
    callback : called with each `Dwell`, from the acquisition on
    how      : of `Playing`

    Raises BadInput for arguments that make no sense, RunFailed if the run does not reach its end. The first call after
    an installation compiles for about a minute, and logs that.
    """
    with play(scenario, **how) as player:
        for dwell in player:
            if callback is not None:
                callback(dwell)
            if progress is not None:
                progress(dwell.t, player.dwells)
    return player.result


def _loaded(scenario: Scenario | str | Path, how: Playing) -> Scenario:
    """The scenario with the settings of a run. Raises BadInput."""
    settings = _texts(how.get("set", ()))
    if not isinstance(scenario, Scenario):
        loaded = load(scenario, settings)
    elif settings:
        raise BadInput(f"{settings[0]}: a Scenario has all its values: give load() the settings, or run() the name")
    else:
        loaded = scenario
    own = {kind: how.get(kind.name) for kind in IN_SCENARIO}
    return as_played(_with_own(loaded, own), how.get("front_end", Start.front_end))


def _with_own(scenario: Scenario, things: Mapping[Kind, Any]) -> Scenario:
    """A scenario with other things, by name or as objects. Raises BadInput."""
    own = {kind: thing for kind, thing in things.items() if thing is not None}
    if not own:
        return scenario
    document = scenario.model_dump()
    for kind, thing in own.items():
        *tables, key = kind.stands.split(".")
        table: Any = document
        for part in tables:
            table = table[part]
            if table is None:
                raise BadInput(f"{kind.name}: {scenario.name} has no [world]")
        try:
            table[key] = named(kind, thing, Path())
        except PluginError as error:
            raise BadInput(f"{kind.name} = {thing!r}: {error}") from None
    try:
        return parse(document, scenario.name)
    except ScenarioError as error:
        raise BadInput(str(error)) from None


def _texts(settings: Settings) -> list[str]:
    if isinstance(settings, Mapping):
        return [f"{key}={_toml(value)}" for key, value in settings.items()]
    return [settings] if isinstance(settings, str) else list(settings)


def _toml(value: object) -> str:
    """A value as a scenario file would have it."""
    match value:
        case Mapping():
            return "{" + ", ".join(f"{json.dumps(str(key))} = {_toml(one)}" for key, one in value.items()) + "}"
        case str() | bool():
            return json.dumps(value, ensure_ascii=False)
        case np.ndarray() | np.bool_():
            return _toml(value.tolist())
        case None:
            raise BadInput("a setting is None, which no scenario can say: leave its key out")
        case Iterable():
            return "[" + ", ".join(map(_toml, value)) + "]"
        case _:
            return str(value)


def _whole(name: str, value: object) -> int:
    """An argument that must be a whole number, of Python or of NumPy. Raises BadInput."""
    try:
        return operator.index(value)  # type: ignore[arg-type] # what is no number is what it finds out
    except TypeError:
        raise BadInput(f"{name} = {value!r}: must be a whole number") from None
