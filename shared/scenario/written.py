"""A scenario written out: a complete TOML file that says every key, with the comments of the files that it is from."""

import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from shared.scenario.scenario import Scenario
from shared.scenario.tables import FIDELITY

_KEY = re.compile(r"""(\w+)\s*=\s*((?:"[^"]*"|'[^']*'|[^#"'])*)(\s+#.*)?$""")
_NUMBER = re.compile(r"(?<=\.)\d+\.")  # of an entry of a list, in a path
_TABLE = re.compile(r"\[+([\w.]+)\]+")
_LEFT_OUT = {  # what stands beside a key that no file has
    **{f"radar.{table}.{key}": "# from fidelity" for table, keys in FIDELITY["robust"].items() for key in keys},
    "world.rcs": "# by default",
    "world.motion.sigma_s_km_s2": "# as the radar assumes",
    "world.echo.amplitude_db": "# as the radar assumes",
}


def written(scenario: Scenario, files: Sequence[Path] = ()) -> str:
    """The scenario as TOML that can be saved and loaded; `files` as of `document.read`, the newest first.

    A comment stays beside its key for as long as its value is that of the file, and so does the first file's head.
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
