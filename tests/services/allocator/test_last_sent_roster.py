"""In real time: with what a track began is said until somebody plans for it, since a waveform may never be radiated."""

from collections.abc import Sequence

from cogradar.services.allocator.last_sent_roster import LastSentRoster
from cogradar.shared.protocol.roster import Roster
from tests.services.births import FAR, HERE, THERE, roster, waveform

PLACES = dict(enumerate((HERE, THERE, FAR)))


def _tracks(ids: Sequence[int], born: Sequence[int] = ()) -> Roster:
    return roster({m: PLACES[m] for m in ids}, born=born)


def _said(last_sent: LastSentRoster, k: int, ids: Sequence[int], born: Sequence[int] = ()) -> list[float]:
    """Directions of the births that a waveform ends up with."""
    sent = last_sent.repeated(waveform(k, _tracks(ids, born)))
    assert sent.roster is not None
    assert sent.roster == last_sent.roster
    return [float(nu) for nu in sent.roster.births[:, 0]]


def test_a_birth_is_said_until_a_plan_has_come_and_so_are_those_after_it() -> None:
    last_sent, (here, there, far) = LastSentRoster(), _tracks([0, 1, 2], [0, 1, 2]).births[:, 0].tolist()
    assert _said(last_sent, 0, [0], [0]) == [here]
    assert _said(last_sent, 1, [0, 1], [1]) == [here, there]
    last_sent.planned.add(1)
    assert _said(last_sent, 2, [0, 1, 2], [2]) == [here, there, far]  # a roster has those of its last tracks
    last_sent.planned.add(0)
    assert _said(last_sent, 3, [0, 1, 2]) == [far]
    last_sent.planned.add(2)
    assert _said(last_sent, 4, [0, 1, 2]) == []


def test_what_has_ended_is_said_no_more() -> None:
    last_sent, (here, there) = LastSentRoster(), _tracks([0, 1], [0, 1]).births[:, 0].tolist()
    assert _said(last_sent, 0, [0, 1], [0, 1]) == [here, there]
    last_sent.planned |= {0, 7}
    assert _said(last_sent, 1, [1]) == [there]
    assert last_sent.planned == set()


def test_an_allocator_that_comes_back_repeats_what_the_scan_says_of_births() -> None:
    last_sent, first = LastSentRoster(), _tracks([0, 1], [1])
    assert last_sent.continued(first, 3) == first
    assert _said(last_sent, 3, [0, 1]) == first.births[:, 0].tolist()
    assert last_sent.continued(last_sent.roster, 4) == last_sent.roster


def test_an_allocator_that_comes_back_begins_no_track_before_a_scan_carries_its_roster() -> None:
    """Until then one of its predecessor may be radiated, with tracks that it does not know: their ids are used."""
    last_sent, old = LastSentRoster(), _tracks([0])
    last_sent.continued(old, 30)
    followed = [last_sent.is_followed]
    own = last_sent.repeated(waveform(30, old.model_copy(update={"next_search": 2}))).roster
    assert own is not None
    late = _tracks([0, 1], [1]).model_copy(update={"next_search": 2})
    assert last_sent.continued(late, 31).next_id == 2
    followed.append(last_sent.is_followed)
    assert last_sent.continued(own, 32).next_id == 2  # the next number, and none that was used
    followed.append(last_sent.is_followed)
    assert followed == [False, False, True]
    assert last_sent.continued(own, 40).next_id == 2  # dwells were missed


def test_the_first_allocator_of_a_run_waits_for_nothing() -> None:
    last_sent = LastSentRoster()
    last_sent.continued(_tracks([]), 0)
    assert last_sent.is_followed
