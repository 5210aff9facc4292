"""The table of topics: who says what to whom, under which key."""

import re

import pytest

from cogradar.shared.protocol.messages import (
    Checkpoint,
    EmulatorCheckpoint,
    Message,
    Plan,
    RunStart,
    Scan,
    Truth,
    Waveform,
)
from cogradar.shared.protocol.recovery import Handover, History, NoPlans
from cogradar.shared.protocol.topics import (
    BY_MESSAGE,
    BY_NAME,
    DWELL,
    EXCHANGES,
    QUERY,
    TOPICS,
    Role,
    Topic,
    topics_read_by,
)
from tests.samples import sample


def _messages(kind: type[Message]) -> set[type[Message]]:
    """Message types that are sent; a name with an underscore is a common part of several."""
    found = (
        {kind}
        if kind.__module__.startswith("cogradar.shared.protocol.") and not kind.__name__.startswith("_")
        else set()
    )
    return found.union(*(_messages(below) for below in kind.__subclasses__()))


def test_every_message_has_one_topic_or_is_of_an_exchange() -> None:
    exchanged = {kind for one in EXCHANGES for kind in (one.question, one.answer)}
    assert set(BY_MESSAGE) | exchanged == _messages(Message) - {Message}
    assert not set(BY_MESSAGE) & exchanged
    assert len(BY_MESSAGE) == len(BY_NAME) == len(TOPICS)


def test_who_reads_what() -> None:
    """The loop: emulator -> planners -> allocator -> emulator. The recorder receives all that the others send, and what
    another recorder would say; metrics reads the journal, and is told when there is more of it."""
    read = {role: {topic.message for topic in topics_read_by(role)} for role in Role}
    assert read == {
        Role.OPERATOR: {Checkpoint},
        Role.ROUTER: set(),
        Role.EMULATOR: {EmulatorCheckpoint, Waveform, History},
        Role.PLANNER: {Checkpoint, Scan, History, Handover, NoPlans},
        Role.ALLOCATOR: {Checkpoint, History, Plan, Scan},
        Role.RECORDER: set(BY_MESSAGE) - {EmulatorCheckpoint, History, Handover},
        Role.METRICS: {Checkpoint},
    }


def test_only_the_recorder_receives_the_truth() -> None:
    assert BY_MESSAGE[Truth].readers == (Role.RECORDER,)


def test_who_reads_what_its_own_role_says() -> None:
    """Workers that hand tracks over or cannot plan, and a recorder that was away while another one took the lead."""
    assert [topic.message for topic in TOPICS if topic.producer in topic.readers] == [Checkpoint, Handover, NoPlans]
    assert all(topic.readers for topic in TOPICS)


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_a_key_matches_its_pattern_and_no_other(topic: Topic) -> None:
    key = topic.key_of(sample(topic.message), "1f3a")
    matching = [t.name for t in TOPICS if re.fullmatch(t.pattern("1f3a").replace("*", "[^/]+"), key)]
    assert matching == [topic.name]
    assert not {"*", "$", "#", "?", "{"} & set(key)


def test_keys() -> None:
    assert BY_MESSAGE[Plan].key_of(sample(Plan, run="r.5", target=2), "1f3a") == "cogradar/10/1f3a/run/r.5/plan/0-15"
    assert BY_MESSAGE[Scan].key_of(sample(Scan, run="r"), "1f3a") == "cogradar/10/1f3a/run/r/scan"
    assert BY_MESSAGE[RunStart].key_of(sample(RunStart, run="r"), "1f3a") == "cogradar/10/run/r/start"
    assert BY_MESSAGE[Plan].key_of(sample(Plan, run="r"), "1f3a", "0-7") == "cogradar/10/1f3a/run/r/plan/0-7"
    assert BY_MESSAGE[Plan].pattern("1f3a") == "cogradar/10/1f3a/run/*/plan/*"
    assert BY_MESSAGE[Plan].pattern("1f3a", slots="0-7") == "cogradar/10/1f3a/run/*/plan/0-7"
    assert BY_MESSAGE[History].pattern("1f3a", to="p1") == "cogradar/10/1f3a/run/*/history/p1"
    assert QUERY.format(metric="rmse") == "cogradar/10/query/rmse"
    assert DWELL.key_of("roof") == "cogradar/10/front-end/roof/dwell"
