"""The examples of docs/howto/extending.md: one file and one line, and everything knows the name."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from services.runs.in_process import play
from shared.protocol.messages import RunStart
from shared.scenario import tables
from shared.scenario.files import load
from shared.scenario.radar_config import Strategy
from shared.scoring.prospects import prospects

PAGE = Path("docs/howto/extending.md").read_text(encoding="utf-8")


def _saved(folder: Path) -> dict[str, str]:
    """The files of the page in a folder of their own; returns its lines of the tables: name -> address there."""
    for path, text in re.findall(r"```python\n# (shared/\S+\.py)\n(.*?)```", PAGE, re.DOTALL):
        (folder / Path(path).name).write_text(text, encoding="utf-8")
    lines = re.findall(r'`"(\w+)": "shared\.\w+\.(\w+:\w+)",`', PAGE)
    assert {name for name, _ in lines} == {"strongest", "bursts", "ahead"}
    return dict(lines)


def test_a_power_rule_is_a_strategy_everywhere(tmp_path: Path) -> None:
    address = _saved(tmp_path)["strongest"]
    program = (
        "import sys; from shared.scenario import tables\n"
        f"tables.POWER_RULES['strongest'] = {address!r}\n"
        "from services.cli.app import main; main()"
    )

    def cogradar(*arguments: str) -> str:
        environment = os.environ | {"PYTHONPATH": f"{Path.cwd()}:{tmp_path}"}
        command = [sys.executable, "-c", program, *arguments]
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=200, check=False, cwd=tmp_path, env=environment
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    for strategy in ("strongest", "uniform"):
        cogradar("run", "smoke", "--in-process", "--dwells", "3", "--strategy", strategy, "--store", "c.db")
    assert "strongest" in cogradar("run", "--help")
    assert cogradar("query", "tracks", "--strategy", "strongest", "--store", "c.db", "--csv").count(",strongest,") == 6
    assert "strongest" in cogradar("report", "c.db")
    assert "strongest" in cogradar("check", "smoke")


def test_a_disturbance_is_a_model_of_the_world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setitem(tables.DISTURBANCES, "bursts", _saved(tmp_path)["bursts"])
    scenario = load("smoke", ["world.disturbance.model=bursts", "dwells=3"])
    assert all(0.0 < p <= 1.0 for one in prospects(scenario) for p in one.p_d.values())
    result = play(RunStart.of(scenario, Strategy.POWER_AWARE, 1, None))
    assert result.run["status"] == "complete"
    as_before = play(RunStart.of(load("smoke", ["dwells=3"]), Strategy.POWER_AWARE, 1, None))
    assert result.run["digest"] != as_before.run["digest"]


def test_a_rule_of_looking_is_a_rule_of_the_planner(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setitem(tables.BIN_RULES, "ahead", _saved(tmp_path)["ahead"])
    digests = {}
    for rule in ("pomcp", "ahead"):
        scenario = load("smoke", [f"radar.planner.rule={rule}", "dwells=20"])
        digests[rule] = play(RunStart.of(scenario, Strategy.POWER_AWARE, 1, None)).run["digest"]
    assert digests["ahead"] != digests["pomcp"]  # no plan of it has simulations
