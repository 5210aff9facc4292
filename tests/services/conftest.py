"""Who of ours is running: tests that start processes check that they left none."""

import time
from collections.abc import Callable
from pathlib import Path

import pytest


def service_processes() -> dict[int, str]:
    """Running service processes, process id -> command line."""
    found = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                command = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
            except OSError:
                continue  # it ended meanwhile
            if "services.cli service" in command:
                found[int(entry.name)] = command
    return found


@pytest.fixture
def process_names() -> Callable[[], list[str]]:
    """Command lines of the service processes left, after up to five seconds of grace."""
    before = set(service_processes())

    def names() -> list[str]:
        deadline = time.monotonic() + 5.0
        while (left := {pid: c for pid, c in service_processes().items() if pid not in before}) and (
            time.monotonic() < deadline
        ):
            time.sleep(0.05)
        return list(left.values())

    return names
