"""Reports as pages: written between the markers of a file, or not at all."""

from pathlib import Path

import pytest

from cogradar.services.analysis.report_tables import write
from cogradar.services.errors import BadInput
from cogradar.services.metrics.store import Store
from tests.services.analysis.conftest import report_of, row_of


def test_tables_are_written_between_the_markers(store: Store, tmp_path: Path) -> None:
    page = tmp_path / "results.md"
    page.write_text("before\n<!-- report smoke -->\nold\n<!-- /report smoke -->\nafter\n")
    found = report_of(store)
    for _ in range(2):  # writing twice changes nothing more
        write(page, [found])
        text = page.read_text()
    assert text.startswith("before\n<!-- report smoke -->\n")
    assert text.endswith("<!-- /report smoke -->\nafter\n")
    assert "old" not in text
    assert text.count("| 1 | uniform | 0.500 [0.500, 0.500] | [0.377, 0.623] |") == 1
    assert text.count("run smoke --in-process --strategy power-aware --seed 1 --dwells 60`, digest `") == 1
    assert {path.name for path in tmp_path.iterdir()} == {"results.md", "tables"}
    page.write_text("no markers")
    with pytest.raises(BadInput, match=r"results\.md: has no lines"):
        write(page, [found])


def test_a_page_that_cannot_be_written_is_named(store: Store, tmp_path: Path) -> None:
    page = tmp_path / "results.md"
    page.write_text("<!-- report smoke -->\n<!-- /report smoke -->\n")
    (tmp_path / "results.md.new").mkdir()
    with pytest.raises(BadInput, match=r"results\.md: Is a directory"):
        write(page, [report_of(store)])


def test_several_reports_go_between_their_own_markers_or_none_does(store: Store, tmp_path: Path) -> None:
    page = tmp_path / "results.md"
    markers = "<!-- report {0} -->\n<!-- /report {0} -->\n"
    page.write_text(markers.format("smoke") + markers.format("other"))
    smoke = report_of(store)
    other = smoke | {"scenario": "other", "fidelity": "paper"}
    write(page, [smoke, other])
    first, second = page.read_text().split("<!-- /report smoke -->")
    assert "smoke (robust): 3 uniform, 3 power-aware runs of 60 dwells" in first
    assert "other (paper): 3 uniform" in second
    before = page.read_text()
    with pytest.raises(BadInput, match="no lines <!-- report third -->"):
        write(page, [smoke | {"digest": "new"}, smoke | {"scenario": "third"}])
    assert page.read_text() == before


def test_reports_stand_side_by_side_where_a_page_asks_for_it(store: Store, tmp_path: Path) -> None:
    page = tmp_path / "results.md"
    markers = "<!-- {0} -->\n<!-- /{0} -->\n"
    page.write_text("".join(markers.format(name) for name in ("side by side", "report smoke", "report other")))
    smoke = report_of(store)
    write(page, [smoke, smoke | {"scenario": "other", "fidelity": "paper"}])
    beside = page.read_text().split("<!-- /side by side -->")[0]
    last, all_ = beside.split("**Side by side, all dwells**")
    p_d = row_of(smoke["last"], target=1, strategy="uniform")["p_d"]
    for table, p_d_of, dwells in ((last, p_d, "41-60"), (all_, 1.0 - 10 / 60, "1-60")):  # ten misses, all at the end
        assert f"In all rows: dwells {dwells};" in table
        for scenario in ("smoke (robust)", "other (paper)"):
            assert table.count(f"| 1 | uniform | {scenario} | {p_d_of:.3f} [") == 1
        lines = [line.split("|")[1] for line in table.splitlines() if line.startswith(("| 1 ", "| 2 "))]
        assert len(lines) == 8
        assert lines == sorted(lines)  # target by target
