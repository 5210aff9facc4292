"""What is said of a scenario before it is played."""

import pytest

from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scoring.prospects import prospects, warnings


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
        (["radar.planner.n_sim=2000000"], "a planner of all tracks needs up to "),
        (["dwells=1000000", "radar.belief.n_particle=20000"], "a run of 1000000 dwells may take "),
        (["world.rcs=swerling1"], 'world.rcs = "swerling1" but radar.assumes.rcs = "known": '),
        (["world.echo.amplitude_db=62.0"], "radar.echo.amplitude_db = 70 but world.echo.amplitude_db = 62: "),
    ],
)
def test_what_is_legal_but_makes_no_sense(settings: list[str], expected: str) -> None:
    assert any(text.startswith(expected) for text in _warnings(load("smoke", settings)))


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
