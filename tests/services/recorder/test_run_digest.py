"""The digest of a run is the same however it was come by; and at the end of a run it is there."""

from collections.abc import Iterator, Sequence

import pytest

from services.recorder.core import RecorderCore
from services.recorder.journal import Journal
from services.recorder.run_digest import CATCH_UP_DWELLS
from shared.protocol.messages import Message, Plan, RunEnd, Tick, Truth
from tests.samples import digest
from tests.services.loop import plans, play, scans, smoke_start, waveforms

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
def said() -> list[Message]:
    return play(smoke_start(dwells=DWELLS))


@pytest.fixture(scope="module")
def expected(said: list[Message]) -> str:
    """By hand: per dwell plans by track, the scan, the waveform."""
    ordered: list[Message] = []
    for scan, waveform in zip(scans(said), waveforms(said), strict=True):
        ordered += [*(plan for plan in plans(said) if plan.k == scan.k), scan, waveform]
    return digest(ordered)


def _heard(core: RecorderCore, messages: Sequence[Message]) -> None:
    for message in messages:
        core.handle(message)


def test_at_the_end_nothing_is_left_to_do(said: list[Message], expected: str) -> None:
    store = Counting()
    core = RecorderCore(store)
    _heard(core, said[:-1])
    before = store.n_read
    assert before == 4 * len(scans(said))
    assert isinstance(said[-1], RunEnd)
    core.handle(said[-1])
    assert (store.n_read, store.digest()) == (before, expected)


def test_dwells_that_become_complete_in_any_order(said: list[Message], expected: str) -> None:
    store = Counting()
    core = RecorderCore(store)
    core.handle(said[0])
    _heard(core, said[:0:-1])
    assert store.digest() == expected


@pytest.mark.parametrize("cut", [0.5, 0.9, 1.0])
def test_a_metrics_that_comes_back_catches_up_a_little_with_every_dwell(
    cut: float, said: list[Message], expected: str
) -> None:
    store, n = Counting(), int(cut * (len(said) - 1))
    _heard(RecorderCore(store), said[:n])
    store.n_read = 0
    core = RecorderCore(store, resume=True)
    most = 4 * CATCH_UP_DWELLS + 20  # and those of the last two dwells
    assert store.n_read <= most
    for message in said[n:-1]:
        before = store.n_read
        core.handle(message)
        assert store.n_read - before <= 4 * CATCH_UP_DWELLS
    core.handle(said[-1])
    assert store.digest() == expected
    assert store.n_read <= 4 * len(scans(said)) + 20  # nothing twice


def test_what_comes_after_its_dwell_was_taken_is_part_of_it(said: list[Message], expected: str) -> None:
    """In real time a dwell is scored without a plan that comes later all the same."""
    store, start = Counting(), smoke_start(dwells=DWELLS).model_copy(update={"rate_hz": 10.0})
    core = RecorderCore(store)
    core.handle(start)
    late = [message for message in said if isinstance(message, Plan) and message.k % 7 == 0]
    _heard(core, [message for message in said[1:-1] if message not in late])
    _heard(core, late)
    core.handle(said[-1])
    for i in range(20):
        core.handle(Tick(float(i)))
    assert store.digest() == expected


def test_of_a_run_that_failed_everything_counts(said: list[Message]) -> None:
    store = Counting()
    core = RecorderCore(store)
    until = next(i for i, message in enumerate(said) if isinstance(message, Truth) and message.k == 5)
    _heard(core, said[: until + 1])  # the scan of dwell 5 as well
    core.handle(RunEnd(run="r", k=5, t=0, status="failed", reason="x"))
    of_dwell = {5: [scan for scan in scans(said) if scan.k == 5]}
    ordered: list[Message] = []
    for scan, waveform in zip(scans(said)[:5], waveforms(said)[:5], strict=True):
        ordered += [*(plan for plan in plans(said) if plan.k == scan.k), scan, waveform]
    assert store.digest() == digest([*ordered, *of_dwell[5]])
