"""No control character of others' text reaches a terminal or a log."""

import logging
from contextlib import closing
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cogradar.services.cli.app import app
from cogradar.services.process import _Printable
from cogradar.services.recorder.journal import Journal
from cogradar.shared.protocol.messages import RunEnd, RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy

ESCAPES = "\x1b]0;owned\x07\x1b[2J\x9b31m\u202e\x00"


@pytest.mark.parametrize("form", [[], ["--csv"], ["--json"], ["--wide"]])
def test_the_reason_of_a_run_is_printed_without_escapes(form: list[str], tmp_path: Path) -> None:
    path = str(tmp_path / "run.db")
    start = RunStart.of(load("smoke"), Strategy.UNIFORM, 1, 5)
    with closing(Journal(path)) as journal:
        journal.add_run(start)
        journal.end_run(RunEnd(run=start.run, k=0, t=0, status="failed", reason=f"gone {ESCAPES} away"), "")
    found = CliRunner().invoke(app, ["query", "runs", "--store", path, *form])
    assert "gone" in found.output
    assert not set(found.output) & set(ESCAPES) - set("0;owned]2J31m[")


def test_a_scenario_is_shown_without_escapes(tmp_path: Path) -> None:
    path = tmp_path / "other.toml"
    path.write_text('extends = "smoke"\ntitle = "a \\u009b31m b"  # \u202e turned\n', encoding="utf-8")
    found = CliRunner().invoke(app, ["scenarios", "--show", str(path)])
    assert found.exit_code == 0, found.output
    assert "title" in found.output
    assert not set(found.output) & {"\x9b", "\u202e"}


def test_a_line_of_the_log_is_one_line_without_escapes() -> None:
    record = logging.LogRecord("a", logging.INFO, "", 0, "dropped %s", (f"x{ESCAPES}\nERROR forged",), None)
    text = _Printable("%(levelname)s %(message)s").format(record)
    assert text.startswith("INFO dropped x?")
    assert text.isprintable()
