"""Shipped scenarios, and settings that meet every branch of the loop, play what they always did, byte for byte."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from cogradar.services.bench.golden import FILE
from tests import golden

SHIPPED, PROCESSES = tuple(golden.SHIPPED), 3  # a process loads all kernels, which takes longer than most runs
# NumPy without its codes for newer processors, OpenBLAS of a processor of 2008; both read when they are loaded.
OLDER = {
    "NPY_DISABLE_CPU_FEATURES": " ".join(np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])),
    "OPENBLAS_CORETYPE": "Nehalem",
}
# Which meet each room: cells of its own, the steered ones, an array with a joint receiver, equal antennas, tracks.
ON_OLDER = ("smoke", "array, echoes told apart", "equal antennas", "bins, joint looks, turns", "steered, RCS unknown")


@pytest.mark.slow
@pytest.mark.parametrize(
    "names",
    [
        *(SHIPPED[i::PROCESSES] for i in range(PROCESSES)),
        *(tuple(golden.VARIANTS)[i::2] for i in range(2)),
        (golden.FIRST_RUN,),
    ],
)
def test_digests_are_the_golden_ones(names: tuple[str, ...]) -> None:
    """In a process of its own, that loads each kernel once."""
    assert_golden(names, {})


def test_the_readme_has_the_digest_of_its_first_run() -> None:
    text = golden.README.read_text(encoding="utf-8")
    digest = json.loads(FILE.read_text(encoding="utf-8"))[golden.FIRST_RUN]["1"]
    assert golden.with_digest(text, digest) == text


def test_digests_are_the_same_on_an_older_processor() -> None:
    """As far as one processor can show it: the codes of NumPy and OpenBLAS are another processor's."""
    assert_golden(ON_OLDER, OLDER)


def assert_golden(names: tuple[str, ...], variables: dict[str, str]) -> None:
    played = subprocess.run(
        [sys.executable, "-m", "tests.golden", *names],
        env=os.environ | variables,
        capture_output=True,
        text=True,
        check=False,
    )
    assert played.returncode == 0, played.stdout + played.stderr
