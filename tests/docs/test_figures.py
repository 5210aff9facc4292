"""Figures of pages show what their tables say, and are as old as they are."""

import re

import numpy as np
import pytest
from matplotlib.patches import Rectangle
from PIL import Image

from docs.generator import decisions, figures


@pytest.mark.parametrize("name", figures.DRAWINGS)
def test_a_picture_is_of_its_tables_and_on_its_page(name: str) -> None:
    drawing = figures.DRAWINGS[name]
    with Image.open(figures.FIGURES / f"{name}.png") as picture:
        cure = "python -m docs.generator.figures"
        assert picture.info.get("Source") == drawing.source, f"older than its tables: {cure}"
    page = (figures.DOCS / drawing.page).read_text(encoding="utf-8")
    assert f"(figures/{name}.png)" in page
    assert all(f"(tables/{table}.csv)" in page for table in drawing.tables)


def test_what_the_search_buys_is_said_of_the_tables() -> None:
    page = decisions.PAGE.read_text(encoding="utf-8")
    assert decisions.with_buys(page) == page, "older than its tables: python -m docs.generator.decisions"
    for place in (figures.DOCS.parent / "README.md", figures.DOCS / "limits.md"):
        ((bound, settings),) = re.findall(
            r"within (0\.\d+) of\s+P_D in each of (\d+) settings", place.read_text(encoding="utf-8")
        )
        assert decisions.largest() <= float(bound)
        assert f"of {settings} settings" in page


def test_marks_are_the_numbers_of_the_tables() -> None:
    marks = [
        float(np.asarray(line.get_xdata())[0])
        for axes in figures.rules().axes
        for line in axes.lines
        if line.get_marker() == "o"
    ]
    assert sorted(marks) == sorted(float(row["P_D"]) for row in figures.rows(figures.POLICIES))
    drawn = figures.dwell().axes[0]
    for text, row in zip(drawn.texts, reversed(figures.rows(figures.SCALE)), strict=True):
        assert text.get_text() == f"{float(row['dwell']):.0f} ms"
    bars = [patch.get_width() for patch in drawn.patches if isinstance(patch, Rectangle)]
    first = sum(bars[: len(figures.SPENT)]) / 100.0
    row = figures.rows(figures.SCALE)[-1]
    assert first * float(row["dwell"]) == pytest.approx(sum(float(row[part]) for part in figures.SPENT))
