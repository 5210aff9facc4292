"""`cogradar run --http` and `--keep`: what is served, and how it ends."""

import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable

import httpx
import pytest

COGRADAR = [sys.executable, "-m", "cogradar"]


@pytest.mark.zenoh
def test_a_run_that_is_kept_is_asked_until_it_is_told_to_end(process_names: Callable[[], list[str]]) -> None:
    """At the next free port, since that is taken; a stream that is open does not keep it up."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        command = [*COGRADAR, "run", "smoke", "--dwells", "6", "--http", f"127.0.0.1:{port}", "--keep", "--json"]
        run = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        try:
            assert run.stdout is not None
            assert run.stderr is not None
            line = next(line for line in run.stderr if line.startswith("watch it: "))
            result = json.loads(run.stdout.readline())
            page = line.split()[2]
            assert "text/html" in httpx.get(page, timeout=30.0).headers["content-type"]
            assert page.endswith(f"/?run={result['run']}")
            address = page.replace("?run=", "api/v1/runs/")
            stays = next(line for line in run.stderr if line.startswith("all processes stay up"))
            assert "--connect tcp/127.0.0.1:" in stays
            assert httpx.URL(address).port not in {port, None}
            row = httpx.get(address, timeout=30.0).json()
            assert (row["status"], row["digest"]) == ("complete", result["digest"])
            with httpx.stream("GET", f"{address}/events", timeout=30.0) as stream:
                assert "id: 1" in next(line for line in stream.iter_lines() if line.startswith("id"))
                began = time.monotonic()
                run.send_signal(signal.SIGTERM)
                run.communicate(timeout=10)
                assert time.monotonic() - began < 6.0
            assert run.returncode == 0
        finally:
            run.kill()
            run.communicate()
    assert process_names() == []


@pytest.mark.parametrize("options", [["--in-process", "--keep"], ["--connect", "tcp/127.0.0.1:1", "--http", "off"]])
def test_what_needs_processes_of_our_own_is_refused_without(options: list[str]) -> None:
    done = subprocess.run([*COGRADAR, "run", "smoke", *options], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "--http and --keep" in done.stderr
