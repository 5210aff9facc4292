"""The digest of a run is the same however it was come by; and at the end of a run it is there."""

from collections.abc import Iterator, Sequence

import pytest

from cogradar.services.recorder.core import CHECKPOINT_DWELLS, RecorderCore
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.run_digest import CATCH_UP_DWELLS
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Message, Plan, RunEnd, Truth
from tests.samples import digest
from tests.services.loop import plans, play, scans, smoke_start, waveforms

pytestmark = pytest.mark.usefixtures("either_store")

DWELLS = 60


class Counting(Journal):
    """Counts the payloads that are read out again."""

    def __init__(self) -> None:
        super().__init__(":memory:")
        self.n_read = 0

    def messages(self, run: str, topics: Sequence[str], from_k: int = 0, to_k: int | None = None) -> Iterator[bytes]:
        for payload in super().messages(run, topics, from_k, to_k):
            self.n_read += 1
            yield payload

    def digest(self) -> str:
        return str(self.read("SELECT digest FROM run")[0]["digest"])


@pytest.fixture(scope="module")
def sent() -> list[Message]:
    return play(smoke_start(dwells=DWELLS))


@pytest.fixture(scope="module")
def expected(sent: list[Message]) -> str:
    """By hand: per dwell plans by track, the scan, the waveform."""
    ordered: list[Message] = []
    for scan, waveform in zip(scans(sent), waveforms(sent), strict=True):
        ordered += [*(plan for plan in plans(sent) if plan.k == scan.k), scan, waveform]
    return digest(ordered)


def _handle(core: RecorderCore, messages: Sequence[Message]) -> None:
    for message in messages:
        core.handle(message)


def test_at_the_end_nothing_is_left_to_do(sent: list[Message], expected: str) -> None:
    journal = Counting()
    core = RecorderCore(journal)
    _handle(core, sent[:-1])
    before = journal.n_read
    assert before == 4 * len(scans(sent))
    assert isinstance(sent[-1], RunEnd)
    core.handle(sent[-1])
    assert (journal.n_read, journal.digest()) == (before, expected)


def test_dwells_that_become_complete_in_any_order(sent: list[Message], expected: str) -> None:
    journal = Counting()
    core = RecorderCore(journal)
    core.handle(sent[0])
    _handle(core, sent[:0:-1])
    assert journal.digest() == expected


@pytest.mark.parametrize("cut", [0.5, 0.9, 1.0])
def test_a_recorder_that_comes_back_catches_up_a_little_with_every_dwell(
    cut: float, sent: list[Message], expected: str
) -> None:
    journal, n = Counting(), int(cut * (len(sent) - 1))
    _handle(RecorderCore(journal), sent[:n])
    journal.n_read = 0
    core = RecorderCore(journal, resume=True)
    most = 5 * (CHECKPOINT_DWELLS + 1)  # those that are not acknowledged
    assert journal.n_read <= most
    for message in sent[n:-1]:
        before = journal.n_read
        core.handle(message)
        assert journal.n_read - before <= 4 * CATCH_UP_DWELLS
    core.handle(sent[-1])
    assert journal.digest() == expected
    assert journal.n_read <= 4 * len(scans(sent)) + most  # nothing twice


def test_in_real_time_what_comes_after_its_dwell_was_completed_is_not_part_of_it(sent: list[Message]) -> None:
    """A dwell that is complete is closed: the journal never changes behind what is acknowledged."""
    journal, start = Counting(), smoke_start(dwells=DWELLS).model_copy(update={"rate_hz": 10.0})
    core = RecorderCore(journal)
    core.handle(start)
    late = [message for message in sent if isinstance(message, Plan) and message.k % 7 == 0]
    _handle(core, [message for message in sent[1:-1] if message not in late])
    for i in range(20):
        core.handle(Tick(float(i)))
        _handle(core, [scans(sent)[-1]])
    _handle(core, late)
    core.handle(sent[-1])
    for i in range(20, 40):
        core.handle(Tick(float(i)))
    ordered: list[Message] = []
    for scan, waveform in zip(scans(sent), waveforms(sent), strict=True):
        ordered += [*(plan for plan in plans(sent) if plan.k == scan.k and plan not in late), scan, waveform]
    assert journal.digest() == digest(ordered)
    assert journal.read("SELECT COUNT(*) AS n FROM message WHERE topic = 'plan' AND k % 7 = 0") == [{"n": 0}]


def test_of_a_run_that_failed_everything_counts(sent: list[Message]) -> None:
    journal = Counting()
    core = RecorderCore(journal)
    until = next(i for i, message in enumerate(sent) if isinstance(message, Truth) and message.k == 5)
    _handle(core, sent[: until + 1])  # the scan of dwell 5 as well
    core.handle(RunEnd(run="r", k=5, t=0, status="failed", reason="x"))
    of_dwell = {5: [scan for scan in scans(sent) if scan.k == 5]}
    ordered: list[Message] = []
    for scan, waveform in zip(scans(sent)[:5], waveforms(sent)[:5], strict=True):
        ordered += [*(plan for plan in plans(sent) if plan.k == scan.k), scan, waveform]
    assert journal.digest() == digest([*ordered, *of_dwell[5]])
