"""What the simulator looks at finds what is wrong, and lets pass what is right."""

import itertools
import math
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cogradar.services.delivery.pacing import Lockstep, RealTime
from cogradar.services.emulator import dwell as emulator
from cogradar.services.emulator.front_end import Transmission
from cogradar.services.planner.held_tracks import HeldTracks
from cogradar.services.recorder import core as recorder
from cogradar.services.recorder import journal
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.recall import recalled
from cogradar.services.recorder.store.seal import message_checksum
from cogradar.services.simulation import memory, trials
from cogradar.services.simulation.checks import runs
from cogradar.services.simulation.disk import Disk
from cogradar.services.simulation.memory import Impure, Memory
from cogradar.services.simulation.schedule import JOINED_S, Asked, Fault, Kind, Schedule
from cogradar.services.simulation.simulator import Outcome, _often, play, undisturbed
from cogradar.shared.protocol.orders import Pause, PowerLimit
from cogradar.shared.protocol.recovery import History
from cogradar.shared.wire.codec import decode, encode
from cogradar.shared.wire.pool.shares import Shares
from tests.services.simulation.plain import PLAIN


@pytest.fixture(autouse=True, scope="module")
def _remembering() -> Iterator[None]:
    with memory.remembering(trials.REMEMBERED):
        yield


def _played(*faults: Fault, **changed: Any) -> Outcome:
    return play(replace(PLAIN, faults=faults, **changed))


def test_a_function_whose_results_differ_is_found() -> None:
    results, known = itertools.count(), Memory(10)

    def impure(_: int) -> int:
        return next(results)

    for _ in range(memory.AGAIN):
        assert known.result(impure, (1,)) == 0
    with pytest.raises(Impure, match="impure: two results of the same arguments"):
        known.result(impure, (1,))


@pytest.mark.parametrize("sky", ["known", "unknown"])
def test_all_that_is_remembered_is_pure(sky: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "AGAIN", 1)
    for _ in range(2):
        assert _played(sky=sky, planners=3).violation == ""


def test_a_frozen_recorder_goes_on_though_another_one_has_its_place() -> None:
    """Frozen twice, by two faults that overlap, of which one starts a successor."""
    faults = Fault(Kind.SUCCESSOR, 0.01, 1.5, "recorder-0", n=0), Fault(Kind.FREEZE, 1.2, 2.7, "recorder-0", n=1)
    assert _played(*faults, rate_hz=10.0).violation == ""


@pytest.mark.parametrize("role", ["emulator", "allocator"])
@pytest.mark.parametrize("wakes_s", [6.9, 7.0, 7.2])
def test_a_process_that_wakes_while_there_is_no_router_takes_nothing(role: str, wakes_s: float) -> None:
    """It sees no claim of another then: it would serve all, beside the one that has taken over from it."""
    faults = Fault(Kind.FREEZE, 4.5, wakes_s, f"{role}-1", n=0), Fault(Kind.ROUTER, 6.767, 7.322, "", n=1)
    for run_seed in (1, 2, 3, 4):
        outcome = _played(*faults, pool=2, rate_hz=2.0, dwells=12, run_seed=run_seed)
        assert outcome.violation == ""


def test_shards_that_two_processes_serve_are_found_though_no_run_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Shares, "_yield", lambda *_: None)
    cut = Fault(Kind.CUT, JOINED_S, 5.0, "emulator-0", "emulator-1")
    assert "how many processes of role emulator serve each: {" in _played(cut, pool=2).violation


def test_shards_that_are_left_alone_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    take = Shares._take
    monkeypatch.setattr(Shares, "_take", lambda self, now_s: None if now_s > 2.0 else take(self, now_s))
    gone = Fault(Kind.GONE, 2.5, math.inf, "allocator-1")
    assert "how many processes of role allocator serve each: {" in _played(gone, pool=2).violation


def test_dwells_that_are_made_up_for_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def made_up(self: RealTime, due_s: float | None, now_s: float) -> float | None:
        due_s = now_s if due_s is None else due_s
        return None if now_s < due_s else due_s + self.period_s

    # Somebody who answers would be waited for, which hides it.
    hangs = Fault(Kind.HANG, 0.25, 3.0, "allocator-0"), Fault(Kind.HANG, 0.65, 1.25, "emulator-0")
    assert _played(*hangs, rate_hz=10.0, dwells=20).violation == ""
    monkeypatch.setattr(RealTime, "next_due_s", made_up)
    assert "three dwells were radiated from" in _played(*hangs, rate_hz=10.0, dwells=20).violation


def test_waveforms_that_wait_for_planners_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    hang = Fault(Kind.HANG, 0.3, 3.0, "planner-0")
    assert _played(hang, planners=1, rate_hz=10.0).violation == ""
    monkeypatch.setattr(RealTime, "wait_s", lambda self, periods: 20.0 * periods * self.period_s)
    assert "only planners were disturbed" in _played(hang, planners=1, rate_hz=10.0).violation


def test_a_radar_that_runs_ahead_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    slow, commands = Fault(Kind.SLOW, 0.0, 0.05, "recorder-0", amount=0.01), (Asked(0, PowerLimit(share=0.5), 0),)
    assert _played(slow, commands=commands).violation == ""
    monkeypatch.setattr(Lockstep, "may_transmit", lambda *_: True)
    assert "ahead of the journal, at most 1" in _played(slow, commands=commands).violation


def test_tracks_that_two_planners_keep_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """One is away for a while, and gets its tracks back."""
    crash, settings = Fault(Kind.CRASH, 1.0, 2.0, "planner-0"), {"rate_hz": 10.0, "dwells": 150}
    assert _played(crash, **settings).violation == ""
    monkeypatch.setattr(HeldTracks, "leave", lambda *_: None)
    assert "is planned by planner-0 and planner-1" in _played(crash, **settings).violation


def test_a_recall_of_what_was_never_sent_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def other(store: Journal, recall: Any) -> list[History]:
        (found,) = recalled(store, recall)
        payloads = [encode(decode(payload).model_copy(update={"isotropic": 0.125})) for payload in found.payloads]
        return [found.model_copy(update={"payloads": payloads})]

    crash = Fault(Kind.CRASH, 0.01, 0.02, "emulator-0")
    assert _played(crash).violation == ""
    monkeypatch.setattr(recorder, "recalled", other)
    assert "of known-1 that was never sent" in _played(crash).violation


def test_damage_that_is_believed_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """A waveform of a dwell that is not acknowledged yet is another one, and the recorder does not look."""

    def rot(disk: Disk) -> None:
        with closing(sqlite3.connect(disk.path)) as db, db:
            k, payload = db.execute("SELECT MAX(k), payload FROM message WHERE topic = 'waveform'").fetchone()
            at = bytes(payload).index(np.float64(vars(decode(payload))["isotropic"]).astype(">f8").tobytes())
            changed = bytearray(payload)
            changed[at + 7] ^= 1
            db.execute("UPDATE message SET payload = ? WHERE topic = 'waveform' AND k = ?", (bytes(changed), k))

    class Fitting(int):
        def __ne__(self, _: object) -> bool:
            return False

    fault = Fault(Kind.ROT, 0.003, 0.02, "recorder-0")
    monkeypatch.setattr(Disk, "rot", rot)
    assert _played(fault).violation == ""
    monkeypatch.setattr(journal, "message_checksum", lambda *row: Fitting(message_checksum(*row)))
    assert "known-1: its damage was believed: digest" in _played(fault).violation


def test_of_two_frozen_recorders_each_keeps_its_journal_open() -> None:
    """The journals of both were closed when the one went on that came second, and ended."""
    first, second = (
        Fault(Kind.SUCCESSOR, 0.0204, 4.6790, "recorder-0", n=0),
        Fault(Kind.SUCCESSOR, 1.5143, 2.5356, "recorder-0", n=1),
    )
    often = {"run_seed": 4, "planners": 1, "checkpoint_dwells": 2, "snapshot_dwells": 2}
    assert _played(second, first, **often).violation == ""


def test_what_a_run_is_compared_with_is_played_by_settings_of_its_own() -> None:
    """A run without commands was played within one with commands, waited for checkpoints, and was a violation."""
    undisturbed.cache_clear()
    commanded = replace(PLAIN, commands=(Asked(0, Pause(dwells=2), 3),))
    with _often(commanded):
        assert undisturbed(commanded.plain())
    undisturbed.cache_clear()


def test_of_a_waveform_without_power_less_is_the_same() -> None:
    """In a pause the power is 0, and it was divided by it."""
    assert runs._limited(("a", 0.0, b""), 0.5) == ("a", 0.0, b"")
    assert runs._limited(("a", 2.0, b""), 0.5) == ("a", 0.5, b"")


@pytest.mark.parametrize(
    "seed",
    [
        pytest.param(9_400_259, id="what was not measured in the acquisition is no dwell"),
        pytest.param(9_400_885, id="no room for the first dwells: no waveform is beside its plans"),
        pytest.param(9_300_389, id="all who had the scans of the acquisition are gone"),
    ],
)
def test_what_no_program_could_have_kept_is_no_violation(seed: int) -> None:
    assert play(Schedule.draw(seed)).violation == ""


@pytest.mark.parametrize("action", [PowerLimit(share=0.5), Pause(dwells=3)])
def test_an_order_that_the_radar_knows_and_does_not_keep_is_found(
    action: PowerLimit | Pause, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The allocator is away, and its last waveform has all power: only the emulator can keep the order."""
    crash, commands = Fault(Kind.CRASH, 0.55, 3.0, "allocator-0"), (Asked(0, action, 8),)
    assert _played(crash, rate_hz=10.0, dwells=20, commands=commands).violation == ""
    monkeypatch.setattr(emulator, "limited", _unlimited)
    monkeypatch.setattr(emulator, "is_paused", lambda _: False)
    assert "with power" in _played(crash, rate_hz=10.0, dwells=20, commands=commands).violation


def _unlimited(asked: Transmission, _most: float) -> Transmission:
    return asked
