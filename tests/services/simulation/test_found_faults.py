"""A fault that is put into the program is found by the simulator."""

from dataclasses import replace
from functools import partial

import pytest

from cogradar.services.allocator.last_sent_roster import LastSentRoster
from cogradar.services.allocator.tracks import FoundTracks
from cogradar.services.delivery.pacing import Lockstep
from cogradar.services.delivery.resend import ResendBuffer
from cogradar.services.emulator.front_end import Transmission
from cogradar.services.planner.owned_track import OwnedTrack
from cogradar.services.planner.run import PlannedRun
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.recorded_run import RecordedRun
from cogradar.services.recorder.store.database import Database
from cogradar.services.simulation import trials
from cogradar.services.simulation.schedule import Fault, Kind, Schedule
from cogradar.services.simulation.simulator import play
from cogradar.shared.protocol.messages import Plan
from tests.services.simulation.plain import PLAIN, played

pytestmark = pytest.mark.usefixtures("remembered")


def test_an_order_that_is_effective_too_early_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the next dwell on that is not acknowledged: some process has come to it already, and another has not."""
    monkeypatch.setattr(
        Lockstep, "first_ordered", lambda _self, _newest_k, acknowledged_k, _notice_s: acknowledged_k + 1
    )
    drawn = [schedule for seed in range(450, 530) if (schedule := Schedule.draw(seed)).commands]
    assert any(play(schedule).violation for schedule in drawn)


def test_a_commit_that_is_not_durable_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """A checkpoint that is sent before its transaction is committed, and a power cut between the two."""
    monkeypatch.setattr(RecordedRun, "validate", lambda *_: None)
    commit = Journal.commit
    monkeypatch.setattr(Journal, "commit", lambda self: None if self.read("SELECT 1 FROM run") else commit(self))
    failed = [seed for seed in range(12) if play(Schedule.draw(seed)).violation]
    assert failed


def test_an_emulator_that_comes_back_and_measures_a_dwell_again_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a planner the waveforms do not tell it how far the radar was."""
    faults = Fault(Kind.LEAVE, 0.4, 1.5, "planner-0"), Fault(Kind.CRASH, 0.75, 1.1, "emulator-0")
    run = partial(played, *faults, sky="unknown", rate_hz=10.0, planners=1, dwells=30)
    assert run().violation == ""
    monkeypatch.setattr(RecordedRun, "_due", lambda _: {})
    assert "dwell 7 was radiated twice" in run().violation


def test_answers_in_real_time_that_the_journal_does_not_explain_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Here of an allocator that begins no tracks and does not say so, and of a planner that looks at the clock."""
    run = partial(played, sky="unknown", rate_hz=10.0, dwells=20)
    with monkeypatch.context() as without:
        without.setattr(LastSentRoster, "is_followed", property(lambda _: False, lambda *_: None), raising=False)
        assert "begins no track" in run().violation
        without.setattr(FoundTracks, "sent", lambda self, waveform: self._last_sent.repeated(waveform))
        assert "replayed to the allocator" in run().violation
    plan = PlannedRun._plan

    def by_the_clock(self: PlannedRun, track: OwnedTrack, t: int) -> Plan:
        return plan(self, track, t).model_copy(update={"range_km": 1.0 + self._clock()})

    monkeypatch.setattr(PlannedRun, "_plan", by_the_clock)
    assert "replayed to the planner" in run().violation


def test_an_allocator_that_makes_no_waveform_any_more_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """In real time the radar goes on with the last one."""
    take = FoundTracks.take
    monkeypatch.setattr(FoundTracks, "take", lambda self, scan, k: scan.k < 40 and take(self, scan, k))
    assert "of the plans are in time" in played(sky="unknown", rate_hz=10.0, dwells=80).violation


def test_a_recorder_that_is_not_fenced_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Database, "check_leads", lambda _: None)
    drawn = [schedule for seed in range(60) if _has_successor(schedule := Schedule.draw(seed))]
    assert any(play(schedule).violation for schedule in drawn)


def _has_successor(schedule: Schedule) -> bool:
    return any(fault.kind is Kind.SUCCESSOR for fault in schedule.faults)


def test_messages_that_nobody_sends_again_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ResendBuffer, "add", lambda _self, _k, messages: messages)
    outcome = played(Fault(Kind.LOSS, 0.0, 0.05, "emulator-0", "recorder-0", 0.5))
    assert "not over" in outcome.violation


def test_power_above_the_limit_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """One in a waveform is refused by the emulator; here it makes more of it than it was asked for."""

    def louder(asked: Transmission, _most: float) -> Transmission:
        return replace(asked, factor=1.1 * asked.factor, isotropic=1.21 * asked.isotropic)

    monkeypatch.setattr("cogradar.services.emulator.dwell.limited", louder)
    assert "with power 1.21, at most 1" in played(rate_hz=10.0).violation


def test_an_end_that_never_comes_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RecordedRun, "is_over", property(lambda _: False))
    assert "not over" in played(rate_hz=10.0).violation


def test_a_failing_schedule_is_shrunk_to_the_faults_that_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ResendBuffer, "add", lambda _self, _k, messages: messages)
    needed = Fault(Kind.LOSS, 0.0, 0.05, "emulator-0", "recorder-0", 0.5)
    others = [Fault(Kind.TWICE, 0.01 * n, 0.3, "planner-0", "allocator-0", 0.5, n) for n in range(1, 4)]
    drawn = replace(PLAIN, faults=(others[0], needed, *others[1:]))
    monkeypatch.setattr(Schedule, "draw", lambda _: drawn)
    assert trials.shrunk(1).schedule.faults == (needed,)
