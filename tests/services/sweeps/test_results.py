"""What a sweep shows: rows of the weakest targets, a table, a figure."""

import csv
from pathlib import Path
from typing import Any

import pytest

from cogradar.services.analysis.pages import WIDEST
from cogradar.services.analysis.report import report
from cogradar.services.campaigns.campaign import Campaign
from cogradar.services.campaigns.pool import play_one
from cogradar.services.metrics.experiments import experiments
from cogradar.services.metrics.selection import Selection
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.runs.run import PICTURE
from cogradar.services.sweeps import results
from cogradar.services.sweeps.grid import Axis, Variant, axis, variants
from cogradar.shared.protocol.build import build
from cogradar.shared.scenario.radar_config import Strategy

DWELLS = 4
OVER = ("world.echo.amplitude_db=70,-100", "radar.fidelity=robust,paper")
SETTINGS = ("radar.acquisition.max_scans=5",)


@pytest.fixture(scope="module")
def axes() -> list[Axis]:
    return [axis(text) for text in OVER]


@pytest.fixture(scope="module")
def grid(axes: list[Axis]) -> list[Variant]:
    return variants("smoke", SETTINGS, axes)


@pytest.fixture(scope="module")
def store(grid: list[Variant]) -> Store:
    """Two variants in which targets are seen, two in which they are not."""
    kept = in_memory()
    scenarios = tuple(variant.scenario for variant in grid)
    asked = Campaign(scenarios, (Strategy.UNIFORM,), runs=2, first_seed=1, dwells=DWELLS)
    for place, start in enumerate(asked.starts(), 1):
        kept.journal.add_recording(play_one(start, build())[0], place)
    return kept


@pytest.fixture(scope="module")
def rows(store: Store, axes: list[Axis], grid: list[Variant]) -> results.Rows:
    return results.rows(store, axes, grid)


def test_a_row_has_the_lowest_p_d_and_the_largest_error_of_a_variant(
    store: Store, grid: list[Variant], rows: results.Rows
) -> None:
    assert [(row["world.echo.amplitude_db"], row["radar.fidelity"]) for row in rows] == [
        (70, "robust"),
        (70, "paper"),
        (-100, "robust"),
        (-100, "paper"),
    ]
    assert [row["scenario"] for row in rows] == [variant.scenario.name for variant in grid]
    (one,) = experiments(store, Selection.of({"run": "all", "scenario": grid[1].scenario.name}))
    last = report(store, one)["last"]
    worst = min(last, key=lambda row: row["p_d"])
    assert len(last) > 1
    assert {name: rows[1][name] for name in ("target", "p_d", "p_d_low", "p_d_high")} == {
        name: worst[name] for name in ("target", "p_d", "p_d_low", "p_d_high")
    }
    # Of whichever target: a tie in P_D must not choose between small and large errors.
    assert rows[1]["position_rmse_km"] == max(row["position_rmse_km"] for row in last)
    assert (rows[1]["runs"], rows[1]["failed"], rows[1]["lost"]) == (2, 0, 0)
    assert rows[1]["largest"] == max(last, key=lambda row: row["position_rmse_km"])["target"]
    (picture,) = report(store, one)["picture"]
    assert {name: rows[1][name] for name in PICTURE} == {name: picture[name] for name in PICTURE}
    assert rows[1]["gospa_km_low"] <= rows[1]["gospa_km"] <= rows[1]["gospa_km_high"]


def test_of_a_variant_whose_runs_failed_nothing_is_known(store: Store, rows: results.Rows) -> None:
    assert [(row["runs"], row["failed"], row["p_d"], row["lost"]) for row in rows[2:]] == 2 * [(0, 2, None, None)]
    assert {row[name] for row in rows[2:] for name in PICTURE} == {None}
    (remark,) = results.remarks(store, rows)
    assert remark.startswith("4 of 8 runs failed, the first: not every target was detected within 5 scans; largest ")


def test_more_than_two_axes_are_a_table_with_a_column_each(
    axes: list[Axis], rows: results.Rows, tmp_path: Path
) -> None:
    linked = axis("radar.motion.sigma_s_km_s2,world.motion.sigma_s_km_s2=0.004,0.03")
    other = axis("world.other.amplitude_db=1")
    found = [row | {linked.name: 0.004, other.name: 1} for row in rows]
    table = results.table(found, [*axes, linked, other])
    names = ["world.echo.amplitude_db", "fidelity", "sigma_s_km_s2", "world.other.amplitude_db"]
    assert [column.heading for column in table.columns[:4]] == names
    assert [column.cell(table.rows[0]) for column in table.columns[:4]] == ["70", "robust", "0.004", "1"]
    assert results.draw(found, [*axes, linked, other], tmp_path / "figures") == []
    assert not (tmp_path / "figures").exists()


def test_the_table_has_a_column_for_each_key(axes: list[Axis], rows: results.Rows) -> None:
    table = results.table(rows, axes)
    assert [column.heading for column in table.columns[:3]] == ["amplitude_db", "fidelity", "strategy"]
    assert [column.cell(table.rows[0]) for column in table.columns[:3]] == ["70", "robust", "uniform"]
    assert table.title == f"Last dwells, 1-{DWELLS}"


def test_dwells_that_differ_have_a_column(axes: list[Axis], rows: results.Rows) -> None:
    table = results.table([rows[0] | {"last_dwell": 9}, *rows[1:]], axes)
    assert table.title == "Last dwells"
    (column,) = [column for column in table.columns if column.heading == "dwells"]
    assert [column.cell(row) for row in table.rows[:2]] == ["1-9", f"1-{DWELLS}"]


@pytest.mark.parametrize("n_axis", [1, 2])
def test_the_figure_is_drawn_for_numbers_and_words(
    n_axis: int, axes: list[Axis], rows: results.Rows, tmp_path: Path
) -> None:
    """The second time with words along x."""
    chosen = axes if n_axis == 2 else axes[1:]
    found = rows if n_axis == 2 else rows[:2]
    files = results.draw(found, chosen, tmp_path / "figures")
    assert [file.name for file in files] == ["sweep.png", "sweep.pdf"]
    assert all(file.stat().st_size > 10_000 for file in files)


def test_what_is_typed_is_a_number_where_it_can_be() -> None:
    texts, values = ("16", "0.5", "1e3", "paper", "[1, 2]"), [16, 0.5, 1000.0, "paper", "[1, 2]"]
    assert [results.typed(text) for text in texts] == values


def test_whole_runs_have_rows_of_their_own(store: Store, axes: list[Axis], grid: list[Variant], tmp_path: Path) -> None:
    whole = results.whole_rows(store, axes, grid)
    assert [row["world.echo.amplitude_db"] for row in whole] == [70, 70]  # of the others no run is complete
    (one,) = experiments(store, Selection.of({"run": "all", "scenario": grid[1].scenario.name}))
    everything = report(store, one)
    of_run = [row for row in everything["windows"] if row["last_dwell"] - row["first_dwell"] == DWELLS - 1]
    assert whole[1]["p_d"] == min(row["p_d"] for row in of_run)
    assert whole[1]["position_rmse_km"] == max(row["position_rmse_km"] for row in of_run)
    assert whole[1]["in_band"] == min(row["in_band"] for row in everything["consistency"])
    assert (whole[1]["lost"], whole[1]["tracks"]) == (0, 4)
    of_flights = {row["flight"]: row for row in everything["flights"]}
    assert (whole[1]["nees"], whole[1]["beyond_99"]) == (of_flights["all"]["nees"], of_flights["all"]["beyond_99"])
    assert whole[1]["nees_straight"] == of_flights["straight"]["nees"]
    assert whole[1]["gospa_km"] == everything["picture"][0]["gospa_km"]
    page = tmp_path / "page.md"
    page.write_text("before\n\n<!-- sweep grid -->\nold\n<!-- /sweep grid -->\n\nafter\n")
    table = results.whole_table(whole, axes)
    results.write(page, "grid", [table], ["4 of 8 runs failed"])
    text = page.read_text()
    assert "old" not in text
    assert "4 of 8 runs failed" in text
    for line in text.splitlines():
        assert line.count(" | ") <= WIDEST
    (file,) = (tmp_path / "tables").iterdir()
    assert f"[All columns](tables/{file.name})" in text
    head, *cells = csv.reader(file.read_text().splitlines())
    assert len(cells) == len(whole)
    assert {column.heading for column in table.columns if "95 %" not in column.heading} <= set(head)


def test_a_target_that_was_never_followed_has_no_consistency(
    store: Store, axes: list[Axis], grid: list[Variant], monkeypatch: pytest.MonkeyPatch
) -> None:
    def unknown(*given: Any) -> dict[str, Any]:
        everything = report(*given)
        everything["consistency"][0]["in_band"] = None
        return everything

    known = results.whole_rows(store, axes, grid)
    monkeypatch.setattr(results, "report", unknown)
    found = results.whole_rows(store, axes, grid)
    assert all(one["in_band"] >= other["in_band"] for one, other in zip(found, known, strict=True))
