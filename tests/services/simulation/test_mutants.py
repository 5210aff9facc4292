"""Faults that are planted in the program have their places, and the simulator finds them."""

import ast
from pathlib import Path

import pytest

from tests.mutants import main, planted
from tests.planted_faults import MUTANTS, Mutant

REPOSITORY = Path(__file__).parents[3]


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_a_planted_fault_has_its_place_and_is_a_program(mutant: Mutant) -> None:
    source = (REPOSITORY / mutant.module).read_text(encoding="utf-8")
    assert ast.dump(ast.parse(planted(mutant, source))) != ast.dump(ast.parse(source))


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "outcome"),
    [("begins unfinished runs at the next dwell", 0), ("searches go on with the random numbers", 0), ("as late", 1)],
)
def test_a_planted_fault_is_found(
    name: str, outcome: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Within its schedules, and not within too few; the exit code says so."""
    monkeypatch.setattr("sys.argv", ["mutants", name, "--schedules", "50" if outcome == 0 else "1"])
    assert main() == outcome
    assert f"{1 - outcome} of 1 planted faults were found" in capsys.readouterr().out


@pytest.mark.nightly
def test_all_planted_faults_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["mutants"])
    assert main() == 0
