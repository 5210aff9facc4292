"""Figures of pages show what their tables say, and are as old as they are."""

import numpy as np
import pytest
from matplotlib.patches import Rectangle
from PIL import Image

from docs.generator import figures


@pytest.mark.parametrize("name", figures.DRAWINGS)
def test_a_picture_is_of_its_tables_and_on_its_page(name: str) -> None:
    drawing = figures.DRAWINGS[name]
    with Image.open(figures.FIGURES / f"{name}.png") as picture:
        cure = "python -m docs.generator.figures"
        assert picture.info.get("Source") == drawing.source, f"older than its tables: {cure}"
    page = (figures.DOCS / drawing.page).read_text(encoding="utf-8")
    assert f"(figures/{name}.png)" in page
    assert all(f"(tables/{table}.csv)" in page for table in drawing.tables)


def test_marks_are_the_numbers_of_the_tables() -> None:
    marks = [
        float(np.asarray(line.get_xdata())[0])
        for axes in figures.rules().axes
        for line in axes.lines
        if line.get_marker() == "o"
    ]
    assert sorted(marks) == sorted(float(row["P_D of target 2"]) for row in figures.rows(figures.POLICIES))
    drawn = figures.dwell().axes[0]
    for text, row in zip(drawn.texts, reversed(figures.rows(figures.SCALE)), strict=True):
        assert text.get_text() == f"{float(row['dwell']):.0f} ms"
    bars = [patch.get_width() for patch in drawn.patches if isinstance(patch, Rectangle)]
    first = sum(bars[: len(figures.SPENT)]) / 100.0
    row = figures.rows(figures.SCALE)[-1]
    assert first * float(row["dwell"]) == pytest.approx(sum(float(row[part]) for part in figures.SPENT))
