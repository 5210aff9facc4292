"""Widened looks: who pays for them, who gets them, and that weak scenes have none."""

import numpy as np
import pytest
from numpy.typing import NDArray

from cogradar.shared.power.looks import detections
from cogradar.shared.power.rules import Emission, Requests
from cogradar.shared.power.urgency import urgency
from cogradar.shared.power.wide import ASTRAY, CALM, KEPT, sure_powers, widened
from cogradar.shared.scenario.files import load
from cogradar.shared.signal.array import angle_bin, bin_centres
from cogradar.shared.signal.waveform import beam_factor, beampattern

RADAR = load("paper").radar
N_BIN = RADAR.array.n_bin


def asked(bins: list[int], km: list[float], reaches: list[int], astray: list[bool]) -> Requests:
    """One cell per track at the paper's SNR."""
    gains = 2e10 * np.array(km) ** -4.0
    single = Requests.of_single(bin_centres(N_BIN)[np.array(bins)], np.array(km), gains)
    return single._replace(reaches=np.array(reaches), astray=np.array(astray))


def lit_bins(sent: Emission) -> list[list[int]]:
    return [angle_bin(row[~np.isnan(row)], N_BIN).tolist() for row in sent.nus]


def before(requests: Requests) -> Emission:
    return detections(RADAR, requests._replace(reaches=np.zeros_like(requests.reaches)))


CASES = [
    asked([30, 70], [25.0, 35.0], [3, 3], [False, False]),
    asked([30, 70], [25.0, 35.0], [3, 99], [False, True]),
    asked([0, 50, 99], [25.0, 60.0, 12.0], [9, 9, 9], [True, False, False]),
]


@pytest.mark.parametrize("requests", CASES)
def test_power_is_moved_and_nobody_falls_below_what_was_promised(requests: Requests) -> None:
    """A beam keeps twice what makes it nearly sure, and in calm times all but 3 % of what it has above that."""
    was, sent = before(requests), detections(RADAR, requests)
    sure = sure_powers(RADAR, requests.gains)
    assert sent.shares.sum() == pytest.approx(1.0, rel=1e-9)
    assert (sent.shares >= 0.0).all()
    np.testing.assert_array_equal(sent.nus[:, 0], was.nus[:, 0])  # its own cell is the brightest
    share = ASTRAY + CALM if requests.astray.any() else CALM
    assert (sent.shares[:, 0] >= was.shares[:, 0] - share * np.maximum(was.shares[:, 0] - KEPT * sure, 0.0)).all()
    assert (sent.shares[:, 0] >= np.minimum(was.shares[:, 0], KEPT * sure)).all()
    further = [row[1:][~np.isnan(nus[1:])] for row, nus in zip(sent.shares, sent.nus, strict=True)]
    assert any(row.size for row in further)
    for row, power in zip(further, sure, strict=True):
        np.testing.assert_allclose(row, power)
    for row in lit_bins(sent):
        assert len(set(row)) == len(row)
        assert min(row) >= 0
        assert max(row) < N_BIN
    gains = beampattern(sent.isotropic, sent.factor, sent.nus[~np.isnan(sent.nus)]) / RADAR.array.n_tx
    assert (gains >= 0.9 * sent.shares[~np.isnan(sent.nus)]).all()  # what is sent there is what was reckoned with


def test_the_nearest_and_cheapest_cells_come_first() -> None:
    calm = lit_bins(detections(RADAR, CASES[0]))
    assert set(calm[0]) >= {29, 30, 31}
    assert len(calm[0]) > len(calm[1])  # a target at 25 km is found with a quarter of the power of one at 35 km
    for row, own in zip(calm, (30, 70), strict=True):
        away = sorted(abs(b - own) for b in row)
        assert away == [(i + 1) // 2 for i in range(len(away))]
        assert max(away) <= 3


def test_a_track_that_is_astray_may_look_over_the_whole_grid() -> None:
    near = asked([30, 70], [20.0, 60.0], [99, 0], [True, False])
    assert sorted(lit_bins(detections(RADAR, near))[0]) == list(range(N_BIN))
    calm = near._replace(astray=np.array([False, False]))
    assert 3 < len(lit_bins(detections(RADAR, calm))[0]) < N_BIN


@pytest.mark.parametrize("objective", [detections, urgency])
def test_without_power_to_spare_nothing_changes(objective: type) -> None:
    """Weak echoes; tracks that ask for nothing; one that is dark, and one whose own look is not sure."""
    weak = asked([30, 70], [110.0, 120.0], [3, 3], [True, True])
    none = asked([30, 70], [25.0, 35.0], [0, 0], [False, False])
    for requests in (weak, none):
        was = objective(RADAR, requests._replace(reaches=np.zeros(2, np.int64)))
        sent = objective(RADAR, requests)
        np.testing.assert_array_equal(sent.nus, was.nus)
        np.testing.assert_array_equal(sent.shares, was.shares)
        np.testing.assert_array_equal(sent.factor, was.factor)


def test_who_is_dark_or_not_sure_gets_no_further_cells() -> None:
    requests = asked([30, 50, 70], [25.0, 60.0, 60.0], [5, 5, 5], [False, True, True])
    nus, shares = np.array([[0.1], [0.0], [np.nan]]), np.array([[0.99], [0.01], [0.0]])
    lit: NDArray[np.bool_] = shares > 0.0
    sent = widened(RADAR, requests, Emission(0.0, beam_factor(nus[lit], shares[lit], RADAR.array.n_tx), nus, shares))
    assert [len(row) > 1 for row in lit_bins(sent)] == [True, False, False]
    assert lit_bins(sent)[2] == []
