"""Tracks that compete for detections: who has which, who is hidden, who is in doubt."""

from dataclasses import replace
from itertools import product
from math import log

import numpy as np
import pytest
from scipy.stats import norm

from cogradar.shared.signal.array import around
from cogradar.shared.signal.scan import Detections
from cogradar.shared.tracking.assignment.clusters import CLUTTER_DENSITY, P_D
from cogradar.shared.tracking.assignment.shares import Share, unclaimed
from cogradar.shared.tracking.assignment.solver import IN_DOUBT, assigned, is_in_doubt
from cogradar.shared.tracking.association import associate
from cogradar.shared.tracking.belief.likelihood import Looks
from cogradar.shared.tracking.existence import MOST_P_D, hit_ratio, miss_ratio, p_fa_of
from cogradar.shared.tracking.model import TrackState
from cogradar.shared.tracking.track import observe
from tests.shared.tracking.contested import (
    BEST_RANGE,
    EXISTENCE,
    IMPOSSIBLE,
    LIMIT,
    LOBE,
    NU_SIGMA,
    UNKNOWN,
    Floats,
    begun,
    scan_of,
    shares,
)


@pytest.mark.parametrize("end", [-0.5, 0.5])
def test_a_track_near_an_end_has_what_a_look_at_the_other_end_finds(end: float) -> None:
    """Both ends are one direction of the array. It was left over, so that a second track began on the same aircraft."""
    scan = scan_of([(end, 0.997 * end, 50.25)], [(-0.995 * end, 50.25)])
    assert [share.row for share in shares(scan)] == [0]
    assert unclaimed(LOBE, scan).tolist() == []
    elsewhere = scan_of([(0.8 * end, 0.8 * end, 50.25)], [(-0.995 * end, 50.25)])
    assert [share.row for share in shares(elsewhere)] == [-1]


@pytest.mark.parametrize("n_track", [1, 2])
def test_a_track_that_turned_keeps_its_echo_though_a_look_of_the_search_beside_had_more_of_it(n_track: int) -> None:
    """Its own look had the echo, too. It was left over: a second track began on the aircraft, and its own one ended."""
    expected = [(0.1, 50.25), (0.13, 52.25)][:n_track]
    scan = scan_of([(0.1, 0.115, 50.25), (0.12, 0.116, 50.25)], expected, sigmas=(0.0005, 0.1))
    assert shares(scan)[0].row == 1
    assert unclaimed(LOBE, scan).tolist() == []
    not_met = scan_of([(0.12, 0.116, 50.25)], expected, sigmas=(0.0005, 0.1), missed=(0.1,))
    assert shares(not_met)[0].row == -1
    assert unclaimed(LOBE, not_met).tolist() == [1]


def best_and_second(scores: Floats, own: int) -> tuple[tuple[int, ...], float]:
    """Of all assignments the best, and how much better it is than the best with another detection for this track."""
    m, n = scores.shape
    gains: dict[tuple[int, ...], float] = {}
    for taken in product(range(-1, n), repeat=m):
        used = [j for j in taken if j >= 0]
        if len(set(used)) == len(used):
            gains[taken] = sum(float(scores[i, j]) for i, j in enumerate(taken) if j >= 0)
    best = max(gains, key=lambda taken: gains[taken])
    return best, gains[best] - max((gain for taken, gain in gains.items() if taken[own] != best[own]), default=-np.inf)


@pytest.mark.parametrize("seed", range(8))
def test_the_assignment_is_the_best_of_all_and_in_doubt_where_the_next_is_near(seed: int) -> None:
    rng = np.random.default_rng(seed)
    doubts, together = set[bool](), set[int]()
    for _ in range(20):
        m, n = rng.integers(2, 5), rng.integers(1, 5)
        scores = rng.normal(3.0, 4.0, (m, n))
        scores[scores < 0.0] = IMPOSSIBLE
        for own in range(m):
            best, ahead = best_and_second(scores, own)
            taken, parts = assigned(scores)
            assert (tuple(taken.tolist()), is_in_doubt(scores, taken, parts, own)) == (best, ahead < IN_DOUBT)
            together.add(np.unique(parts).size)
            doubts.add(ahead < IN_DOUBT)
    assert doubts == {False, True}
    assert {1, 2} <= together


def log_odds(nu: float, range_km: float, echo: tuple[float, float, float], sigmas: tuple[float, float]) -> float:
    """Of one pair, by the densities themselves."""
    in_nu = norm.pdf(echo[1], nu, np.hypot(sigmas[0], NU_SIGMA)) * 2.0 / 16
    in_cell = norm.cdf(echo[2] + 0.25, range_km, sigmas[1]) - norm.cdf(echo[2] - 0.25, range_km, sigmas[1])
    found = P_D * EXISTENCE
    return log(max(in_nu * in_cell / CLUTTER_DENSITY, 1e-300)) + log(found / (1.0 - found))


@pytest.mark.parametrize("seed", range(5))
def test_every_owner_finds_the_same_assignment_and_it_is_the_best(seed: int) -> None:
    """Tracks and detections in a heap, none of them in one cell: by enumeration of all pairs of densities."""
    rng, sigmas = np.random.default_rng(seed), (0.004, 0.5)
    tracks = [(0.01 * float(rng.normal()), 50.0 + float(rng.normal())) for _ in range(4)]
    echoes = [(0.0, 0.01 * float(rng.normal()), 48.25 + 1.0 * i) for i in rng.permutation(5)[:4].tolist()]
    scan = scan_of(echoes, tracks, sigmas)
    scan = scan._replace(beams=np.full((4, 1), -1, np.int32))  # nobody has a look of its own
    scores = np.array([[log_odds(*track, echo, sigmas) for echo in sorted(echoes)] for track in tracks])
    scores[scores < 0.0] = IMPOSSIBLE
    best, _ = best_and_second(scores, 0)
    assert [share.row for share in shares(scan)] == list(best)
    assert max(best) >= 0


def test_the_farther_one_of_two_in_a_direction_is_missed_and_not_captured() -> None:
    """4 km apart in range, in each other's gates; one echo fades."""
    scan = scan_of([(0.1, 0.1, 50.25)], [(0.1, 50.2), (0.1, 53.9)])
    assert shares(scan) == [Share(0), Share(-1)]
    looks = told(scan, 1)
    assert not looks.is_hit
    assert looks.nus.tolist() == [0.1]  # a miss: the other echo is in another range cell


def test_of_two_in_one_cell_one_has_the_detection_and_the_other_is_hidden() -> None:
    scan = scan_of([(0.1, 0.104, 50.25)], [(0.1, 50.2), (0.11, 50.3)])
    one, other = shares(scan)
    assert (one.row, one.is_hidden, other.row, other.is_hidden, other.in_doubt) == (0, False, -1, True, True)
    assert 0.005 < one.drawn < 0.01  # the distance of the two, seen nearly on axis
    looks = told(scan, 0)
    assert looks.nu_sigma == pytest.approx(np.hypot(NU_SIGMA, one.drawn))
    assert told(scan, 1).nus.size == 0
    alone = scan_of([(0.1, 0.104, 50.25)], [(0.1, 50.2)])
    assert shares(alone) == [Share(0)]


@pytest.mark.parametrize("range_km", [50.3, 53.9])
def test_the_same_across_the_ends_of_the_field(range_km: float) -> None:
    """A neighbour at the other end was a field away: it hid nothing, and drew directions aside without end."""
    found = list[list[Share]]()
    for turn in (0.0, 0.394, 0.399, -0.604):
        looked, measured, own, other = around(np.array([0.1, 0.104, 0.1, 0.11]) + turn).tolist()
        found.append(shares(scan_of([(looked, measured, 50.25)], [(own, 50.2), (other, range_km)])))
        doubtful = scan_of([(looked, float(around(0.16 + turn)), 50.25)], [(own, 50.2), (other, range_km)])
        found[-1] += shares(doubtful)
    for across in found[1:]:
        for one, inside in zip(across, found[0], strict=True):
            assert one == pytest.approx(inside, abs=1e-12)


def test_what_hides_is_the_range_cell() -> None:
    """Without range cells all echoes of a direction add."""
    scan = scan_of([(0.1, 0.1, 0.0)], [(0.1, 50.2), (0.1, 80.0)])
    one, other = shares(scan, replace(LOBE, range_cell_km=np.inf))
    assert {one.row, other.row} == {-1, 0}
    assert one.is_hidden != other.is_hidden


def test_detections_in_neighbouring_cells_are_one_echo_unless_another_track_is_there() -> None:
    echoes = [(0.1, 0.1, 50.25), (0.1, 0.1, 50.75), (0.15, 0.101, 50.75)]
    assert shares(scan_of(echoes, [(0.1, 50.9), (0.3, 50.9)])) == [Share(2), Share(-1)]
    both = shares(scan_of(echoes, [(0.1, 50.25), (0.1, 50.9)]))
    assert [share.row for share in both] == [0, 2]


def test_a_track_that_has_turned_keeps_a_detection_in_its_own_look_that_nobody_explains() -> None:
    turned = scan_of([(0.1, 0.1, 50.25), (0.15, 0.18, 54.75)], [(0.1, 50.2), (0.15, 53.3)])
    assert [share.row for share in shares(turned)] == [0, 1]
    fits_another = scan_of([(0.15, 0.1, 50.25)], [(0.1, 50.2), (0.15, 50.3)])
    assert [share.row for share in shares(fits_another)] == [0, -1]


def test_a_detection_that_does_not_fit_is_no_turn_while_another_track_is_beside() -> None:
    """Two echoes that add may be in any direction: it coasts."""
    one, _ = shares(scan_of([(0.1, 0.16, 50.25)], [(0.1, 50.2), (0.12, 50.4)]))
    assert (one.row, one.is_hidden, one.in_doubt) == (-1, True, True)
    one, _ = shares(scan_of([(0.1, 0.16, 50.25)], [(0.1, 50.2), (0.12, 53.4)]))
    assert one.row == 0


def test_a_detection_of_the_search_serves_a_track_that_is_not_lit() -> None:
    scan = scan_of([(0.12, 0.1, 50.25)], [(0.1, 50.2), (-0.3, 50.2)])
    scan = scan._replace(beams=np.full((2, 1), -1, np.int32))
    assert shares(scan) == [Share(0), Share(-1)]
    first, other = (observe(BEST_RANGE, begun(target, (nu, 0.0)), scan) for target, nu in ((0, 0.1), (1, -0.3)))
    assert (first.detected, other.detected) == (True, False)
    assert other.looked[:, 3:].sum() == 0.0  # it was not missed either


def test_looks_of_an_older_waveform_are_judged_by_where_the_belief_expects_the_target() -> None:
    """Their roster expects the track elsewhere: there a miss is none, and an echo is not its own."""
    certain = tentative()._replace(existence=0.99, confirmed=True)
    there, elsewhere = scan_of([(0.1, 0.1, 50.25)], [(0.1, 50.2)]), scan_of([(0.3, 0.3, 50.25)], [(0.3, 50.2)])
    missed = scan_of([], [(0.3, 50.2)], missed=[0.3])
    for state in (tentative(), certain):
        assert observe(UNKNOWN, state, there._replace(waveform_k=-1)).detected
        for scan in (elsewhere, missed):
            stale = observe(UNKNOWN, state, scan._replace(waveform_k=-1))
            assert not stale.detected
            assert stale.existence > 0.99 * state.existence
            fresh = observe(UNKNOWN, state, scan)
            assert fresh.detected or odds(fresh) < 0.75 * odds(state)
    own = observe(UNKNOWN, tentative(), scan_of([], [(0.1, 50.2)], missed=[0.1])._replace(waveform_k=-1))
    assert odds(own) < 0.75 * odds(tentative())  # it was aimed well all the same


def test_an_older_roster_that_still_is_right_tells_whose_a_detection_is() -> None:
    """Each by its own belief would take it: two tracks would follow one target, until the younger one ended."""
    states = [begun(target, (nu, 0.0)) for target, nu in ((0, 0.1), (1, 0.11))]
    for flown, n_hit in ((0.01, 1), (0.1, 2)):
        scan = scan_of([(0.1, 0.104, 50.25)], [(0.1 + flown, 50.2), (0.11 + flown, 50.2)])
        stale = [associate(BEST_RANGE, state, scan._replace(waveform_k=-1)) for state in states]
        assert [one.looks.is_hit for one in stale].count(True) == n_hit


def test_a_detection_says_more_of_a_target_the_rarer_noise_makes_it_and_a_miss_less_where_another_hides_it() -> None:
    """By the limit and the statistic, in as many range cells as the gate of each look has."""
    n_cell = 2 * 9  # gate: 46 .. 55 km
    hit, missed, both = (
        scan_of([(0.1, 0.1, 50.25)], [(0.1, 50.2)]),
        scan_of([], [(0.1, 50.2)], missed=[0.1]),
        scan_of([(0.1, 0.11, 50.25)], [(0.1, 50.2), (0.11, 50.3)]),
    )
    p_fa, u = p_fa_of(LIMIT, n_cell), p_fa_of(200.0, n_cell)
    after = observe(UNKNOWN, tentative(), hit)
    assert after.detected
    assert after.confirmed
    assert hit_ratio(p_fa, u) > hit_ratio(p_fa, p_fa) > 10.0
    weak = observe(UNKNOWN, tentative(), hit._replace(statistic=np.full(1, LIMIT)))
    survived = 0.1 * np.exp(-1.0 / 600.0)
    assert odds(weak) == pytest.approx(survived / (1.0 - survived) * hit_ratio(p_fa, p_fa), rel=1e-6)
    assert odds(observe(UNKNOWN, tentative(), missed)) < 0.5 * odds(tentative())
    hidden = observe(UNKNOWN, tentative(), both)
    assert not hidden.detected
    assert odds(hidden) > 0.9 * odds(tentative())
    assert miss_ratio(1.0 - MOST_P_D, 0.9) == pytest.approx(0.91)


def odds(state: TrackState) -> float:
    return state.existence / (1.0 - state.existence)


@pytest.mark.parametrize("seed", range(10))
def test_each_detection_is_of_one_track_or_a_birth_or_heard_beside(seed: int) -> None:
    """What owners take by themselves, and what the allocator takes for new, never overlap."""
    rng = np.random.default_rng(seed)
    for _ in range(20):
        tracks = [(float(rng.uniform(-0.1, 0.1)), float(rng.uniform(48.0, 53.0))) for _ in range(rng.integers(1, 6))]
        at = [(nu, nu + 0.004 * float(rng.normal()), np.floor(2.0 * r) / 2.0 + 0.25) for nu, r in tracks]
        more = rng.uniform((-0.2, 46.0), (0.2, 55.0), (3, 2)).tolist()
        scan = scan_of(at + [(nu, nu, float(np.floor(2.0 * r) / 2.0 + 0.25)) for nu, r in more], tracks)
        taken = [share.row for share in shares(scan) if share.row >= 0]
        found = unclaimed(LOBE, scan).tolist()
        assert len(set(taken)) == len(taken)
        assert not set(taken) & set(found)


def test_a_leak_into_the_look_of_a_track_is_neither_its_detection_nor_a_reason_against_a_birth() -> None:
    """A strong echo beside: it is in the track's own look, too, far off the axis."""
    scan = scan_of([(0.1, 0.15, 50.25), (0.15, 0.15, 50.25)], [(0.1, 50.2)])
    scan = scan._replace(statistic=np.array([100.0, 900.0]), alpha_hat=np.array([0.35, 1.0], np.complex64))
    (share,) = shares(scan)
    assert (share.row, share.is_hidden) == (-1, False)
    assert unclaimed(LOBE, scan).tolist() == [1]


def test_a_track_keeps_its_own_range_cell_beside_a_stronger_echo() -> None:
    scan = scan_of([(0.1, 0.1, 50.25), (0.1, 0.1, 50.75)], [(0.1, 50.2)])
    assert shares(scan)[0].row == 0
    assert unclaimed(LOBE, scan).tolist() == [1]


def test_a_detection_too_far_off_is_of_no_track() -> None:
    scan = scan_of([(0.1, 0.1, 54.75)], [(0.1, 50.2)], sigmas=(0.002, 1.0))._replace(
        beams=np.full((1, 1), -1, np.int32)
    )
    assert shares(scan)[0].row == -1
    assert unclaimed(LOBE, scan).tolist() == [0]


def test_a_second_aircraft_is_born_one_lobe_or_one_range_cell_beside_a_track_if_it_has_a_detection() -> None:
    track = [(0.1, 50.2)]
    for second in ((0.1 + 1.1 * LOBE.lobe, 50.25), (0.1, 50.75)):
        scan = scan_of([(0.1, 0.1, 50.25), (second[0], second[0], second[1])], track)
        found = unclaimed(LOBE, scan)
        assert [(scan.nus[row], scan.ranges_km[row]) for row in found] == [second]
    leak = scan_of([(0.1, 0.1, 50.25), (0.1 + 0.8 * LOBE.lobe, 0.101, 50.25)], track)
    assert unclaimed(LOBE, leak).size == 0  # the same direction, measured again by the look beside


def test_a_target_between_two_range_cells_is_met_in_either_and_is_no_second_one() -> None:
    """Another look has its echo in the next range cell; one that reports both cells has two targets."""
    beside, track = 0.1 + 0.3 * LOBE.lobe, [(0.1, 50.4)]
    once = [(0.1, 0.1, 50.25), (beside, 0.1002, 50.75)]
    assert unclaimed(LOBE, scan_of(once, track)).size == 0
    scan = scan_of([*once, (beside, 0.1001, 50.25)], track)
    assert scan.ranges_km[unclaimed(LOBE, scan)].tolist() == [50.75]
    for off in (0.45, 0.8):  # another direction in the next range cell is another target
        look = (0.1 + 0.95 * LOBE.lobe, 0.1 + off * LOBE.lobe, 50.75)
        assert unclaimed(LOBE, scan_of([once[0], look], track)).size == 1


def test_between_two_tracks_no_third_begins_from_an_echo_that_both_may_add_to() -> None:
    unlit = np.full((2, 1), -1, np.int32)  # the look is of the search
    pair = scan_of([(0.12, 0.125, 50.25)], [(0.1, 50.2), (0.14, 50.3)])
    apart = scan_of([(0.12, 0.125, 50.25)], [(0.1, 50.2), (0.14, 55.3)])
    assert [unclaimed(LOBE, scan._replace(beams=unlit)).tolist() for scan in (pair, apart)] == [[], [0]]


def test_a_track_that_hardly_exists_or_may_be_anywhere_explains_no_detection() -> None:
    scan = scan_of([(0.1, 0.1, 50.25)], [(0.11, 50.2)])
    scan = scan._replace(beams=np.full((1, 1), -1, np.int32))  # of the search
    expected = np.asarray(scan.expected)
    vague = np.array([[0.11, 0.3, 50.2, 20.0, 0.02]])
    unlikely = expected.copy()
    unlikely[:, 4] = 1e-6
    born = [unclaimed(LOBE, scan._replace(expected=one)).tolist() for one in (expected, vague, unlikely)]
    assert born == [[], [0], [0]]


def test_without_a_track_each_echo_is_born_once_the_strongest_first() -> None:
    beside = LOBE.lobe
    scan = scan_of([(0.1, 0.101, 50.25), (0.1 + 0.5 * beside, 0.1012, 50.25), (0.3, 0.3, 40.25)], [(0.0, 90.0)])
    scan = scan._replace(statistic=np.array([300.0, 200.0, 900.0]))
    assert unclaimed(LOBE, scan).tolist() == [2, 0]


def tentative() -> TrackState:
    return begun(0, (0.1, 0.0))._replace(existence=0.1, confirmed=False)


def told(scan: Detections, target: int) -> Looks:
    return associate(BEST_RANGE, begun(target, (0.1, 0.0)), scan).looks
