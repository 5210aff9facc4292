"""How a command ends: the exit code of what went wrong, one line, and signals as they were before."""

import csv
import io
import os
import signal
import sys
import threading
from contextlib import suppress
from pathlib import Path

import pytest
import typer
from rich.console import Console
from typer.testing import CliRunner

from cogradar.services.cli import console
from cogradar.services.cli.app import app
from cogradar.services.cli.console import CONFIG_VARIABLE, Stop, call, command, endpoints, print_csv, say, wrong_usage
from cogradar.services.errors import BadInput, Interrupted, NoMetrics, RunFailed, StoreFailed
from cogradar.shared.scenario.files import ScenarioError
from cogradar.shared.scenario.plugins.names import names_of
from cogradar.shared.scenario.radar_config import Strategy


def test_standard_output_without_a_reader_is_a_line_and_no_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    gone = typer.Typer()

    @gone.command()
    def feeds() -> None:
        with command():
            sys.stdout.close()
            raise RunFailed("standard output: its reader is gone")

    monkeypatch.setattr(sys, "argv", ["cogradar"])
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    with pytest.raises(SystemExit) as ended:
        call(gone)
    assert ended.value.code == 1
    assert capsys.readouterr().err == "standard output: its reader is gone\n"


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (RunFailed("x"), 1),
        (StoreFailed("x"), 1),
        (ConnectionError("x"), 1),
        (BadInput("x"), 2),
        (ScenarioError("x"), 2),
        (NoMetrics("x"), 3),
        (Interrupted("x"), 130),
    ],
)
def test_what_goes_wrong_is_said_in_one_line_with_its_exit_code(
    error: Exception, code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(typer.Exit) as ended, command():
        raise type(error)("[red]x\x1b[31m :warning:")
    assert ended.value.exit_code == code
    sent = capsys.readouterr()
    assert (sent.out, sent.err) == ("", "[red]x?[31m :warning:\n")


def test_csv_is_read_back_by_whoever_reads_csv(capsys: pytest.CaptureFixture[str]) -> None:
    rows = [
        {"run": "a,b", "reason": 'sent "no"', "p_d": 0.1 + 0.2, "n": 3, "scans": None, "lost": True},
        {"run": "two\nlines", "reason": "", "p_d": 1e-300, "n": 0, "scans": 7, "lost": False},
    ]
    print_csv(rows)
    text = capsys.readouterr().out
    assert text.startswith("run,reason,p_d,n,scans,lost\n")
    read = list(csv.DictReader(io.StringIO(text, newline="")))
    assert read == [{key: "" if value is None else str(value) for key, value in row.items()} for row in rows]
    assert float(read[0]["p_d"]) == 0.1 + 0.2  # every digit


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["run", "smoke", "--seed", "-1"], "--seed = -1: must be an integer >= 0 and <= 9223372036854775807"),
        (["run", "smoke", "--planners", "x"], "--planners = x: must be an integer >= 1 and <= 64"),
        (["run", "smoke", "--rate", "nan"], "--rate = nan: must be a number >= 0.001 and <= 1000.0"),
        *(
            ([*asked, "--strategy", name], f"--strategy: {name!r}: must be one of {names_of(list(Strategy))}{cure}")
            for asked in (["run", "smoke"], ["query", "p_d"])
            for name, cure in (
                ("best", "; best is a fidelity: --set radar.fidelity=best"),
                ("unifor", "; did you mean uniform?"),
                ("x", ""),
            )
        ),
        (["replay", "--to", "emulator"], "--to = emulator: must be one of planner, allocator"),
        (["report", "a.db", "--seed", "x"], "--seed = x: must be an integer >= 0 and <= 9223372036854775807"),
        *(
            (
                [*asked, text],
                f"{asked[-1]}: {text!r} is no endpoint, such as tcp/127.0.0.1:7447, tls/HOST:PORT, udp/, quic/ or"
                " ws/HOST:PORT, unixsock-stream/PATH",
            )
            for asked in (["query", "p_d", "--connect"], ["service", "router", "--listen"])
            for text in (
                "x",
                "tcp/host",
                "tcp/host:65536",
                "sctp/host:1",
                "tls/ho st:1",
                "tls//a:1",
                "unixsock-stream/",
            )
        ),
        (
            ["service", "planner", "--name", "/"],
            "--name: '/': 1 to 64 letters, digits, '.', '_' and '-'; of a planner, @FIRST-LAST behind them",
        ),
        *(
            ([*asked, *both], f"{both[2]}: --store reads a store, --connect asks services: one of them")
            for asked in (["query", "p_d"], ["export", "--out", "x.csv"], ["replay", "--to", "planner"])
            for both in (["--store", "a.db", "--connect", "tcp/a:1"], ["--connect", "tcp/a:1", "--store", "a.db"])
        ),
        (["run"], "Missing argument 'scenario'"),
        (["run", "smoke", "--plugins", "nosuch"], "--plugins: nosuch: no such folder, .py file or module"),
        (["command", "pause"], "Missing argument 'ACTION...': cogradar command run ACTION..."),
        (["run", "smoke", "--sed", "1"], "No such option: --sed (Possible options: --seed, --set, --store)"),
    ],
)
def test_a_wrong_command_line_is_said_as_other_bad_input_is(arguments: list[str], said: str) -> None:
    with pytest.raises(typer.TyperException) as caught:
        app(arguments, standalone_mode=False, prog_name="cogradar")
    assert wrong_usage(caught.value) == f"{said} (see cogradar {arguments[0]} --help)"
    assert caught.value.exit_code == 2


@pytest.mark.parametrize(
    "text",
    [
        "tcp/host:1",
        "tls/radar.example:7447",
        "tls/[::1]:7447#root_ca_certificate=/ca.crt",
        "quic/h:1?prio=1,tcp/b:2",
        "unixsock-stream//run/zenoh",
    ],
)
def test_every_endpoint_of_zenoh_is_taken(text: str) -> None:
    assert endpoints(text) == text


def test_a_file_of_zenoh_is_for_one_command_and_a_wrong_one_is_bad_input(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(CONFIG_VARIABLE, raising=False)
    file = tmp_path / "zenoh.json5"
    wrong = CliRunner().invoke(app, ["query", "runs", "--zenoh-config", str(file)])
    assert (wrong.exit_code, wrong.stderr) == (2, f"--zenoh-config {file}: no such file or directory\n")
    file.write_text("{}")
    with command(zenoh_config=str(file)):
        assert os.environ[CONFIG_VARIABLE] == str(file)
    assert CONFIG_VARIABLE not in os.environ


def test_an_endpoint_of_the_environment_gives_way_to_a_store(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("COGRADAR_CONNECT", "tcp/a:1")
    done = CliRunner().invoke(app, ["query", "runs", "--store", str(tmp_path / "none.db")])
    assert (done.exit_code, done.stderr.count("no such file")) == (2, 1)


def test_prose_is_broken_between_words_and_commands_are_whole(capsys: pytest.CaptureFixture[str]) -> None:
    """In a pipe, too: nothing here is a terminal."""
    path, command_ = "/" + 60 * "x", f"  cogradar query p_d --store {60 * 'y'}"
    say(f"a line that is longer than forty columns are\n{command_}\nread {path} first", Console(width=40))
    assert capsys.readouterr().out.splitlines() == [
        "a line that is longer than forty columns",
        "are",
        command_,
        "read",
        path,
        "first",
    ]


def test_csv_of_nothing_is_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    print_csv([])
    assert capsys.readouterr().out == ""


def test_a_bug_is_not_hidden() -> None:
    with pytest.raises(KeyError), command():
        raise KeyError("bug")


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.parametrize("at_once", [True, False])
def test_a_signal_ends_a_command_at_once_or_sets_its_stop(number: signal.Signals, code: int, at_once: bool) -> None:
    before = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)]
    went_on: list[bool] = []

    def work() -> None:
        with suppress(Exception):  # somebody else's code that hides what it meets
            signal.raise_signal(number)
            went_on.append(True)
        raise Interrupted("interrupted")  # as work does that looks at its stop

    with pytest.raises(typer.Exit) as ended, command(at_once=at_once) as stop:
        work()
    assert ended.value.exit_code == code
    assert stop.is_set()
    assert went_on == ([] if at_once else [True])
    assert [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)] == before


def test_without_a_terminal_long_work_says_how_far_it_is_now_and_then(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 100.0
    monkeypatch.setattr("time.monotonic", lambda: now_s)
    with console.progress(Console(file=io.StringIO())) as tell:
        for step in range(0, 100, 5):
            now_s = 100.0 + step
            tell(f"{min(step, 60)} of 60 runs")
    assert capsys.readouterr().err.splitlines() == ["30 of 60 runs", "60 of 60 runs"]


def test_on_a_terminal_it_says_so_at_one_place(capsys: pytest.CaptureFixture[str]) -> None:
    shown = io.StringIO()
    with console.progress(Console(file=shown, force_terminal=True)) as tell:
        tell("half of it")
    assert "half of it" in shown.getvalue()
    assert capsys.readouterr().err == ""


def test_a_signal_that_comes_while_the_stop_is_waited_for_stops() -> None:
    stop = Stop()
    stop.forget()

    def interrupted() -> None:  # as the handler does it to a thread that is about to wait
        with stop._cond:
            stop._on_signal(signal.SIGTERM, None)

    waiting = threading.Thread(target=interrupted, daemon=True)
    waiting.start()
    waiting.join(10.0)
    assert (stop.is_set(), stop.exit_code) == (True, 128 + signal.SIGTERM)
