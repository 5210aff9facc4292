"""What a short command imports: it must not wait for the compiler and the libraries of the signal path."""

import subprocess
import sys

import pytest

HEAVY = {"numba", "scipy", "matplotlib", "cvxpy", "clarabel"}


@pytest.mark.parametrize(
    "module",
    [
        "cogradar.shared.protocol.topics",
        "cogradar.services.health",
        "cogradar.services.metrics.client",
        "cogradar.services.metrics.answers",
        "cogradar.services.cli.display",
        "cogradar.services.cli.app",
        "cogradar",
    ],
)
def test_what_talks_and_asks_imports_neither_compiler_nor_solvers(module: str) -> None:
    """In a process of its own: this one has imported everything."""
    script = f"import sys, {module}; print(*{{name.partition('.')[0] for name in sys.modules}})"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert module.partition(".")[0] in done.stdout.split()
    assert HEAVY & set(done.stdout.split()) == set()
