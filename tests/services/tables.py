"""Whether a table is shown whole: at 80 and 120 columns, for every module that makes tables."""

import re
from collections.abc import Sequence

from cogradar.services.analysis.tables import Table
from cogradar.services.cli.terminal import layout

WIDTHS = (80, 120)


def shown(table: Table, width: int) -> str:
    """The table as text of at most `width` columns, with every heading and every cell in it."""
    lines = [str(line) for line in layout(table, width)]
    assert max(map(len, lines)) <= width
    text = "\n".join(lines)
    words = {form for word in text.split() for form in (word, word.strip(",;"))}
    for column in table.columns:
        assert all(part in text for part in re.split("[ _]", column.heading)), column.heading
        assert {word for row in table.rows for word in column.cell(row).split()} <= words, column.heading
    return text


def assert_shown_whole(tables: Sequence[Table]) -> None:
    for table in tables:
        for width in WIDTHS:
            shown(table, width)
