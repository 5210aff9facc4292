"""Tables on a terminal, at any width: no value is cut, and columns that are left out for want of room are named.

A row is one line, or several where its last column is a sentence.
"""

import re
import textwrap
from collections.abc import Sequence
from itertools import chain, zip_longest

from rich.cells import cell_len
from rich.console import Console
from rich.text import Text

from cogradar.services.analysis.tables import Column, Table
from cogradar.shared.scenario.faults import printable

INDENT = 2  # of a value that has lines of its own
SENTENCE = 20  # characters of its line, at least
SHORT = 4  # characters of a heading that is never broken


class _Drawn:
    """A column as text: lines of its heading, one cell per row."""

    def __init__(self, column: Column, table: Table) -> None:
        self.name, self.left = column.heading, column.left
        self.heading = [column.heading]
        self.cells = [printable(" ".join(column.cell(row).splitlines())) for row in table.rows]
        self.width = max(map(cell_len, [*self.heading, *self.cells]))
        self.lines = [[cell] for cell in self.cells]

    def wrap(self, width: int) -> None:
        """Break the cells between their words."""
        self.lines = [textwrap.wrap(cell, width) or [""] for cell in self.cells]
        self.width = width

    def narrow(self) -> None:
        """Break the heading between its words: as narrow as the cells or the longest word."""
        words = [self.name] if len(self.name) <= SHORT else re.findall(r"[^ _]+_?|_", self.name)
        self.width = max(map(cell_len, [*self.cells, *words]), default=0)
        self.heading = words[:1]
        for word in words[1:]:
            joined = self.heading[-1] + ("" if self.heading[-1].endswith("_") else " ") + word
            if cell_len(joined) <= self.width:
                self.heading[-1] = joined
            else:
                self.heading.append(word)


def print_tables(console: Console, tables: Sequence[Table], width: int | None = None, remedy: str = "") -> None:
    """Print tables, at most as wide as the console or as `width`, with a blank line after each.

    `remedy` says what shows the columns that are left out; a wider window does if there is nothing else.
    """
    for table in tables:
        for line in [*layout(table, width or console.width, remedy), Text("")]:
            console.print(line, soft_wrap=True)


def layout(table: Table, width: int, remedy: str = "") -> list[Text]:
    """The lines of a table, none wider than `width`.

    If the columns do not fit side by side, their headings are broken, and a sentence in the last one. A single row
    becomes a list of its values. Of several rows, what is the same in all goes into a line of its own. If that is not
    enough, the last columns are left out, and named, with what shows them.
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
    room = width - sum(column.width + 2 for column in columns[:-1])
    if table.columns[-1].wraps and room >= SENTENCE:
        columns[-1].wrap(room)
        return [*title, *_grid(table, columns, width)]
    needed = sum(column.width + 1 for column in columns) - 1
    columns, same = _split(columns, width)
    shown = list(columns)
    while len(shown) > 1 and not _fits(shown, width, gap=1):
        shown.pop()
    # A name and its value stay together: a no-break space is none to textwrap.
    notes = [("all rows:", [f"{name}\xa0{value or '-'}" for name, value in same])]
    notes += [("left out:", [column.name for column in columns[len(shown) :]])]
    remedy = remedy or f"; a window of {needed} characters, or COLUMNS={needed}, shows them"
    above, below = (
        [Text(line.replace("\xa0", " ")) for line in textwrap.wrap(f"{head} {'; '.join(words)}{end}", width) if words]
        for (head, words), end in zip(notes, ("", remedy), strict=True)
    )
    return [*title, *above, *_grid(table, shown, width), *below]


def _split(columns: list[_Drawn], width: int) -> tuple[list[_Drawn], list[tuple[str, str]]]:
    """Columns that stay, and name and value of those that are the same in all rows: as many as must go, in order.

    Several may have the same name: intervals have.
    """
    left, same = list(columns), list[tuple[str, str]]()
    for column in columns:
        if not _fits(left, width, gap=1) and len(set(column.cells)) == 1 and len(left) > 1:
            left.remove(column)
            same.append((column.name, column.cells[0]))
    return left, same


def _grid(table: Table, columns: Sequence[_Drawn], width: int) -> list[Text]:
    """Head, rule and rows, two blanks between the columns if there is room for them."""
    gap = " " * (2 if _fits(columns, width) else 1)
    height = max(len(column.heading) for column in columns)
    headings = [[""] * (height - len(column.heading)) + column.heading for column in columns]
    head = [_line(columns, texts, gap) for texts in zip(*headings, strict=True)]
    rows = [
        [_line(columns, texts, gap) for texts in zip_longest(*(column.lines[i] for column in columns), fillvalue="")]
        for i in range(len(table.rows))
    ]
    lines = [Text(line) for line in [*head, "-" * max(map(cell_len, [*head, *chain(*rows)]))]]
    for i, row in enumerate(rows):
        if i and table.group and table.rows[i][table.group] != table.rows[i - 1][table.group]:
            lines.append(Text(""))
        lines += [Text(line, "bold" if i in table.bold else "") for line in row]
    return lines


def _line(columns: Sequence[_Drawn], texts: Sequence[str], gap: str) -> str:
    """One line of a table: its texts, one per column."""
    parts = [
        text + padding if column.left else padding + text
        for column, text in zip(columns, texts, strict=True)
        for padding in [" " * (column.width - cell_len(text))]
    ]
    return gap.join(parts).rstrip()


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


def _fits(columns: Sequence[_Drawn], width: int, gap: int = 2) -> bool:
    return sum(column.width for column in columns) + gap * (len(columns) - 1) <= width


def _title(title: str) -> Text:
    text = Text(title, "bold")
    text.highlight_words(["LOST"], "red")
    return text
