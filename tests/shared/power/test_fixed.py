"""Fixed powers: a track has what it asks for as long as there is so much, and the others what is left."""

from typing import Any

import numpy as np
import pytest

from cogradar.shared.power.rules import Requests, power_rule
from cogradar.shared.power.search import LEAST_SHARE, most_for_tracks, search_power
from cogradar.shared.power.wide import KEPT, LEAST_FIXED, affordable, levelled, sure_powers
from cogradar.shared.scenario.files import load
from cogradar.shared.signal.array import bin_centres
from cogradar.shared.signal.waveform import beampattern

NUS, GAINS = bin_centres(100)[[10, 40, 70]], 4e3 * np.array([1.0, 2.0, 0.5])
ASKED = np.array([0.0, 0.3, 0.0])


def _requests(fixed: np.ndarray, **more: Any) -> Requests:
    ranges, worths = (1e6 / GAINS) ** 0.25, np.full(3, 0.5)
    return Requests(NUS[:, np.newaxis], np.ones((3, 1)), ranges, GAINS, worths, fixed=fixed)._replace(**more)


@pytest.mark.parametrize("objective", ["max-min", "detections", "urgency"])
@pytest.mark.parametrize("fixed", [ASKED, np.array([0.1, 0.3, 0.2])])
def test_a_track_has_the_power_that_it_asks_for_and_all_of_it_is_radiated(objective: str, fixed: np.ndarray) -> None:
    radar = load("paper", [f'radar.allocation.objective="{objective}"']).radar
    sent = power_rule("power-aware")(radar, _requests(fixed, k=10))  # the turn of the second, if turns are taken
    assert sent.shares.sum() == pytest.approx(1.0)
    echo = beampattern(0.0, sent.factor, NUS) / radar.array.n_tx
    assert (echo >= fixed * 0.999).all()
    if (fixed == 0.0).any():
        assert echo[1] == pytest.approx(0.3, rel=0.02)
        assert (echo > 0.1).all()


@pytest.mark.parametrize("fixed", [np.array([0.0, 0.3, 0.2]), np.array([0.0, 0.8, 0.0])])
def test_a_turn_takes_no_power_that_is_fixed(fixed: np.ndarray) -> None:
    """That of the first track, whose look would need more than all of it; also if its only open cell is improbable."""
    radar = load("paper", ['radar.allocation.objective="urgency"']).radar
    weak = _requests(fixed, k=0, gains=np.array([1.0, 8e3, 4e3]))
    beside = np.array([[NUS[1], 0.0], [NUS[1], NUS[1]], [NUS[2], NUS[2]]])
    hidden = weak._replace(nus=beside, chances=np.array([[0.9, 0.005], [1.0, 0.0], [1.0, 0.0]]))
    for requests in (weak, hidden):
        sent = power_rule("power-aware")(radar, requests)
        assert (sent.shares >= 0.0).all()
        assert sent.shares.sum() == pytest.approx(1.0)
        assert sent.shares[1].max() >= 0.99 * fixed[1]


def test_looks_are_not_widened_at_the_cost_of_what_is_fixed() -> None:
    radar = load("paper", ['radar.allocation.objective="detections"']).radar
    reaches, astray = np.full(3, 2), np.array([True, False, False])
    plain, fixed = (
        power_rule("power-aware")(radar, _requests(one, reaches=reaches, astray=astray)) for one in (0.0 * ASKED, ASKED)
    )
    assert plain.nus.shape[1] > 1
    assert fixed.nus.shape[1] > 1
    assert fixed.shares[1, 0] == pytest.approx(0.3)


def test_all_have_what_others_need_not_and_the_greatest_are_cut_first() -> None:
    radar = load("paper").radar
    sure = sure_powers(radar, GAINS)
    given = affordable(radar, _requests(np.array([0.0, 5.0, 0.1])), 1.0)
    assert given == pytest.approx([0.0, 1.0 - sure[0] - 0.1, 0.1])
    weak = _requests(np.array([0.0, 5.0, 0.1]), gains=np.array([1.0, 8e3, 2e3]))
    assert affordable(radar, weak, 1.0).sum() == pytest.approx(LEAST_FIXED)
    assert levelled(np.array([0.2, 3.0, 2.0, 0.0]), 1.0) == pytest.approx([0.2, 0.4, 0.4, 0.0])
    assert levelled(ASKED, 1.0) == pytest.approx(ASKED)


def test_the_search_gives_up_what_is_asked_for_but_its_least_share() -> None:
    radar = load("paper-best-range", ['radar.tracks="unknown"']).radar
    assert radar.search is not None
    kept = KEPT * sure_powers(radar, GAINS)
    for fixed, needed in ((ASKED, 0.3 + kept[0] + kept[2]), (9.0 * ASKED, 9.0)):
        found = search_power(radar, radar.search, _requests(fixed))
        assert found == pytest.approx(max(1.0 - needed, LEAST_SHARE))
    assert most_for_tracks(radar) == pytest.approx(1.0 - LEAST_SHARE)
    assert most_for_tracks(load("paper").radar) == 1.0
