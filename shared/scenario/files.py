"""Scenario files: found by name or path, read, checked; and a scenario written out as a file."""

import json
import re
from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from cogradar.shared.scenario.cross_checks import cross_faults
from cogradar.shared.scenario.document import (
    SCENARIO_DIR,
    Document,
    ScenarioError,
    built_in,
    read,
)
from cogradar.shared.scenario.faults import MAX_EXPLAINED, MAX_SHOWN, Fault, faults, printable, unknown_keys
from cogradar.shared.scenario.limits import MAX_ROWS
from cogradar.shared.scenario.plugins.kinds import IN_SCENARIO
from cogradar.shared.scenario.plugins.names import PluginRefused
from cogradar.shared.scenario.plugins.sources import settled
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.scenario.scenario import ASSUMED, Scenario
from cogradar.shared.scenario.section import Section
from cogradar.shared.scenario.tables import FIDELITY
from cogradar.shared.scenario.trajectories.csv_files import element_errors, trajectory
from cogradar.shared.scenario.world_config import WorldConfig
from cogradar.shared.signal.recording import RecordingError, sha256

__all__ = [
    "SCENARIO_DIR",
    "ScenarioError",
    "built_in",
    "comments_of",
    "load",
    "parse",
    "parse_radar",
    "parse_world",
    "written",
]
T = TypeVar("T", bound=Section)

_KEY = re.compile(r"""(\w+)\s*=\s*((?:"[^"]*"|'[^']*'|[^#"'])*)(\s+#.*)?$""")
_NUMBER = re.compile(r"(?<=\.)\d+\.")  # of an entry of a list, in a path
_TABLE = re.compile(r"\[+([\w.]+)\]+")
_LEFT_OUT = {  # what stands beside a key that no file has
    **{f"radar.{table}.{key}": "# from fidelity" for table, keys in FIDELITY["robust"].items() for key in keys},
    "world.rcs": "# by default",
    "world.signal": "# by default",
    "world.motion.sigma_s_km_s2": "# as the radar assumes",
    "world.echo.amplitude_db": "# as the radar assumes",
}


def load(
    name_or_path: str, settings: Sequence[str] = (), over: Sequence[str] = (), rule: str | None = None
) -> Scenario:
    """Read and check a scenario: the name of a built-in one, or the path of a TOML file.

    A file may say `extends = "paper"`: a name, or a path relative to the file; what it leaves out is as there, but
    its name is the file's. `settings` go on top, each KEY=VALUE: a dotted key, entries of a list counted from 1,
    and a TOML value; strings need no quotes. `over` are settings of a sweep, which its errors call --over; `rule` is
    the action-selection policy, of --rule.

    Raises ScenarioError with a one-line text that names the file or the setting, the key, the value and what is
    allowed.
    """
    document, unset = read(name_or_path), list[str]()
    given = [*((setting, "--set") for setting in settings), *((setting, "--over") for setting in over)]
    for setting in [*given, *([(f"radar.planner.rule={rule}", "--rule", rule)] if rule is not None else [])]:
        try:
            document.set(*setting)
        except ScenarioError as error:
            unset += error.faults
    read_in = (_read_trajectories, _read_errors, _read_recording, _settle_names)
    scenario = _checked(document, Scenario, unset, [fault for each in read_in for fault in each(document)])
    _check_recording(scenario, document)
    return scenario


def _read_errors(document: Document) -> list[Fault]:
    """Put the rows of files with errors of antennas into the place of their names; returns what is wrong with them."""
    table, wrong = _within(document, _ARRAY), list[Fault]()
    for key in ("tx_errors", "rx_errors"):
        if not isinstance(table.get(key), str):
            continue
        loc = (*_ARRAY, key)
        given_by = document.file_of(loc)
        try:
            table[key] = element_errors((given_by.parent if given_by else Path()) / table[key])
        except ScenarioError as error:
            wrong.append(Fault(loc, f" = {table[key]!r}", str(error)))
    return wrong


def _within(document: Document, loc: Sequence[str]) -> dict[str, Any]:
    """A table of a document that may be wrong; an empty one if it has none."""
    table: Any = document.tables
    for key in loc:
        table = table.get(key) if isinstance(table, dict) else None
    return table if isinstance(table, dict) else {}


def _settle_names(document: Document) -> list[Fault]:
    """Put names that say their source's hash into the place of a user's own ones; returns what is wrong with them."""
    wrong = list[Fault]()
    for kind in IN_SCENARIO:
        loc = tuple(kind.stands.split("."))
        table = _within(document, loc[:-1])
        if not isinstance(given := table.get(loc[-1]), str):
            continue
        given_by = document.file_of(loc)
        try:
            folder, file = (given_by.parent, str(given_by)) if given_by else (Path(), "")
            table[loc[-1]] = settled(kind, given, folder, file)
        except PluginRefused as error:
            close = get_close_matches(given, kind.built_in, n=1) if len(given) <= MAX_SHOWN else []
            meant = f"; did you mean {close[0]}?" if close else ""
            wrong.append(Fault(loc, f" = {printable(given)!r}", f"{error}{meant}"))
    return wrong


_ARRAY = ("world", "array")
_TAKEN = {("world", section) for section, _ in ASSUMED}
_RECORDING = ("world", "disturbance", "recording")


def _read_recording(document: Document) -> list[Fault]:
    """Put the whole path and the digest of a recording beside its name; returns what is wrong with it."""
    table = _within(document, _RECORDING)
    if not isinstance(table.get("file"), str) or "\0" in table["file"]:
        return []
    loc = [*_RECORDING, "file"]
    given_by = document.file_of(loc)
    path = ((given_by.parent if given_by else Path()) / table["file"]).resolve()
    try:
        digest = sha256(path)
    except (RecordingError, OSError) as error:
        said = error.strerror if isinstance(error, OSError) else error
        return [Fault(loc, f" = {table['file']!r}", printable(str(said)))]
    if table.get("sha256", digest) != digest:
        loc[-1] = "sha256"
        said = f"must be {digest}, of {path}: leave it out, or name the file that the run had"
        return [Fault(loc, f" = {table['sha256']!r}", printable(said))]
    table |= {"file": str(path), "sha256": digest}
    return []


def _check_recording(scenario: Scenario, document: Document) -> None:
    """Raise ScenarioError for a recording that no run of the scenario can use, or that is too short for one."""
    if (world := scenario.world) is None or (section := world.disturbance.recording) is None:
        return
    from cogradar.shared.signal.looks import n_range_cells

    n_cell = n_range_cells(*scenario.radar.acquisition.ranges_km, scenario.radar.receiver.range_cell_km)
    try:
        recording = section.read(*scenario.data_set_shape)
        has, needs = recording.dwells(n_cell), scenario.most_dwells
        n_dwell, n_range = recording.data.shape[:2]
        held = f"{section.file}: has {n_dwell} dwells of {n_range} range cells,"
        if has == 0:
            raise RecordingError(
                f"{held} a dwell of the radar needs {n_cell} range cells: give a longer one, or set a larger"
                " radar.receiver.range_cell_km"
            )
        if has < needs and not section.repeat:
            raise RecordingError(
                f"{held} enough for {has} dwells of the radar with {n_cell} range cells each, a run has up to {needs}:"
                " give a longer one, or set repeat = true"
            )
    except RecordingError as error:
        fault = Fault(list(_RECORDING), "", printable(str(error)))
        raise _refusal([fault.given_by(document.source_of(_RECORDING))], 1) from None


def _read_trajectories(document: Document) -> list[Fault]:
    """Put the rows of trajectory files into the place of their names; returns what is wrong with them."""
    world = document.tables.get("world")
    targets = world.get("targets") if isinstance(world, dict) else None
    wrong, most = list[Fault](), MAX_ROWS
    for m, target in enumerate(targets if isinstance(targets, list) else []):
        if not isinstance(target, dict) or not isinstance(target.get("trajectory"), str):
            continue
        loc = ("world", "targets", m, "trajectory")
        given_by = document.file_of(loc)
        try:
            rows = trajectory((given_by.parent if given_by else Path()) / target["trajectory"], most)
            target["trajectory"], most = rows, most - len(rows)
        except ScenarioError as error:
            wrong.append(Fault(loc, f" = {target['trajectory']!r}", str(error)))
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


def _checked(document: Document, kind: type[T], unset: Sequence[str] = (), unread: Sequence[Fault] = ()) -> T:
    """The document, if nothing is wrong with it.

    unset  : faults of settings that have no place in it
    unread : faults of files that it names, and of what these hold
    """
    lines, is_file = list(unset), bool(document.sources)  # else a message: it is refused in less time than a file
    order = document.order() if is_file else None
    found, n_unknown = unknown_keys(document.tables, kind)
    if n_unknown > MAX_EXPLAINED:  # nothing else matters, and to look for it takes long
        raise _refusal([*lines, *(fault.given_by(document.source_of(fault.loc)) for fault in found)], n_unknown)
    found = list(unread)
    try:
        checked = kind.model_validate(document.tables)
        tables = checked.model_dump()
    except ValidationError as error:
        tables = document.tables
        known = {tuple(fault.loc) for fault in unread}
        found += [
            fault for fault in faults(error, kind, tables if is_file else None, order) if tuple(fault.loc) not in known
        ]
    if len(found) > MAX_EXPLAINED:
        pass  # what is wrong with values together is not shown
    elif kind is Scenario:
        found += cross_faults(tables, found)
    elif kind is RadarConfig:
        found += [fault._replace(loc=fault.loc[1:]) for fault in cross_faults({"radar": tables}, found)]
    if not isinstance(document.tables.get("radar", {}), dict):  # what the world would take over from it is not missing
        found = [fault for fault in found if tuple(fault.loc) not in _TAKEN]
    found = [*dict.fromkeys(_as_written(fault, document) for fault in found)]
    if order is not None:
        found.sort(key=lambda fault: order(fault.loc))
    n = len(lines) + len(found)
    lines += [fault.given_by(document.source_of(fault.loc)) for fault in found[: MAX_EXPLAINED + 1]]
    if not lines:
        return checked
    raise _refusal(lines, n)


def _as_written(fault: Fault, document: Document) -> Fault:
    """The fault where its value stands: the world takes over what the radar assumes and the file leaves out."""
    loc = tuple(fault.loc)
    is_taken = any(loc == ("world", *place) for place in ASSUMED) and loc[1] not in _within(document, ["world"])
    return fault._replace(loc=("radar", *loc[1:]) if is_taken else loc)


def _refusal(lines: Sequence[str], n: int) -> ScenarioError:
    """What is wrong: the first of n faults in a line each."""
    shown = lines[:n] if n <= MAX_EXPLAINED + 1 else lines[:MAX_EXPLAINED]  # one more is as short as to count it
    first = lines[0] + (f" (and {n - 1} more)" if n > 1 else "")
    return ScenarioError(first, [*shown, *([f"and {n - len(shown)} more"] if n > len(shown) else [])])


def written(scenario: Scenario, files: Sequence[Path] = ()) -> str:
    """The scenario as TOML that can be saved and loaded; `files` as of `document.read`, the newest first.

    A comment stays beside its key for as long as its value is the file's, and so does the first file's head.
    """
    comments: dict[str, tuple[str, str]] = {}  # by key: the value as it was written, and what was said of it
    for file in reversed(files):
        comments |= comments_of(file.read_text(encoding="utf-8-sig"))
    head = _head(files[0].read_text(encoding="utf-8-sig")) if files else []
    return "\n".join([*head, *_lines(scenario.model_dump(mode="json", exclude_none=True), "", comments)]) + "\n"


def _head(text: str) -> list[str]:
    """Lines of comment before anything else."""
    lines = text.splitlines()
    n = next((i for i, line in enumerate(lines) if not line.startswith("#")), len(lines))
    return [*lines[:n], ""] if n else []


def comments_of(text: str) -> dict[str, tuple[str, str]]:
    """By key of a scenario's text: its value, in one form, and the comment beside it."""
    found, table, entries = {}, "", dict[str, int]()
    for line in text.splitlines():
        if match := _TABLE.match(line):
            table = match[1] + "."
            if line.startswith("[["):
                entries[table] = entries.get(table, 0) + 1
                table += f"{entries[table]}."
        elif match := _KEY.match(line):
            found[table + match[1]] = (_plain(match[2]), (match[3] or "").strip())
    return found


def _lines(table: dict[str, Any], path: str, comments: dict[str, tuple[str, str]]) -> Iterator[str]:
    """Keys first, then tables, then lists of tables."""
    for key, value in table.items():
        if not _is_table(value):
            text = f"{key} = {_toml(value)}"
            plain = _plain(_toml(value))
            before, comment = comments.get(path + key, (plain, _LEFT_OUT.get(path + key, "") if comments else ""))
            yield f"{text:21} {comment}" if comment and before == plain else text
    for key, value in table.items():
        if isinstance(value, dict):
            yield from ("", f"[{path}{key}]") if not all(map(_is_table, value.values())) else ()
            yield from _lines(value, f"{path}{key}.", comments)
        elif _is_table(value):
            for i, entry in enumerate(value):
                yield from ("", f"[[{_NUMBER.sub('', path)}{key}]]")
                yield from _lines(entry, f"{path}{key}.{i + 1}.", comments)


def _is_table(value: Any) -> bool:
    return isinstance(value, dict) or (isinstance(value, list) and any(isinstance(entry, dict) for entry in value))


def _toml(value: Any) -> str:
    """Numbers, words and lists of them; JSON writes these as TOML does, but for one character."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _plain(value: str) -> str:
    """A value's text in one form: 1e-4 and 0.0001 are the same."""
    try:
        return str(json.loads(value))
    except ValueError:
        return value.strip()
