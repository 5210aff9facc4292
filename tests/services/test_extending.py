"""The examples of docs/howto/extending.md."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = Path("docs/howto/extending.md").read_text(encoding="utf-8")
TEMPLATES = Path("deploy/plugins")


def _saved(folder: Path) -> None:
    """The file of the page that belongs into the package, in a folder of its own."""
    ((path, text),) = re.findall(r"```python\n# (shared/\S+\.py)\n(.*?)```", PAGE, re.DOTALL)
    (folder / Path(path).name).write_text(text, encoding="utf-8")


@pytest.mark.parametrize("kind", [path.stem for path in sorted(TEMPLATES.glob("*.py")) if path.stem != "front_end"])
def test_the_examples_of_the_page_are_the_files_to_begin_with(kind: str) -> None:
    """The tests in tests/services/plugins play them."""
    page = Path("docs/howto/feed.md").read_text(encoding="utf-8") if kind == "feed" else PAGE
    assert f"```python\n{(TEMPLATES / kind).with_suffix('.py').read_text(encoding='utf-8')}```" in page


def test_a_rule_of_somebodys_own_is_a_name_everywhere(tmp_path: Path) -> None:
    def cogradar(*arguments: str) -> str:
        command = [sys.executable, "-m", "cogradar", *arguments]
        environment = os.environ | {"PYTHONPATH": str(Path.cwd())}
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=300, check=False, cwd=tmp_path, env=environment
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    cogradar("new", "strategy", "mine.py")
    assert "mine.py:strongest#" in cogradar("check", "mine.py")
    for strategy in ("mine.py:strongest", "uniform"):
        cogradar("run", "smoke", "--in-process", "--dwells", "3", "--strategy", strategy, "--store", "c.db")
    rows = cogradar("query", "tracks", "--strategy", "mine.py:strongest", "--store", "c.db", "--csv")
    assert len(re.findall(r",mine\.py:strongest#[0-9a-f]{16},", rows)) == 6
    assert "mine.py:strongest#" in cogradar("report", "c.db")
    cogradar("new", "disturbance", "bursts.py")
    assert "valid" in cogradar("check", "smoke", "--set", "world.disturbance.model=bursts.py:BURSTS")


_WITH_METRIC = """
import sys, types
from pathlib import Path

source = Path("shared/scoring/columns.py").read_text()
head, _, rest = source.partition("\\n)\\nPICTURE = (")
columns = sys.modules["cogradar.shared.scoring.columns"] = types.ModuleType("cogradar.shared.scoring.columns")
exec(head + "\\n    " + sys.argv[1] + "\\n)\\nPICTURE = (" + rest, columns.__dict__)

from docs.generator import numbers
from cogradar.services.analysis.export.tables import scores
from cogradar.services.analysis.arrays.result import Result
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
    written = [value for value in scores(result)["range_error_km"].tolist() if value == value]
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
