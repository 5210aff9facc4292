"""Where the search looks and how much power it has."""

import numpy as np
import pytest

from cogradar.shared.power.rules import Requests
from cogradar.shared.power.search import LEAST_SHARE, search_directions, search_power
from cogradar.shared.power.wide import KEPT, sure_powers
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import RadarConfig, SearchSection
from cogradar.shared.signal.array import bin_centres


def _radar(*settings: str) -> tuple[RadarConfig, SearchSection]:
    radar = load("paper-best-range", ['radar.tracks="unknown"', *settings]).radar
    assert radar.search is not None
    return radar, radar.search


def _requests(*gains: float) -> Requests:
    nus = np.linspace(-0.3, 0.3, len(gains))
    return Requests.of_single(nus, np.full(len(gains), 50.0), np.array(gains))


@pytest.mark.parametrize("beams", [1, 4, 7, 64])
def test_a_sweep_goes_through_all_directions_once_and_the_next_one_between_them(beams: int) -> None:
    radar, search = _radar(f"radar.search.beams={beams}")
    length = -(-100 // beams)
    sweeps = [
        np.sort(np.concatenate([search_directions(radar, search, k) for k in range(i * length, (i + 1) * length)]))
        for i in range(4)
    ]
    assert np.allclose(sweeps[0], bin_centres(100))
    assert np.allclose(sweeps[1][:-1], bin_centres(100)[:-1] + 0.5 / 99)
    assert sweeps[1].max() == 0.5
    assert np.array_equal(sweeps[0], sweeps[2])
    assert np.array_equal(sweeps[1], sweeps[3])


def test_beams_of_a_dwell_are_ascending_and_apart() -> None:
    radar, search = _radar("radar.search.beams=7")
    for k in range(40):
        assert (np.diff(search_directions(radar, search, k)) > 2.0 / radar.array.n_rx).all()


def test_a_search_in_all_directions_has_no_beams() -> None:
    assert search_directions(*_radar("radar.search.pattern=isotropic"), 3).size == 0


def test_it_has_what_the_tracks_can_spare() -> None:
    radar, search = _radar()
    weak, strong = _requests(1e3, 2e3), _requests(10.0, 20.0)
    assert search_power(radar, search, None) == radar.array.power
    assert search_power(radar, search, weak) == pytest.approx(1.0 - KEPT * sure_powers(radar, weak.gains).sum())
    assert search_power(radar, search, strong) == LEAST_SHARE
    assert search_power(*_radar("radar.search.share=0.3"), strong) == pytest.approx(0.3)
