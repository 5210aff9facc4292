"""What comes before its run is known is kept, but never much."""

import numpy as np

from cogradar.services.delivery import pending
from cogradar.services.delivery.pending import MAX_BYTES, MAX_PENDING, Pending
from cogradar.shared.protocol.messages import Message, Refused, Waveform
from tests.samples import plan, sample
from tests.services.births import HERE, roster, waveform


def _replayed(kept: Pending, run: str = "run-1") -> list[Message]:
    seen: list[Message] = []

    def handle(message: Message) -> list[Message]:
        seen.append(message)
        return []

    assert kept.replay(run, handle) == []
    return seen


def test_messages_of_a_run_come_back_once_in_their_order() -> None:
    kept = Pending()
    for k in range(3):
        kept.add(plan(k))
        kept.add(plan(k, run="other"))
    assert _replayed(kept) == [plan(k) for k in range(3)]
    assert _replayed(kept) == []
    assert _replayed(kept, "other") == [plan(k, run="other") for k in range(3)]


def test_the_oldest_go_first_when_there_are_too_many() -> None:
    kept = Pending()
    for k in range(MAX_PENDING + 5):
        kept.add(plan(k))
    assert [message.k for message in _replayed(kept) if hasattr(message, "k")] == list(range(5, MAX_PENDING + 5))


def test_the_oldest_go_first_when_they_are_too_large() -> None:
    kept, factor = Pending(), np.ones((512, 512), np.complex64)
    n = MAX_BYTES // factor.nbytes
    for k in range(3 * n):
        kept.add(sample(Waveform, k=k, factor=factor))
    left = _replayed(kept)
    assert len(left) in {n - 1, n}
    assert left[-1] == sample(Waveform, k=3 * n - 1, factor=factor)
    for k in range(10):  # what was forgotten takes no room
        kept.add(plan(k))
    assert len(_replayed(kept)) == 10


def test_what_is_within_a_roster_takes_room() -> None:
    sent = waveform(0, roster({0: HERE}, born=[0]))
    assert sent.roster is not None
    more = sent.roster.model_copy(update={"searched": np.linspace(-0.5, 0.5, 4096)})
    assert pending._size(sent.model_copy(update={"roster": more})) - pending._size(sent) == 8 * (4096 - 2)


def test_a_message_that_is_refused_does_not_take_the_others_with_it() -> None:
    kept = Pending()
    for k in range(3):
        kept.add(plan(k))

    def handle(message: Message) -> list[Message]:
        if message == plan(1):
            raise Refused("odd")
        return [message]

    assert kept.replay("run-1", handle) == [plan(0), plan(2)]


def test_forgetting_a_run_leaves_the_others() -> None:
    kept = Pending()
    kept.add(plan(1))
    kept.add(plan(2, run="other"))
    kept.forget("run-1")
    assert (_replayed(kept), _replayed(kept, "other")) == ([], [plan(2, run="other")])


def test_the_bounds_fit_each_other() -> None:
    """A thousand messages without arrays are kept."""
    assert MAX_PENDING * pending.OVERHEAD_BYTES < MAX_BYTES
