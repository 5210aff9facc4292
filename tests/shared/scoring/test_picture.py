"""Identities over dwells: what is a swap, a break, a false track, and what is nobody's fault."""

from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cogradar.shared.scoring import picture
from cogradar.shared.scoring.figures import LONG_VISIBLE, Discovery, Figures, Totals
from cogradar.shared.scoring.picture import AirPicture, Objects
from tests.oracles.sets import set_distance

Places = Mapping[int, tuple[float, float]]  # (x, y) in km by id
FAR = (100.0, 100.0)


def _objects(places: Places) -> Objects:
    states = np.array([[x, 0.0, y, 0.0] for x, y in places.values()]).reshape(-1, 4)
    return Objects(list(places), states)


def _totals(dwells: Sequence[tuple[Places, Places]], counting: Sequence[int] | None = None) -> Totals:
    """Sums over dwells of tracks and targets, of which these count; None: all."""
    picture, found = AirPicture(), []
    for t, (tracks, targets) in enumerate(dwells, 1):
        counts = [counting is None or target in counting for target in targets]
        found.append(picture.advance(t, _objects(tracks), _objects(targets), counts)[0])
    return Totals(*map(sum, zip(*found, strict=True)))


def test_two_tracks_exchanged_for_good_are_two_swaps() -> None:
    here, there = (50.0, 0.0), (53.0, 0.0)
    before, after = ({1: here, 2: there}, {1: here, 2: there}), ({1: there, 2: here}, {1: here, 2: there})
    assert _totals([*3 * [before], *3 * [after]]).swaps == 2
    assert _totals([*3 * [before], *2 * [after], *3 * [before]]).swaps == 0


def test_tracks_that_overlap_within_their_errors_are_not_exchanged_back_and_forth() -> None:
    targets = {1: (50.0, 0.0), 2: (50.0, 1.0)}
    one, other = {1: (50.5, 0.9), 2: (49.5, 0.1)}, {1: (50.5, 0.1), 2: (49.5, 0.9)}
    total = _totals([(other, targets), (one, targets), (other, targets), (one, targets)])
    assert (total.swaps, total.breaks, total.stretches) == (0, 0, 2)


def test_a_track_that_goes_over_to_another_target_is_a_swap() -> None:
    near, far = (40.0, 0.0), (90.0, 0.0)
    targets = {1: near, 2: far}
    captured = _totals([*3 * [(targets, targets)], *3 * [({2: near}, targets)]])
    assert (captured.swaps, captured.breaks, captured.followed) == (1, 2, 9)


def test_a_track_that_was_replaced_does_not_come_back_by_being_a_little_nearer() -> None:
    target = {1: (50.0, 0.0)}
    old, new = (50.0, 1.0), (50.0, -1.5)
    total = _totals([*3 * [({1: old}, target)], *3 * [({1: FAR, 2: new}, target)], ({1: old, 2: new}, target)])
    assert (total.stretches, total.breaks, total.swaps) == (2, 1, 0)


def test_a_second_track_on_a_target_is_ambiguous_and_a_stranger_is_spurious() -> None:
    total = _totals(3 * [({1: (50.0, 0.0), 2: (51.0, 0.0), 3: FAR}, {1: (50.0, 0.0)})])
    figures = Figures.of(total, 1.0)
    assert (figures.completeness, figures.ambiguity, figures.spuriousness) == (1.0, 2.0, 1 / 3)
    assert (total.began, total.established, figures.false_tracks) == (3, 1, 2)
    assert figures.false_tracks_per_hour == 2400.0


@pytest.mark.parametrize(("near", "established"), [((1, 2, 4, 5, 7), 0), ((4, 5, 6), 1)])
def test_a_track_of_noise_that_passes_near_a_target_now_and_then_is_false(
    near: tuple[int, ...], established: int
) -> None:
    place = (50.0, 0.0)
    total = _totals([({7: place if t in near else FAR}, {1: place}) for t in range(1, 9)])
    assert (total.began, total.established, total.swaps) == (1, established, 0)


def test_dwells_on_two_targets_in_turn_do_not_add_up() -> None:
    one, other = (50.0, 0.0), (90.0, 0.0)
    total = _totals([({7: place}, {1: one, 2: other}) for place in (one, one, other, other)])
    assert (total.established, total.swaps) == (0, 0)


def test_only_targets_that_count_have_tracks() -> None:
    seen, unseen = (50.0, 0.0), (90.0, 0.0)
    targets = {1: seen, 2: unseen}
    dwells = [({7: place}, targets) for place in 4 * [unseen] + 4 * [seen] + 4 * [unseen]]
    total = _totals(dwells, counting=[1])
    assert (total.established, total.swaps, total.tracks) == (1, 0, 4)
    never = _totals(dwells[:4], counting=[1])
    assert (never.began, never.established) == (1, 0)


def test_waits_breaks_and_lives_of_a_target_that_comes_and_goes() -> None:
    """Followed from its third dwell, lost for two, found by a new track, followed until it leaves."""
    place = (30.0, 5.0)
    targets = [{}, *(10 * [{4: place}]), {}]
    followers = [None, None, None, 1, 1, 1, None, None, 9, 9, 9, None]
    dwells = [({} if track is None else {track: place}, there) for track, there in zip(followers, targets, strict=True)]
    total = _totals(dwells)
    assert (total.confirmed, total.confirmed_after, total.regained, total.regained_after) == (1, 2, 1, 2)
    assert (total.stretches, total.breaks, total.swaps, total.began, total.established) == (2, 1, 0, 2, 2)
    figures = Figures.of(total, 2.0)
    assert (figures.track_life_s, figures.confirmation_s, figures.reacquisition_s) == (6.0, 4.0, 4.0)
    assert (figures.completeness, figures.ambiguity, figures.spuriousness) == (0.6, 1.0, 0.0)
    assert figures.gospa_missed_km**2 == pytest.approx(4 * 12.5 / 12)
    assert (figures.gospa_localisation_km, figures.gospa_false_km) == (0.0, 0.0)


def test_targets_that_are_never_found_wait_for_ever() -> None:
    """(visible, confirmed, visible dwells, s of a dwell)."""
    found = [(1, 1 + wait, 30, 0.5) for wait in range(19)]
    assert Discovery.of(found) == (19, 19, 4.5, 9.0, 19, 0)
    never = [(5, None, LONG_VISIBLE, 0.5), (5, None, LONG_VISIBLE - 1, 0.5)]
    assert Discovery.of([*found, *never]) == (21, 19, 4.5, 9.0, 20, 1)  # 19 of 20 waits are known: 95 %
    assert Discovery.of([*found[:3], *(3 * never)]) == (9, 3, 1.0, None, 6, 3)
    assert Discovery.of([(9, 4, 2, 0.5)]) == (1, 1, 0.0, 0.0, 0, 0)  # found before it was visible
    assert Discovery.of([]) == (0, 0, None, None, 0, 0)


def test_a_target_that_does_not_count_is_left_out_with_its_track() -> None:
    seen, unseen = (50.0, 0.0), (180.0, 0.0)
    both = {1: seen, 2: unseen}
    total = _totals([({1: seen}, both), *3 * [(both, both)]], counting=[1])
    assert (total.targets, total.tracks, total.followed, total.missed_km2, total.false_km2) == (4, 4, 4, 0.0, 0.0)
    assert (total.confirmed, total.began, total.established) == (1, 2, 1)


def test_of_nothing_there_are_no_shares() -> None:
    figures = Figures.of(_totals([({}, {}), ({}, {})]), 1.0)
    shares = (figures.completeness, figures.ambiguity, figures.spuriousness, figures.track_life_s)
    assert shares == (None, None, None, None)
    assert (figures.gospa_km, figures.ospa_km, figures.false_tracks_per_hour) == (0.0, 0.0, 0.0)


def _reversed(places: Places) -> Places:
    return dict(reversed(list(places.items())))


ids = st.dictionaries(st.integers(1, 4), st.tuples(*(2 * [st.sampled_from([0.0, 1.5, 3.0, 6.0, 9.0])])), max_size=4)


@settings(max_examples=50)
@given(st.lists(st.tuples(ids, ids), min_size=1, max_size=6))
def test_the_order_of_rows_is_nothing_and_sums_are_consistent(dwells: list[tuple[Places, Places]]) -> None:
    total = _totals(dwells)
    distances = [set_distance(_objects(tracks).states, _objects(targets).states) for tracks, targets in dwells]
    assert total.localisation_km2 == pytest.approx(sum(found.localisation for found in distances))
    assert total.missed_km2 == 12.5 * (total.targets - total.followed) == sum(found.missed for found in distances)
    assert total.false_km2 == 12.5 * (total.tracks - total.followed) == sum(found.false for found in distances)
    assert total.ospa_km2 == pytest.approx(sum(found.ospa for found in distances))
    assert total.followed <= total.assigned <= total.tracks == sum(len(tracks) for tracks, _ in dwells)
    assert total.breaks <= total.stretches
    assert total.established <= total.began == len({track for tracks, _ in dwells for track in tracks})
    mirrored = _totals([(_reversed(tracks), _reversed(targets)) for tracks, targets in dwells])
    assert (mirrored.missed_km2, mirrored.false_km2) == (total.missed_km2, total.false_km2)
    assert mirrored.localisation_km2 == pytest.approx(total.localisation_km2)


def test_what_is_known_of_tracks_of_long_ago_is_forgotten_and_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each track follows the target for four dwells; one of old stays all the while."""
    near, far = (20.0, 0.0), (60.0, 0.0)
    dwells = [({0: near, 1 + t // 4: far}, {0: near, 1: far}) for t in range(200)]
    whole = _totals(dwells)
    monkeypatch.setattr(picture, "REMEMBERED", 8)
    assert _totals(dwells) == whole
    air = AirPicture()
    for t, (tracks, targets) in enumerate(dwells, 1):
        air.advance(t, _objects(tracks), _objects(targets), [True] * len(targets))
    assert max(len(air._known), len(air._target_of), len(air._whose)) <= 2 * 8 + 1
