"""A stored run is fed into one core: what is the same is counted, what differs is found where it begins."""

import json
import shutil
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from cogradar.services.analysis import replay as module
from cogradar.services.analysis.replay import CORES, Difference, Replay, replay, words
from cogradar.services.analysis.stored_run import StoredRun
from cogradar.services.cli.app import app
from cogradar.services.delivery import pacing
from cogradar.services.errors import BadInput
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.recording import take
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs import in_process
from cogradar.shared.protocol.messages import Command, Message, Plan, RunStart, Scan, Waveform
from cogradar.shared.protocol.orders import MAX_ORDERS, DropTrack, Order, Priority
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.codec import decode, encode
from tests.services.loop import play, scans
from tests.services.stored import seal
from tests.skies import sky_start

DWELLS, TRACKS = 70, 2  # more than a core gets between two checkpoints
AT = 40  # dwell k that is changed
CUT = 6  # ... before which a run is cut: the third aircraft comes then


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("store") / "runs.db"
    store = Store(Journal(str(path)))
    in_process.play(RunStart.of(load("smoke"), Strategy.POWER_AWARE, 1, DWELLS), store=store)
    store.close()
    return path


@pytest.fixture
def file(original: Path, tmp_path: Path) -> Path:
    """A copy of it, to be changed."""
    return Path(shutil.copy(original, tmp_path / "runs.db"))


@pytest.fixture
def store(file: Path) -> Iterator[Store]:
    opened = Store(Journal(str(file)))
    yield opened
    opened.close()


def _stored(store: Store) -> StoredRun:
    return StoredRun(partial(answer, store))


def _k(store: Store) -> int:
    """Dwells of the run, acquisition included."""
    return int(_stored(store).row["k"])


def _message(store: Store, topic: str, item: int) -> Message:
    payload = store.journal.message(_stored(store).name, AT, topic, item)
    assert payload is not None
    return decode(payload)


def _change(store: Store, topic: str, item: int, **changed: object) -> None:
    other = encode(_message(store, topic, item).model_copy(update=changed))
    where = "WHERE k = ? AND topic = ? AND item = ?"
    assert store.journal.write(f"UPDATE message SET payload = ? {where}", other, AT, topic, item) == 1  # noqa: S608
    seal(store.journal)


def _remove(store: Store, topic: str, item: int) -> None:
    assert store.journal.write("DELETE FROM message WHERE k = ? AND topic = ? AND item = ?", AT, topic, item) == 1
    seal(store.journal)


@pytest.mark.parametrize(("to", "each"), [("planner", TRACKS), ("allocator", 1)])
def test_a_run_replays_clean(to: str, each: int, file: Path, store: Store) -> None:
    fed: list[int] = []
    n_dwell = _k(store)
    assert replay(_stored(store), to, fed.append) == Replay(agreed=each * n_dwell)
    assert fed == list(range(1, n_dwell + 1))
    done = CliRunner().invoke(app, ["replay", "--store", str(file), "--to", to])
    assert "the newest run, and no other" in done.stderr
    assert done.exit_code == 0, done.stderr
    assert f"{each * n_dwell} {'plan' if to == 'planner' else 'waveform'}s agree bit for bit" in done.stdout


def test_a_run_that_was_cut_and_commanded_replays_from_its_first_dwell(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An allocator that is told of an order answers no dwell that is far from the acknowledged one."""
    name, n_dwell = _stored(store).name, _k(store)
    drop = Command(run=name, id="0" * 32, by="operator", action=DropTrack(track=0))  # changes nothing here
    store.journal.add_command(drop, 1, AT + 1, "")
    store.journal.cut(name, AT)
    store.journal.commit()
    monkeypatch.setattr(pacing, "MAX_AHEAD_DWELLS", AT // 2)
    monkeypatch.setattr(module, "ACKNOWLEDGE_EVERY", 8)
    assert replay(_stored(store), "allocator") == Replay(agreed=n_dwell - AT)


def test_of_a_run_that_was_cut_the_tracks_that_began_later_are_replayed() -> None:
    store, start = in_memory(), sky_start(dwells=40)
    in_process.play(start, store=store)
    whole = replay(_stored(store), "planner")
    store.journal.cut(start.run, CUT)
    (row,) = store.journal.read("SELECT COUNT(*) AS n FROM message WHERE topic = 'plan'")
    left = replay(_stored(store), "planner")
    assert (left.difference, left.agreed + left.cut_off) == (None, row["n"])
    assert 0 < left.agreed < whole.agreed
    assert f"{left.cut_off} plans were not compared: their tracks began" in module.words("r", "planner", left)[1]


def test_the_tracks_of_a_known_number_begin_with_the_dwells_that_were_cut(store: Store) -> None:
    store.journal.cut(_stored(store).name, AT)
    with pytest.raises(BadInput, match=f"its first {AT} dwells were cut, .* COGRADAR_KEEP_BYTES"):
        replay(_stored(store), "planner")


def test_of_priorities_a_replay_tells_those_whose_tracks_are_there() -> None:
    """A run without an end has more of them than a checkpoint holds."""
    scan = scans(play(sky_start("radar.search.beams=4", dwells=20)))[-1]
    tracks = [0, *range(100, 100 + MAX_ORDERS)]
    given = [Order(n=n, k=9, action=Priority(track=m, weight=2.0)) for n, m in enumerate(tracks, 1)]
    assert module._obeyed(given, [scan], 19, by_clock=False) == given[:1]


def test_a_plan_that_was_altered_is_found_at_its_dwell(file: Path, store: Store) -> None:
    plan = _message(store, "plan", 2)
    assert isinstance(plan, Plan)
    estimate = plan.estimate.copy()
    estimate[1] = np.nextafter(estimate[1], 1.0)
    _change(store, "plan", 2, estimate=estimate)
    name = _stored(store).name
    expected = Difference(AT, plan.t, 2, "estimate[1]", str(float(estimate[1])), str(float(plan.estimate[1])))
    assert replay(_stored(store), "planner") == Replay(agreed=TRACKS * AT + 1, difference=expected)
    done = CliRunner().invoke(app, ["replay", name, "--store", str(file), "--to", "planner"])
    assert done.exit_code == 1
    assert f"{name}: the plan of track 2 at dwell k = {AT} (t = {plan.t}) differs: estimate[1] was" in done.stdout
    told = json.loads(CliRunner().invoke(app, ["replay", "--store", str(file), "--to", "planner", "--json"]).stdout)
    assert (told["run"], told["difference"]["k"], told["difference"]["field"]) == (name, AT, "estimate[1]")


def test_a_waveform_that_was_altered_is_found_at_its_dwell(store: Store) -> None:
    waveform = _message(store, "waveform", 0)
    assert isinstance(waveform, Waveform)
    _change(store, "waveform", 0, factor=waveform.factor[:, :1])
    outcome = replay(_stored(store), "allocator")
    assert outcome.difference is not None
    assert (outcome.agreed, outcome.difference.k, outcome.difference.track) == (AT, AT, None)
    assert (outcome.difference.field, outcome.difference.recorded) == ("factor.shape", "(16, 1) of complex64")
    assert "with other contents" not in " ".join(words("r", "allocator", outcome))
    store.journal.write("UPDATE run SET conflicts = 3")
    seal(store.journal)
    said = words("r", "allocator", replay(_stored(store), "allocator"))
    assert "3 messages of this run were sent again with other contents" in said[-1]


def test_a_waveform_after_a_scan_of_an_older_roster_is_not_compared_in_real_time(tmp_path: Path) -> None:
    """The allocator went on from the roster that it had sent meanwhile, which a replay in lockstep has not."""
    store = Store(Journal(str(tmp_path / "runs.db")))
    sky = load("smoke", ["radar.fidelity=best-range", 'radar.tracks="unknown"', "radar.search.beams=2"])
    in_process.play(RunStart.of(sky, Strategy.POWER_AWARE, 1, AT + 10), store=store)
    scan = _message(store, "scan", 0)
    assert isinstance(scan, Scan)
    assert scan.roster is not None
    older = scan.roster.model_copy(update={"next_search": scan.roster.next_search - 2})
    _change(store, "scan", 0, roster=older)
    assert replay(_stored(store), "allocator").difference is not None  # in lockstep it is one
    store.journal.write("UPDATE run SET rate_hz = 5.0")
    seal(store.journal)
    outcome = replay(_stored(store), "allocator")
    assert (outcome.difference, outcome.late) == (None, 1)
    assert outcome.agreed == _k(store) - 1
    store.close()


def test_another_planner_is_found(store: Store) -> None:
    """As after a change of its code: here of what its document says."""
    store.journal.write("UPDATE run SET document = json_set(document, '$.radar.planner.n_sim', 7)")
    seal(store.journal)
    outcome = replay(_stored(store), "planner")
    assert outcome.difference is not None
    assert (outcome.difference.track, outcome.difference.field, outcome.difference.now) == (1, "n_sim", "7")
    assert outcome.difference.k == _k(store) - DWELLS - 1  # where the tracks begin


def test_in_real_time_what_the_clock_decided_is_left_out_and_counted(store: Store) -> None:
    store.journal.write("UPDATE run SET rate_hz = 10.0")
    seal(store.journal)
    plan = _message(store, "plan", 1)
    assert isinstance(plan, Plan)
    _change(store, "plan", 1, n_sim=plan.n_sim - 1, bins=(plan.bins + 1) % 16)
    n_dwell = _k(store)
    assert replay(_stored(store), "planner") == Replay(agreed=TRACKS * n_dwell, cut_short=1)
    _change(store, "waveform", 0, late=np.array([1, 0], dtype=np.int32))
    assert replay(_stored(store), "allocator") == Replay(agreed=n_dwell - 1, late=1)
    _change(store, "waveform", 0, late=np.array([0, 0], dtype=np.int32), begins_none=True)
    assert replay(_stored(store), "allocator") == Replay(agreed=n_dwell - 1, late=1)
    _remove(store, "plan", 1)
    assert replay(_stored(store), "planner") == Replay(agreed=TRACKS * n_dwell - 1)
    _remove(store, "scan", 0)  # whose plans were made of a scan that the journal lost, and so were all later ones
    n_other = TRACKS * (n_dwell - AT) - 1
    assert replay(_stored(store), "planner") == Replay(agreed=TRACKS * AT, missing=1, other_scans=n_other)


@pytest.mark.parametrize("to", CORES)
def test_a_campaigns_run_cannot_be_replayed(to: str, store: Store) -> None:
    kept, recording = in_memory(), take(store, _stored(store).name)
    assert recording is not None
    kept.journal.add_recording(recording, 1)
    with pytest.raises(BadInput, match="as in the store of a campaign"):
        replay(_stored(kept), to)


def test_a_core_that_there_is_not_is_bad_input(file: Path, store: Store) -> None:
    done = CliRunner().invoke(app, ["replay", "--store", str(file), "--to", "emulator"])
    assert done.exit_code == 2
    with pytest.raises(BadInput, match="to = 'emulator': must be one of planner, allocator"):
        replay(_stored(store), "emulator")
