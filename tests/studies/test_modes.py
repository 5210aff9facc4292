"""What counts as a condition, and which modes it asks for."""

import ast
from pathlib import Path

import pytest

from studies.modes import ROOMS, conditions, counts, modes_asked, sources

PROGRAM = """
if radar.is_unknown and scan.roster is not None:
    pass
elif period_s:
    pass
near = [nu for nu in nus if nu > 0.0]
own = a if model.aperture is None else b
while n < 3:
    n += 1
match n:
    case 1 if radar.receiver.range_cell_km > 0.0:
        pass
    case 2:
        pass
"""


def test_each_test_filter_and_case_is_one_condition() -> None:
    assert len(list(conditions(ast.parse(PROGRAM)))) == 7


def test_a_condition_that_asks_twice_for_one_mode_counts_once(tmp_path: Path) -> None:
    file = tmp_path / "program.py"
    file.write_text(PROGRAM, encoding="utf-8")
    shown: list[str] = []
    found = counts([file], shown)
    assert (found["conditions"], found["modes"], found["lines"]) == (7, 4, PROGRAM.count("\n"))
    assert {mode: found[mode] for mode in ("unannounced", "real time", "bins/steered", "range cells")} == {
        "unannounced": 1,
        "real time": 1,
        "bins/steered": 1,
        "range cells": 1,
    }
    assert len(shown) == 4


@pytest.mark.parametrize(
    ("text", "modes"),
    [
        ("model.sensor.law.tells_range", ["law of the RCS"]),
        ("state.modes.size and scan.expected is None", ["unannounced", "modes of motion"]),
        ("isinstance(hit, Looks)", ["bins/steered"]),
        ("radar.receiver.cells == 'steered'", ["bins/steered"]),
        ("scan.ids.size > roster_size", []),
    ],
)
def test_modes_of_a_condition(text: str, modes: list[str]) -> None:
    assert modes_asked(ast.parse(text, mode="eval").body) == modes


def test_the_nine_rooms_exist() -> None:
    assert set(ROOMS) <= sources(Path(__file__).parents[2]).keys()
