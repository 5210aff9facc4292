"""Epochs and stamps: who leads a run, and what was made of more than its journal has."""

import logging
from collections.abc import Sequence

import pytest

from cogradar.shared.protocol.events import Rewind
from cogradar.shared.protocol.fields import MAX_EPOCH
from cogradar.shared.protocol.messages import Checkpoint, Command, Lead, Message, Plan, RunCancel, RunStart, Scan
from cogradar.shared.protocol.recovery import History
from cogradar.shared.protocol.topics import BY_MESSAGE, Role
from cogradar.shared.wire.bus import LOCAL, Inbox, LocalNetwork
from cogradar.shared.wire.codec import BadMessage, encode
from cogradar.shared.wire.epochs import MAX_RUNS_HEARD, Epochs, Stamp
from tests.samples import sample

Leads = Sequence[Lead]


FIRST = (Lead(epoch=5, revision=0),)


def told(epoch: int, revision: int, *, opened: int = 0, before: Leads = FIRST, rate_hz: float = 0.0) -> Checkpoint:
    """A checkpoint of a recorder, which began with revision `opened`, after others."""
    leads = [*(lead for lead in before if lead.epoch < epoch), Lead(epoch=epoch, revision=opened)]
    found = sample(Checkpoint, epoch=epoch, revision=revision, leads=leads, rate_hz=rate_hz)
    assert isinstance(found, Checkpoint)
    return found


def heard(*checkpoints: Checkpoint) -> Epochs:
    """A process that has heard these."""
    epochs = Epochs()
    for checkpoint in checkpoints:
        epochs.fault(checkpoint)
    return epochs


def test_what_a_deposed_recorder_says_is_dropped_and_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    """Of the run in which a higher epoch was heard; another recorder may lead another run."""
    inbox = Inbox(LOCAL)

    def heard(kind: type[Message], epoch: int, run: str = "run-1") -> bool:
        message = sample(kind, epoch=epoch, run=run)
        return inbox.open(BY_MESSAGE[kind].key_of(message, LOCAL), encode(message)) == [message]

    assert [heard(Checkpoint, epoch) for epoch in (3, 3, 5, 4, 5, 3, 6)] == [True, True, True, False, True, False, True]
    assert not heard(History, 5)
    assert heard(Checkpoint, 1, "run-2")
    assert inbox.bad_of_topic == {"checkpoint": 2, "history": 1}
    first, _ = [record.getMessage() for record in caplog.records]
    assert first.endswith("the first: run-1: of epoch 4, another recorder of epoch 5 leads it")


def test_epochs_of_the_runs_that_were_heard_of_last_are_kept() -> None:
    epochs = Epochs()
    for n in range(MAX_RUNS_HEARD + 1):
        assert not epochs.fault(sample(Checkpoint, epoch=5, run=f"run-{n}"))
        assert epochs.fault(sample(Checkpoint, epoch=4, run="run-0"))  # heard of all the time
    assert epochs.fault(sample(Checkpoint, epoch=4, run=f"run-{n}"))
    assert not epochs.fault(sample(Checkpoint, epoch=4, run="run-1"))


def test_in_lockstep_what_a_worker_makes_has_a_stamp_and_what_is_asked_of_a_run_has_none() -> None:
    epochs = heard(told(5, 12))
    assert {kind: epochs.say(sample(kind)) for kind in (Scan, Plan)} == dict.fromkeys((Scan, Plan), Stamp(5, 12))
    assert {epochs.say(sample(kind)) for kind in (RunStart, RunCancel, Command, Checkpoint)} == {None}
    assert heard(told(5, 12, rate_hz=10.0)).say(sample(Scan)) is None
    assert Epochs().say(sample(Scan)) is None


def test_it_grows_with_what_others_made_of_more() -> None:
    """What is made of a scan is made of all that its sender knew, heard here or not."""
    epochs = heard(told(5, 12))
    assert not epochs.fault(sample(Scan), Stamp(5, 30))
    assert not epochs.fault(sample(Scan), Stamp(5, 20))
    assert epochs.say(sample(Plan)) == Stamp(5, 30)


@pytest.mark.parametrize(
    ("stamp", "is_heeded"),
    [
        (None, True),
        (Stamp(5, 8), True),  # of before the journal was put back: it has all of it
        (Stamp(5, 9), False),
        (Stamp(6, 9), True),
        (Stamp(7, 8), False),  # its recorder is heard first
    ],
)
def test_what_is_made_of_more_than_the_journal_has_is_dropped(stamp: Stamp | None, is_heeded: bool) -> None:
    epochs = heard(told(5, 8), told(6, 8, opened=8))
    assert (epochs.fault(sample(Scan), stamp) == "") is is_heeded


def test_a_recorder_drops_it_too() -> None:
    epochs = Epochs()
    assert epochs.say(told(6, 8, opened=8)) is None
    assert epochs.fault(sample(Scan), Stamp(5, 9))
    assert not epochs.fault(sample(Scan), Stamp(5, 8))


def test_without_a_checkpoint_it_is_taken_of_one_epoch_only() -> None:
    epochs = Epochs()
    assert not epochs.fault(sample(Scan), Stamp(5, 9))
    assert epochs.fault(sample(Scan), Stamp(4, 0))
    assert epochs.fault(sample(Scan), Stamp(6, 0))
    assert epochs.voids(told(6, 8, opened=8))


@pytest.mark.parametrize(
    ("checkpoint", "is_void"),
    [
        (told(6, 12, opened=12), False),
        (told(6, 11, opened=11), True),
        (told(6, 30, opened=11), True),
        (told(5, 11, opened=11), False),
        (told(6, 11, opened=11, rate_hz=10.0), False),  # no dwell can be repeated
    ],
)
def test_a_process_that_was_told_more_than_the_journal_has_is_void(checkpoint: Checkpoint, is_void: bool) -> None:
    assert heard(told(5, 12)).voids(checkpoint) is is_void


PUT_BACK = told(7, 20, opened=18, before=[Lead(epoch=5, revision=0), Lead(epoch=6, revision=8)])


@pytest.mark.parametrize(
    ("stamp", "is_heeded"),
    [(Stamp(4, 1), False), (Stamp(5, 8), True), (Stamp(5, 9), False), (Stamp(6, 18), True), (Stamp(6, 19), False)],
)
def test_a_journal_that_was_put_back_before_its_last_recorder_began_is_noticed(stamp: Stamp, is_heeded: bool) -> None:
    """It has more now than it was put back to. Who was away for both hears of both."""
    assert (heard(PUT_BACK).fault(sample(Scan), stamp) == "") is is_heeded
    assert heard(told(*stamp)).voids(PUT_BACK) is not is_heeded


def test_a_journal_that_was_led_beside_another_copy_has_nothing_of_it() -> None:
    """Whatever its own recorder was told of since: of an epoch that it does not know, nothing is in it."""
    original = told(7, 30, opened=30)
    assert heard(told(6, 20, opened=8)).voids(original)
    assert heard(original).fault(sample(Scan), Stamp(6, 20))
    assert not heard(told(5, 30)).voids(original)


def test_in_lockstep_an_older_checkpoint_of_the_epoch_is_dropped() -> None:
    """It comes late, and says less. The end of a run is heeded whatever it says."""
    assert heard(told(5, 12)).fault(told(5, 11)).endswith("it comes late, of revision 11; 12 was told")
    assert not heard(told(5, 12)).fault(told(5, 12))
    assert not heard(told(5, 12)).fault(told(5, 0).model_copy(update={"ended": True}))
    assert not heard(told(5, 12, rate_hz=10.0)).fault(told(5, 11, rate_hz=10.0))


def test_in_lockstep_a_recorder_is_heard_by_its_checkpoints_first() -> None:
    """What a history tells of is more than the process knows of the recorder's journal."""
    epochs = heard(told(5, 30))
    assert epochs.fault(sample(History, epoch=6))
    assert epochs.voids(told(6, 20, opened=20))
    assert not epochs.fault(told(6, 20, opened=20))
    assert not epochs.fault(sample(History, epoch=6))
    assert not heard(told(5, 30, rate_hz=10.0)).fault(sample(History, epoch=6))


def test_a_rewind_comes_before_the_checkpoint_that_says_so() -> None:
    network = LocalNetwork()
    bus = network.endpoint(Role.ALLOCATOR, "allocator")
    checkpoints = [told(5, 12), told(6, 11, opened=11), told(6, 12, opened=11)]
    for checkpoint in checkpoints:
        network.deliver(checkpoint)
    assert list(bus.queue) == [checkpoints[0], Rewind(checkpoints[0].run), *checkpoints[1:]]


def test_stamps_come_back_from_the_wire() -> None:
    stamp = Stamp(2**61, 12)
    assert stamp.packed().hex() == "0000000000000020" + "0c00000000000000"
    assert Stamp.of(stamp.packed()) == stamp


@pytest.mark.parametrize("packed", [b"", bytes(15), bytes(17), Stamp(MAX_EPOCH + 1, 0).packed(), b"\xff" * 16])
def test_a_message_with_a_stamp_that_is_none_is_dropped(packed: bytes, caplog: pytest.LogCaptureFixture) -> None:
    with pytest.raises(BadMessage, match="a stamp of"):
        Stamp.of(packed)
    inbox, scan = Inbox(LOCAL), sample(Scan)
    with caplog.at_level(logging.WARNING):
        assert inbox.open(BY_MESSAGE[Scan].key_of(scan, LOCAL), encode(scan), packed) == []
    assert inbox.bad_of_topic == {"scan": 1}
    assert "a stamp of" in caplog.text
