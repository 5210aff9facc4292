"""What comes before its run is known is kept, but never much."""

import numpy as np

from services.delivery import pending as early
from services.delivery.pending import MAX_BYTES, MAX_EARLY, Early
from shared.protocol.messages import Message, Refused, Waveform
from tests.samples import plan, sample


def _replayed(kept: Early, run: str = "run-1") -> list[Message]:
    seen: list[Message] = []

    def handle(message: Message) -> list[Message]:
        seen.append(message)
        return []

    assert kept.replay(run, handle) == []
    return seen


def test_messages_of_a_run_come_back_once_in_their_order() -> None:
    kept = Early()
    for k in range(3):
        kept.keep(plan(k))
        kept.keep(plan(k, run="other"))
    assert _replayed(kept) == [plan(k) for k in range(3)]
    assert _replayed(kept) == []
    assert _replayed(kept, "other") == [plan(k, run="other") for k in range(3)]


def test_the_oldest_go_first_when_there_are_too_many() -> None:
    kept = Early()
    for k in range(MAX_EARLY + 5):
        kept.keep(plan(k))
    assert [message.k for message in _replayed(kept) if hasattr(message, "k")] == list(range(5, MAX_EARLY + 5))


def test_the_oldest_go_first_when_they_are_too_large() -> None:
    kept, factor = Early(), np.ones((512, 512), np.complex64)
    n = MAX_BYTES // factor.nbytes
    for k in range(3 * n):
        kept.keep(sample(Waveform, k=k, factor=factor))
    left = _replayed(kept)
    assert len(left) in {n - 1, n}
    assert left[-1] == sample(Waveform, k=3 * n - 1, factor=factor)
    for k in range(10):  # what was forgotten takes no room
        kept.keep(plan(k))
    assert len(_replayed(kept)) == 10


def test_a_message_that_is_refused_does_not_take_the_others_with_it() -> None:
    kept = Early()
    for k in range(3):
        kept.keep(plan(k))

    def handle(message: Message) -> list[Message]:
        if message == plan(1):
            raise Refused("odd")
        return [message]

    assert kept.replay("run-1", handle) == [plan(0), plan(2)]


def test_forgetting_a_run_leaves_the_others() -> None:
    kept = Early()
    kept.keep(plan(1))
    kept.keep(plan(2, run="other"))
    kept.forget("run-1")
    assert (_replayed(kept), _replayed(kept, "other")) == ([], [plan(2, run="other")])


def test_the_bounds_fit_each_other() -> None:
    """A thousand messages without arrays are kept."""
    assert MAX_EARLY * early.OVERHEAD_BYTES < MAX_BYTES
