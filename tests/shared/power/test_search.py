"""Where the search looks and how much power it has."""

import numpy as np
import pytest
from numpy.typing import NDArray

from cogradar.shared.power.rules import Requests
from cogradar.shared.power.search import LEAST_SHARE, P_D, edge_power, search_directions, search_power
from cogradar.shared.power.wide import KEPT, sure_powers
from cogradar.shared.protocol.roster import Roster, no_tracks
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import RadarConfig, SearchSection
from cogradar.shared.signal.array import bin_centres
from cogradar.shared.signal.receiver import detection_probability, threshold
from cogradar.shared.tracking.existence import alert_p_fa

POWER = 0.1


def _radar(*settings: str) -> tuple[RadarConfig, SearchSection]:
    radar = load("paper-best-range", ['radar.tracks="unknown"', *settings]).radar
    assert radar.search is not None
    return radar, radar.search


def _in_turn(radar: RadarConfig, search: SearchSection, first: int, power: float) -> NDArray[np.float64]:
    """Directions of a dwell in the order of their numbers."""
    n = search_directions(radar, search, first, power)[0].size
    single = search.model_copy(update={"beams": 1})
    return np.concatenate([search_directions(radar, single, first + i, power)[0] for i in range(n)])


def _requests(*gains: float) -> Requests:
    nus = np.linspace(-0.3, 0.3, len(gains))
    return Requests.of_single(nus, np.full(len(gains), 50.0), np.array(gains))


@pytest.mark.parametrize("beams", [1, 4, 7, 64])
def test_a_sweep_goes_through_all_directions_once_and_the_next_one_between_them(beams: int) -> None:
    radar, search = _radar(f"radar.search.beams={beams}")
    found = np.concatenate([_in_turn(radar, search, n, POWER) for n in range(0, 401, beams)])
    sweeps = [np.sort(found[i * 100 : (i + 1) * 100]) for i in range(4)]
    assert np.allclose(sweeps[0], bin_centres(100))
    assert np.allclose(sweeps[1][:-1], bin_centres(100)[:-1] + 0.5 / 99)
    assert sweeps[1].max() == 0.5
    assert np.array_equal(sweeps[0], sweeps[2])
    assert np.array_equal(sweeps[1], sweeps[3])


def test_beams_of_a_dwell_are_ascending_and_apart() -> None:
    radar, search = _radar("radar.search.beams=7")
    for first in range(0, 280, 7):
        assert (np.diff(search_directions(radar, search, first, POWER)[0]) > 2.0 / radar.array.n_rx).all()


@pytest.mark.parametrize("beams", [1, 7])
def test_a_sweep_visits_each_direction_as_often_as_it_is_told(beams: int) -> None:
    """Never from -0.3 to -0.1, twice from 0.2: also in the sweep between the bins, and with no beam left out."""

    def times(nus: NDArray[np.float64]) -> NDArray[np.int64]:
        return np.where((nus >= -0.3) & (nus <= -0.1), 0, np.where(nus >= 0.2, 2, 1))

    radar, search = _radar(f"radar.search.beams={beams}")
    wanted = times(bin_centres(100))
    first, found = 0, list[NDArray[np.float64]]()
    while first < 2 * beams * wanted.sum():
        nus, after = search_directions(radar, search, first, POWER, times)
        assert after == first + beams
        found, first = [*found, nus], after
    visits = np.concatenate(found)
    assert (times(visits) > 0).all()
    bins = np.floor(visits * 99 + 49.5 + 1e-9).astype(int)  # of the bin, or half a bin further
    assert np.bincount(bins, minlength=100).tolist() == (2 * beams * wanted).tolist()


@pytest.mark.parametrize("n_bin", [3, 4, 6, 31, 100, 256])
def test_a_sweep_meets_each_bin_of_any_grid(n_bin: int) -> None:
    radar, search = _radar(f"radar.array.n_bin={n_bin}", "radar.search.beams=1")
    found = np.concatenate([search_directions(radar, search, n, POWER)[0] for n in range(n_bin)])
    assert np.allclose(np.sort(found), bin_centres(n_bin))


def test_power_to_spare_makes_more_beams_each_of_which_finds_the_echo_from_the_end_of_the_range() -> None:
    radar, search = _radar("radar.echo.amplitude_db=72.0", "radar.acquisition.range_max_km=100.0")
    one = edge_power(radar)
    sizes = [search_directions(radar, search, 0, share * one)[0].size for share in (0.2, 10.2, 17.9, 30.2, 1e4)]
    assert sizes == [10, 10, 17, 30, radar.array.n_bin]
    snr = 10.0**-0.8  # 72 dB less 40 log10(100)
    limit = threshold(alert_p_fa(radar.array.n_bin), 190)  # range cells of 0.5 km from 5 to 100 km
    assert detection_probability(2e4 * snr * one, limit) == pytest.approx(P_D, abs=1e-9)


def test_a_search_in_all_directions_has_no_beams() -> None:
    assert search_directions(*_radar("radar.search.pattern=isotropic"), 3, POWER)[0].size == 0


def test_it_has_what_the_tracks_can_spare() -> None:
    radar, search = _radar()
    weak, strong = _requests(1e3, 2e3), _requests(10.0, 20.0)
    assert search_power(radar, search, None) == radar.array.power
    assert search_power(radar, search, weak) == pytest.approx(1.0 - KEPT * sure_powers(radar, weak.gains).sum())
    assert search_power(radar, search, strong) == LEAST_SHARE
    assert search_power(*_radar("radar.search.share=0.3"), strong) == pytest.approx(0.3)


@pytest.mark.parametrize("first", [2**31 - 50, 2**44, 2**48 - 1000])
def test_a_search_goes_on_after_any_number_of_beams(first: int) -> None:
    """A run without an end makes 2^31 of them in a month or two."""
    radar, search = _radar("radar.search.beams=100")
    first -= first % 200  # two sweeps
    nus, after = search_directions(radar, search, first, POWER)
    assert np.array_equal(nus, search_directions(radar, search, 0, POWER)[0])
    roster = no_tracks().model_dump() | {"next_search": after}
    assert Roster.model_validate(roster).next_search == first + 100
