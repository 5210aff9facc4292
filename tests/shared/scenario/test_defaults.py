"""Scenario files: what follows from a key for those left out, and what must go together."""

import tomllib
from typing import Any

import pytest

from cogradar.shared.scenario.files import SCENARIO_DIR, ScenarioError, load, parse, parse_radar
from cogradar.shared.scenario.limits import MAX_TRACKS
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.scenario.tables import REACQUIRE_BELOW

SMOKE = (SCENARIO_DIR / "smoke.toml").read_text()
UNKNOWN = ["radar.fidelity=best", "radar.tracks=unknown"]


def _smoke() -> dict[str, Any]:
    return tomllib.loads(SMOKE)


@pytest.mark.parametrize(("fidelity", "n_particle"), [("paper", 12_000), ("robust", 3_000), ("best-range", 3_000)])
def test_how_many_particles_if_nobody_says_it(fidelity: str, n_particle: int) -> None:
    document = _smoke()
    document["radar"] |= {"fidelity": fidelity}
    del document["radar"]["belief"]["n_particle"]
    assert parse(document, source="s").radar.belief.n_particle == n_particle


@pytest.mark.parametrize(
    ("looks", "allocation", "expected"),
    [
        (None, {}, "max-min"),
        ("joint", {}, "detections"),
        ("joint", {"objective": "urgency"}, "urgency"),
        ("single", {"objective": "detections"}, "detections"),
    ],
)
def test_what_power_is_for_follows_from_the_looks_if_nobody_says_it(
    looks: str | None, allocation: dict[str, str], expected: str
) -> None:
    document = _smoke()
    document["radar"]["planner"] |= {"looks": looks} if looks else {}
    document["radar"]["allocation"] |= allocation
    assert parse(document, source="s").radar.allocation.objective == expected


@pytest.mark.parametrize(
    ("looks", "objective", "expected"),
    [
        (None, "urgency", "joint"),
        (None, "detections", "joint"),
        (None, "max-min", "single"),
        ("single", "urgency", "single"),
    ],
)
def test_looks_follow_from_what_power_is_for_if_nobody_says_them(
    looks: str | None, objective: str, expected: str
) -> None:
    document = _smoke()
    document["radar"]["planner"] |= {"looks": looks} if looks else {}
    document["radar"]["allocation"] |= {"objective": objective}
    planner = parse(document, source="s").radar.planner
    assert (planner.looks, planner.wide_looks) == (expected, expected == "joint")


def test_only_joint_looks_are_widened_and_they_are_unless_it_is_said() -> None:
    document = _smoke()
    assert not parse(document, source="s").radar.planner.wide_looks
    document["radar"]["planner"]["looks"] = "joint"
    assert parse(document, source="s").radar.planner.wide_looks
    document["radar"]["planner"]["wide_looks"] = False
    assert not parse(document, source="s").radar.planner.wide_looks


@pytest.mark.parametrize(
    ("section", "key", "value"), [("planner", "looks", "joint"), ("allocation", "objective", "urgency")]
)
def test_the_published_filter_begins_again_with_joint_looks_unless_it_is_said(
    section: str, key: str, value: str
) -> None:
    document = _smoke()
    document["radar"]["fidelity"] = "paper"
    assert parse(document, source="s").radar.belief.reacquire_below == 0.0
    document["radar"][section][key] = value
    assert parse(document, source="s").radar.belief.reacquire_below == REACQUIRE_BELOW
    document["radar"]["belief"]["reacquire_below"] = 0.0
    assert parse(document, source="s").radar.belief.reacquire_below == 0.0


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (["radar.max_tracks=7"], 'radar: tracks = 2: max_tracks must be left out, need tracks = "unknown"'),
        (
            [
                "radar.initiation={false_tracks_per_hour=1.0}",
                'radar.search={share="auto",beams=2,pattern="swept"}',
            ],
            'radar: tracks = 2: search and initiation must be left out, need tracks = "unknown"',
        ),
        ([*UNKNOWN, "radar.search.share=1.0"], 'radar.search.share=1.0: must be a number > 0 and < 1 or "auto"'),
        ([*UNKNOWN, "radar.search.share=all"], 'radar.search.share=all: must be a number > 0 and < 1 or "auto"'),
        ([*UNKNOWN, "radar.max_tracks=0"], "radar.max_tracks=0: must be an integer >= 1 and <= 1000"),
    ],
)
def test_what_tracks_of_an_unknown_number_need_and_others_must_not_have(settings: list[str], expected: str) -> None:
    """With other faults in the document it is said as well."""
    with pytest.raises(ScenarioError) as caught:
        load("smoke", settings)
    assert expected in str(caught.value)
    if "left out" in expected:
        with pytest.raises(ScenarioError) as caught:
            load("smoke", [*settings, "radar.planner.gamma=2"])
        assert any(expected in fault for fault in caught.value.faults)


def test_the_most_tracks_there_may_be() -> None:
    assert [load("smoke", UNKNOWN + more).radar.most_tracks for more in ([], ["radar.max_tracks=7"])] == [100, 7]
    known = load("smoke").radar
    assert (known.most_tracks, known.max_tracks) == (2, None)
    assert RadarConfig.model_validate(known.model_dump()) == known


def test_a_waveform_of_all_tracks_must_fit_into_a_message() -> None:
    """A thousand tracks of 512 antennas would end the allocator."""
    most, many = [f"radar.max_tracks={MAX_TRACKS}"], ["radar.array.n_tx=512", "radar.array.n_rx=512"]
    assert load("traffic", most).radar.most_tracks == MAX_TRACKS
    words = rf"a waveform of tracks = {MAX_TRACKS} with array\.n_tx = 512 may need 12\.0 MiB, must be at most 4 MiB"
    with pytest.raises(ScenarioError, match=words):
        load("traffic", most + many)
    assert load("traffic", ["radar.max_tracks=300", *many]).radar.array.n_tx == 512
    with pytest.raises(ScenarioError, match=f"{MAX_TRACKS}"):
        load("traffic", [f"radar.max_tracks={MAX_TRACKS + 1}"])


def test_the_world_is_as_the_radar_assumes_unless_it_is_said() -> None:
    document = _smoke()
    as_assumed = parse(document, source="s").simulated
    assert (as_assumed.motion.sigma_s_km_s2, as_assumed.echo.amplitude_db) == (0.004, 70.0)
    document["world"]["motion"] = {"sigma_s_km_s2": 0.1}
    other = parse(document, source="s")
    assert (other.simulated.motion.sigma_s_km_s2, other.simulated.echo.amplitude_db) == (0.1, 70.0)
    assert other.radar == parse(_smoke(), source="s").radar


@pytest.mark.parametrize(("y_km", "bin_"), [(20.0, 10), (31.0, 11), (10.0, 9)])
def test_with_steered_cells_targets_must_start_two_bins_apart(y_km: float, bin_: int) -> None:
    """Each is heard in both while they are acquired. Target 2 is in bin 10."""
    settings = ["radar.fidelity=best", f"world.targets.1.state=[50.0, 0.0, {y_km}, 0.0]"]
    words = f"#1 and #2 start in angle bins {bin_} and 10 of 16, must start 2 bins apart"
    with pytest.raises(ScenarioError, match=words):
        load("smoke", settings)
    if bin_ != 10:
        load("smoke", settings[1:])  # bins


def test_with_steered_cells_the_next_bin_but_one_is_far_enough() -> None:
    load("smoke", ["radar.fidelity=best", "world.targets.1.state=[50.0, 0.0, 43.0, 0.0]"])


def test_beliefs_of_gaussians_need_no_memory_for_particles() -> None:
    settings = ["radar.fidelity=best-range", 'radar.tracks="unknown"', "radar.belief.n_particle=1000000"]
    assert load("smoke", settings).radar.belief.filter == "gaussian"
    with pytest.raises(ScenarioError, match=r"belief\.n_particle = 1000000, tracks = 100"):
        load("smoke", [*settings, "radar.belief.filter=likelihood"])


def test_the_most_tracks_that_there_may_be_must_fit_into_memory() -> None:
    settings = ["radar.belief.filter=likelihood", "radar.belief.n_particle=100000", "radar.planner.n_sim=100"]
    assert load("crossing", settings).radar.most_tracks == 100
    with pytest.raises(ScenarioError, match="tracks = 300"):
        load("crossing", [*settings, "radar.max_tracks=300"])
    radar = load("crossing", settings).radar.model_dump()
    with pytest.raises(ScenarioError, match="tracks = 300"):
        parse_radar(radar | {"max_tracks": 300}, "radar")
