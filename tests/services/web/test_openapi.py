"""The service does what its description says, for whatever the description allows and for what it does not."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
SCHEMATHESIS = Path(sys.executable).parent / "schemathesis"


@pytest.mark.slow
@pytest.mark.parametrize(
    "extent",
    [
        pytest.param(["--phases", "coverage"], id="coverage"),  # every parameter at its limits
        pytest.param(["--max-examples", "50"], id="all", marks=pytest.mark.nightly),  # also at random, and in sequences
    ],
)
def test_the_service_is_as_described(extent: list[str], server: str, tmp_path: Path) -> None:
    command = [str(SCHEMATHESIS), "--config-file", str(HERE / "schemathesis.toml"), "run"]
    command += [f"{server}/api/v1/openapi.json", "--checks", "all", "--seed", "1"]
    done = subprocess.run(
        [*command, *extent, "--no-color"],
        cwd=tmp_path,
        env=os.environ | {"SCHEMATHESIS_HOOKS": "schemathesis_hooks", "PYTHONPATH": str(HERE)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-6000:]
