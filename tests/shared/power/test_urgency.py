"""Urgency: the looks that tell most are bright, other tracks dark, but none for ever."""

import numpy as np
import pytest
from numpy.typing import NDArray

from cogradar.shared.power.curve import curve_of
from cogradar.shared.power.rules import Emission, Requests
from cogradar.shared.power.urgency import TURN, urgency
from cogradar.shared.scenario.files import load
from cogradar.shared.signal.array import angle_bin, bin_centres
from cogradar.shared.signal.receiver import threshold

RADAR = load("paper").radar
BRIGHT = curve_of(threshold(1e-4)).s_chord ** 2  # zeta of the most detections per power


def asked(
    bins: list[list[int]], chances: list[list[float]], gains: list[float], worths: list[float], k: int
) -> Requests:
    nus, far = bin_centres(100)[np.array(bins)], np.full(len(bins), 60.0)
    return Requests(nus, np.array(chances), far, np.array(gains), np.array(worths), k=k)


def lit_bins(sent: Emission) -> NDArray[np.int64]:
    """The cells lit for each track, (M, L); -1: none. All the power is spent on them."""
    is_lit = ~np.isnan(sent.nus)
    assert sent.shares.sum() == pytest.approx(RADAR.array.power, rel=1e-9)
    assert (is_lit == (sent.shares > 0.0)).all()
    return np.where(is_lit, angle_bin(np.nan_to_num(sent.nus), 100), -1)


def test_as_many_as_can_be_bright_are_lit_those_first_whose_looks_tell_most() -> None:
    """Each needs .4 of the power: two of four."""
    requests = asked([[10], [30], [50], [70]], 4 * [[1.0]], 4 * [BRIGHT / 0.4], [0.1, 0.7, 0.5, 0.3], k=1)
    assert lit_bins(urgency(RADAR, requests))[:, 0].tolist() == [-1, 30, 50, -1]


def test_what_a_look_tells_is_weighed_against_its_power() -> None:
    """The first tells somewhat more, and needs all the power; the others a third of it each."""
    requests = asked([[10], [30], [50]], 3 * [[1.0]], [BRIGHT, 4 * BRIGHT, 4 * BRIGHT], [0.5, 0.4, 0.4], k=1)
    assert lit_bins(urgency(RADAR, requests))[:, 0].tolist() == [-1, 30, 50]


def test_a_track_that_may_be_in_either_of_two_cells_has_both_lit() -> None:
    requests = asked([[10, 11], [50, 51]], [[0.5, 0.5], [1.0, 0.0]], [1000.0, 1000.0], [0.4, 0.001], k=1)
    lit = lit_bins(urgency(RADAR, requests))
    assert sorted(lit[0].tolist()) == [10, 11]
    assert lit[1].tolist() in ([-1, -1], [50, -1])


def test_of_tracks_in_one_cell_the_strongest_is_lit() -> None:
    """The others would take its echo for theirs; one in the next cell would not."""
    gains, worths = [300.0, 900.0, 600.0, 900.0], [0.9, 0.5, 0.9, 0.5]
    requests = asked([[10], [10], [10], [11]], 4 * [[1.0]], gains, worths, k=1)
    assert lit_bins(urgency(RADAR, requests))[:, 0].tolist() == [-1, 10, -1, 11]
    at_both_ends = asked([[0], [99], [0], [1]], 4 * [[1.0]], gains, worths, k=1)
    assert lit_bins(urgency(RADAR, at_both_ends))[:, 0].tolist() == [-1, 99, -1, 1]


def test_the_first_cell_of_a_stronger_track_is_no_further_cell_of_another() -> None:
    requests = asked([[10, 11], [11, 10], [40, 41]], 3 * [[0.6, 0.4]], [900.0, 800.0, 700.0], 3 * [0.9], k=1)
    lit = lit_bins(urgency(RADAR, requests))
    assert [sorted(row.tolist()) for row in lit] == [[-1, 10], [-1, 11], [40, 41]]


def test_a_track_behind_another_is_looked_for_in_its_other_cells_also_in_its_turn() -> None:
    """Its first cell is another's; in dwell TURN it is the second track's turn, whose look is worth nothing."""
    requests = asked([[10, 9], [10, 12], [40, 41]], 3 * [[0.6, 0.4]], [900.0, 800.0, 700.0], [0.9, 0.0, 0.9], k=TURN)
    assert 12 in lit_bins(urgency(RADAR, requests))[1].tolist()
    hidden = requests._replace(chances=np.array([[0.6, 0.4], [1.0, 0.0], [0.6, 0.4]]))
    assert (lit_bins(urgency(RADAR, hidden))[1] == -1).all()


@pytest.mark.parametrize("dear", [1e-3, 1.0, 12.0])
def test_nobody_is_dark_for_longer_than_its_turn_takes(dear: float) -> None:
    """Neither a track whose look costs more than all the power, nor one that is known, nor one beside another."""
    bins, gains, worths = [[10], [30], [50], [51]], [dear, 500.0, 500.0, 100.0], [0.9, 0.9, 0.0, 0.9]
    lit = [lit_bins(urgency(RADAR, asked(bins, 4 * [[1.0]], gains, worths, k)))[:, 0] >= 0 for k in range(8 * TURN)]
    for m in range(4):
        dwells = np.flatnonzero([one[m] for one in lit])
        assert dwells.size > 1
        assert np.diff(dwells).max() <= 4 * TURN
    assert not np.all(lit)


def test_somebody_is_lit_if_all_is_known_or_nothing_can_be_seen() -> None:
    for gains, worths in (([1.0, 2.0], [0.5, 0.5]), ([1e4, 1e4], [0.0, 0.0]), ([0.0, 0.0], [0.0, 0.0])):
        assert (lit_bins(urgency(RADAR, asked([[10], [30]], [[1.0], [1.0]], gains, worths, k=1))) >= 0).any()
