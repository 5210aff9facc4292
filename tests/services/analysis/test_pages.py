"""Tables on a page: narrow, with intervals and targets beside their values, all columns in a file."""

from pathlib import Path

import pytest

from cogradar.services.analysis.pages import WIDEST, as_csv, narrow, write_into
from cogradar.services.analysis.tables import Column, Table
from cogradar.services.errors import BadInput

HEADINGS = ["looks", "strategy", "runs", "worst", "P_D", "95 %, runs", "95 %, Wilson", "swaps"]
LEFT = [False, True, *[False] * 6]
ROWS = [
    ["single", "uniform", "20", "2", "0.966", "0.963 0.969", "0.9 1.0", "0.0"],
    ["joint", "uniform", "20", "1", "0.996", "- -", "0.9 1.0", "-"],
]


def test_values_have_their_intervals_and_targets_and_constants_are_said_once() -> None:
    assert narrow("All dwells", HEADINGS, LEFT, ROWS).splitlines() == [
        "**All dwells**",
        "",
        "In all rows: strategy uniform; runs 20; P_D [95 %, Wilson] [0.9, 1.0].",
        "",
        "| looks | lowest P_D [95 %] | swaps |",
        "| --- | ---: | ---: |",
        "| single | 0.966 [0.963, 0.969], target 2 | 0.0 |",
        "| joint | 0.996, target 1 | - |",
    ]


def test_one_row_stands_upright() -> None:
    lines = narrow("All dwells", HEADINGS, LEFT, ROWS[:1]).splitlines()
    assert lines[:4] == ["**All dwells**", "", "|  |  |", "| --- | ---: |"]
    assert "| lowest P_D [95 %] | 0.966 [0.963, 0.969], target 2 |" in lines


def test_a_wide_table_becomes_several_of_whole_topics() -> None:
    headings = ["name", "P_D", "in bin", "RMSE km", *(f"NEES {i}" for i in range(5))]
    rows = [[str(i + 10 * j) for j in range(len(headings))] for i in range(3)]
    text = narrow("T", headings, [True, *[False] * 8], rows)
    assert [line for line in text.splitlines() if line.startswith("**")] == [
        "**T: detection, accuracy**",
        "**T: consistency**",
    ]
    assert max(line.count(" | ") + 1 for line in text.splitlines()) <= WIDEST
    assert all(text.count(heading) == 1 for heading in headings[1:])


def test_a_page_gets_its_tables_and_files_of_all_columns(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("a\n<!-- sweep x -->\nold\n<!-- /sweep x -->\nb\n")
    columns = [Column(name, f"{{c{i}}}", left) for i, (name, left) in enumerate(zip(HEADINGS, LEFT, strict=True))]
    table = Table("T", columns, [_row(cells) for cells in ROWS])
    write_into(page, {"sweep x": ["before", table]})
    text = page.read_text()
    assert text.startswith("a\n<!-- sweep x -->\n\nbefore\n\n**T**")
    assert text.endswith("[All columns](tables/page-sweep-x-1.csv)\n\n<!-- /sweep x -->\nb\n")
    assert (tmp_path / "tables" / "page-sweep-x-1.csv").read_text() == as_csv(HEADINGS, ROWS)
    with pytest.raises(BadInput, match="has no lines"):
        write_into(page, {"sweep y": [table]})


def test_a_file_has_every_column_with_the_ends_of_intervals_apart() -> None:
    head, first, second = as_csv(HEADINGS, ROWS).splitlines()
    assert head.startswith('looks,strategy,runs,worst,P_D,"P_D, 95 %, runs, low","P_D, 95 %, runs, high",')
    assert first == "single,uniform,20,2,0.966,0.963,0.969,0.9,1.0,0.0"
    assert second == "joint,uniform,20,1,0.996,,,0.9,1.0,"


def _row(cells: list[str]) -> dict[str, str]:
    return {f"c{i}": cell for i, cell in enumerate(cells)}
