"""In real time: with what a track began is said until somebody plans for it, since a waveform may never be radiated."""

from collections.abc import Sequence

from services.allocator.told import Told
from shared.protocol.roster import Roster
from tests.services.births import FAR, HERE, THERE, roster, waveform

PLACES = dict(enumerate((HERE, THERE, FAR)))


def _tracks(ids: Sequence[int], born: Sequence[int] = ()) -> Roster:
    return roster({m: PLACES[m] for m in ids}, born=born)


def _said(told: Told, k: int, ids: Sequence[int], born: Sequence[int] = ()) -> list[float]:
    """Directions of the births that a waveform ends up with."""
    sent = told.repeated(waveform(k, _tracks(ids, born)))
    assert sent.roster is not None
    assert sent.roster == told.roster
    return [float(nu) for nu in sent.roster.births[:, 0]]


def test_a_birth_is_said_until_a_plan_has_come_and_so_are_those_after_it() -> None:
    told, (here, there, far) = Told(), _tracks([0, 1, 2], [0, 1, 2]).births[:, 0].tolist()
    assert _said(told, 0, [0], [0]) == [here]
    assert _said(told, 1, [0, 1], [1]) == [here, there]
    told.planned.add(1)
    assert _said(told, 2, [0, 1, 2], [2]) == [here, there, far]  # a roster has those of its last tracks
    told.planned.add(0)
    assert _said(told, 3, [0, 1, 2]) == [far]
    told.planned.add(2)
    assert _said(told, 4, [0, 1, 2]) == []


def test_what_has_ended_is_said_no_more() -> None:
    told, (here, there) = Told(), _tracks([0, 1], [0, 1]).births[:, 0].tolist()
    assert _said(told, 0, [0, 1], [0, 1]) == [here, there]
    told.planned |= {0, 7}
    assert _said(told, 1, [1]) == [there]
    assert told.planned == set()


def test_an_allocator_that_comes_back_repeats_what_the_scan_says_of_births() -> None:
    told, first = Told(), _tracks([0, 1], [1])
    assert told.goes_on_from(first, 3, 5).next_id == 15
    assert _said(told, 3, [0, 1]) == first.births[:, 0].tolist()
    assert told.goes_on_from(first, 4, 5) == told.roster
    assert told.goes_on_from(first, 6, 5).next_id == 30  # a dwell was missed
