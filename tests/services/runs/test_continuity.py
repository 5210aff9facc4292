"""Tracks of a run in real time: which a process ended, and how long one was without a plan."""

from collections.abc import Callable, Iterator
from contextlib import closing

import pytest

from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.tables import MEMORY
from cogradar.services.runs.chaos import RealTimeTrial, all_together, timeline
from cogradar.services.runs.continuity import Continuity, Span, continuity
from cogradar.shared.protocol.messages import Message, Plan, RunStart, Scan
from cogradar.shared.protocol.topics import BY_MESSAGE
from cogradar.shared.wire.codec import encode
from tests.services.web.unknown_run import sent

RATE_HZ = 2.0


@pytest.fixture
def journal() -> Iterator[Journal]:
    with closing(Journal(MEMORY)) as found:
        yield found


def _of(journal: Journal, is_lost: Callable[[Message], bool] = lambda _: False, doubted_k: int = -1) -> Continuity:
    """Of the run by hand at two dwells a second, without the messages that are lost; from a dwell on its third track is
    tentative again.
    """
    start, *messages = sent()
    assert isinstance(start, RunStart)
    start = start.model_copy(update={"rate_hz": RATE_HZ})
    journal.add_run(start)
    for message in messages:
        if isinstance(message, Scan) and message.roster is not None and message.k >= doubted_k >= 0:
            message.roster.confirmed[message.roster.ids == 2] = False
        if isinstance(message, Plan | Scan) and not is_lost(message):
            item = message.target + 1 if isinstance(message, Plan) else 0
            journal.add_message(start.run, message.k, BY_MESSAGE[type(message)].name, item, encode(message))
    return continuity(journal, start, 0.9)


def test_a_track_that_its_planner_ends_is_no_loss(journal: Journal) -> None:
    spans = (Span("track", 1, 3, 11), Span("track", 3, 8, 9))
    assert _of(journal) == Continuity(2, ended=0, longest_coast_s=0.0, lost_dwells=0, completeness=0.9, spans=spans)


def test_one_that_goes_without_a_word_is(journal: Journal) -> None:
    """The third track flies away with dwell 9, and here the plan that says so is never made."""
    found = _of(journal, lambda message: isinstance(message, Plan) and message.target == 2 and message.k == 9)
    assert (found.tracks, found.ended) == (2, 1)


def test_a_track_that_is_doubted_before_its_planner_ends_it_is_no_loss(journal: Journal) -> None:
    """A target left the field of view: four dwells later its belief ended the track."""
    assert _of(journal, doubted_k=9).ended == 0


def test_one_that_is_doubted_and_goes_without_a_word_is(journal: Journal) -> None:
    gone = _of(journal, lambda message: isinstance(message, Plan) and (message.target, message.k) == (2, 9), 9)
    assert gone.ended == 1


def test_the_longest_time_without_a_plan(journal: Journal) -> None:
    away = _of(journal, lambda message: isinstance(message, Plan) and message.target == 0 and 4 <= message.k <= 7)
    assert (away.ended, away.longest_coast_s, away.lost_dwells) == (0, 4 / RATE_HZ, 0)
    assert [span for span in away.spans if span.what != "track"] == [Span("coast", 1, 4, 7)]


def test_a_track_that_has_no_plan_to_the_end_has_coasted(journal: Journal) -> None:
    away = _of(journal, lambda message: isinstance(message, Plan) and message.target == 0 and message.k >= 9)
    assert (away.ended, away.longest_coast_s) == (0, 3 / RATE_HZ)
    assert [span for span in away.spans if span.what != "track"] == [Span("coast", 1, 9, 11)]


def test_dwells_that_never_happened_are_time_too(journal: Journal) -> None:
    away = _of(journal, lambda message: getattr(message, "k", 0) in {5, 6})
    assert (away.ended, away.lost_dwells, away.longest_coast_s) == (0, 2, 2 / RATE_HZ)
    assert [span for span in away.spans if span.what == "missed"] == [Span("missed", None, 5, 6)]


def test_all_runs_together_are_told_in_a_line_by_role() -> None:
    victims = ["planner-0", "planner-1", "router-0"]
    first = RealTimeTrial(1, victims, [3.5, 4.0, 9.0], Continuity(7, 0, 1.5, 0, None), None)
    second = RealTimeTrial(2, ["recorder-0"], [7.0], Continuity(5, 1, 11.25, 3, 0.9, (Span("coast", 4, 8, 30),)), None)
    assert all_together([first, second]) == (
        "2 runs, 4 processes killed (2 planner, 1 recorder, 1 router); 1 of 12 confirmed tracks ended by a process,"
        " longest time without a plan 11.2 s"
    )
    assert list(timeline([first, second])) == [
        (1, "killed", "planner-0", 3.5, 3.5),
        (1, "killed", "planner-1", 4.0, 4.0),
        (1, "killed", "router-0", 9.0, 9.0),
        (2, "killed", "recorder-0", 7.0, 7.0),
        (2, "coast", "4", 8, 30),
    ]
