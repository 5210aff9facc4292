"""An IMM-EKF and a tracker of Stone Soup on this radar's detections, and the scores of all trackers."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import cogradar
from cogradar.shared.numerics.constants import G_KM_S2
from studies.trackers import imm_ekf
from studies.trackers.scans import Scan, scans
from studies.trackers.scores import IMM, OWN, UKF, Score, compare
from studies.trackers.skies import SKIES
from studies.trackers.table import table

DWELLS = 25
SIGMA_NU, RANGE_SIGMA_KM = 3e-4, 0.15
Floats = NDArray[np.float64]


def _scans(places: NDArray[np.complex128], seed: int = 1) -> list[Scan]:
    """A detection of each aircraft, places x + iy in km, (T, n), with errors in direction and range."""
    rng = np.random.default_rng(seed)
    found = []
    for t, place in enumerate(places, 1):
        nus = 0.5 * place.imag / np.abs(place) + SIGMA_NU * rng.standard_normal(place.size)
        ranges = np.abs(place) + RANGE_SIGMA_KM * rng.standard_normal(place.size)
        found.append(Scan(t, nus, np.full(place.size, SIGMA_NU), ranges, RANGE_SIGMA_KM))
    return found


def _flight(g: float, seconds: int, speed: float = 0.25) -> NDArray[np.complex128]:
    """Straight for 30 s, then a turn; every second, (T, 1)."""
    angles = np.cumsum(np.where(np.arange(seconds) < 30, 0.0, g * G_KM_S2 / speed))
    return (50.0 + np.cumsum(speed * np.exp(1j * angles)))[:, np.newaxis].astype(np.complex128)


def test_all_trackers_are_judged_by_the_rule_of_this_program() -> None:
    scores = compare(cogradar.load("crossing"), 3, DWELLS)
    figures = cogradar.run("crossing", seed=3, dwells=DWELLS).picture.figures
    own = scores[OWN]
    assert own.gospa_km == pytest.approx(figures["gospa_km"], rel=1e-9)
    assert own.missed_km == pytest.approx(figures["gospa_missed_km"], rel=1e-9)
    for other in (scores[IMM], scores[UKF]):
        assert other.gospa_km**2 == pytest.approx(other.localisation_km**2 + other.missed_km**2 + other.false_km**2)
        assert other.missed_km < 3.0  # 5 km without any track: two targets of 12.5 km^2
        assert 0.0 < other.localisation_km < 1.0
        assert other.missed < 20.0
        assert 10.0 < other.rmse_m < 400.0


def test_detections_without_direction_or_range_are_refused() -> None:
    with pytest.raises(cogradar.BadInput, match="no measured direction, or no range"):
        compare(cogradar.load("smoke"), 1, 5)


def test_of_detections_in_one_lobe_and_range_cell_the_strongest_is_kept() -> None:
    columns = {
        "t": np.array([1, 1, 1, 1, 2]),
        "nu_measured": np.array([0.1, 0.104, 0.104, 0.3, 0.1]),
        "nu_measured_sigma": np.full(5, 1e-3),
        "range_km": np.array([50.25, 50.25, 50.75, 50.25, 50.25]),
        "range_cell_km": np.full(5, 0.5),
        "statistic": np.array([30.0, 40.0, 25.0, 20.0, 30.0]),
    }
    first, second, empty = scans(columns, (1, 2, 3), 0.01)
    assert sorted(zip(first.nus.tolist(), first.ranges_km.tolist(), strict=True)) == [
        (0.104, 50.25),
        (0.104, 50.75),
        (0.3, 50.25),
    ]
    assert second.nus.tolist() == [0.1]
    assert empty.nus.size == 0


@pytest.mark.parametrize("rate", [0.0, 0.05, -0.4])
def test_a_turn_keeps_the_speed_and_its_jacobian_is_its_derivative(rate: float) -> None:
    state = np.array([50.0, 0.2, -20.0, 0.15, rate])
    moved, jacobian = imm_ekf.turned(state, 2.0)
    assert np.hypot(moved[1], moved[3]) == pytest.approx(np.hypot(state[1], state[3]))
    steps = 1e-4 * np.eye(5)  # rates below 1e-5 are taken for that
    numeric = [(imm_ekf.turned(state + h, 2.0)[0] - imm_ekf.turned(state - h, 2.0)[0]) / 2e-4 for h in steps]
    np.testing.assert_allclose(jacobian, np.array(numeric).T, atol=1e-3)


@pytest.mark.parametrize(("g", "worst_m"), [(0.0, 150.0), (3.0, 250.0), (7.0, 350.0)])
def test_the_imm_ekf_follows_turns_with_one_track(g: float, worst_m: float) -> None:
    places = _flight(g, 60)
    found = list(imm_ekf.followed(_scans(places), 1.0, 0.0005))
    assert found[0].ids == []  # one detection confirms nothing
    assert {tuple(one.ids) for one in found[1:]} == {(1,)}
    errors = np.array(
        [abs(complex(*one.states[0, 0:3:2]) - place[0]) for one, place in zip(found, places, strict=True) if one.ids]
    )
    assert 1e3 * errors[10:].max() < worst_m


def test_the_imm_ekf_is_honest_in_straight_flight() -> None:
    """Mean NEES of 20 flights; 4 of an honest filter that assumes as much noise as there is."""
    values = []
    for seed in range(20):
        places = _flight(0.0, 40)
        for t, one in enumerate(imm_ekf.followed(_scans(places, seed), 1.0, 0.0005)):
            if t >= 10:
                off = one.states[0] - np.array([places[t, 0].real, 0.25, places[t, 0].imag, 0.0])
                values.append(off @ np.linalg.solve(one.covariances[0], off))
    assert 1.5 < np.mean(values) < 5.0


def test_the_imm_ekf_ends_a_track_after_three_dwells_without_a_detection() -> None:
    found = _scans(_flight(0.0, 10))
    none = np.empty(0)
    found += [Scan(t, none, none, none, RANGE_SIGMA_KM) for t in range(11, 16)]
    assert [len(one.ids) for one in imm_ekf.followed(found, 1.0, 0.0005)] == [0, *(9 * [1]), 1, 1, 0, 0, 0]


@pytest.mark.parametrize("name", SKIES)
def test_skies_are_scenarios_of_an_unknown_number(name: str, tmp_path: Path) -> None:
    texts = [SKIES[name](seed) for seed in (1, 1, 2)]
    assert texts[0] == texts[1] != texts[2]
    (tmp_path / "sky.toml").write_text(texts[0], encoding="utf-8")
    scenario = cogradar.load(tmp_path / "sky.toml")
    assert scenario.radar.is_unknown
    assert scenario.n_target == {"dense": 45, "six": 6, "formation": 2}[name]


def test_a_table_has_medians_and_compares_with_the_better_of_the_others() -> None:
    def score(gospa_km: float, nees: float = float("nan")) -> Score:
        return Score(gospa_km, 0.1, 0.1, 0.1, 2.0, 1.0, 1.0, 100.0, 30.0, (4.0, float("nan"), nees, float("nan")))

    runs = [
        {OWN: score(0.9), IMM: score(1.0, 5.0), UKF: score(3.0)},
        {OWN: score(1.0), IMM: score(4.0, 7.0), UKF: score(2.0)},
        {OWN: score(1.2), IMM: score(1.0), UKF: score(2.0)},
    ]
    found = table({"build/a sky.toml": runs})
    own, imm, _ = found.rows
    assert [column.cell(imm) for column in found.columns][-4:] == ["4.0 [4.0, 4.0]", "-", "6.0 [5.0, 7.0]", "-"]
    assert own["sky"] == "a sky"
    assert own["gospa_km"] == "1.00 [0.90, 1.20]"
    assert own["ratio"] == "0.90 [0.50, 1.20]"
    assert (own["swaps"], own["missed"], imm["ratio"]) == ("3", "2.0", None)
    assert own["nees_2"] is None
