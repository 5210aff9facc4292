"""What a process notes of its messages."""

from shared.wire.timestamps import Heard, Said, Stamps, Timing
from tests.samples import plan


def test_a_message_is_noted_when_the_process_is_free_again() -> None:
    stamps = Stamps()
    stamps.hear(plan(3), 1.0, 2.0)
    assert not stamps.heard
    stamps.rest()
    stamps.rest()
    (heard,) = stamps.heard
    assert heard[:6] == ("plan", plan(3).run, 3, plan(3).target, 1.0, 2.0)
    assert heard.done > 0.0


def test_what_is_said_of_a_run_comes_back_from_json() -> None:
    stamps, other = Stamps(), plan(1).model_copy(update={"run": "other"})
    for message in (plan(1), other, plan(2)):
        stamps.hear(message, 0.25, 0.5)
        stamps.rest()
        stamps.say(message, 0.75, 100)
    timing = Timing.read(stamps.of("other"))
    assert timing.cpu_s > 0.0
    assert timing.heard == [Heard("plan", "other", 1, other.target, 0.25, 0.5, stamps.heard[1].done)]
    assert timing.said == [Said("plan", "other", 1, other.target, 0.75, 100)]
    assert Timing.read(stamps.of("")).said == []
