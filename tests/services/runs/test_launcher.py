"""Starting processes on this machine: what takes their place, and what they leave."""

import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from cogradar.services.errors import BadInput, RunFailed
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs import cluster, launcher
from cogradar.services.runs.launcher import MAX_LOG_BYTES, SCRATCH, Launcher, LocalProcesses, scratch
from cogradar.services.runs.run import Progress


def _until_it_fails(processes: Launcher, look: Callable[[], None] = lambda: None) -> None:
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        look()
        processes.check()
        time.sleep(0.02)


@pytest.mark.zenoh
def test_a_port_that_somebody_else_took_ends_the_run_with_a_clear_error(
    monkeypatch: pytest.MonkeyPatch, process_names: Callable[[], list[str]]
) -> None:
    """Between being found free and being listened on, and again whenever the router is started again."""
    with socket.create_server(("127.0.0.1", 0)) as thief:
        port = thief.getsockname()[1]
        monkeypatch.setattr(launcher, "free_port", lambda: port)
        monkeypatch.setattr(launcher, "MAX_RESTARTS", 2)
        with Launcher(LocalProcesses(1, ":memory:"), threading.Event()) as processes:
            words = rf"(?s)router-0 .*cannot listen on tcp/127.0.0.1:{port}: .*in use"
            with pytest.raises(RunFailed, match=words):
                _until_it_fails(processes)
    assert process_names() == []


def test_what_processes_write_is_kept_up_to_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their last lines are there when they end."""
    write = f"sys.stdout.write('x' * {MAX_LOG_BYTES // 2}); time.sleep(0.5)"
    code = f"import sys, time\nfor i in range(4): {write}\nprint('bye')"
    sizes, popen = list[int](), subprocess.Popen

    def start(_: list[str], **settings: Any) -> Any:
        return popen([sys.executable, "-c", code], **settings)

    monkeypatch.setattr(subprocess, "Popen", start)
    monkeypatch.setattr(launcher, "MAX_RESTARTS", 0)
    with Launcher(LocalProcesses(1, ":memory:"), threading.Event()) as processes:
        logs = Path(processes._folder.name)
        with pytest.raises(RunFailed, match=r"(?s)after 0 restarts of it.*bye"):
            _until_it_fails(processes, lambda: sizes.extend(file.stat().st_size for file in logs.iterdir()))
    assert MAX_LOG_BYTES < max(sizes) < 2 * MAX_LOG_BYTES


def test_a_process_is_named_that_ends_too_often_and_others_do_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each is started again five times a minute: kills of all roles together end nothing."""
    popen, started, said = subprocess.Popen, list[str](), list[str]()

    def start(command: list[str], **settings: Any) -> Any:
        name = command[command.index("--name") + 1]
        started.append(name)
        ends = "print('no more memory'); os.kill(os.getpid(), 9)" if name == "planner-0" else "sys.exit(1)"
        code = ends if name == "planner-0" or started.count(name) <= 3 else "input()"
        return popen([sys.executable, "-uc", f"import os, sys; {code}"], **settings)

    monkeypatch.setattr(subprocess, "Popen", start)
    given = LocalProcesses(1, ":memory:")
    with Launcher(given, threading.Event(), said.append) as processes, pytest.raises(RunFailed) as failed:
        _until_it_fails(processes)
    first, *lines = str(failed.value).splitlines()
    assert first.startswith("planner-0 ended unexpectedly (signal 9, SIGKILL), after 5 restarts of it within 60 s")
    assert (lines[0], set(lines[1:])) == ("Its last lines:", {"  planner-0: no more memory"})
    assert started.count("planner-0") == 6
    assert {started.count(name) for name in set(started) - {"planner-0"}} == {4}
    assert "metrics-0 ended unexpectedly (exit code 1); starting it again" in said


def test_no_password_is_on_a_command_line(monkeypatch: pytest.MonkeyPatch) -> None:
    store, started = "postgresql://radar:hunter2@127.0.0.1:1/db", dict[str, tuple[list[str], str]]()
    popen = subprocess.Popen

    def start(command: list[str], **settings: Any) -> Any:
        started[command[4]] = command, settings["env"].get("PGPASSWORD", "")
        return popen([sys.executable, "-c", "input()"], **settings)

    monkeypatch.delenv("PGPASSWORD", raising=False)
    monkeypatch.setattr(subprocess, "Popen", start)
    given = LocalProcesses(1, store, front_end=f"recorded:{store}#r")
    with Launcher(given, threading.Event()):
        assert "hunter2" not in str([command for command, _ in started.values()])
    assert started["emulator"][0][-1] == "recorded:postgresql://radar@127.0.0.1:1/db#r"
    assert {role for role, (_, word) in started.items() if word == "hunter2"} == {"emulator", "recorder", "metrics"}
    waits = Progress(0, 5, None, cluster.EMULATOR, [])
    told = cluster._Told(lambda _: None, given.front_end).of(waits, 0.0).waiting_for
    assert told == "front end recorded:postgresql://radar@127.0.0.1:1/db#r, for the emulator"


def test_on_windows_the_user_is_told_what_works_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "name", "nt")
    with pytest.raises(BadInput, match="use WSL, or --in-process"):
        Launcher(LocalProcesses(1), threading.Event())


@pytest.mark.zenoh
def test_a_store_that_somebody_else_took_is_bad_input_and_not_tried_again(
    tmp_path: Path, process_names: Callable[[], list[str]]
) -> None:
    store = str(tmp_path / "busy.db")
    with (
        closing(Journal(store, owner="somebody")),
        Launcher(LocalProcesses(1, store), threading.Event()) as processes,
        pytest.raises(BadInput, match=r"busy\.db: in use by somebody"),
    ):
        _until_it_fails(processes)
    assert process_names() == []


def test_a_folder_of_a_process_that_was_killed_is_removed_at_the_next_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with subprocess.Popen([sys.executable, "-c", ""]) as over:
        over.wait()
    ours, alive = tmp_path / f"{SCRATCH}{over.pid}-abc", tmp_path / f"{SCRATCH}{os.getpid()}-abc"
    for folder in (ours, alive, tmp_path / "cogradar-mine", tmp_path / f"{SCRATCH}odd"):
        folder.mkdir()
    with scratch() as own:
        assert not ours.exists()
        assert {path.name for path in tmp_path.iterdir()} == {
            alive.name,
            "cogradar-mine",
            f"{SCRATCH}odd",
            Path(own).name,
        }
