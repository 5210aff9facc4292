"""What a command or a process imports before it begins: it must not wait for libraries that it does not use."""

import subprocess
import sys
from pathlib import Path

import pytest

from cogradar.shared.protocol.topics import Role

HEAVY = {"numba", "scipy", "matplotlib", "cvxpy", "clarabel"}
SOLVERS = {"scipy.optimize", "scipy.sparse", "scipy.linalg", "scipy.spatial", "scipy.interpolate", "scipy.special"}
SHOWN = {"matplotlib", "plotly", "rich", "typer", "uvicorn", "starlette"}
# What the process of each role must not have loaded when its core is there.
UNUSED = {
    Role.EMULATOR: SOLVERS | SHOWN | {"cvxpy", "clarabel", "prometheus_client"},
    Role.PLANNER: SOLVERS | SHOWN | {"cvxpy", "clarabel", "prometheus_client", "sqlite3"},
    Role.ALLOCATOR: SOLVERS | SHOWN | {"cvxpy", "clarabel", "prometheus_client", "sqlite3"},
    Role.RECORDER: HEAVY | SHOWN | {"prometheus_client"},
    Role.METRICS: HEAVY | SHOWN,
    Role.OPERATOR: HEAVY | SHOWN | {"prometheus_client", "sqlite3"},
}


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
    loaded = _loaded_after(f"import {module}")
    assert module.partition(".")[0] in loaded
    assert HEAVY & loaded == set()


@pytest.mark.parametrize("role", UNUSED)
def test_a_role_imports_only_what_it_uses(role: Role, tmp_path: Path) -> None:
    service = f"topology.SERVICES[topology.Role({role.value!r})]"
    start = f"topology.Start('one', store={str(tmp_path / 'one.db')!r})"
    loaded = _loaded_after(f"from cogradar.services import topology; {service}.core({start})")
    assert f"cogradar.services.{role}" in loaded
    assert UNUSED[role] & loaded == set()


def test_the_command_line_loads_no_store_before_a_command_asks_for_one() -> None:
    """The process of each role is started by it."""
    assert "sqlite3" not in _loaded_after("import cogradar.services.cli.app")


def _loaded_after(statements: str) -> set[str]:
    """Modules of a process that has done no more: this one has imported everything."""
    script = f"import sys; {statements}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_the_process_that_starts_and_watches_a_run_loads_no_solver_and_no_receiver() -> None:
    loaded = _loaded_after(
        "from cogradar.services.cli import runs; from cogradar.services.runs import cluster, launcher;"
        " from cogradar.services import kernels"
    )
    others = {"front_ends", "emulator.simulated", "runs.chaos", "runs.in_process"}
    assert (SOLVERS | {f"cogradar.services.{name}" for name in others}) & loaded == set()
