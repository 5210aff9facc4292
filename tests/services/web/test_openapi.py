"""The service does what its description says, for whatever the description allows and for what it does not."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCHEMATHESIS = Path(sys.executable).parent / "schemathesis"


@pytest.mark.slow
def test_the_service_is_as_described(server: str, tmp_path: Path) -> None:
    command = [str(SCHEMATHESIS), "run", f"{server}/api/v1/openapi.json", "--checks", "all", "--seed", "1"]
    done = subprocess.run(
        [*command, "--max-examples", "5", "--no-color"],
        cwd=tmp_path,
        env=os.environ | {"SCHEMATHESIS_HOOKS": "schemathesis_hooks", "PYTHONPATH": str(Path(__file__).parent)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-6000:]
