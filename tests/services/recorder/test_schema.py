"""The page about the store keeps up with the store."""

import re
from pathlib import Path

from services.recorder.journal import Journal
from services.recorder.schema import MEMORY, SCHEMA_VERSION

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "reference" / "store.md").read_text(encoding="utf-8")


def test_every_table_and_column_is_documented_and_no_other() -> None:
    journal = Journal(MEMORY)
    tables = [row["name"] for row in journal.read("SELECT name FROM sqlite_master WHERE type = 'table'")]
    real = {
        table: [row["name"] for row in journal.read("SELECT name FROM pragma_table_info(?)", [table])]
        for table in tables
    }
    parts = re.split(r"^## (\w+): .*$", PAGE, flags=re.MULTILINE)[1:]
    documented = {
        name: re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE)
        for name, text in zip(parts[::2], parts[1::2], strict=True)
    }
    assert documented == real
    assert f"version of this page: {SCHEMA_VERSION}." in PAGE
