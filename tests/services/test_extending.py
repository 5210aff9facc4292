"""The examples of docs/howto/extending.md: one file and one line, and everything knows the name."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from cogradar.services.runs.in_process import play
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario import tables
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scoring.prospects import prospects

PAGE = Path("docs/howto/extending.md").read_text(encoding="utf-8")


def _saved(folder: Path) -> dict[str, str]:
    """The files of the page in a folder of their own; returns its lines of the tables: name -> address there."""
    for path, text in re.findall(r"```python\n# (shared/\S+\.py)\n(.*?)```", PAGE, re.DOTALL):
        (folder / Path(path).name).write_text(text, encoding="utf-8")
    lines = re.findall(r'`"(\w+)": "cogradar\.shared\.\w+\.(\w+:\w+)",`', PAGE)
    assert {name for name, _ in lines} == {"strongest", "bursts", "ahead"}
    return dict(lines)


def test_a_power_rule_is_a_strategy_everywhere(tmp_path: Path) -> None:
    address = _saved(tmp_path)["strongest"]
    program = (
        "import sys; from cogradar.shared.scenario import tables\n"
        f"tables.POWER_RULES['strongest'] = {address!r}\n"
        "from cogradar.services.cli.app import main; main()"
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


_WITH_METRIC = """
import sys, types
from pathlib import Path

source = Path("shared/scoring/columns.py").read_text()
head, _, rest = source.partition("\\n)\\nPICTURE = (")
columns = sys.modules["cogradar.shared.scoring.columns"] = types.ModuleType("cogradar.shared.scoring.columns")
exec(head + "\\n    " + sys.argv[1] + "\\n)\\nPICTURE = (" + rest, columns.__dict__)

from docs.generator import numbers
from cogradar.services.analysis import export
from cogradar.services.analysis.run_arrays import Result
from cogradar.services.analysis.stored_run import StoredRun
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.recording import take
from cogradar.services.metrics.store import in_memory
from cogradar.services.runs.in_process import play
from cogradar.services.web.openapi import describe
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy

for more in (["dwells=3"], ["dwells=15", "radar.fidelity=best", 'radar.tracks="unknown"']):
    store, kept = in_memory(), in_memory()
    play(RunStart.of(load("smoke", more), Strategy.POWER_AWARE, 1, None), store=store)
    rows = [row["range_error_km"] for row in answer(store, "tracks", {})]
    result = Result(StoredRun(lambda metric, parameters: answer(store, metric, parameters)))
    written = [value for value in export.table(result)["range_error_km"].tolist() if value == value]
    assert sorted(written) == sorted(value for value in rows if value is not None) != [], (written, rows)
    assert "range_error_km" in answer(store, "summary", {})[0]
    kept.journal.add_recording(take(store, store.read("SELECT run FROM run")[0]["run"]), 1)
    assert [row["range_error_km"] for row in kept.read("SELECT * FROM main.score ORDER BY t, target")] == rows
schemas = describe()["components"]["schemas"]
for name in ("TrackRow", "TargetOfDwell", "SummaryRow"):
    assert schemas[name]["properties"]["range_error_km"]["description"] == "of the estimate", name
assert "| `range_error_km` | real | km | of the estimate |" in numbers.store()
"""


def test_a_metric_is_one_file_and_one_line(tmp_path: Path) -> None:
    """In a process of its own, whose table of columns has the line of the page."""
    _saved(tmp_path)
    ((line, address),) = re.findall(r'`(Column\("range_error_km", .*"cogradar\.shared\.scoring\.(\w+:\w+)".*,)`', PAGE)
    command = [sys.executable, "-c", _WITH_METRIC, line.replace(f"cogradar.shared.scoring.{address}", address)]
    environment = os.environ | {"PYTHONPATH": f"{Path.cwd()}:{tmp_path}"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, env=environment)
    assert done.returncode == 0, done.stderr
