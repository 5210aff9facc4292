"""Scenario files: found by name or path, read, checked."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from shared.scenario.cross_checks import cross_faults
from shared.scenario.document import SCENARIO_DIR, Document, ScenarioError, built_in, read, trajectory
from shared.scenario.faults import MAX_EXPLAINED, Fault, faults
from shared.scenario.limits import MAX_ROWS
from shared.scenario.radar_config import RadarConfig
from shared.scenario.scenario import Scenario
from shared.scenario.section import Section
from shared.scenario.world_config import WorldConfig

__all__ = ["SCENARIO_DIR", "ScenarioError", "built_in", "load", "parse", "parse_radar", "parse_world"]
T = TypeVar("T", bound=Section)


def load(name_or_path: str, settings: Sequence[str] = (), over: Sequence[str] = ()) -> Scenario:
    """Read and check a scenario: the name of a built-in one, or the path of a TOML file.

    A file may say `extends = "paper"`: a name, or a path relative to the file; what it leaves out is as there, but
    its name is that of the file. `settings` go on top, each KEY=VALUE: a dotted key, entries of a list counted from 1,
    and a TOML value; strings need no quotes. `over` are those of a sweep, which its errors call --over.

    Raises ScenarioError with a one-line text that names the file or the setting, the key, the value and what is
    allowed.
    """
    document, unset = read(name_or_path), list[str]()
    for option, setting in [*(("--set", setting) for setting in settings), *(("--over", setting) for setting in over)]:
        try:
            document.set(setting, option)
        except ScenarioError as error:
            unset += error.faults
    if unread := _read_trajectories(document):
        raise _refusal([*unset, *unread])
    return _checked(document, Scenario, unset)


def _read_trajectories(document: Document) -> list[str]:
    """Put the rows of trajectory files into the place of their names; returns what is wrong with them."""
    world = document.tables.get("world")
    targets = world.get("targets") if isinstance(world, dict) else None
    wrong, most = list[str](), MAX_ROWS
    for m, target in enumerate(targets if isinstance(targets, list) else []):
        if not isinstance(target, dict) or not isinstance(target.get("trajectory"), str):
            continue
        loc = ("world", "targets", m, "trajectory")
        given_by = document.file_of(loc)
        try:
            rows = trajectory((given_by.parent if given_by else Path()) / target["trajectory"], most)
            target["trajectory"], most = rows, most - len(rows)
        except ScenarioError as error:
            fault = Fault(loc, f" = {target['trajectory']!r}", str(error))
            wrong.append(fault.given_by(document.source_of(loc)))
    return wrong


def parse(document: dict[str, Any], source: str) -> Scenario:
    """Check a decoded scenario; `source` is named in the error."""
    return _checked(Document(source, document), Scenario)


def parse_radar(document: dict[str, Any], source: str) -> RadarConfig:
    """Check a decoded table `[radar]`."""
    return _checked(Document(source, document), RadarConfig)


def parse_world(document: dict[str, Any], source: str) -> WorldConfig:
    """Check a decoded table `[world]`."""
    return _checked(Document(source, document), WorldConfig)


def _checked(document: Document, kind: type[T], unset: Sequence[str] = ()) -> T:
    """The document, if nothing is wrong with it; `unset` are the faults of settings that have no place in it."""
    lines, found = list(unset), list[Fault]()
    try:
        checked = kind.model_validate(document.tables)
        tables = checked.model_dump()
    except ValidationError as error:
        found, tables = faults(error, kind), document.tables
    if kind is Scenario:
        found += cross_faults(tables, found)
    elif kind is RadarConfig:
        found += [fault._replace(loc=fault.loc[1:]) for fault in cross_faults({"radar": tables}, found)]
    lines += [fault.given_by(document.source_of(fault.loc)) for fault in found]
    if not lines:
        return checked
    raise _refusal(lines)


def _refusal(lines: Sequence[str]) -> ScenarioError:
    more = len(lines) - MAX_EXPLAINED
    first = lines[0] + (f" (and {len(lines) - 1} more)" if len(lines) > 1 else "")
    return ScenarioError(first, [*lines[:MAX_EXPLAINED], *([f"and {more} more"] if more > 0 else [])])
