"""The table of topics: who says what to whom, under which key."""

import re

import pytest

from shared.protocol.messages import Checkpoint, EmulatorCheckpoint, Message, Plan, Scan, Truth, Waveform
from shared.protocol.recovery import History
from shared.protocol.topics import ALIVE, BY_MESSAGE, BY_NAME, QUERY, TOPICS, Role, Topic, topics_read_by
from tests.samples import sample


def _messages(kind: type[Message]) -> set[type[Message]]:
    """Message types that are sent; a name with an underscore is a common part of several."""
    found = {kind} if kind.__module__.startswith("shared.protocol.") and not kind.__name__.startswith("_") else set()
    return found.union(*(_messages(below) for below in kind.__subclasses__()))


def test_every_message_has_one_topic() -> None:
    assert set(BY_MESSAGE) == _messages(Message) - {Message}
    assert len(BY_MESSAGE) == len(BY_NAME) == len(TOPICS)


def test_who_reads_what() -> None:
    """The loop: emulator -> planners -> allocator -> emulator. The recorder receives all that the others send; metrics
    reads its journal, and is told when there is more of it."""
    read = {role: {topic.message for topic in topics_read_by(role)} for role in Role}
    assert read == {
        Role.OPERATOR: {Checkpoint},
        Role.ROUTER: set(),
        Role.EMULATOR: {EmulatorCheckpoint, Waveform, History},
        Role.PLANNER: {Checkpoint, Scan, History},
        Role.ALLOCATOR: {Checkpoint, Plan},
        Role.RECORDER: {topic.message for topic in TOPICS if topic.producer is not Role.RECORDER},
        Role.METRICS: {Checkpoint},
    }


def test_only_the_recorder_receives_the_truth() -> None:
    assert BY_MESSAGE[Truth].readers == (Role.RECORDER,)


def test_nobody_reads_what_it_says_itself() -> None:
    assert all(topic.producer not in topic.readers and topic.readers for topic in TOPICS)


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_a_key_matches_its_pattern_and_no_other(topic: Topic) -> None:
    key = topic.key_of(sample(topic.message))
    matching = [t.name for t in TOPICS if re.fullmatch(t.pattern.replace("*", "[^/]+"), key)]
    assert matching == [topic.name]
    assert not {"*", "$", "#", "?", "{"} & set(key)


def test_keys() -> None:
    assert BY_MESSAGE[Plan].key_of(sample(Plan, run="r.5", target=2)) == "cogradar/run/r.5/plan/2"
    assert BY_MESSAGE[Scan].key_of(sample(Scan, run="r")) == "cogradar/run/r/scan"
    assert BY_MESSAGE[Plan].pattern == "cogradar/run/*/plan/*"
    assert ALIVE.format(role=Role.PLANNER, name="p1") == "cogradar/alive/planner/p1"
    assert QUERY.format(metric="rmse") == "cogradar/query/rmse"
