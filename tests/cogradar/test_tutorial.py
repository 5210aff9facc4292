"""The tutorial does what it says: every cell runs, from top to bottom, and its answers are those of this program."""

from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

NOTEBOOK = Path(__file__).resolve().parents[2] / "docs" / "tutorial" / "notebook.ipynb"


def _notebook() -> Any:
    return import_module("nbformat").read(NOTEBOOK, as_version=4)  # seven seconds to import, which all would wait for


def test_it_is_stored_without_outputs() -> None:
    for cell in _notebook().cells:
        assert cell.cell_type == "markdown" or (cell.outputs == [] and cell.execution_count is None)


@pytest.mark.slow
def test_every_cell_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    notebook = _notebook()
    monkeypatch.setenv("JUPYTER_DATA_DIR", str(tmp_path))
    client = import_module("nbclient").NotebookClient(
        notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}
    )
    client.execute()
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    texts = [output.data["text/plain"] for output in outputs if "data" in output]
    assert any(
        text.split()[-2:] == ["True,", "True)"] for text in texts
    )  # the stored run is the one that was played here
    assert any("image/png" in output.get("data", {}) for output in outputs)
