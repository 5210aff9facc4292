"""The recorder with tracks that begin and end: a dwell is complete with the plans of the tracks of its scan."""

from collections.abc import Sequence
from itertools import pairwise, permutations

import numpy as np
import pytest

from cogradar.services.planner.owned_track import snapshot_of
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.journal import Journal
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Checkpoint, Message, Refused, RunStart, Scan, Truth
from cogradar.shared.protocol.recovery import History, ScanRecall
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.tracking.birth import born
from cogradar.shared.tracking.model import TrackerModel
from cogradar.shared.wire.codec import encode
from tests.samples import digest
from tests.services.births import HERE, THERE, UNKNOWN, end, plan, roster, scan, start_of, truth, waveform
from tests.services.loop import smoke_start

pytestmark = pytest.mark.usefixtures("either_store")

NONE, ONE, TWO, LATER = roster({}), roster({0: HERE}), roster({0: HERE, 1: THERE}), roster({1: THERE})
# The tracks of each dwell: one begins with the first, one with the second, and the first ends.
ROSTERS = (NONE, ONE, TWO, LATER)


def _dwell(k: int) -> list[Message]:
    here, later = ROSTERS[k], ROSTERS[min(k + 1, len(ROSTERS) - 1)]
    plans = [plan(k, m, status="tracking" if m in later.ids else "ended") for m in here.ids.tolist()]
    return [scan(k, here), truth(k, {0: HERE}), *plans, waveform(k, later)]


def _all() -> list[Message]:
    return [message for k in range(len(ROSTERS)) for message in _dwell(k)]


def _recorder(messages: Sequence[Message] = (), start: RunStart | None = None) -> tuple[RecorderCore, Journal]:
    journal = Journal(":memory:")
    core = RecorderCore(journal)
    core.handle(start or start_of(len(ROSTERS)))
    for message in messages:
        core.handle(message)
    return core, journal


def _complete(core: RecorderCore, journal: Journal) -> int:
    for _ in range(2):
        core.handle(Tick(0.0))
    (run,) = journal.read("SELECT acknowledged_k AS k FROM run")
    return int(run["k"])


def test_a_run_is_complete_with_the_plans_of_the_tracks_there_are() -> None:
    journal = _recorder([*_all(), end(len(ROSTERS))])[1]
    (run,) = journal.read("SELECT * FROM run")
    assert (run["status"], run["acknowledged_k"], run["acknowledged_t"]) == ("complete", 4, 4)
    assert (run["n_track"], run["n_target"], run["acquisition_scans"]) == (None, 2, 0)
    said = [m for k in range(4) for m in sorted(_dwell(k), key=_topic) if not isinstance(m, Truth)]
    assert run["digest"] == digest(said)


def _topic(message: Message) -> str:
    return type(message).__name__


def test_the_messages_of_a_dwell_may_come_in_any_order() -> None:
    """Plans before the scan that says whose are needed; the dwell is complete with the last of the five."""
    before = [*_dwell(0), *_dwell(1)]
    for order in list(permutations(_dwell(2)))[::7]:
        core, journal = _recorder([*before, *order[:-1]])
        assert _complete(core, journal) == 2
        core.handle(order[-1])
        assert _complete(core, journal) == 3


def test_a_plan_of_another_track_does_not_stand_for_one_that_is_missing() -> None:
    core, journal = _recorder([*_dwell(0), scan(1, ONE), truth(1, {0: HERE}), plan(1, 1), waveform(1, TWO)])
    assert _complete(core, journal) == 1
    core.handle(plan(1, 0))
    assert _complete(core, journal) == 2


def test_a_recorder_that_comes_back_knows_whose_plans_it_waits_for() -> None:
    core, journal = _recorder([*_dwell(0), *_dwell(1), *_dwell(2)[:-1]])
    journal.commit()
    core = RecorderCore(journal, resume=True)
    assert _complete(core, journal) == 2
    for message in [_dwell(2)[-1], *_dwell(3), end(4)]:
        core.handle(message)
    assert journal.read("SELECT digest, status FROM run") == _recorder([*_all(), end(4)])[1].read(
        "SELECT digest, status FROM run"
    )


def test_in_real_time_the_clock_goes_on_without_the_first_scan() -> None:
    messages: list[Message] = [*_dwell(1), *_dwell(2), *_dwell(3), end(4)]
    core, journal = _recorder(messages, start_of(4, rate_hz=10.0))
    for _ in range(20):
        core.handle(Tick(0.0))
    assert journal.read("SELECT acknowledged_t AS t, acquisition_scans AS n, status FROM run") == [
        {"t": 4, "n": 0, "status": "complete"}
    ]


def test_a_track_is_recalled_from_the_scan_after_the_one_that_it_began_with() -> None:
    core, _ = _recorder(_all())
    (history,) = core.handle(ScanRecall(run="r", k=2, targets=[1], planner="p"))
    assert isinstance(history, History)
    assert history.payloads == [encode(message) for message in _all() if isinstance(message, Scan) and message.k >= 2]


def test_of_tracks_that_have_ended_no_snapshot_is_kept() -> None:
    """One begins with each dwell and lives for two; also those that come late, after the end."""
    n, most, late = 60, 0, list[Message]()
    model = TrackerModel.of(UNKNOWN.radar, Strategy.POWER_AWARE, 1)
    state = born(model, 0, 0, roster({0: HERE}, born=[0]).births[0])
    core, journal = _recorder(start=start_of(n))
    rosters = [roster(dict.fromkeys(range(max(k - 2, 0), k), HERE)) for k in range(n + 1)]
    for k, (here, later) in enumerate(pairwise(rosters)):
        plans = [plan(k, m, status="tracking" if m in later.ids else "ended") for m in here.ids.tolist()]
        for message in [scan(k, here), truth(k, {0: HERE}), *plans, waveform(k, later), *late]:
            core.handle(message)
        assert _complete(core, journal) == k + 1
        found = {row["target"] - 1 for row in journal.read("SELECT target FROM snapshot")}
        assert found <= set(here.ids.tolist())
        most = max(most, len(found))
        late = [snapshot_of("r", state._replace(target=m, k=k)) for m in here.ids.tolist()]
    assert most == 1  # the one that goes on


REFUSED: dict[str, tuple[Message, str]] = {
    "more tracks may not have begun": (plan(2, 10), "track 10 in dwell 2, there can be 10"),
    "none has begun": (plan(0, 0), "track 0 in dwell 0, there can be 0"),
    "a known number": (scan(2, TWO).model_copy(update={"roster": None}), r"without roster: .*tracks = unknown"),
    "too many": (waveform(2, roster(dict.fromkeys(range(6), HERE))), "beams of 6 tracks, at most 5 exist"),
    "too long": (scan(4, LATER), "dwell 4 of a run that ends by 3"),
    "more targets": (
        truth(2, {}).model_copy(update={"bins": np.full(3, -1, np.int32), "states": np.zeros((3, 4))}),
        "truth of 3 targets",
    ),
}


@pytest.mark.parametrize(("message", "words"), REFUSED.values(), ids=REFUSED.keys())
def test_what_cannot_be_is_refused(message: Message, words: str) -> None:
    core, _ = _recorder()
    with pytest.raises(Refused, match=words):
        core.handle(message)


def test_a_known_number_has_no_roster() -> None:
    with pytest.raises(Refused, match=r"with directions: .*tracks = 2"):
        _recorder([scan(2, TWO)], smoke_start(dwells=4))


def test_its_checkpoint_is_that_of_any_run() -> None:
    core = RecorderCore(Journal(":memory:"))
    first = [answer for answer in core.handle(start_of(4)) if isinstance(answer, Checkpoint)]
    assert [(answer.k, answer.t, answer.radar["tracks"]) for answer in first] == 2 * [(0, 0, "unknown")]
