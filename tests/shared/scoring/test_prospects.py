"""What is said of a scenario before it is played."""

import numpy as np
import pytest

from cogradar.shared.power.search import search_directions
from cogradar.shared.scenario.files import ScenarioError, load
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scoring.prospects import prospects, warnings
from cogradar.shared.signal.array import spatial_frequency, steering_vector
from cogradar.shared.signal.looks import n_range_cells
from cogradar.shared.signal.receiver import detection_probability, threshold
from cogradar.shared.signal.waveform import beam_factor, beampattern
from cogradar.shared.tracking.existence import alert_p_fa

GAUSSIAN = ["radar.fidelity=best-range", 'radar.tracks="unknown"', "radar.belief.filter=gaussian"]


def _warnings(scenario: Scenario) -> list[str]:
    return warnings(scenario, prospects(scenario) if scenario.world is not None else [])


def test_the_paper_s_targets_as_the_paper_has_them() -> None:
    first, second, third = prospects(load("paper"))
    assert [one.target for one in (first, second, third)] == [1, 2, 3]
    assert second.range_km == pytest.approx(60.467, abs=1e-3)
    assert second.angle_deg == pytest.approx(7.125, abs=1e-3)
    assert second.snr_db == pytest.approx(-11.26, abs=0.01)  # 60 - 40 log10 60.467
    assert second.array_snr_db == pytest.approx(second.snr_db + 40.0)
    # The spectrum of ar6-t is high at target 2: the orthogonal waveform sees it in one dwell of eight.
    assert [round(one.p_d["orthogonal"], 2) for one in (first, second, third)] == [0.99, 0.14, 0.99]
    assert all(p > 0.99 for one in (first, second, third) for name, p in one.p_d.items() if name != "orthogonal")


@pytest.mark.parametrize("name", ["paper", "paper-literal", "smoke"])
def test_what_comes_with_the_project_makes_sense(name: str) -> None:
    assert _warnings(load(name)) == []


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (
            ["world.targets.1.state=[300.0, 0.0, -260.0, 0.0]"],
            "target 1 starts at 397 km, beyond the prior: radar.acquisition.range_min_km .. range_max_km = 5 .. 200",
        ),
        (["radar.acquisition.range_max_km=30.0"], "target 1 starts at 50 km, beyond the prior"),
        (["radar.acquisition.v_max_km_s=0.05"], "target 1 flies at 0.1 km/s along an axis, beyond the prior"),
        (
            ["world.targets.1.state=[1.0, -0.1, -30.0, 0.0]"],
            "target 1 passes x = 0 at dwell 11 of 12 and leaves the field of view",
        ),
        (["radar.echo.amplitude_db=40.0"], "target 2 cannot be detected: P_D "),
        (
            ["radar.echo.amplitude_db=40.0"],
            "target 2 is probably not acquired, so that no track begins: it takes some ",
        ),
        (
            ["world.signal=array", "world.targets.1.state=[5.0, 0.0, -60.0, 0.0]"],
            "target 1 starts at nu = -0.4983, within 1/n_tx = 0.0625 of end-fire: the array hears it at both ends",
        ),
        (
            ["world.signal=array", "radar.echo.amplitude_db=90", "world.echo.amplitude_db=90"],
            "target 1 has an echo 30 dB over the limit: more than 25 dB are detected through sidelobes, too",
        ),
        (["radar.planner.n_sim=2000000"], "a planner of all tracks needs up to "),
        (["dwells=1000000", "radar.belief.n_particle=20000"], "a run of 1000000 dwells may take "),
        (["world.rcs=swerling1"], 'world.rcs = "swerling1" but radar.assumes.rcs = "known": '),
        (
            [*GAUSSIAN, "radar.belief.kernel_bandwidth=0.5"],
            'radar.belief.kernel_bandwidth = 0.5 has no effect with radar.belief.filter = "gaussian": leave it out',
        ),
        ([*GAUSSIAN, "radar.belief.reacquire_below=0.0"], "radar.belief.reacquire_below = 0 has no effect with "),
        (["world.echo.amplitude_db=62.0"], "radar.echo.amplitude_db = 70 but world.echo.amplitude_db = 62: "),
    ],
)
def test_what_is_legal_but_makes_no_sense(settings: list[str], expected: str) -> None:
    assert any(text.startswith(expected) for text in _warnings(load("smoke", settings)))


def _of_dwell_time(name: str, *settings: str) -> list[str]:
    return [text for text in _warnings(load(name, settings)) if "motion.dt_s" in text]


@pytest.mark.parametrize("fidelity", ["paper", "robust"])
def test_a_dwell_in_which_a_belief_outgrows_single_looks_is_warned_of(fidelity: str) -> None:
    """P_D of target 2 was 0.9 with dwells of 1 s and 0 with 10 s, and 0.9 of the others, where bins are wider."""
    settings = f"radar.fidelity={fidelity}", "dwells=30"
    for dt_s in (0.1, 1.0, 3.0):
        assert _of_dwell_time("paper", f"radar.motion.dt_s={dt_s}", *settings) == []
    (only,) = _of_dwell_time("paper", "radar.motion.dt_s=10", *settings)
    assert only == (
        "target 2 may be 3.9 km away after a dwell of motion.dt_s = 10 s (acquisition.v_max_km_s = 0.35): 6.3 cells at"
        " 60.5 km, and 1 is lit, so that the track may be lost; set motion.dt_s = 3.2 or less, or fidelity ="
        ' "best" (joint looks light more cells)'
    )


def test_a_dwell_time_as_short_as_the_cure_says_has_no_warning() -> None:
    text = next(text for text in _of_dwell_time("paper", "radar.motion.dt_s=12") if text.startswith("target 2"))
    longest_s = float(text.partition("set motion.dt_s = ")[2].split()[0])
    assert not any(text.startswith("target 2") for text in _of_dwell_time("paper", f"radar.motion.dt_s={longest_s}"))
    assert any(text.startswith("target 2") for text in _of_dwell_time("paper", f"radar.motion.dt_s={1.1 * longest_s}"))


@pytest.mark.parametrize("dt_s", [0.1, 1.0, 4.0, 8.0, 10.0, 12.0])
@pytest.mark.parametrize("name", ["crossing", "traffic", "hard-turns"])
def test_where_power_lights_more_cells_than_a_belief_grows_by_long_dwells_are_in_order(name: str, dt_s: float) -> None:
    assert _of_dwell_time(name, f"radar.motion.dt_s={dt_s}") == []


def test_joint_looks_follow_as_far_as_power_suffices() -> None:
    """Wide looks at weak echoes: 30 dB less leave power for hardly a cell."""
    assert _of_dwell_time("crossing", "radar.motion.dt_s=12") == []
    assert len(_of_dwell_time("crossing", "radar.motion.dt_s=12", "radar.echo.amplitude_db=40")) == 2
    narrow = _of_dwell_time("crossing", "radar.motion.dt_s=12", "radar.planner.wide_looks=false")
    assert len(narrow) == 2
    assert all(" and 3 are lit" in text and "planner.wide_looks = true" in text for text in narrow)


def test_a_field_of_view_that_is_crossed_in_a_few_dwells_is_warned_of() -> None:
    """Without a world, too: it is a property of the radar."""
    assert _of_dwell_time("crossing", "radar.motion.dt_s=20", "radar.acquisition.range_max_km=100") == []
    settings = "radar.motion.dt_s=20", "radar.acquisition.range_max_km=100", "radar.acquisition.v_max_km_s=1.1"
    scenario = load("crossing", settings).model_copy(update={"world": None})
    assert _warnings(scenario) == [
        "radar.motion.dt_s = 20: a target with acquisition.v_max_km_s = 1.1 crosses acquisition.range_max_km = 100 in"
        " 4.5 dwells, too few to follow it; set motion.dt_s = 17 or less"
    ]


def test_a_field_of_view_that_is_crossed_in_a_dwell_is_refused() -> None:
    with pytest.raises(ScenarioError) as refused:
        load("paper", ["radar.motion.dt_s=40", "radar.acquisition.v_max_km_s=5"])
    assert refused.value.faults == (
        "--set radar.acquisition.v_max_km_s=5: radar.acquisition: v_max_km_s = 5: in a dwell of motion.dt_s = 40 s a"
        " target flies 200 km, must be less than range_max_km = 200: shorten motion.dt_s",
    )
    assert load("paper", ["radar.motion.dt_s=39", "radar.acquisition.v_max_km_s=5"]).radar.motion.dt_s == 39.0


def test_a_belief_of_gaussians_takes_no_time_for_particles() -> None:
    assert _warnings(load("smoke", GAUSSIAN)) == []
    many = ["dwells=20000", "radar.belief.n_particle=1000000"]
    takes = [
        [
            text
            for text in _warnings(load("smoke", [*more, *many]))
            if text.startswith("a run of 20000 dwells may take ")
        ]
        for more in ([], GAUSSIAN)
    ]
    assert [len(texts) for texts in takes] == [1, 0]


@pytest.mark.parametrize("rcs", ["swerling1", "swerling3"])
def test_a_fluctuating_target_is_seen_as_its_law_says(rcs: str) -> None:
    """Target 2 of the paper: more often with the orthogonal waveform, less often with a beam."""
    settings = [f"world.rcs={rcs}", "radar.assumes.rcs=mean"]
    steady, found = prospects(load("paper"))[1].p_d, prospects(load("paper", settings))[1].p_d
    assert found["orthogonal"] > 1.3 * steady["orthogonal"]
    assert 0.9 < found["power-aware"] < steady["power-aware"] - 0.005
    assert _warnings(load("paper", settings)) == []


def test_of_a_real_front_end_only_sizes_are_known() -> None:
    scenario = load("paper").model_copy(update={"world": None, "dwells": 1_000_000})
    (only,) = _warnings(scenario)
    assert only.startswith("a run of 1000000 dwells")


def test_what_the_disturbance_has_towards_a_target_is_said() -> None:
    """The paper's target 2 is where the disturbance is strong; white noise is the same everywhere."""
    assert [round(prospect.disturbance_db, 1) for prospect in prospects(load("paper"))] == [-5.4, 2.1, -5.0]
    white = prospects(load("paper", ["world.disturbance.model=white"]))
    assert [prospect.disturbance_db for prospect in white] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)


def test_steered_cells_lose_nothing_under_a_beam_and_by_straddling_without() -> None:
    """Target 1 of the paper starts near a border. With range cells a cell is nearer, but thresholds are higher."""
    bins, steered, ranged = (
        prospects(load("paper", [f"radar.fidelity={name}", "world.echo.amplitude_db=57"]))[0].p_d
        for name in ("robust", "best", "best-range")
    )
    assert max(steered["orthogonal"], ranged["orthogonal"]) < 0.5 * bins["orthogonal"]
    assert min(steered["power-aware"], ranged["power-aware"]) > 0.999
    assert _warnings(load("paper", ["radar.fidelity=best-range"])) == []  # false alarms hardly confirm each other


def test_a_target_at_a_height_is_seen_where_the_array_measures_it() -> None:
    high = load("smoke", ["world.targets.1.state=[30.0, 0.1, -30.0, 0.05]", "world.targets.1.height_km=40.0"])
    flat = load("smoke", ["world.targets.1.state=[50.0, 0.1, -30.0, 0.05]"])
    assert prospects(high)[0] == prospects(flat)[0]


def test_p_d_is_that_of_the_estimate_of_the_noise() -> None:
    settings = ["radar.fidelity=best-range", "world.signal=array", "world.echo.amplitude_db=56.0"]
    by_noise = [
        prospects(load("smoke", [*settings, f"radar.receiver.noise={noise}"]))[0].p_d["power-aware"]
        for noise in ("lags", "rows", "range-cells")
    ]
    lags, rows, range_cells = by_noise
    assert 0.9 > lags > range_cells > rows > 0.1  # 16 transmit channels are few clusters


@pytest.mark.parametrize("search", ["radar.search.beams=8", "radar.search.beams=auto"])
def test_an_unknown_sky_has_the_seconds_until_a_target_is_seen(search: str) -> None:
    """Against sweeps that are played: looks meet or miss the target as often as their P_D says."""
    scenario = load("traffic", [search, "world.echo.amplitude_db=71"])
    radar, seen = scenario.radar, prospects(scenario)[1]
    assert list(seen.p_d) == ["search"]
    assert radar.search is not None
    array, limits = radar.array, dict[int, float]()
    nu = float(spatial_frequency(scenario.simulated.measured_states())[1])
    n_cell = n_range_cells(*radar.acquisition.ranges_km, radar.receiver.range_cell_km)
    alpha = 10.0 ** (seen.snr_db / 20.0)
    level = 10.0 ** (seen.disturbance_db / 10.0)
    rng, waited = np.random.default_rng(1), list[int]()
    beam, n_dwell = 0, 0
    for _ in range(8_000):
        n_dwell += 1
        nus, beam = search_directions(radar, radar.search, beam, array.power)
        factor = beam_factor(nus, np.full(nus.size, array.power / nus.size), array.n_tx)
        look = nus[np.abs(nus - nu).argmin()]
        # The signature of the target against that of the look which is nearest to it.
        power = beampattern(0.0, factor[:, [int(np.abs(nus - nu).argmin())]], np.array([nu]))[0] * array.n_rx
        off = abs(steering_vector(look, array.n_rx).conj() @ steering_vector(nu, array.n_rx) / array.n_rx) ** 2
        zeta = 2.0 * alpha**2 * power * off / level
        limit = limits.setdefault(nus.size, threshold(alert_p_fa(nus.size), n_cell))
        if rng.uniform() < detection_probability(zeta, limit):
            waited.append(n_dwell)
            n_dwell, beam = 0, int(rng.integers(10_000))  # another target comes
    assert seen.seconds == pytest.approx(radar.motion.dt_s * np.mean(waited), rel=4.0 / np.sqrt(len(waited)))
    assert 0.05 < seen.p_d["search"] < 1.0


def test_an_unknown_sky_is_not_told_of_an_acquisition() -> None:
    far = ["radar.echo.amplitude_db=30", "world.echo.amplitude_db=30"]
    found = _warnings(load("traffic", far))
    assert any("is probably never seen: the search with all power takes some " in text for text in found)
    assert not any("acquired" in text or "best strategy" in text for text in found)
