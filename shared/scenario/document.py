"""A scenario as a document: a file, the file that it extends, and settings on top; and where each value stands."""

import errno
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from itertools import pairwise
from math import isfinite
from pathlib import Path
from typing import Any

from cogradar.shared.scenario.faults import MAX_EXPLAINED, Loc, printable
from cogradar.shared.scenario.limits import MAX_HEIGHT_KM, MAX_POSITION_KM, MAX_ROWS, MAX_TIME_S, MIN_ROWS

# Beside this package, wherever it is installed; in a checkout it is a link to deploy/scenarios.
SCENARIO_DIR = (Path(__file__).parents[2] / "scenarios").resolve()
MAX_FILE_BYTES = 1 << 22  # of a scenario
# Of one: keys; lists and tables; values in lists. Python reads 200 keys or 400 numbers of TOML in a millisecond, so
# only skies with very many rows of trajectories take longer than a fifth of a second.
MAX_PIECES = {"=": 20_000, "[": MAX_ROWS + 20_000, ",": 4 * MAX_ROWS}
MAX_KEYS = 128  # of one table; none that there is has half as many
MAX_DOTS = 32  # in one key: Python takes the square of their number
MAX_TRAJECTORY_BYTES = 1 << 23
TRAJECTORY = ["t_s", "x_km", "y_km"]  # header of its file
ELEMENT_ERRORS = ["gain_db", "phase_deg"]  # header of a file with errors of antennas
MAX_ELEMENTS = 512
TRAJECTORIES = (TRAJECTORY, [*TRAJECTORY, "z_km"])
MAX_NAME = 20
NAME = rf"^[a-z0-9][a-z0-9-]{{0,{MAX_NAME - 1}}}$"  # of a scenario
NAME_IN_WORDS = f"1 to {MAX_NAME} lower-case letters, digits and hyphens, the first no hyphen"
MAX_CHAIN = 8  # files, each of which extends the next
SETTING = "must be KEY=VALUE, such as radar.array.n_tx=32 or world.targets.2.state=[60.0, 0.2, 7.5, 0.1]"


class ScenarioError(ValueError):
    """A scenario file that cannot be used; the text is one line: file, key, value, allowed.

    `faults` has such a line for each thing that is wrong.
    """

    def __init__(self, text: str, faults: Sequence[str] = ()) -> None:
        super().__init__(text)
        self.faults = tuple(faults) or (text,)


@dataclass
class Document:
    """Decoded TOML, and the source of each value: a file or a setting."""

    source: str  # of what is missing
    tables: dict[str, Any] = field(default_factory=dict)
    sources: dict[tuple[int | str, ...], str] = field(default_factory=dict)
    files: list[Path] = field(default_factory=list)  # the file, what it extends, and so on

    def source_of(self, loc: Loc) -> str:
        """Where the value at `loc`, or the table around it, was given."""
        inside = [source for place, source in self.sources.items() if loc and place[: len(loc)] == tuple(loc)]
        if inside:  # the last that gave a part of it
            return inside[-1]
        known = (tuple(loc[:n]) for n in range(len(loc), 0, -1))
        return next((self.sources[place] for place in known if place in self.sources), self.source)

    def file_of(self, loc: Loc) -> Path | None:
        """The file that gave the value at `loc`; None: a setting did."""
        source = self.source_of(loc)
        return next((file for file in self.files if str(file) == source), None)

    def overlay(self, tables: dict[str, Any], source: str) -> None:
        """Put a file's values over those that are there: tables key by key, anything else whole."""
        self._overlay(self.tables, tables, source, ())

    def _overlay(self, below: dict[str, Any], over: dict[str, Any], source: str, loc: tuple[str, ...]) -> None:
        for key, value in over.items():
            if isinstance(value, dict) and isinstance(below.get(key), dict):
                self._overlay(below[key], value, source, (*loc, key))
            else:
                below[key] = value
                self._give((*loc, key), source)

    def set(self, setting: str, option: str = "--set") -> None:
        """Put one setting, KEY=VALUE, which `option` gave, over what is there. Raises ScenarioError."""
        key, equals, text = setting.partition("=")
        parts = key.strip().split(".")
        source = f"{option} {printable(setting)}"
        if not equals or not all(parts):
            raise ScenarioError(f"{source}: {SETTING}")
        place: Any = self.tables
        loc: tuple[int | str, ...] = ()
        for i, part in enumerate(parts):
            step = _step(place, part, ".".join(parts[:i]), source)
            loc = (*loc, step)
            if i == len(parts) - 1:
                place[step] = _value(text.strip())
            elif isinstance(place, dict) and step not in place:
                place[step] = {}
                self._give(loc, source)
            place = place[step]
        self._give(loc, source)
        self.source += f" {source}"

    def _give(self, loc: tuple[int | str, ...], source: str) -> None:
        for inner in [known for known in self.sources if known[: len(loc)] == loc]:
            del self.sources[inner]
        self.sources[loc] = source


def built_in() -> list[str]:
    """Names of the scenarios that come with the project."""
    return sorted(path.stem for path in SCENARIO_DIR.glob("*.toml"))


def read(name_or_path: str) -> Document:
    """The document of a built-in scenario or of a file, with those that it extends below it. Raises ScenarioError."""
    chain: list[tuple[Path, dict[str, Any]]] = []
    folder, wanted, by = Path(), name_or_path, ""
    while True:
        path = SCENARIO_DIR / f"{wanted}.toml" if Path(wanted).suffix != ".toml" else folder / wanted
        files = [path for path, _ in chain]
        if by and path.resolve() in [file.resolve() for file in files]:
            cycle = " -> ".join(file.name for file in [*files, path])
            raise ScenarioError(printable(f"{by}extends itself: {cycle}"))
        if len(chain) == MAX_CHAIN:
            raise ScenarioError(printable(f"{by}the chain is too long, must be at most {MAX_CHAIN} files"))
        try:
            tables = _decoded(path)
        except FileNotFoundError:
            raise ScenarioError(printable(f"{by}{wanted}: {_no_such(folder, wanted)}")) from None
        chain.append((path, tables))
        if "extends" not in tables:
            break
        if "name" not in tables and (name := _name_after(path)):
            tables["name"] = name  # two scenarios that differ should not share a name
        wanted = tables.pop("extends")
        by, folder = f"{path}: extends = {wanted!r}: ", path.parent
        if not isinstance(wanted, str) or "\0" in wanted:  # which no path may hold
            raise ScenarioError(printable(f"{by}must be the name of a built-in scenario or the path of a .toml file"))
    document = Document(str(chain[0][0]), files=[path for path, _ in chain])
    for path, tables in reversed(chain):
        document.overlay(tables, str(path))
    return document


def _step(place: Any, part: str, key: str, source: str) -> int | str:
    """The key or the index, from 0, of one part of a setting's key in `place`."""
    if isinstance(place, dict):
        return part
    if not isinstance(place, list):
        raise ScenarioError(printable(f"{source}: {key} is no table"))
    if not (part.isdecimal() and len(part) < 10 and 1 <= int(part) <= len(place)):
        raise ScenarioError(printable(f"{source}: {key} has no entry {part}, must be 1 to {len(place)}"))
    return int(part) - 1


def _value(text: str) -> Any:
    """A TOML value; what is none is a string, so that words need no quotes."""
    try:
        decoded = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return decoded["value"] if decoded.keys() == {"value"} else text


def _decoded(path: Path) -> dict[str, Any]:
    try:
        text = _text(path)
        _check_size(text)
        tables = tomllib.loads(text)
        _check_keys(tables)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise ScenarioError(printable(f"{path}: {error.strerror}")) from None
    except ScenarioError as error:
        raise ScenarioError(printable(f"{path}: {error}")) from None
    except RecursionError:
        raise ScenarioError(printable(f"{path}: not valid TOML: nested too deeply")) from None
    except ValueError as error:  # also of decoding, and of integers with thousands of digits
        raise ScenarioError(printable(f"{path}: not valid TOML: {error}")) from None
    if not tables:
        raise ScenarioError(printable(f'{path}: empty; begin with extends = "paper", or see `scenarios --show paper`'))
    return tables


def _check_size(text: str) -> None:
    """Raise ScenarioError for text that takes long to be decoded."""
    for piece, most in MAX_PIECES.items():
        if (n := text.count(piece)) > most:
            raise ScenarioError(
                f"has {n} times {piece!r}, must be at most {most}: rows of trajectories go into CSV files"
            )
    if any(
        len(_DOT.findall(part)) > MAX_DOTS for part in re.split(r"[,=\n\[\]{}]", text) if part.count(".") > MAX_DOTS
    ):
        raise ScenarioError(f"has a key of more than {MAX_DOTS + 1} parts")


def _check_keys(table: dict[str, Any], name: str = "") -> None:
    """Raise ScenarioError for a table with too many keys to be looked at one by one."""
    if len(table) > MAX_KEYS:
        first = ", ".join(key[:20] for key in list(table)[:MAX_EXPLAINED])
        raise ScenarioError(f"{name or 'it'} has {len(table)} keys, no table has {MAX_KEYS}: {first} and more")
    for key, value in table.items():
        if isinstance(value, dict):
            _check_keys(value, f"{name}.{key}" if name else key)


_DOT = re.compile(r"[\w\"'-][ \t]*\.[ \t]*(?=[\w\"'-])")  # between parts of a key


def _name_after(path: Path) -> str:
    """What the name of a scenario may have of its file's; empty if nothing is left."""
    return re.sub("[^a-z0-9]+", "-", path.stem.lower()).strip("-")[:MAX_NAME].rstrip("-")


def _no_such(folder: Path, wanted: str) -> str:
    """What is wrong with a name of a scenario or a file that there is not, and what was probably meant."""
    if Path(folder, wanted).is_dir():
        return "a directory, must be a .toml file or the name of a built-in scenario"
    files = [str(Path(wanted).with_name(file.name)) for file in Path(folder, wanted).parent.glob("*.toml")]
    close = get_close_matches(wanted, [*built_in(), *files], n=1)
    guess = f" (did you mean {close[0]}?)" if close else ""
    return f"no such scenario or .toml file{guess}; the built-in ones are: {', '.join(built_in())}"


def trajectory(path: Path, most: int) -> list[list[float]]:
    """Rows [t_s, x_km, y_km], or with z_km, of a CSV file with this header, at most so many. Raises ScenarioError."""
    rows, places = _csv_rows(path, TRAJECTORIES, most, f"trajectories must have at most {MAX_ROWS} rows together")
    if len(rows) < MIN_ROWS:
        raise ScenarioError(printable(f"{path}: has {len(rows)} rows of numbers, must have at least {MIN_ROWS}"))
    try:
        check_rows(rows, places)
    except ValueError as error:
        raise ScenarioError(printable(f"{path}: {error}")) from None
    return rows


def element_errors(path: Path) -> list[list[float]]:
    """Rows [gain_db, phase_deg] of a CSV file with this header. Raises ScenarioError."""
    return _csv_rows(path, (ELEMENT_ERRORS,), MAX_ELEMENTS, f"must have at most {MAX_ELEMENTS} rows")[0]


def _csv_rows(
    path: Path, headers: Sequence[Sequence[str]], most: int, too_many: str
) -> tuple[list[list[float]], list[str]]:
    """Rows of numbers of a CSV file with one of these headers, and the line of each. Raises ScenarioError."""
    try:
        lines = _text(path, MAX_TRAJECTORY_BYTES).splitlines()
    except FileNotFoundError:
        raise ScenarioError(printable(f"{path}: no such file")) from None
    except OSError as error:
        raise ScenarioError(printable(f"{path}: {error.strerror}")) from None
    except ValueError as error:
        raise ScenarioError(printable(f"{path}: no text: {error}")) from None
    header = [cell.strip() for cell in lines[0].split(",")] if lines else []
    if header not in headers:
        first = f"begins with {lines[0][:60]!r}" if lines else "is empty"
        must = " or ".join(map(",".join, headers))
        raise ScenarioError(printable(f"{path}: {first}, must have the header {must}"))
    rows, places = list[list[float]](), list[str]()
    for i, line in enumerate(lines[1:], start=2):
        try:
            row = [float(cell) for cell in line.split(",")]
        except ValueError:
            row = []
        if line.strip() and (len(row) != len(header) or not all(map(isfinite, row))):
            numbers = f"{len(header)} numbers, {','.join(header)}"
            raise ScenarioError(printable(f"{path}: line {i}, {line[:60]!r}: must be {numbers}"))
        if row:
            rows.append(row)
            places.append(f"line {i}")
        if len(rows) > most:
            raise ScenarioError(printable(f"{path}: line {i}: {too_many}"))
    return rows, places


def check_rows(rows: Sequence[Sequence[float]], places: Sequence[str]) -> None:
    """Raise ValueError, with its place, for the first row of a trajectory that is not after that before, or too far."""
    for (one, before), (next_, place) in pairwise(zip(rows, places, strict=True)):
        if next_[0] <= one[0]:
            raise ValueError(f"{place}: t_s = {next_[0]:g} must be above that of {before}, {one[0]:g}")
    for (t, x, y, *heights), place in zip(rows, places, strict=True):
        if max(abs(x), abs(y)) > MAX_POSITION_KM or abs(t) > MAX_TIME_S:
            raise ValueError(
                f"{place}: x_km and y_km must be within {MAX_POSITION_KM:g} km, t_s within {MAX_TIME_S:g} s"
            )
        if len(heights) != len(rows[0]) - 3:
            raise ValueError(f"{place}: all rows must have z_km, or none of them")
        if any(not 0.0 <= z <= MAX_HEIGHT_KM for z in heights):
            raise ValueError(f"{place}: z_km = {heights[0]:g}: must be 0 .. {MAX_HEIGHT_KM:g}")


def _text(path: Path, most: int = MAX_FILE_BYTES) -> str:
    if not path.is_file():
        raise OSError(errno.EINVAL, "not a regular file") if path.exists() else FileNotFoundError
    if path.stat().st_size > most:
        raise OSError(errno.EFBIG, f"larger than {most} bytes, too large")
    return path.read_text(encoding="utf-8-sig")  # some editors begin a file with a byte order mark
