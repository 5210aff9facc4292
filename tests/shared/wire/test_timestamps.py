"""The timestamps that a process keeps of its messages."""

from cogradar.shared.wire.timestamps import Received, Sent, Timestamps
from studies.processes.timestamps import RunTimestamps
from tests.samples import plan


def test_a_message_is_noted_when_the_process_is_free_again() -> None:
    timestamps = Timestamps()
    timestamps.receive(plan(3), 1.0, 2.0)
    assert not timestamps.received
    timestamps.finish()
    timestamps.finish()
    (received,) = timestamps.received
    assert received[:6] == ("plan", plan(3).run, 3, plan(3).target, 1.0, 2.0)
    assert received.done > 0.0


def test_the_timestamps_of_one_run_come_back_from_json() -> None:
    timestamps, other = Timestamps(), plan(1).model_copy(update={"run": "other"})
    for message in (plan(1), other, plan(2)):
        timestamps.receive(message, 0.25, 0.5)
        timestamps.finish()
        timestamps.send(message, 0.75, 100)
    found = RunTimestamps.read(timestamps.of("other"))
    assert found.cpu_s > 0.0
    assert found.received == [Received("plan", "other", 1, other.target, 0.25, 0.5, timestamps.received[1].done)]
    assert found.sent == [Sent("plan", "other", 1, other.target, 0.75, 100)]
    assert RunTimestamps.read(timestamps.of("")).sent == []
