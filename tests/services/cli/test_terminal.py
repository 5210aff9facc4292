"""Tables on a terminal: nothing is cut, whatever its width, and what people read first stays readable."""

import io
import re
from typing import Any

import pytest
from rich.console import Console

from cogradar.services.analysis.tables import Column, Table
from cogradar.services.cli.answers import NOTES, ORDER, rows_table
from cogradar.services.cli.terminal import layout, print_tables
from cogradar.services.metrics.answers import METRICS, answer
from cogradar.services.metrics.selection import ALL
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.recorder.core import RecorderCore
from cogradar.shared.protocol.messages import Command
from cogradar.shared.protocol.orders import EndRun
from cogradar.shared.scoring.figures import Discovery
from tests.services.loop import play, smoke_start
from tests.services.tables import WIDTHS


def _lines(table: Table, width: int) -> list[str]:
    return [str(line) for line in layout(table, width)]


def _table(rows: list[dict[str, Any]], *names: str, **other: Any) -> Table:
    return Table("", [Column(name, f"{{{name}}}") for name in names], rows, **other)


@pytest.fixture(scope="module")
def store() -> Store:
    """Two runs of two targets."""
    store = in_memory()
    core = RecorderCore(store.journal)
    for seed, run in enumerate(("smoke-0123456789ab", "another-one")):
        for message in play(smoke_start(dwells=30, run=run, seed=seed)):
            core.handle(message)
        store.journal.add_command(Command(run=run, id=f"{seed:032}", by="tower", action=EndRun()), 1, 250, "")
    return store


@pytest.mark.parametrize("width", [*WIDTHS, 40, 300])
@pytest.mark.parametrize("metric", METRICS)
def test_answers_to_every_question_have_a_line_per_row_and_name_what_has_no_room(
    metric: str, width: int, store: Store
) -> None:
    rows = answer(store, metric, {} if metric == "runs" else {"run": ALL})
    if metric == "confirmation":  # these runs are of a known number
        assert rows == []
        found = Discovery.of([(1, 3, 30, 1.0), (2, None, 25, 1.0)])
        rows = 2 * [{"scenario": "smoke", "strategy": "power-aware", "runs": 3} | found._asdict()]
    assert len(rows) > 1
    lines = _lines(rows_table(rows, ORDER[metric]), width)
    assert max(map(len, lines)) <= width
    (rule,) = (i for i, line in enumerate(lines) if set(line) == {"-"})
    notes = " ".join(lines[rule + 1 + len(rows) :])
    assert not notes or notes.startswith("left out: ")
    text = "\n".join(lines)
    for name in set(rows[0]) - set(NOTES):
        assert all(part in text for part in re.split("_", name)), name
    for name in ORDER[metric][:4]:  # what people read first is there at 80 columns
        assert width < 80 or name not in re.split("[ ,]+", notes)
    assert width < 300 or not notes


@pytest.mark.parametrize("width", WIDTHS)
def test_tracks_of_one_run_say_its_name_once(width: int, store: Store) -> None:
    run = "smoke-0123456789ab"
    lines = _lines(rows_table(answer(store, "tracks", {"run": run}), ORDER["tracks"]), width)
    assert "\n".join(lines).count(run) == 1
    assert lines[0].startswith(f"all rows: run {run}")


def test_a_digest_is_short_unless_all_is_asked_for(store: Store) -> None:
    rows = answer(store, "runs", {})
    digest = rows[0]["digest"]
    for wide, shown in ((False, digest[:12]), (True, digest)):
        table = rows_table(rows, ORDER["runs"], wide=wide)
        (column,) = (column for column in table.columns if column.heading == "digest")
        assert column.cell(rows[0]) == shown


def test_what_fits_is_one_line_a_row_under_its_heading() -> None:
    rows = [{"name": "a", "p_d": 0.5}, {"name": "bcd", "p_d": 1.0}]
    table = Table("title", [Column("name", "{name}", left=True), Column("p_d", "{p_d:.2f}")], rows)
    assert _lines(table, 80) == ["title", "name   p_d", "----------", "a     0.50", "bcd   1.00"]


def test_a_number_that_is_long_before_its_point_has_an_exponent() -> None:
    column = Column("NEES", "{nees:.2f}, {low:.1f}, {asked:.4g}")
    assert column.cell({"nees": 568716483352072000.0, "low": -1.25e5, "asked": 1.0e5}) == "5.7e17, -1.2e5, 1e5"
    assert column.cell({"nees": 99_999.0, "low": float("inf"), "asked": 4.0}) == "99999.00, inf, 4"
    column = Column("difference", "{difference:+z.4f}, {n:.1f}, {share:.2e}, {name}")
    assert column.cell({"difference": 2.5e6, "n": 200_000, "share": 0.0, "name": "1e+06"}) == (
        "+2.5e6, 2.0e5, 0.00e0, 1e+06"
    )


def test_headings_are_broken_between_words() -> None:
    rows = [{"first_dwell": 1, "position_rmse_km": 2}, {"first_dwell": 3, "position_rmse_km": 4}]
    table = _table(rows, "first_dwell", "position_rmse_km")
    assert _lines(table, 20) == [
        "first_  position_",
        " dwell    rmse_km",
        "-----------------",
        "     1          2",
        "     3          4",
    ]


def test_what_is_the_same_in_all_rows_goes_into_one_line_if_it_must() -> None:
    rows = [{"a": "x" * 10, "b": "y" * 10, "c": f"z{i}"} for i in range(2)]
    assert _lines(_table(rows, "a", "b", "c"), 20) == [
        "all rows:",
        f"a {'x' * 10}",
        f"{'b':>10}  {'c':>2}",
        "--------------",
        f"{'y' * 10}  z0",
        f"{'y' * 10}  z1",
    ]


def test_two_of_one_name_that_are_the_same_in_all_rows_keep_their_values() -> None:
    """As intervals of several figures have: the last one's stood at the place of the first."""
    columns = [Column(name, "{" + key + "}") for name, key in (("P_D", "a"), ("low", "b"), ("lost", "c"), ("low", "d"))]
    rows = [{"a": 1.0, "b": 0.342, "c": 0, "d": 0.0, "run": 30 * f"{i}"} for i in range(2)]
    lines = _lines(Table("", (*columns, Column("run", "{run}")), rows), 30)
    assert " ".join(lines[:2]) == "all rows: P_D 1.0; low 0.342; lost 0; low 0.0"


def test_what_has_no_room_is_left_out_from_the_end_and_named() -> None:
    rows = [{"a": f"{i}" * 10, "b": f"{i}" * 4, "c_d": f"{i}" * 12} for i in range(2)]
    assert _lines(_table(rows, "a", "b", "c_d"), 18) == [
        f"{'a':>10}  {'b':>4}",
        "----------------",
        "0" * 10 + "  0000",
        "1" * 10 + "  1111",
        "left out: c_d; a",
        "window of 28",
        "characters, or",
        "COLUMNS=28, shows",
        "them",
    ]
    shown = [line for line in _lines(_table(rows, "a", "b", "c_d"), 28) if "left out" in line]
    assert shown == []  # so much is enough


def test_a_sentence_in_the_last_column_has_several_lines() -> None:
    rows = [
        {"check": "cost", "found": "a dwell takes at most so many ms"},
        {"check": "loads", "found": "yes"},
    ]
    columns = [Column("check", "{check}", left=True), Column("found", "{found}", left=True, wraps=True)]
    assert _lines(Table("", columns, rows), 32) == [
        "check  found",
        "-------------------------------",
        "cost   a dwell takes at most so",
        "       many ms",
        "loads  yes",
    ]


def test_a_single_row_that_is_too_wide_is_a_list_of_its_values() -> None:
    table = _table([{"run": "smoke", "digest": "9" * 18, "reason": ""}], "run", "digest", "reason")
    assert _lines(table, 20) == ["run     smoke", "digest", f"  {'9' * 18}", "reason  -"]


def test_unknown_values_are_dashes_and_groups_are_set_apart() -> None:
    table = _table([{"a": 1, "b": None}, {"a": 1, "b": 2}, {"a": 2, "b": 3}], "a", "b", group="a")
    assert _lines(table, 80) == ["a  b", "----", "1  -", "1  2", "", "2  3"]


def test_rows_are_shown_as_they_are() -> None:
    tricky = "[red]/tmp/[/red] [bold]x[/] :warning: [0] \x1b[31m"
    console = Console(file=io.StringIO(), width=80, force_terminal=True, color_system=None, legacy_windows=False)
    print_tables(console, [rows_table([{"key": tricky, "number": 0.123456}]), rows_table([])])
    assert isinstance(console.file, io.StringIO)
    text = console.file.getvalue()
    assert all(words in text for words in (tricky.replace("\x1b", "?"), "0.1235", "no rows"))
