"""Tables on a terminal, at any width: nothing is cut, what does not fit side by side goes on in further lines."""

import re
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from rich.cells import cell_len
from rich.console import Console
from rich.text import Text

from services.analysis.tables import Column, Table
from shared.scenario.faults import printable

INDENT = 2  # of the further lines of a row


class _Drawn:
    """A column as text: lines of its heading, one cell per row."""

    def __init__(self, column: Column, table: Table) -> None:
        self.name, self.left = column.heading, column.left
        self.heading = [column.heading]
        self.cells = [printable(" ".join(column.cell(row).splitlines())) for row in table.rows]
        self.width = max(map(cell_len, [*self.heading, *self.cells]))

    def narrow(self) -> None:
        """Break the heading between its words: as narrow as the cells or the longest word."""
        words = re.findall(r"[^ _]+_?|_", self.name)
        self.width = max(map(cell_len, [*self.cells, *words]), default=0)
        self.heading = words[:1]
        for word in words[1:]:
            joined = self.heading[-1] + ("" if self.heading[-1].endswith("_") else " ") + word
            if cell_len(joined) <= self.width:
                self.heading[-1] = joined
            else:
                self.heading.append(word)


@dataclass(frozen=True)
class _Layout:
    """Columns side by side, in as many lines as it takes."""

    bands: list[list[_Drawn]]  # the columns of each line
    width: int
    gap: int

    @classmethod
    def of(cls, columns: Sequence[_Drawn], width: int) -> "_Layout":
        """As many columns in a line as fit, in their order; the gap is two if all fit into one line then."""
        gap = 2 if _fits(columns, width) else 1
        bands: list[list[_Drawn]] = [[]]
        for column in columns:
            room = width - INDENT * (len(bands) > 1)
            if bands[-1] and not _fits([*bands[-1], column], room, gap):
                bands.append([])
            bands[-1].append(column)
        return cls(bands, width, gap)

    def lines(self, text: Callable[[_Drawn], list[str]]) -> list[str]:
        """The lines of the head or of a row; `text` says what a column has there."""
        found = []
        for i, band in enumerate(self.bands):
            indent = " " * (INDENT if i else 0)
            blocks = [text(column) for column in band]
            height = max(map(len, blocks))
            for j in range(height):
                parts = [
                    self._aligned(column, block[j - height] if j >= height - len(block) else "")
                    for column, block in zip(band, blocks, strict=True)
                ]
                line = indent + (" " * self.gap).join(parts).rstrip()
                found += textwrap.wrap(line, self.width, subsequent_indent=indent) or [""]
        return found

    def _aligned(self, column: _Drawn, text: str) -> str:
        padding = " " * (column.width - cell_len(text))
        is_alone = column.width > self.width - INDENT
        return text + padding if column.left or is_alone else padding + text


def print_tables(console: Console, tables: Sequence[Table]) -> None:
    """Print tables, at most as wide as the console, with a blank line after each."""
    for table in tables:
        for line in [*layout(table, console.width), Text("")]:
            console.print(line, soft_wrap=True)


def layout(table: Table, width: int) -> list[Text]:
    """The lines of a table, none wider than `width`.

    If the columns do not fit side by side: their headings are broken; a single row becomes a list of its values; of
    several rows, what is the same in all goes into a line of its own; and if that is not enough, each row takes several
    lines, and so does the head.
    """
    title = [_title(table.title)] if table.title else []
    if not table.rows:
        return [*title, Text("no rows")]
    columns = [_Drawn(column, table) for column in table.columns]
    if not _fits(columns, width):
        for column in columns:
            column.narrow()
    if _fits(columns, width, gap=1):
        return [*title, *_grid(table, columns, width)]
    if len(table.rows) == 1:
        return [*title, *map(Text, _record(columns, width))]
    columns, same = _split(columns, width)
    if not _fits(columns, width, gap=1):
        columns = [_Drawn(column, table) for column in table.columns if column.heading not in same]
    # A name and its value stay together: a no-break space is none to textwrap.
    shared = ", ".join(f"{name}\xa0{value or '-'}" for name, value in same.items())
    lines = [Text(line.replace("\xa0", " ")) for line in textwrap.wrap(f"all rows: {shared}", width) if same]
    return [*title, *lines, *_grid(table, columns, width)]


def _split(columns: list[_Drawn], width: int) -> tuple[list[_Drawn], dict[str, str]]:
    """Columns that stay, and name and value of those that are the same in all rows: as many as must go, in order."""
    left, same = list(columns), dict[str, str]()
    for column in columns:
        if not _fits(left, width, gap=1) and len(set(column.cells)) == 1 and len(left) > 1:
            left.remove(column)
            same[column.name] = column.cells[0]
    return left, same


def _grid(table: Table, columns: Sequence[_Drawn], width: int) -> list[Text]:
    """Head, rule and rows."""
    drawn = _Layout.of(columns, width)
    head = drawn.lines(lambda column: column.heading)
    rows = [drawn.lines(partial(_cell, i)) for i in range(len(table.rows))]
    rule = "-" * max(cell_len(line) for part in (head, *rows) for line in part)
    lines = [Text(line) for line in [*head, rule]]
    for i, row in enumerate(rows):
        if i and table.group and table.rows[i][table.group] != table.rows[i - 1][table.group]:
            lines.append(Text(""))
        lines += [Text(line, "bold" if i in table.bold else "") for line in row]
    return lines


def _record(columns: Sequence[_Drawn], width: int) -> list[str]:
    """A line per value; one that is too long for the rest of its line has lines of its own."""
    names = max(cell_len(column.name) for column in columns)
    lines = []
    for column in columns:
        name, value = f"{column.name:{names}}", column.cells[0] or "-"
        if names + 2 + cell_len(value) <= width:
            lines.append(f"{name}  {value}")
        else:
            indent = " " * INDENT
            lines += [column.name, *textwrap.wrap(value, width, initial_indent=indent, subsequent_indent=indent)]
    return lines


def _cell(i: int, column: _Drawn) -> list[str]:
    return [column.cells[i]]


def _fits(columns: Sequence[_Drawn], width: int, gap: int = 2) -> bool:
    return sum(column.width for column in columns) + gap * (len(columns) - 1) <= width


def _title(title: str) -> Text:
    text = Text(title, "bold")
    text.highlight_words(["LOST"], "red")
    return text
