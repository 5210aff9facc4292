"""Shipped scenarios, and settings that meet every branch of the loop, play what they always did, byte for byte."""

import os
import subprocess
import sys

import pytest

from tests import golden


@pytest.mark.slow
@pytest.mark.parametrize("names", [*[(name,) for name in golden.SHIPPED], tuple(golden.VARIANTS)], ids=lambda n: n[0])
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
