"""No message that can be sent ends a process, hangs it, or changes it by being refused.

Of a million and more mutants a pair of topic and reader, the ordinary suite plays ten thousand in all.
"""

from collections.abc import Iterator
from pathlib import Path

import pytest

from cogradar.services.planner import owned_track
from cogradar.services.recorder import core as recorder
from cogradar.services.simulation.memory import remembering
from cogradar.shared.protocol.topics import Role, Topic
from tests.robustness.heard import PAIRS, SCHEDULE, SKIES, Run, record
from tests.robustness.trials import AT_ONCE, Fates, play

IN_CI = 10_000  # mutants, over all pairs and runs
REMEMBERED = 4000  # results of a core that hears the same again: more would cost more time than they save
EACH = [pytest.param(topic, role, id=f"{topic.name}-{role}") for topic, role in PAIRS]
SLOW_S = 2.0  # for a message, on a machine with other work


@pytest.fixture(scope="module", autouse=True)
def _often() -> Iterator[None]:
    """Checkpoints and snapshots so often that a short run has several."""
    with pytest.MonkeyPatch.context() as patch, remembering(REMEMBERED):
        patch.setattr(recorder, "CHECKPOINT_DWELLS", SCHEDULE.checkpoint_dwells)
        patch.setattr(owned_track, "SNAPSHOT_DWELLS", SCHEDULE.snapshot_dwells)
        yield


@pytest.fixture(scope="module")
def runs(_often: None, tmp_path_factory: pytest.TempPathFactory) -> list[Run]:
    """Known and unknown numbers of tracks, in lockstep and in real time."""
    folder: Path = tmp_path_factory.mktemp("runs")
    return [record(sky, rate_hz, folder) for sky, rate_hz in SKIES]


def _play(runs: list[Run], topic: Topic, role: Role, n: int) -> None:
    """Lots of mutants, run after run; a lot is a function of its number."""
    fates = Fates()
    for lot in range(-(-n // AT_ONCE)):
        try:
            play(runs[lot % len(runs)], topic, role, lot, fates)
        except Exception as error:
            error.add_note(f"lot {lot} of {topic.name} at the {role}, run {lot % len(runs)}")
            raise
    assert fates.counts["dropped"] > 0
    assert fates.slowest_s < SLOW_S


@pytest.mark.parametrize(("topic", "role"), EACH)
def test_mutants_end_no_core(runs: list[Run], topic: Topic, role: Role) -> None:
    _play(runs, topic, role, IN_CI // len(PAIRS))


@pytest.mark.nightly
@pytest.mark.parametrize(("topic", "role"), EACH)
def test_a_million_mutants_end_no_core(runs: list[Run], topic: Topic, role: Role, pytestconfig: pytest.Config) -> None:
    _play(runs, topic, role, pytestconfig.getoption("--mutants"))
