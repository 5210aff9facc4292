"""The commands as a user types them: exit codes, one-line errors, JSON."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import pytest

from cogradar.shared.wire.session import free_port
from tests.services.cli.here import here
from tests.services.stored import rows

COGRADAR = [sys.executable, "-m", "cogradar"]


def _cogradar(*arguments: str, timeout: float = 90) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*COGRADAR, *arguments], capture_output=True, text=True, timeout=timeout, check=False)


def test_scenarios_lists_the_built_in_ones() -> None:
    listed = json.loads(here("scenarios", "--json").stdout)
    assert {"paper", "smoke"} <= set(listed)


def test_check_accepts_every_built_in_scenario() -> None:
    for name in json.loads(here("scenarios", "--json").stdout):
        assert here("check", name).returncode == 0


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (("n_tx = 16", "n_tx = 1"), ["array.n_tx", "= 1", "2"]),
        (("n_tx = 16", "n_antenna = 16"), ["n_antenna"]),
        (("p_fa = 1e-4", 'p_fa = "low"'), ["detector.p_fa", "low"]),
        (("[50.0, -0.05, 20.0, 0.10]", "[-1.0, 0.0, 20.0, 0.0]"), ["targets #2, state", "behind the array"]),
        (("[50.0, -0.05, 20.0, 0.10]", "[40.0, 0.0, -30.0, 0.0]"), ["targets #1 and #2", "same angle bin"]),
        (('name = "smoke"', "name ="), ["TOML"]),
    ],
)
def test_a_bad_scenario_is_one_line_and_exit_code_2(edit: tuple[str, str], words: list[str], tmp_path: Path) -> None:
    source = Path("deploy/scenarios/smoke.toml").read_text()
    assert edit[0] in source
    file = tmp_path / "bad.toml"
    file.write_text(source.replace(*edit, 1))
    for command in ("check", "run"):
        done = here(command, str(file))
        assert (done.returncode, done.stdout) == (2, "")
        first, *rest = done.stderr.splitlines()
        assert all(word in first for word in ["bad.toml", *words])
        if command == "run":
            assert rest == []


def test_check_names_every_fault(tmp_path: Path) -> None:
    source = Path("deploy/scenarios/smoke.toml").read_text()
    file = tmp_path / "bad.toml"
    file.write_text(source.replace("n_tx = 16", "n_tx = 1", 1).replace("gamma = 0.8", "gamma = 2", 1))
    done = _cogradar("check", str(file))
    assert (done.returncode, done.stdout) == (2, "")
    lines = done.stderr.splitlines()
    assert [line.removeprefix(f"{file}: ").split(":")[0] for line in lines] == [
        "radar.array.n_tx = 1",
        "radar.planner.gamma = 2",
    ]


def test_brackets_and_names_of_pictures_are_shown_as_they_are(tmp_path: Path) -> None:
    """No file name is taken for markup, wherever it is shown."""
    folder = tmp_path / "[red]a [bold] [link=b] :warning: [0]"
    folder.mkdir()
    good, bad, text = folder / "good.toml", folder / "bad.toml", folder / "text.db"
    good.write_text(Path("deploy/scenarios/smoke.toml").read_text())
    bad.write_text("name =")
    text.write_text("dear diary, " * 200)
    assert str(good) in here("check", str(good)).stdout
    for arguments in (
        ("check", str(bad)),
        ("run", str(bad)),
        ("query", "p_d", "--store", str(text)),
        ("report", str(text)),
        ("figures", str(text)),
        ("campaign", "smoke", "--store", str(text)),
        ("run", "smoke", "--in-process", "--store", str(folder / "no" / "x.db")),
    ):
        done = here(*arguments)
        assert done.returncode in {1, 2}
        assert str(folder) in done.stderr
        assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    "arguments",
    [
        ("run", "nowhere"),
        ("run", "smoke", "--strategy", "best"),
        ("run", "smoke", "--dwells", "0"),
        ("run", "smoke", "--dwells", "endless"),
        ("run", "smoke", "--planners", "0"),
        ("run", "smoke", "--seed", "-1"),
        ("service", "chef"),
        ("query", "p_d", "--target", "0"),
        ("query", "p_d", "--store", "nowhere.db"),
        ("query", "runs", "--connect", "nowhere"),
        ("query", "runs", "--connect", ""),
        ("query", "runs", "--connect", "tcp/127.0.0.1"),
        ("run", "smoke", "--connect", "tcp/127.0.0.1:7447,nowhere"),
        ("service", "planner", "--connect", "nowhere"),
    ],
)
def test_bad_arguments_are_exit_code_2_without_a_traceback(arguments: tuple[str, ...]) -> None:
    done = here(*arguments)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert done.stderr.strip()


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--rate", "5"), "--rate 5"),
        (("--rate", "5", "--pace", "lockstep"), "--rate 5"),
        (("--pace", "realtime", "--in-process"), "--in-process"),
        (("--dwells", "unlimited", "--in-process"), "--in-process"),
        (("--chaos", "5", "--in-process"), "--in-process"),
        (("--chaos", "5", "--connect", "tcp/127.0.0.1:1"), "--chaos"),
        (("--in-process", "--connect", "tcp/127.0.0.1:1"), "--connect"),
    ],
)
def test_what_does_not_go_together_is_one_line_and_exit_code_2(arguments: tuple[str, ...], named: str) -> None:
    done = here("run", "smoke", *arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert named in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    "arguments",
    [
        ("--pace", "fast"),
        ("--pace", "realtime", "--rate", "0"),
        ("--pace", "realtime", "--rate", "1001"),
        ("--pace", "realtime", "--rate", "nan"),
        ("--chaos", "0"),
        ("--chaos", "121"),
    ],
)
def test_a_pace_out_of_range_is_exit_code_2(arguments: tuple[str, ...]) -> None:
    done = here("run", "smoke", *arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert "Traceback" not in done.stderr
    assert arguments[-2] in done.stderr


def test_a_query_without_a_metrics_service_is_exit_code_3() -> None:
    done = _cogradar("query", "p_d", "--connect", "tcp/127.0.0.1:1")
    assert done.returncode == 3
    assert "no metrics service" in done.stderr


def test_run_prints_one_json_object_and_keeps_the_store(tmp_path: Path) -> None:
    store = str(tmp_path / "runs.db")
    done = _cogradar("run", "smoke", "--in-process", "--dwells", "5", "--seed", "3", "--store", store, "--json")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert (result["scenario"], result["strategy"], result["seed"], result["dwells"]) == ("smoke", "power-aware", 3, 5)
    target = {"target", "born_t", "gone_t", "visible_t", "confirmed_t", "p_d", "p_d_low", "p_d_high", "hit_rate"}
    target |= {"in_bin", "outage", "outage_longest", "position_rmse_km", "velocity_rmse_km_s", "lost"}
    assert [set(row) for row in result["targets"]] == [target, target]
    (answer,) = json.loads(here("query", "p_d", "--target", "2", "--store", store, "--json").stdout)
    assert answer["p_d"] == result["targets"][1]["p_d"]
    header, line = here("query", "p_d", "--target", "2", "--store", store, "--csv").stdout.splitlines()
    assert dict(zip(header.split(","), line.split(","), strict=True)) == {key: str(answer[key]) for key in answer}
    assert here("query", "p_d", "--store", store, "--csv", "--json").returncode == 2
    chosen = here("query", "tracks", "--columns", "t,x_hat", "--store", store, "--csv").stdout.splitlines()
    assert (chosen[0], len(chosen)) == ("t,x_hat", 1 + 2 * 5)
    wide = here("query", "runs", "--store", store, "--wide").stdout
    assert result["digest"] in wide
    assert here("query", "runs", "--columns", "speed", "--store", store).returncode == 2
    for wrong in (("--dwells", "x"), ("--dwells", "20:10"), ("--dwells", "1:6"), ("--target", "3")):
        refused = here("query", "p_d", *wrong, "--store", store)
        assert (refused.returncode, refused.stdout) == (2, "")
        assert wrong[1].split(":")[-1] in refused.stderr
    assert here("query", "speed", "--store", store).returncode == 2


def test_run_prints_a_table_per_target() -> None:
    done = _cogradar("run", "smoke", "--in-process", "--dwells", "5")
    assert done.returncode == 0, done.stderr
    assert all(word in done.stdout for word in ("target 1", "target 2", "P_D", "RMSE", "all 5", "digest"))


def test_an_interrupt_while_a_command_still_loads_is_one() -> None:
    """It takes half a second, and was a traceback of imports."""
    code = (
        "import sys\n"
        "class Interrupted:\n"
        "    def find_spec(name, *_):\n"
        "        if name == 'cogradar.services.cli.console':\n"
        "            raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Interrupted)\n"
        "from cogradar.__main__ import main\n"
        "main()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "interrupted\n")


@pytest.mark.zenoh
def test_metrics_answers_during_a_run(process_names: Callable[[], list[str]]) -> None:
    run = subprocess.Popen(
        [*COGRADAR, "run", "smoke", "--dwells", "100000"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert run.stdout is not None
        lines = (line for line in run.stdout if "--connect" in line)
        endpoint = next(lines).split("--connect ")[1].split()[0]
        deadline = time.monotonic() + 20.0
        while True:  # until it has scored a dwell
            done = _cogradar("query", "p_d", "--target", "2", "--connect", endpoint, "--json")
            if done.stdout.strip() != "[]" or time.monotonic() > deadline:
                break
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)[0]["n"] > 0
        refused = _cogradar("query", "p_d", "--dwells", "x", "--connect", endpoint)
        assert refused.returncode == 2
        assert "a:b" in refused.stderr
        began = time.monotonic()
        run.send_signal(signal.SIGINT)
        run.communicate(timeout=10)
        assert run.returncode == 130
        assert time.monotonic() - began < 6.0
    finally:
        run.kill()
        run.communicate()
    assert process_names() == []


@pytest.mark.zenoh
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_store_that_is_kept_holds_no_run_that_seems_to_go_on(
    number: signal.Signals, code: int, tmp_path: Path
) -> None:
    """Or the next metrics service that opens it would go on with what the user interrupted."""
    file = str(tmp_path / "runs.db")
    command = [*COGRADAR, "run", "smoke", "--dwells", "100000", "--store", file]
    run = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert run.stdout is not None
    next(line for line in run.stdout if "--connect" in line)
    deadline = time.monotonic() + 20.0
    while not rows(file, "SELECT run FROM run WHERE status = 'running'") and time.monotonic() < deadline:
        time.sleep(0.05)
    run.send_signal(number)
    run.communicate(timeout=15)
    assert run.returncode == code
    (row,) = json.loads(_cogradar("query", "runs", "--store", file, "--json").stdout)
    assert (row["status"], row["reason"]) == ("stopped", "by user")
    unknown = _cogradar("query", "p_d", "--store", file, "--run", "nosuchrun")
    told = f"run = 'nosuchrun': no such run; `cogradar query runs` lists those that are there; asked was {file}"
    assert (unknown.returncode, unknown.stderr.strip()) == (2, told)


def test_a_router_that_cannot_listen_does_not_say_that_it_does() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        done = _cogradar("service", "router", "--listen", f"tcp/127.0.0.1:{taken.getsockname()[1]}")
    assert done.returncode == 1
    assert "cannot listen on" in done.stderr
    assert "listening" not in done.stderr


def test_the_version_is_the_installed_one() -> None:
    assert _cogradar("--version").stdout.strip() == f"cogradar {version('cogradar')}"


@pytest.mark.zenoh
@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGKILL, -9)])
def test_no_process_is_left_however_the_run_is_ended(
    number: signal.Signals, code: int, process_names: Callable[[], list[str]]
) -> None:
    run = subprocess.Popen(
        [*COGRADAR, "run", "smoke", "--dwells", "100000"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert run.stdout is not None
    next(line for line in run.stdout if "--connect" in line)
    os.kill(run.pid, number)
    run.communicate(timeout=10)
    assert run.returncode == code
    assert process_names() == []


@pytest.mark.zenoh
def test_services_started_by_hand_play_a_run(process_names: Callable[[], list[str]], tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    services = [[*COGRADAR, "service", "router", "--listen", endpoint]]
    services += [[*COGRADAR, "service", role, "--connect", endpoint] for role in ("planner", "emulator", "allocator")]
    kept = ("--store", str(tmp_path / "runs.db"))
    services += [[*COGRADAR, "service", role, "--connect", endpoint, *kept] for role in ("recorder", "metrics")]
    running = [subprocess.Popen(command, stderr=subprocess.DEVNULL) for command in services]
    try:
        done = _cogradar("run", "smoke", "--dwells", "5", "--connect", endpoint, "--json")
        assert done.returncode == 0, done.stderr
        local = _cogradar("run", "smoke", "--dwells", "5", "--in-process", "--json")
        assert json.loads(done.stdout)["digest"] == json.loads(local.stdout)["digest"]
        after = _cogradar("query", "runs", "--connect", endpoint, "--json")  # metrics outlives the run
        assert json.loads(after.stdout)[0]["status"] == "complete"
    finally:
        began = time.monotonic()
        for process in running:
            process.terminate()
        codes = [process.wait(timeout=10) for process in running]
    assert codes == [0] * len(running)
    assert time.monotonic() - began < 6.0  # seconds, with room for a busy machine
    assert process_names() == []
