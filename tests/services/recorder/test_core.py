"""The recorder: what it journals, and how it comes back."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import pytest

from cogradar.services.delivery.pacing import MAX_AHEAD_DWELLS
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.journal import Journal
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import (
    Checkpoint,
    Message,
    Plan,
    Refused,
    RunEnd,
    RunStart,
    Scan,
    Truth,
    Waveform,
)
from cogradar.shared.protocol.recovery import History, ScanRecall, WaveformRecall
from cogradar.shared.wire.codec import encode
from tests.samples import digest
from tests.services.loop import plans, scans, smoke_start, waveforms
from tests.services.recorder.conftest import acknowledged
from tests.services.stored import seal

pytestmark = pytest.mark.usefixtures("either_store")


def _recorded(messages: Iterable[Message]) -> Journal:
    journal = Journal(":memory:")
    core = RecorderCore(journal)
    for message in messages:
        assert all(isinstance(answer, Checkpoint) for answer in core.handle(message))
    return journal


def _rows(journal: Journal) -> list[dict[str, object]]:
    return journal.read("SELECT run, k, topic, item, payload FROM message ORDER BY run, k, topic, item")


# What it journals.


def test_a_run_is_journalled_from_start_to_end(sent: list[Message]) -> None:
    journal = _recorded(sent)
    (run,) = journal.read("SELECT * FROM run")
    n = len(scans(sent))
    assert (run["run"], run["strategy"], run["seed"], run["dwells"]) == ("r", "power-aware", 1, 20)
    assert (run["status"], run["acknowledged_k"], run["acknowledged_t"]) == ("complete", n, 20)
    assert run["acquisition_scans"] == sum(scan.t == 0 for scan in scans(sent))
    kept = journal.read("SELECT topic, COUNT(*) AS n FROM message GROUP BY topic")
    assert {row["topic"]: row["n"] for row in kept} == {"scan": n, "truth": n, "waveform": n, "plan": 2 * n}
    assert journal.read("SELECT * FROM score") == []  # others derive them


def test_the_digest_covers_scans_plans_and_waveforms_in_order(sent: list[Message]) -> None:
    """Independently: per dwell plans by track, the scan, the waveform (topics in alphabetical order)."""
    ordered: list[Message] = []
    for scan, waveform in zip(scans(sent), waveforms(sent), strict=True):
        ordered += {plan.target: plan for plan in plans(sent) if plan.k == scan.k}.values()
        ordered += [scan, waveform]
    assert _recorded(sent).read("SELECT digest FROM run") == [{"digest": digest(ordered)}]


def test_order_of_arrival_and_repetition_do_not_matter(sent: list[Message]) -> None:
    one, other = _recorded(sent), _recorded([*sent[::-1], *sent])
    assert _rows(one) == _rows(other)
    columns = "SELECT digest, acknowledged_k, acknowledged_t, status, conflicts FROM run"
    assert one.read(columns) == other.read(columns)


def test_what_no_process_comes_to_with_this_journal_is_refused(sent: list[Message]) -> None:
    """In lockstep: a journal that was put back is behind what its processes were told. They would go on with dwells
    that this one never comes to, as orders that are granted again shape others.
    """
    (start, *_), last = sent, scans(sent)[-1]
    far = last.model_copy(update={"k": MAX_AHEAD_DWELLS})
    core = RecorderCore(journal := _recorded([start]), resume=True)
    with pytest.raises(Refused, match=f"dwell {far.k}, though only those before 0 are .* was an older journal put in"):
        core.handle(far)
    core.handle(far.model_copy(update={"k": far.k - 1}))
    assert [row["k"] for row in _rows(journal)] == [far.k - 1]


def test_a_message_that_differs_from_the_first_is_counted_and_refused(sent: list[Message]) -> None:
    """Before and after its dwell is complete."""
    journal, first = Journal(":memory:"), plans(sent)[0]
    core, n = RecorderCore(journal), 0
    for until in (sent.index(first) + 1, len(sent) - 1):
        for message in sent[n:until]:
            core.handle(message)
        n = until
        with pytest.raises(Refused, match="plan of dwell 0 differs"):
            core.handle(first.model_copy(update={"n_sim": 7}))
    assert journal.read("SELECT conflicts FROM run") == [{"conflicts": 2}]


def test_a_failed_run_says_why() -> None:
    journal = _recorded([smoke_start(), RunEnd(run="r", k=0, t=0, status="failed", reason="no target")])
    assert journal.read("SELECT status, reason FROM run") == [{"status": "failed", "reason": "no target"}]


# How it comes back.


@pytest.mark.parametrize("cut", [1, 7, 40, 96, 105])
def test_a_recorder_that_comes_back_goes_on_where_the_journal_is(sent: list[Message], cut: int, tmp_path: Path) -> None:
    """Cut anywhere: in the acquisition, in its last dwell, in the middle of a dwell. What was not committed is lost."""
    path, whole = str(tmp_path / "runs.db"), _recorded(sent)
    first = Journal(path)
    acknowledged(RecorderCore(first), sent[:cut])
    first.rollback()
    first.close()
    second = Journal(path)
    core = RecorderCore(second, resume=True)
    asked = [m for tick in (0.25, 0.5) for m in core.handle(Tick(tick)) if isinstance(m, Checkpoint) and m.resend]
    acknowledged(core, [m for m in sent[1:] if getattr(m, "k", 0) >= asked[0].k])
    assert _rows(second) == _rows(whole)
    columns = "SELECT digest, acknowledged_k, acknowledged_t, acquisition_scans, status, conflicts FROM run"
    assert second.read(columns) == whole.read(columns)
    second.close()


def test_a_run_that_nobody_resumes_is_marked_as_interrupted() -> None:
    journal = _recorded([smoke_start()])
    RecorderCore(journal)
    assert journal.read("SELECT status, reason FROM run") == [{"status": "failed", "reason": "interrupted"}]


UNREADABLE = {
    "another schema": ("UPDATE run SET document = replace(document, ?, '\"other\"') WHERE run = 'bad'", '"array"'),
    "no JSON": ("UPDATE run SET document = ? WHERE run = 'bad'", "{"),
    "a torn message": ("UPDATE message SET payload = ? WHERE run = 'bad' AND topic = 'scan'", bytes(20)),
}


@pytest.mark.parametrize("damage", UNREADABLE.values(), ids=UNREADABLE.keys())
def test_a_run_that_cannot_be_read_is_set_aside_and_the_others_go_on(
    damage: tuple[str, str | bytes], sent: list[Message]
) -> None:
    journal = Journal(":memory:")
    core = RecorderCore(journal)
    for message in sent[:-1]:
        core.handle(message.model_copy(update={"run": "bad"}))
    for message in sent[:40]:
        core.handle(message)
    journal.write("UPDATE run SET acknowledged_k = 3, acknowledged_t = 1 WHERE run = 'bad'")
    journal.write(*damage)
    seal(journal)  # as another program would have written it
    again = RecorderCore(journal, resume=True)
    (bad,) = journal.read("SELECT status, reason FROM run WHERE run = 'bad'")
    assert bad["status"] == "quarantined"
    assert bad["reason"]
    acknowledged(again, sent[1:])
    assert journal.read("SELECT status FROM run WHERE run = 'r'") == [{"status": "complete"}]
    again.handle(scans(sent)[5].model_copy(update={"run": "bad"}))
    if journal.read("SELECT document FROM run WHERE run = 'bad'") == journal.read(
        "SELECT document FROM run WHERE run = 'r'"
    ):
        with pytest.raises(Refused, match="another run has this name"):
            again.handle(smoke_start(run="bad", seed=9))
    else:  # whoever began it is told that it is over
        assert _is_end(again.handle(smoke_start(run="bad")))


def _is_end(answers: Sequence[Message]) -> bool:
    return bool(answers) and all(isinstance(answer, Checkpoint) and answer.ended for answer in answers)


def test_a_message_that_is_torn_long_since_sets_its_run_aside_when_the_digest_comes_to_it(sent: list[Message]) -> None:
    journal = Journal(":memory:")
    core = RecorderCore(journal)
    acknowledged(core, sent[:-1])
    journal.write("UPDATE message SET payload = ? WHERE topic = 'scan' AND k = 2", bytes(20))
    seal(journal)
    again = RecorderCore(journal, resume=True)
    again.handle(smoke_start(run="other"))
    assert isinstance(sent[-1], RunEnd)
    assert _is_end(again.handle(sent[-1]))
    assert journal.read("SELECT run, status FROM run ORDER BY place") == [
        {"run": "r", "status": "quarantined"},
        {"run": "other", "status": "running"},
    ]


@pytest.mark.parametrize("kind", [Scan, Truth, Plan, Waveform])
def test_what_comes_before_its_run_is_known_is_journalled_when_it_begins(
    kind: type[Message], sent: list[Message]
) -> None:
    journal = Journal(":memory:")
    core, early = RecorderCore(journal), next(message for message in sent if isinstance(message, kind))
    assert core.handle(early) == ()
    assert isinstance(sent[0], RunStart)
    core.handle(sent[0])
    assert [row["topic"] for row in _rows(journal)] == [kind.__name__.lower()]


@pytest.mark.parametrize(("rate_hz", "answered"), [(0.0, []), (10.0, [3])])
def test_in_real_time_a_waveform_that_is_missing_is_recalled_by_the_newest_before_it(
    rate_hz: float, answered: list[int], sent: list[Message]
) -> None:
    """All processes are started anew, and the journal has the last scan, but not its waveform: the radar goes on."""
    core = RecorderCore(Journal(":memory:"))
    core.handle(smoke_start(dwells=20).model_copy(update={"rate_hz": rate_hz}))
    for message in [*scans(sent)[:6], *waveforms(sent)[:4]]:
        core.handle(message)
    histories = [answer for answer in core.handle(WaveformRecall(run="r", k=5)) if isinstance(answer, History)]
    assert [history.k for history in histories] == answered
    assert [history.payloads for history in histories] == [[encode(waveforms(sent)[k])] for k in answered]


@pytest.mark.parametrize(("rate_hz", "recalled"), [(0.0, [1, 2]), (10.0, [1, 2, 5, 6])])
def test_scans_are_recalled_over_gaps_in_real_time_only(
    rate_hz: float, recalled: list[int], sent: list[Message]
) -> None:
    """In lockstep what is missing will come; in real time a dwell may never have happened."""
    core = RecorderCore(Journal(":memory:"))
    core.handle(smoke_start(dwells=20).model_copy(update={"rate_hz": rate_hz}))
    for k in (0, 1, 2, 5, 6):
        core.handle(scans(sent)[k])
    (history,) = core.handle(ScanRecall(run="r", k=1, targets=[0], planner="p"))
    assert isinstance(history, History)
    assert history.payloads == [encode(scans(sent)[k]) for k in recalled]
