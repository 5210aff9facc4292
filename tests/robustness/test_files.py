"""Files with anything wrong in them: a line that says so, exit code 2, and the file as it was."""

import os
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, example, given, settings
from hypothesis import strategies as st

from cogradar.services.errors import BadInput, Failure
from cogradar.services.metrics.store import Store
from cogradar.services.recorder.full_disk import Recorder
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs import in_process
from cogradar.services.simulation.skies import start_of
from cogradar.services.skies.place import Place
from cogradar.services.skies.recorded import recorded
from cogradar.shared.protocol.events import Tick
from cogradar.shared.scenario.document import SCENARIO_DIR
from cogradar.shared.scenario.files import ScenarioError, load
from cogradar.shared.scenario.limits import MAX_ROWS
from cogradar.shared.scenario.trajectories.csv_files import trajectory
from tests.services.cli.here import here
from tests.services.stored import seal

PHASES = [Phase.explicit, Phase.reuse, Phase.generate]  # to shrink a store would take minutes
SHARED = settings(phases=PHASES, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
STRANGE = st.sampled_from(
    [
        *("nan", "inf", "-inf", "1e308", "-1e308", "5e-324", "-1", "0", "1", "2", "1e9", "9223372036854775807", "0x10"),
        *("true", "''", '"\\u0000"', "[]", "[[]]", "{}", "[1,[2]]", "1979-05-27", "07:32:00", "0001-01-01T00:00+14:00"),
        *("paper", "../x", "/dev/zero", "/proc/self/mem", "\x00", "\ufeff", "é", "1_0", "9" * 5000),
    ]
)
SCENARIO = (SCENARIO_DIR / "smoke.toml").read_text(encoding="utf-8")
SKY = (SCENARIO_DIR / "crossing.toml").read_text(encoding="utf-8")
FLIGHT = "t_s,x_km,y_km\n0,40,-30\n10,41,-29.5\n20,42,-29\n"
POSITIONS = "time,icao24,lat,lon\n" + "".join(
    f"{t},{name},{48.5 + 0.001 * t + 0.01 * m:.4f},{12.2 + 0.002 * t:.4f}\n"
    for t in range(0, 60, 5)
    for m, name in enumerate(("abc000", "abc001"))
)
PLACE = Place(48.35, 11.79, 60.0)


@st.composite
def changed(draw: st.DrawFn, text: str) -> bytes:
    """A text in which words, lines or bytes are others."""
    for _ in range(draw(st.integers(1, 3))):
        words = [
            at for at, (a, b) in enumerate(zip(" " + text, text, strict=False)) if a in " ,=[\n" and b not in " ,=\n"
        ]
        begin = draw(st.sampled_from(words or [0]))
        length = next((n for n, c in enumerate(text[begin:]) if c in " ,=]\n"), 1)
        match draw(st.integers(0, 4)):
            case 0 | 1:
                text = text[:begin] + draw(STRANGE) + text[begin + length :]
            case 2:
                text = text[:begin] + draw(st.text(max_size=8)) + text[begin + length :]
            case 3:
                lines = text.splitlines(keepends=True) or [""]
                n = draw(st.integers(0, len(lines) - 1))
                text = "".join(lines[:n] + lines[n + 1 :] + draw(st.sampled_from([[], [lines[n], lines[n]]])))
            case _:
                text = text[: draw(st.integers(0, len(text)))]
    encoded = text.encode("utf-8", "surrogatepass")
    at = draw(st.integers(0, len(encoded)))
    return encoded[:at] + draw(st.just(b"") | st.binary(max_size=3)) + encoded[at:]


def _said(error: Exception) -> None:
    """One line that can be printed."""
    assert str(error)
    assert str(error).isprintable()


@settings(SHARED, max_examples=30)
@given(content=changed(SCENARIO) | changed(SKY))
@example(content=b'extends = "\\u0000.toml"')
def test_a_scenario_is_loaded_or_refused(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "s.toml"
    file.write_bytes(content)
    try:
        load(str(file))
    except ScenarioError as error:
        _said(error)
        for line in error.faults:
            assert line.isprintable()


@settings(SHARED, max_examples=30)
@given(content=changed(FLIGHT))
def test_a_trajectory_is_read_or_refused(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "flight.csv"
    file.write_bytes(content)
    try:
        trajectory(file, MAX_ROWS)
    except ScenarioError as error:
        _said(error)
    (tmp_path / "s.toml").write_text('extends="smoke"\n[[world.targets]]\ntrajectory="flight.csv"\n', encoding="utf-8")
    try:
        load(str(tmp_path / "s.toml"))
    except ScenarioError as error:
        _said(error)


@settings(SHARED, max_examples=30)
@given(content=changed(POSITIONS))
def test_positions_are_read_or_refused(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "positions.csv"
    file.write_bytes(content)
    try:
        recorded(file, PLACE, 100.0)
    except BadInput as error:
        _said(error)


@pytest.mark.parametrize(
    ("name", "content", "command"),
    [
        ("s.toml", SCENARIO.replace("p_fa = 1e-4", "p_fa = nan").encode(), ["check"]),
        ("s.toml", SCENARIO.encode()[:700], ["check"]),
        ("s.toml", b"\xff" + SCENARIO.encode(), ["check"]),
        (
            "p.csv",
            POSITIONS.replace("48.5", "nan").encode(),
            ["sky", "--origin", "48.35,11.79", "--out", "sky.toml", "--from"],
        ),
    ],
)
def test_what_is_wrong_is_said_in_a_line_with_exit_code_2(
    name: str, content: bytes, command: list[str], tmp_path: Path
) -> None:
    file = tmp_path / name
    file.write_bytes(content)
    done = here(*command, str(file))
    assert done.returncode == 2
    assert name in done.stderr.replace("\n", "")
    assert "Traceback" not in done.stderr


# Stores.


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A journal with a run that is over, and the beginning of another."""
    file = tmp_path_factory.mktemp("store") / "runs.db"
    journal = Journal(str(file))
    in_process.play(start_of("known", 1, 0.0), store=Store(journal))
    journal.close()
    return file


QUESTIONS = ("runs", "summary", "p_d", "rmse", "consistency", "confirmation", "tracks", "picture")
PAYLOADS = st.sampled_from([0, -1, 2**62, 1e308, "", "x", b"", b"\x80", b"\xc1"])


@st.composite
def damage(draw: st.DrawFn) -> Callable[[Path], None]:
    """Something that is done to a store: bytes of the file, its length, payloads, its version."""
    places = draw(
        st.lists(st.tuples(st.floats(0, 1) | st.floats(0, 0.005), st.binary(min_size=1, max_size=40)), max_size=5)
    )
    size = draw(st.none() | st.floats(0, 1))
    sql = [
        "UPDATE message SET payload = substr(payload, 1, ?) WHERE k % 2",
        "UPDATE message SET payload = ? WHERE k % 3 = 1",
        "UPDATE run SET document = ?",
        "PRAGMA user_version = 3",
        "PRAGMA application_id = 3",
        "ALTER TABLE message RENAME COLUMN payload TO said",
    ]
    statement, value = draw(st.sampled_from(sql)), draw(PAYLOADS)
    length, is_sealed = draw(st.integers(0, 400)), draw(st.booleans())

    def bytes_changed(file: Path) -> None:
        content = bytearray(file.read_bytes())
        for place, noise in places:
            at = int(place * len(content))
            content[at : at + len(noise)] = noise
        file.write_bytes(content if size is None else content[: int(size * len(content))])

    def rows_changed(file: Path) -> None:
        with closing(sqlite3.connect(file)) as db, db:
            db.execute(statement, (length if "substr" in statement else value,) if "?" in statement else ())
        if is_sealed:  # as another program would write it
            with suppress(Failure), closing(Journal(str(file))) as journal:
                seal(journal)

    return draw(st.sampled_from((rows_changed, bytes_changed)))


def _copied(store: Path, folder: Path) -> Path:
    for old in folder.glob("runs.db*"):
        old.unlink()
    return Path(shutil.copy(store, folder / "runs.db"))


@settings(SHARED, max_examples=25)
@given(harm=damage(), question=st.sampled_from(QUESTIONS))
def test_a_damaged_store_is_read_or_refused(
    harm: Callable[[Path], None], question: str, store: Path, tmp_path: Path
) -> None:
    file = _copied(store, tmp_path)
    harm(file)
    before = file.read_bytes()
    done = here("query", question, "--store", str(file))
    assert done.returncode in {0, 1, 2}
    assert done.returncode == 0 or done.stderr
    assert file.read_bytes() == before


@settings(SHARED, max_examples=25)
@given(harm=damage(), k=st.integers(0, 8))
def test_a_recorder_goes_on_with_a_damaged_journal_or_refuses_it(
    harm: Callable[[Path], None], k: int, store: Path, tmp_path: Path
) -> None:
    file = _copied(store, tmp_path)
    with closing(sqlite3.connect(file)) as db, db:
        db.execute("UPDATE run SET status = 'running', acknowledged_k = ?, acknowledged_t = 0, digest = NULL", (k,))
        db.execute("DELETE FROM message WHERE k > ?", (k + 2,))
    with closing(Journal(str(file))) as journal:
        seal(journal)
    harm(file)
    try:
        recorder = Recorder(Journal(str(file)), resume=True)
        for n in range(8):
            recorder.handle(Tick(0.25 * n, drained=True))
        recorder.close()
    except Failure as error:
        _said(error)


def test_a_value_that_the_world_takes_over_is_blamed_where_it_stands(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text('extends = "paper"\n[radar.echo]\namplitude_db = "72 dB"\n')
    with pytest.raises(ScenarioError) as caught:
        load(str(tmp_path / "s.toml"))
    (fault,) = caught.value.faults
    assert fault.endswith(
        "s.toml: radar.echo.amplitude_db = '72 dB': must be a number >= -100 and <= 200; write 72,"
        " without quotes and unit"
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a disk that is full")
def test_output_that_cannot_be_written_is_no_traceback(tmp_path: Path) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "cogradar", "scenarios", "--json"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    said = "standard output: No space left on device: the output is not complete\n"
    assert (done.returncode, done.stderr) == (1, said)
    (tmp_path / "dtü.toml").write_text('extends = "smoke"\n')
    ascii_only = {**os.environ, "PYTHONIOENCODING": "ascii"}
    command = [sys.executable, "-m", "cogradar", "scenarios", "--show", str(tmp_path / "dtü.toml"), "--set", "title=ü"]
    done = subprocess.run(command, capture_output=True, text=True, env=ascii_only, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert 'title = "\\xfc"' in done.stdout.replace("  ", " ")
