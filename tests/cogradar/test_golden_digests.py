"""Shipped scenarios, and settings that meet every branch of the loop, play what they always did, byte for byte."""

import os
import subprocess
import sys

import pytest

from tests import golden

SHIPPED, PROCESSES = tuple(golden.SHIPPED), 3  # a process loads all kernels, which takes longer than most runs


@pytest.mark.slow
@pytest.mark.parametrize("names", [*(SHIPPED[i::PROCESSES] for i in range(PROCESSES)), tuple(golden.VARIANTS)])
def test_digests_are_the_golden_ones(names: tuple[str, ...]) -> None:
    """In a process of its own: what pins the arithmetic is read when NumPy is loaded."""
    played = subprocess.run(
        [sys.executable, "-m", "tests.golden", *names],
        env=os.environ | golden.PINNED,
        capture_output=True,
        text=True,
        check=False,
    )
    assert played.returncode == 0, played.stdout + played.stderr
