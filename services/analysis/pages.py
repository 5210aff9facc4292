"""Tables on a Markdown page: at most seven columns each, all columns in a CSV file beside the page.

A value and its interval are one cell, `0.966 [0.963, 0.969]`. What is the same in all rows is said above the table. A
table that is still too wide becomes several, each of whole topics, with the keys of the rows first. A table of one row
stands upright.
"""

import csv
import io
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cogradar.services.analysis.tables import Table, check_page
from cogradar.services.errors import BadInput

WIDEST = 7  # columns
FOLDER = "tables"  # beside the page
DIGITS = 16  # of a digest
TOPICS = {
    "detection": r"P_D|in bin|bin hits|lost|^power$",
    "accuracy": r"RMSE|GOSPA|of errors|of missed|of false",
    "air picture": r"complete|spurious|swaps|false tracks",
    "consistency": r"NEES|beyond 99",
    "confirmation": r"confirmed|never found",
}
# A column that has the target of the value in the next one, and what that value is.
EXTREMES = {"worst": "lowest", "least detected": "lowest", "largest": "largest"}
_INTERVAL = re.compile(r"^95 %(?:, (.*))?$")
_BOOTSTRAP = {None, "runs"}


@dataclass(frozen=True)
class _Column:
    heading: str
    cells: tuple[str, ...]
    is_key: bool = False

    @property
    def is_known(self) -> bool:
        return any(cell.strip("- ") for cell in self.cells)

    @property
    def is_constant(self) -> bool:
        return len(set(self.cells)) == 1

    @property
    def topic(self) -> str:
        return next((name for name, words in TOPICS.items() if re.search(words, self.heading)), "")


def on_page(table: Table) -> str:
    """The table for a page of people."""
    return narrow(table.title, *_texts(table))


def narrow(title: str, headings: Sequence[str], is_left: Sequence[bool], rows: Sequence[Sequence[str]]) -> str:
    """Tables of a page from the cells of one table. Its keys are the columns up to the last that is aligned left."""
    n_key = max((i + 1 for i, left in enumerate(is_left) if left), default=1)
    cells = list(zip(*rows, strict=True)) if rows else [()] * len(headings)
    columns = [
        _Column(heading, texts, i < n_key) for i, (heading, texts) in enumerate(zip(headings, cells, strict=True))
    ]
    merged = [column for column in _with_targets(_with_intervals(columns)) if column.is_known or not rows]
    if len(rows) == 1:
        names = _Column("", tuple(column.heading for column in merged), is_key=True)
        return f"**{title}**\n\n{_drawn([names, _Column('', tuple(column.cells[0] for column in merged))])}"
    same = [column for column in merged if column.is_constant] if len(rows) > 1 else []
    said = [f"In all rows: {'; '.join(f'{c.heading} {c.cells[0]}' for c in same)}."] if same else []
    shown = [column for column in merged if column not in same]
    keys, values = [c for c in shown if c.is_key], [c for c in shown if not c.is_key]
    parts = list(_parts(values, WIDEST - len(keys))) or [values]
    drawn = [_drawn([*keys, *part]) for part in parts]
    heads = [f"**{title}{_part(parts, i)}**" for i in range(len(parts))]
    heads[0] = "\n\n".join([heads[0], *said])
    return "\n\n".join(text for pair in zip(heads, drawn, strict=True) for text in pair)


def write_into(path: Path, blocks: Mapping[str, Sequence[str | Table]]) -> None:
    """Replace what is between the markers of each name by its texts and tables, all of them or none.

    A table that the page cannot show whole is also a file of its own, in the folder `tables` beside the page. Raises
    BadInput.
    """
    text = check_page(path, list(blocks))
    files: dict[Path, str] = {}
    for name, block in blocks.items():
        begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
        before, _, rest = text.partition(begin)
        parts = list(_blocks(path, name, block, files))
        text = "\n\n".join([before + begin, *parts, end + rest.partition(end)[2]])
    new = path.with_suffix(path.suffix + ".new")
    try:
        for file, content in files.items():
            file.parent.mkdir(exist_ok=True)
            file.write_text(content, encoding="utf-8")
        new.write_text(text, encoding="utf-8")
        new.replace(path)
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}") from None


def first_run(run: Mapping[str, Any], scenario: str, settings: Sequence[str] = ()) -> str:
    """How to repeat a run that a table has, and the beginning of its digest: another program may play another one.

    run      : strategy, seed, dwells and digest
    scenario : as on a command line
    """
    words = ["cogradar", "run", scenario, "--in-process", "--strategy", run["strategy"], "--seed"]
    words += [str(run["seed"]), "--dwells", str(run["dwells"])]
    words += [word for setting in settings for word in ("--set", setting)]
    return f"The first of these runs is `{shlex.join(words)}`, digest `{run['digest'][:DIGITS]}`."


def as_csv(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """All columns. An interval is two of them, named after the value before it; what is not known is empty."""
    split = [_INTERVAL.match(heading) is not None for heading in headings]
    named, value = [], ""
    for heading, is_interval in zip(headings, split, strict=True):
        value = value if is_interval else heading
        named += [f"{value}, {heading}, low", f"{value}, {heading}, high"] if is_interval else [heading]
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(named)
    for row in rows:
        cells: list[str] = []
        for cell, is_interval in zip(row, split, strict=True):
            cells += _ends(cell) if is_interval else [cell]
        writer.writerow(["" if cell == "-" else cell for cell in cells])
    return file.getvalue()


def _texts(table: Table) -> tuple[list[str], list[bool], list[list[str]]]:
    cells = [[column.cell(row) for column in table.columns] for row in table.rows]
    return [column.heading for column in table.columns], [column.left for column in table.columns], cells


def _blocks(path: Path, name: str, block: Sequence[str | Table], files: dict[Path, str]) -> Iterator[str]:
    place = 0
    for part in block:
        if isinstance(part, str):
            yield part
            continue
        headings, is_left, rows = _texts(part)
        yield narrow(part.title, headings, is_left, rows)
        if len(headings) > WIDEST:
            place += 1
            file = f"{path.stem}-{name.replace(' ', '-')}-{place}.csv"
            files[path.parent / FOLDER / file] = as_csv(headings, rows)
            yield f"[All columns]({FOLDER}/{file})"


def _ends(interval: str) -> list[str]:
    ends = interval.split()
    return ends if len(ends) == 2 else ["", ""]


def _with_intervals(columns: Sequence[_Column]) -> list[_Column]:
    """Each value with the first interval after it."""
    merged: list[_Column] = []
    is_open = False  # the last column has no interval yet
    for column in columns:
        found = _INTERVAL.match(column.heading)
        if found is None:
            merged.append(column)
            is_open = True
            continue
        last, of = merged[-1], found[1]
        kind = "95 %" if of in _BOOTSTRAP else f"95 %, {of}"
        ends = [_ends(cell) for cell in column.cells]
        texts = [f"[{low}, {high}]" if {low, high}.isdisjoint({"", "-"}) else "" for low, high in ends]
        if is_open:
            cells = tuple(f"{cell} {text}".strip() for cell, text in zip(last.cells, texts, strict=True))
            merged[-1] = replace(last, heading=f"{last.heading} [{kind}]" if any(texts) else last.heading, cells=cells)
            is_open = False
        else:
            merged.append(_Column(f"{last.heading.partition(' [')[0]} [{kind}]", tuple(texts)))
    return merged


def _with_targets(columns: Sequence[_Column]) -> list[_Column]:
    """Each extreme value with the target that has it."""
    merged: list[_Column] = []
    of: _Column | None = None
    for column in columns:
        if column.heading in EXTREMES:
            of = column
        elif of is not None:
            pairs = zip(column.cells, of.cells, strict=True)
            cells = [f"{value}, target {target}" if target != "-" else value for value, target in pairs]
            heading = column.heading.replace(" of it", "")
            merged.append(replace(column, heading=f"{EXTREMES[of.heading]} {heading}", cells=tuple(cells)))
            of = None
        else:
            merged.append(column)
    return merged


def _parts(values: Sequence[_Column], room: int) -> Iterator[list[_Column]]:
    """The columns in tables that have room for them; a topic begins a new table if it does not fit whole."""
    topics: dict[str, list[_Column]] = {}
    for column in values:
        topics.setdefault(column.topic, []).append(column)
    part: list[_Column] = []
    for columns in topics.values():
        if part and len(part) + len(columns) > room:
            yield part
            part = []
        for column in columns:
            if len(part) == room:
                yield part
                part = []
            part.append(column)
    if part:
        yield part


def _part(parts: Sequence[Sequence[_Column]], i: int) -> str:
    """What a part of a table has, in its title: the topics, or which part it is."""
    topics = list(dict.fromkeys(column.topic for column in parts[i]))
    if len(parts) == 1:
        return ""
    return f": {', '.join(topics)}" if all(topics) else f" ({i + 1} of {len(parts)})"


def _drawn(columns: Sequence[_Column]) -> str:
    rule = ["---" if column.is_key else "---:" for column in columns]
    lines = [[column.heading for column in columns], rule, *map(list, zip(*(c.cells for c in columns), strict=True))]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
