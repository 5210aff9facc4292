"""A scenario as a document: a file, the file that it extends, and settings on top; and where each value stands."""

import errno
import re
import secrets
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from math import inf
from pathlib import Path
from typing import Any

from pydantic_core import from_json

from cogradar.shared.scenario.faults import MAX_EXPLAINED, Loc, no_text, printable
from cogradar.shared.scenario.limits import MAX_ROWS

# Beside this package, wherever it is installed; in a checkout it is a link to deploy/scenarios.
SCENARIO_DIR = (Path(__file__).parents[2] / "scenarios").resolve()
MAX_FILE_BYTES = 1 << 22  # of a scenario
# Of one without the rows of trajectories, each on one line, which are read as JSON: characters; keys; lists and tables;
# values in lists; lines; escaped characters. Python reads 200 keys, 400 numbers or 10 000 characters of TOML in a
# millisecond, and all of these together in less than a fifth of a second.
MAX_TEXT = 1 << 19
MAX_LISTS, MAX_NUMBERS = MAX_ROWS + 10_000, 4 * MAX_ROWS + 10_000  # with these rows
MAX_PIECES = {"=": 15_000, "[": 10_000, ",": 20_000, "\n": 24_000, "\\": 4_000}
MAX_KEYS = 128  # of one table; none that there is has half as many
MAX_DOTS = 32  # in one key: Python takes the square of their number
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

    def order(self) -> Callable[[Loc], tuple[float, ...]]:
        """Sorts places as they were given, line by line, settings last. What is missing is at its table's end."""
        last: dict[Loc, int] = {}
        for i, (place, source) in enumerate(self.sources.items()):
            is_setting = source.startswith("--")  # which says nothing of what is around its place
            last |= {place[:n]: i for n in range(len(place) if is_setting else 1, len(place) + 1)}
            last.setdefault(place[:1], i)

        def of(loc: Loc) -> tuple[float, ...]:
            place = next((tuple(loc[:n]) for n in range(len(loc), 0, -1) if tuple(loc[:n]) in last), ())
            if place not in self.sources and self.sources:
                return (last.get(place, inf) + 0.5,)
            value: Any = self.tables
            found = [float(last.get(place, 0))]
            for part in place:
                value = value[part]
            for part in loc[len(place) :] if isinstance(value, dict | list) else ():
                known: Sequence[Any] = range(len(value)) if isinstance(value, list) else [*value]
                found.append(known.index(part) if part in known else inf)
                if not isinstance(value := value[part] if part in known else None, dict | list):
                    break
            return (*found, inf)

        return of

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

    def set(self, setting: str, option: str = "--set", given: str | None = None) -> None:
        """Put one setting, KEY=VALUE, over what is there, which `option` gave, in other words if these are `given`.

        Raises ScenarioError.
        """
        key, equals, text = setting.partition("=")
        parts = key.strip().split(".")
        source = f"{option} {printable(setting if given is None else given)}"
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
            raise ScenarioError(printable(f"{by or f'{wanted}: '}{_no_such(folder, wanted, files)}")) from None
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
        text, rows = _without_rows(text_of(path))
        _check_size(text)
        tables = tomllib.loads(text)
        _check_keys(tables)
        _put_back(tables, rows)
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


def _without_rows(text: str) -> tuple[str, dict[str, Any]]:
    """A text with a word in place of the rows of each trajectory, and the rows by these words.

    As JSON they are read in a thirtieth of the time that TOML takes; rows that JSON does not know are left as they are.
    """
    is_in_string = "'''" in text or '"""' in text  # perhaps
    if is_in_string or text.count("[") > MAX_LISTS or text.count(",") > MAX_NUMBERS:
        return text, {}
    found, mark = dict[str, Any](), secrets.token_hex(8)  # a word that cannot be in the document

    def taken(line: re.Match[str]) -> str:
        try:
            rows = from_json(line[2])
        except ValueError:
            return line[0]
        word = f"{mark}-{len(found)}"
        found[word] = rows
        return f'{line[1]}"{word}"{line[3]}'

    return _ROWS.sub(taken, text), found


def _put_back(value: Any, rows: Mapping[str, Any]) -> None:
    """Put rows in place of their words, in tables and lists of tables."""
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, inner in items if rows else ():
        if isinstance(inner, str) and inner in rows:
            value[key] = rows[inner]
        elif isinstance(inner, dict | list):
            _put_back(inner, rows)


def _check_size(text: str) -> None:
    """Raise ScenarioError for text that takes long to be decoded."""
    if len(text) > MAX_TEXT:
        raise ScenarioError(f"has {len(text)} characters, must have at most {MAX_TEXT}: {_ELSEWHERE}")
    for piece, most in MAX_PIECES.items():
        if (n := text.count(piece)) > most:
            raise ScenarioError(f"has {n} times {piece!r}, must be at most {most}: {_ELSEWHERE}")
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


_ELSEWHERE = "rows of trajectories go on one line each, or into CSV files"
_ROWS = re.compile(r"^([ \t]*trajectory[ \t]*=[ \t]*)(\[\[[-+.0-9eE, \t\[\]]*\]\])([ \t]*(?:#.*)?)$", re.MULTILINE)
_DOT = re.compile(r"[\w\"'-][ \t]*\.[ \t]*(?=[\w\"'-])")  # between parts of a key


def _name_after(path: Path) -> str:
    """What the name of a scenario may have of its file's; empty if nothing is left."""
    return re.sub("[^a-z0-9]+", "-", path.stem.lower()).strip("-")[:MAX_NAME].rstrip("-")


def _no_such(folder: Path, wanted: str, chain: Sequence[Path]) -> str:
    """What is wrong with a name that no scenario or file has, and what was probably meant: no file that extends it."""
    if (path := Path(folder, wanted)).is_dir():
        return "a directory, must be a .toml file or the name of a built-in scenario"
    if path.is_symlink():
        return "a symbolic link that leads to no file"
    if path.is_file():
        return "is there, but no scenario's file, whose name ends in .toml"
    known_by_now = {file.resolve() for file in chain}
    beside = [file for file in Path(folder, wanted).parent.glob("*.toml") if file.resolve() not in known_by_now]
    known = [*built_in(), *(str(Path(wanted).with_name(file.name)) for file in beside)]
    exact = [name for name in (f"{wanted}.toml", Path(wanted).stem) if name in known]
    close = exact or get_close_matches(wanted, known, n=1)
    guess = f" (did you mean {close[0]}?)" if close else ""
    return f"no such scenario or .toml file{guess}; the built-in ones are: {', '.join(built_in())}"


def text_of(path: Path, most: int = MAX_FILE_BYTES) -> str:
    """The text of a file of at most so many bytes. Raises OSError, ScenarioError."""
    if not path.is_file():
        raise OSError(errno.EINVAL, "not a regular file") if path.exists() else FileNotFoundError
    if path.stat().st_size > most:
        raise OSError(errno.EFBIG, f"larger than {most} bytes, too large")
    try:
        return path.read_text(encoding="utf-8-sig")  # some editors begin a file with a byte order mark
    except UnicodeDecodeError as error:
        raise ScenarioError(no_text(error)) from None
