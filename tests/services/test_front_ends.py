"""Front ends by name; the example of docs/howto/front-end.md, as a reader would try it."""

import json
import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from cogradar.services import kernels
from cogradar.services.emulator.front_end import FrontEndError
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.services.errors import BadInput
from cogradar.services.front_ends import open_front_end, settled
from cogradar.services.metrics.store import Store
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs import in_process
from cogradar.services.runs.cluster import _Told
from cogradar.services.runs.run import Progress, as_played
from cogradar.services.topology import Start
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.signal.array import angle_bin
from tests.services.loop import SMOKE, checkpoint
from tests.services.stored import seal
from tests.udp_device import Device

REPOSITORY = Path(__file__).resolve().parents[2]
PAGE = (REPOSITORY / "docs/howto/front-end.md").read_text(encoding="utf-8")
DWELLS = 6
COGRADAR = [sys.executable, "-m", "cogradar"]


def _cogradar(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*COGRADAR, *arguments], capture_output=True, text=True, timeout=200, check=False, cwd=folder)


@pytest.fixture
def example(tmp_path: Path) -> Path:
    """A folder with the page's receiver and its scenario."""
    code, ranged, udp, recorded = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    (tmp_path / "receiver.py").write_text(f"{code}\n\n{ranged}")
    (tmp_path / "udp_receiver.py").write_text(udp)
    (tmp_path / "record.py").write_text(recorded)
    (command,) = re.findall(r"^sed .*$", PAGE, flags=re.MULTILINE)
    subprocess.run(["sh", "-c", command.replace("mine.toml", str(tmp_path / "mine.toml"))], check=True, cwd=REPOSITORY)
    assert "[world" not in (tmp_path / "mine.toml").read_text()
    return tmp_path


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str, str]:
    """A file with a complete run of seed 1, the run's name, its digest."""
    file = str(tmp_path_factory.mktemp("recording") / "runs.db")
    journal = Journal(file)
    run = in_process.play(RunStart.of(SMOKE, Strategy.POWER_AWARE, 1, DWELLS), store=Store(journal)).run
    journal.close()
    return file, run["run"], run["digest"]


def _played(scenario_file: str, front_end: str, folder: Path, *options: str) -> dict[str, object]:
    kernels.compile_all(lambda _: None)
    arguments = [scenario_file, "--front-end", front_end, "--store", "mine.db", "--json", *options]
    done = _cogradar("run", *arguments, folder=folder)
    assert done.returncode == 0, done.stderr
    played: dict[str, object] = json.loads(done.stdout)
    return played


@pytest.mark.slow
@pytest.mark.parametrize(
    "options", [("--in-process",), pytest.param(("--planners", "2"), marks=pytest.mark.zenoh)], ids=["process", "zenoh"]
)
def test_the_example_of_the_page_tracks_without_truth(options: tuple[str, ...], example: Path) -> None:
    played = _played("mine.toml", "receiver.py:Receiver", example, *options)
    assert played["dwells"] == 12
    assert [target["p_d"] for target in played["targets"]] == [None, None]  # type: ignore[attr-defined]
    rows = json.loads(_cogradar("query", "tracks", "--store", "mine.db", "--json", folder=example).stdout)
    assert {(row["target"], row["bin"]) for row in rows} == {(1, 3), (2, 11)}
    assert {row["x"] for row in rows} == {None}


@pytest.mark.slow
def test_the_example_with_range_cells_tracks_both_aircraft(example: Path) -> None:
    options = ("--in-process", "--set", "radar.fidelity=best-range", "--set", "radar.echo.amplitude_db=67")
    played = _played("mine.toml", "receiver.py:Ranged", example, *options)
    assert played["dwells"] == 12
    rows = json.loads(_cogradar("query", "tracks", "--store", "mine.db", "--json", folder=example).stdout)
    assert {(row["target"], row["bin"]) for row in rows} == {(1, 3), (2, 11)}


@pytest.mark.nightly
@pytest.mark.zenoh
def test_a_receiver_by_udp_that_loses_datagrams_and_has_outages_loses_no_track(
    example: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fifth of all cells are lost, and twice three seconds of data."""
    outages = {*range(60, 90), *range(130, 160)}
    targets = ([40.0, 0.010, -30.0, 0.005], [50.0, -0.005, 20.0, 0.010])
    with Device(SMOKE.radar.array.n_bin, SMOKE.radar.echo.amplitude_db, targets, 0.2, outages) as device:
        monkeypatch.setenv("RADAR_DEVICE", device.address)
        paced = ("--pace", "realtime", "--rate", "10", "--dwells", "200", "--set", "radar.motion.dt_s=0.1")
        played = _played("mine.toml", "udp_receiver.py:UdpReceiver", example, *paced)
    assert played["dwells"] == 200
    assert device.lost > 0.2 * device.sent
    assert len(outages) <= cast(int, played["unmeasured_dwells"]) < len(outages) + 40
    rows = json.loads(_cogradar("query", "tracks", "--store", "mine.db", "--json", folder=example).stdout)
    off = defaultdict[int, list[int]](list)  # bins between each track and its target, by dwell
    for row in rows:
        (x, y), n = device.positions(row["k"])[row["target"] - 1], SMOKE.radar.array.n_bin
        bins = [
            angle_bin(0.5 * at_y / np.hypot(at_x, at_y), n) for at_x, at_y in ((x, y), (row["x_hat"], row["y_hat"]))
        ]
        off[row["target"]].append(abs(int(bins[0] - bins[1])))
    assert set(off) == {1, 2}
    for found in off.values():
        assert len(found) == 200
        assert np.mean(np.array(found) <= 1) > 0.95
        assert max(found[-20:]) <= 1


def test_the_recordings_of_the_page_are_calibrated_as_it_says(example: Path) -> None:
    subprocess.run([sys.executable, "record.py"], check=True, cwd=example)
    (shown,) = re.findall(r"```console\n(\$ cogradar calibrate.*?)```", PAGE, flags=re.DOTALL)
    dialogue = re.findall(r"\$ (cogradar calibrate .*)\n((?:[^$].*\n)*)", shown)
    assert len(dialogue) == 2
    for i, (command, answer) in enumerate(dialogue):
        done = _cogradar(*command.split()[1:], folder=example)
        assert done.returncode == i
        assert done.stdout == answer
    assert _cogradar("calibrate", "target.npy", "mine.toml", "--bearing", "20", folder=example).returncode == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "options", [("--in-process",), pytest.param((), marks=pytest.mark.zenoh)], ids=["process", "zenoh"]
)
def test_a_recording_played_back_has_the_digest_of_its_run(
    options: tuple[str, ...], recording: tuple[str, str, str], tmp_path: Path
) -> None:
    file, _, digest = recording
    played = _played("smoke", f"recorded:{file}", tmp_path, *options, "--dwells", str(DWELLS))
    assert played["digest"] == digest
    other = _played("smoke", f"recorded:{file}", tmp_path, "--in-process", "--dwells", str(DWELLS), "--seed", "2")
    assert other["digest"] != digest


def test_a_run_without_a_world_needs_a_front_end(example: Path) -> None:
    for command in (["run", "mine.toml"], ["chaos", "mine.toml"], ["campaign", "mine.toml", "--store", "c.db"]):
        done = _cogradar(*command, folder=example)
        assert (done.returncode, done.stdout) == (2, "")
        assert "has no [world]" in done.stderr
        assert "--front-end" in done.stderr


def test_a_scenario_is_played_with_a_world_by_the_simulated_front_end_only() -> None:
    assert as_played(SMOKE, Start.front_end) == SMOKE
    assert as_played(SMOKE, "receiver.py:Receiver").world is None
    with pytest.raises(BadInput, match=r"no \[world\]"):
        as_played(SMOKE.model_copy(update={"world": None}), Start.front_end)
    assert open_front_end(Start.front_end) == SimulatedFrontEnd.open


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("hardware", "must be simulated, recorded:FILE"),
        ("receiver.py:", "must be simulated, recorded:FILE"),
        ("receiver.py", "say which class or function of it makes front ends: receiver.py:NAME"),
        ("nowhere.py:Receiver", "No such file"),
        ("no_such_package.module:Receiver", "No module named"),
        ("json:Receiver", "there is no Receiver"),
        ("json:__all__", "must be a class or a function"),
        ("recorded:nowhere.db", "no such file"),
        ("decimal:Context", "needs the method transmit"),
        ("recorded:postgresql://radar:x#y@host/db", "of a password as %2F"),
    ],
)
def test_what_is_no_front_end_is_refused(name: str, words: str) -> None:
    for find in (open_front_end, settled):
        with pytest.raises(BadInput, match=words):
            find(name)


@pytest.mark.parametrize(
    ("name", "cure"),
    [
        ("receiver.py:Dish", ": `cogradar check receiver.py:Dish` opens and asks it without a run"),
        ("radar.dish:Dish", ": `cogradar check radar.dish:Dish` opens and asks it without a run"),
        ("zenoh:dish", ": is its process up, and at the same router?"),
        ("recorded:a.db", ""),
    ],
)
def test_a_front_end_that_is_waited_for_is_named_with_what_to_do(name: str, cure: str) -> None:
    said = list[str]()
    told = _Told(said.append, name)
    for quiet_s in (0.0, 9.0, 10.0):
        now = told.of(Progress(0, 10, None, "the emulator's first scan", []), quiet_s)
    assert now.waiting_for == f"front end {name}, for the emulator's first scan"
    assert said == [f"waiting for {now.waiting_for}, or the recorder{cure}"]


def test_a_file_that_raises_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "broken.py"
    file.write_text("raise RuntimeError('no driver')")
    with pytest.raises(BadInput, match="RuntimeError: no driver"):
        open_front_end(f"{file}:Receiver")


def test_a_name_that_a_file_has_not_is_said_once(tmp_path: Path) -> None:
    file = tmp_path / "receiver.py"
    file.write_text("")
    with pytest.raises(BadInput, match=rf"^{file}:Nope: there is no Nope in {file}$"):
        open_front_end(f"{file}:Nope")


def test_a_recording_is_settled_with_its_run(recording: tuple[str, str, str]) -> None:
    file, run, _ = recording
    assert settled(f"recorded:{file}") == f"recorded:{file}#{run}"
    with pytest.raises(BadInput, match="no run other"):
        settled(f"recorded:{file}#other")


def test_a_recording_of_another_radar_is_refused_when_it_is_opened(recording: tuple[str, str, str]) -> None:
    opened = open_front_end(f"recorded:{recording[0]}")
    radar = SMOKE.radar.model_copy(update={"detector": SMOKE.radar.detector.model_copy(update={"p_fa": 0.01})})
    start = RunStart.of(SMOKE.model_copy(update={"radar": radar, "world": None}), Strategy.POWER_AWARE, 1, DWELLS)
    with pytest.raises(FrontEndError, match=r"another radar\.detector"):
        opened(checkpoint(start))


def test_a_recording_with_a_gap_is_refused(recording: tuple[str, str, str], tmp_path: Path) -> None:
    file = tmp_path / "gap.db"
    file.write_bytes(Path(recording[0]).read_bytes())
    journal = Journal(str(file))
    journal.write("DELETE FROM message WHERE k = 3 AND topic = 'scan'")
    seal(journal)
    journal.close()
    with pytest.raises(BadInput, match="only a run without gaps"):
        open_front_end(f"recorded:{file}")
