"""A store says itself what its tables and columns are."""

import re

from services.recorder.journal import Journal
from services.recorder.schema import MEMORY


def test_every_table_and_column_has_its_comment_in_the_file() -> None:
    journal = Journal(MEMORY)
    tables = {row["name"]: row["sql"] for row in journal.read("SELECT * FROM sqlite_master WHERE type = 'table'")}
    for table, text in tables.items():
        columns = [row["name"] for row in journal.read("SELECT name FROM pragma_table_info(?)", [table])]
        assert re.search(rf"CREATE TABLE {table} \( -- \S", text)
        assert re.findall(r"^ *([a-z]\w*) .* -- \S", text, re.MULTILINE) == columns
