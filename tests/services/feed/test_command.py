"""`cogradar feed` of a run that is stored."""

import json
import signal
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cogradar.services.errors import RunFailed
from cogradar.services.feed.picture import Picture
from cogradar.services.metrics.store import Store
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs import in_process
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from tests.services.cli.here import here
from tests.services.feed.made import picture, track

SITE = ["site.latitude_deg=48.35", "site.longitude_deg=11.79", "site.boresight_deg=60"]


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Two runs, the newest with a site."""
    path = str(tmp_path_factory.mktemp("feed") / "runs.db")
    store = Store(Journal(path))
    for settings in ((), SITE):
        in_process.play(RunStart.of(load("smoke", settings), Strategy.POWER_AWARE, 1, 5), store=store)
    store.close()
    return path


def test_a_stored_run_becomes_files(file: str, tmp_path: Path) -> None:
    done = here("feed", "--to", "aircraft-json", "--out", str(tmp_path), "--store", file, "--speed", "0")
    assert (done.returncode, done.stdout) == (0, "")
    assert f"pictures written into {tmp_path}" in done.stderr.replace("\n", " ")
    assert {entry.name for entry in tmp_path.iterdir()} == {"aircraft.json", "receiver.json"}
    assert json.loads((tmp_path / "aircraft.json").read_text())["aircraft"] == []  # the run is over


def test_it_is_said_that_nothing_has_read_the_pictures(file: str) -> None:
    done = here("feed", "--to", "asterix", "--out", "tcp://127.0.0.1:9", "--store", file, "--speed", "0")
    assert done.returncode == RunFailed.exit_code
    said = done.stderr.replace("\n", " ")
    assert "no picture was sent to tcp://127.0.0.1:9, 6 were lost" in said
    assert "nothing of the run was sent: start the receiver first" in said
    with socket.create_server(("127.0.0.1", 0)) as display:
        name = f"tcp://127.0.0.1:{display.getsockname()[1]}"
        done = here("feed", "--to", "asterix", "--out", name, "--store", file, "--speed", "0")
    assert (done.returncode, done.stderr.replace("\n", " ")) == (0, f"6 pictures sent to {name} ")
    done = here("feed", "--to", "asterix", "--out", "udp://127.0.0.1:9", "--store", file, "--speed", "0")
    assert "6 pictures sent to udp://127.0.0.1:9; datagrams do not tell" in done.stderr.replace("\n", " ")


def test_a_live_feed_that_is_interrupted_says_what_it_has_sent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def live(_endpoint: str, _run: str | None, check: Callable[[], None], *_: object) -> Iterator[Picture]:
        yield picture(track(1))
        signal.raise_signal(signal.SIGINT)
        check()

    monkeypatch.setattr("cogradar.services.feed.source.live", live)
    done = here("feed", "--to", "geojson", "--out", str(tmp_path))
    assert done.returncode == 130
    assert done.stderr.replace("\n", " ") == f"1 picture written into {tmp_path} interrupted "


def test_it_is_played_at_the_pace_that_is_asked_for(file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    waited = list[float]()
    monkeypatch.setattr("cogradar.services.feed.source.time.sleep", waited.append)
    moments = iter(range(10**6))
    monkeypatch.setattr("cogradar.services.feed.source.time.monotonic", lambda: next(moments) / 1000.0)
    options = ("--to", "geojson", "--out", str(tmp_path), "--store", file, "--speed", "10")
    assert here("feed", *options).returncode == 0
    assert len(waited) > 4
    assert max(waited) <= 0.1


def test_a_run_without_a_site_is_put_where_the_command_says(file: str, tmp_path: Path) -> None:
    without = json.loads(here("query", "runs", "--store", file, "--json").stdout)[0]["run"]
    options = ("--to", "aircraft-json", without, "--out", str(tmp_path), "--store", file, "--speed", "0")
    assert here("feed", *options, "--site", "-33.9,18.4,10,60").returncode == 0
    receiver = json.loads((tmp_path / "receiver.json").read_text())
    assert (receiver["lat"], receiver["lon"]) == (-33.9, 18.4)


def test_a_format_of_ones_own_is_a_file(file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert here("new", "feed", "lines.py").returncode == 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as display:
        display.bind(("127.0.0.1", 0))
        display.settimeout(5.0)
        given = ("--out", f"udp://127.0.0.1:{display.getsockname()[1]}", "--store", file, "--speed", "0")
        done = here("feed", "--to", "lines.py:Lines", *given)
        assert done.returncode == 0, done.stderr
        lines = [display.recv(1000).split() for _ in range(10)]
    assert {len(line) for line in lines} == {6}
    assert {line[1] for line in lines} == {b"1", b"2"}
    text = (tmp_path / "lines.py").read_text()
    for line, instead, code, said in (
        ("return [", "return 1 / 0 and [", 1, "wrong.py:Lines: "),
        ("return [", "return b'' and [", 1, "wrong.py:Lines returned b'': encode must return Outputs of bytes"),
        ("    def encode", "    def __init__(self):\n        1 / 0\n\n    def encode", 1, "ZeroDivisionError"),
        ("def encode", "def decode", 2, "a feed needs the method encode, which it has not"),
        ("class Lines(Format):", "class Lines(Format):\n    has_files = True\n", 2, "this format is files"),
    ):
        (tmp_path / "wrong.py").write_text(text.replace(line, instead).replace("Lines(Format)", "Lines"))
        done = here("feed", "--to", "wrong.py:Lines", *given)
        assert (done.returncode, said in done.stderr.replace("\n", " ")) == (code, True), done.stderr


def test_without_services_the_cure_is_said(tmp_path: Path) -> None:
    for command in (
        ("feed", "--to", "geojson", "--out", str(tmp_path)),
        ("export", "--out", "x.csv"),
        ("query", "runs"),
    ):
        done = here(*command, "--connect", "tcp/127.0.0.1:9")
        assert done.returncode == 3, done
        assert "--store FILE" in done.stderr
        assert "--connect that it" in done.stderr.replace("\n", " ")


def test_bad_input_is_a_sentence(file: str, tmp_path: Path) -> None:
    without = json.loads(here("query", "runs", "--store", file, "--json").stdout)[0]["run"]
    out = ("--out", str(tmp_path), "--store", file)
    for options, words in (
        (("--to", "asterisk", *out), "--to asterisk: must be one of"),
        (("--to", "asterix", "--categories", "48", "--out", "-", "--store", file), "must be some of 034, 048, 062"),
        (("--to", "geojson", without, *out), "has no [site]"),
        (("--to", "geojson", "--tasks", "--out", str(tmp_path)), "--tasks: only --to sapient takes them"),
        (("--to", "sapient", "--tasks", "--out", "tcp://127.0.0.1:9", "--store", file), "of a run that goes on"),
        (("--to", "geojson", "nothing", *out), "no such run"),
        (("--to", "geojson", "--site", "48,11", *out), "must be LATITUDE,LONGITUDE,HEIGHT,BEARING"),
        (("--to", "geojson", "--site", "148,11,0,60", *out), "latitude_deg: input should be less than or equal to 90"),
        (("--to", "geojson", "--out", f"{file}/x", "--store", file), "is a file: name a folder"),
        (("--to", "geojson", "--out", "udp:1.2.3.4:8600/x", "--store", file), "must be udp://HOST:PORT"),
    ):
        done = here("feed", *options)
        assert done.returncode == 2, done
        assert words in done.stderr
