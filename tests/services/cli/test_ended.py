"""Runs that end before their last dwell: their table is of the dwells that they have."""

from pathlib import Path

import pytest

from tests.services.cli.here import here


@pytest.mark.parametrize("dwells", [40, 300])
def test_a_recording_that_is_shorter_than_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dwells: int) -> None:
    monkeypatch.chdir(tmp_path)
    whole = here("run", "smoke", "--in-process", "--dwells", "25", "--store", "a.db")
    assert whole.returncode == 0, whole.stderr
    again = here(
        *("run", "smoke", "--in-process", "--dwells", str(dwells), "--store", "b.db"),
        *("--front-end", "recorded:a.db"),
    )
    assert (again.returncode, again.stderr.count("Traceback")) == (0, 0), again.stderr
    assert f"at dwell 25 of {dwells}" in " ".join(again.stdout.split())
