"""Tables as data: made by analysis and benches, shown by a terminal, or put between the markers of a Markdown page."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path
from string import Formatter
from typing import Any

from cogradar.services.errors import BadInput
from cogradar.shared.scenario.faults import no_text

Row = Mapping[str, Any]
LONG = 1e5  # from here on a number with decimals is 5.7e17: an estimate that is lost may be as far off as it likes


class _Known(Formatter):
    """Formats as `str.format` does; what is not known (None) is a dash, and what is long has an exponent."""

    def format_field(self, value: Any, format_spec: str) -> str:
        if value is None:
            return "-"
        if format_spec.endswith("f") and LONG <= abs(value) < inf:
            format_spec = re.sub(r"(\.\d+)?f$", ".1e", format_spec)  # a sign that is asked for stays
        text = str(super().format_field(value, format_spec))
        return text if isinstance(value, str) else re.sub(r"e\+0*(?=\d)", "e", text)


_KNOWN = _Known()


@dataclass(frozen=True)
class Column:
    """One column: its heading, and the format of a row's cell, such as "{p_d:.3f}"."""

    heading: str
    form: str
    left: bool = False  # aligned so: a text, not a number
    wraps: bool = False  # the last one, a sentence: it has several lines where there is little room

    def cell(self, row: Row) -> str:
        """Text of this column in a row; "-" for what is not known."""
        return _KNOWN.vformat(self.form, (), row)


@dataclass(frozen=True)
class Table:
    """A table before it is drawn."""

    title: str
    columns: Sequence[Column]
    rows: Sequence[Row]
    group: str = ""  # key of the rows: where its value changes, a group ends
    bold: frozenset[int] = frozenset()  # rows that must be seen, counted from 0


def in_metres(row: Row) -> Row:
    """The row with its velocities in m/s as well: what people are shown; programs get km/s, as the keys say."""
    velocities = {key: value for key, value in row.items() if "km_s" in key}
    return {**row, **{key.replace("km_s", "m_s"): value and 1e3 * value for key, value in velocities.items()}}


def markdown(table: Table) -> str:
    """The table as Markdown, under its title."""
    headings = [column.heading for column in table.columns]
    rule = ["---" if column.left else "---:" for column in table.columns]
    cells = [[column.cell(row) for column in table.columns] for row in table.rows]
    return "\n".join([f"**{table.title}**", "", *(f"| {' | '.join(line)} |" for line in (headings, rule, *cells))])


def check_page(path: Path, names: Sequence[str]) -> str:
    """Text of a page that has the markers `<!-- NAME -->` and `<!-- /NAME -->` of each name. Raises BadInput."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: {no_text(error)}") from None
    for name in names:
        begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
        if end not in text.partition(begin)[2]:
            raise BadInput(f"{path}: has no lines {begin} and {end}")
    return text
