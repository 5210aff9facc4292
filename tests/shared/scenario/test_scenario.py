"""Scenario files: the values of the paper, and one line for everything that can be wrong with a file."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shared.scenario.files import SCENARIO_DIR, ScenarioError, load, parse
from shared.scenario.limits import MAX_PLANNER_BYTES, beliefs_bytes
from shared.scenario.radar_config import RadarConfig
from shared.scenario.scenario import Scenario
from shared.scenario.tables import FIDELITY

SMOKE = (SCENARIO_DIR / "smoke.toml").read_text()


def refusal(file: Path) -> str:
    """The error of a file, without the file's name, which it must begin with."""
    with pytest.raises(ScenarioError) as caught:
        load(str(file))
    text = str(caught.value)
    assert text.isprintable()  # one line
    assert text.startswith(f"{file}: ")
    return text.removeprefix(f"{file}: ")


def edited(old: str, new: str) -> str:
    assert SMOKE.count(old) == 1
    return SMOKE.replace(old, new)


def test_the_paper_has_the_constants_of_its_publication() -> None:
    """arXiv 2507.17506; echo, tree and rollout from its single-target parent, arXiv 2410.17967."""
    paper = load("paper")
    assert (paper.radar.array.n_tx, paper.radar.array.n_rx, paper.radar.array.n_bin, paper.radar.array.power) == (
        100,
        100,
        100,
        1.0,
    )
    assert (paper.dwells, paper.radar.motion.dt_s, paper.radar.motion.sigma_s_km_s2) == (300, 1.0, 0.004)
    assert paper.radar.detector.p_fa == 1e-4  # the threshold is -2 ln p_fa = 18.42
    assert paper.radar.echo.amplitude_db == 60.0
    assert paper.simulated.disturbance.model == "ar6-t"
    assert (paper.radar.belief.n_particle, paper.radar.planner.n_sim) == (12_000, 12_000)
    assert (paper.radar.planner.depth, paper.radar.planner.gamma, paper.radar.planner.rollout_depth) == (2, 0.8, 100)
    assert paper.radar.planner.ucb_c == np.sqrt(2.0)
    assert paper.radar.acquisition.v_max_km_s == 0.35
    states = [[20.0, 0.05, -60.0, 0.01], [60.0, 0.20, 7.5, 0.10], [5.0, 0.05, 60.0, 0.01]]
    np.testing.assert_array_equal(paper.simulated.initial_states(), states)
    assert paper.radar.tracks == 3


@pytest.mark.parametrize("name", [path.stem for path in SCENARIO_DIR.glob("*.toml")])
def test_every_built_in_scenario_is_valid_and_survives_a_round_trip(name: str) -> None:
    scenario = load(name)
    assert scenario.name == name
    assert parse(scenario.model_dump(), source="dump") == scenario  # as RunStart carries it


@pytest.mark.parametrize("fidelity", ["paper", "robust"])
def test_fidelity_fills_what_a_file_leaves_out_and_nothing_else(tmp_path: Path, fidelity: str) -> None:
    file = tmp_path / "s.toml"
    file.write_text(edited('fidelity = "robust"', f'fidelity = "{fidelity}"'))
    scenario = load(str(file)).model_dump()
    for section, filled in FIDELITY[fidelity].items():
        assert {key: scenario["radar"][section][key] for key in filled} == filled
    file.write_text(edited("n_particle = 500", "n_particle = 500\nkernel_bandwidth = 0.125"))
    assert load(str(file)).radar.belief.kernel_bandwidth == 0.125


INTEGER = "must be an integer >= 2 and <= 512"
ARRAY_KEYS = "unknown key (did you mean radar.array.n_tx?), must be one of n_tx, n_rx, n_bin, power"
RCS, ASSUMED = "must be one of constant, swerling1, swerling3", "must be one of known, mean, unknown"
UNKNOWN = ["radar.fidelity=best", "radar.tracks=unknown"]
TABLES = ", ".join(Scenario.model_fields)
STATE = "[50.0, -0.05, 20.0, 0.10]"


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        # unknown key, unknown table
        (
            "n_tx = 16 ",
            "n_tx = 16\nn_ty = 3 #",
            f"radar.array.n_ty = 3: {ARRAY_KEYS}",
        ),
        (
            "[radar.detector]",
            "[sonar]\n[radar.detector]",
            f"sonar: unknown key, must be one of {TABLES}",
        ),
        (
            "n_tx = 16 ",
            'n_tx = 16\n"a\\nb" = 3 #',
            "radar.array.a?b = 3: unknown key, must be one of n_tx, n_rx, n_bin, power",
        ),
        # wrong type: nothing is converted silently
        ("n_tx = 16 ", "n_tx = 16.0 #", f"radar.array.n_tx = 16.0: {INTEGER}"),
        ("n_tx = 16 ", "n_tx = true #", f"radar.array.n_tx = True: {INTEGER}"),
        ("n_tx = 16 ", 'n_tx = "16" #', f"radar.array.n_tx = '16': {INTEGER}"),
        ("dwells = 12", 'dwells = "12"', "dwells = '12': must be an integer >= 1 and <= 1000000"),
        (STATE, '[50.0, "a", 20.0, 0.1]', "world.targets #2, state #2 = 'a': must be a number"),
        # out of range
        ("n_tx = 16 ", "n_tx = 1 #", f"radar.array.n_tx = 1: {INTEGER}"),
        ("gamma = 0.8", "gamma = 1.0", "radar.planner.gamma = 1.0: must be a number >= 0 and < 1"),
        ("p_fa = 1e-4", "p_fa = nan", "radar.detector.p_fa = nan: must be a number >= 1e-09 and <= 0.1"),
        (
            "range_max_km = 200.0",
            "range_max_km = 2.0",
            "radar.acquisition: range_max_km = 2 must be above range_min_km = 5",
        ),
        ('"robust"', '"exact"', "radar.fidelity = 'exact': must be one of paper, robust, best, best-range"),
        ('"barrier"', '"lp"', "radar.allocation.solver = 'lp': must be one of barrier, sdp"),
        ('"ar6-t"', '"ar7"', "world.disturbance.model = 'ar7': must be one of ar6-t, ar3-t, compound-ar6, white"),
        ("[world.disturbance]", '[world]\nrcs = "swerling2"\n[world.disturbance]', f"world.rcs = 'swerling2': {RCS}"),
        ("[world.disturbance]", "[world]\nrcs = 1\n[world.disturbance]", f"world.rcs = 1: {RCS}"),
        ("[radar.belief]", '[radar.assumes]\nrcs = "none"\n[radar.belief]', f"radar.assumes.rcs = 'none': {ASSUMED}"),
        (
            "[radar.belief]",
            "[radar.assumes]\nrsc = 1\n[radar.belief]",
            "radar.assumes.rsc = 1: unknown key (did you mean radar.assumes.rcs?), must be one of rcs",
        ),
        ("[radar.belief]", "[[radar.assumes]]\n[radar.belief]", "radar.assumes = [{}]: must be a table"),
        # targets
        (
            STATE,
            "[80.0, 0.0, -60.0, 0.0]",
            "world.targets #1 and #2 start in the same angle bin 3 of 16, must start in two",  # both at nu = -0.3
        ),
        (
            STATE,
            "[-1.0, 0.0, 5.0, 0.0]",
            "world.targets #2, state = [-1.0, 0.0, 5.0, 0.0]: x must be >= 0: the target is behind the array",
        ),
        (
            STATE,
            "[0.0, 0.0, 0.0, 0.0]",
            "world.targets #2, state = [0.0, 0.0, 0.0, 0.0]: x and y must not both be 0:"
            " the target is at the array itself",
        ),
        (
            STATE,
            "[1e5, 0.0, 5.0, 0.0]",
            "world.targets #2, state = [100000.0, 0.0, 5.0, 0.0]: x and y must be within 10000 km",
        ),
        (
            STATE,
            "[5.0, 0.0, 9.0, -11.0]",
            "world.targets #2, state = [5.0, 0.0, 9.0, -11.0]: vx and vy must be within +-10 km/s",
        ),
        (STATE, "[50.0]", "world.targets #2, state = [50.0]: must be a list of 4"),
        (
            STATE,
            f"{STATE}\nturns = [{{ from_s = 5.0, to_s = 5.0, g = 6.0 }}]",
            "world.targets #2, turns #1: to_s = 5 must be above from_s = 5",
        ),
        (
            STATE,
            f"{STATE}\nturns = [{{ from_s = 0.0, to_s = 5.0, g = 6.0 }}, {{ from_s = 4.0, to_s = 9.0, g = 1.0 }}]",
            "world.targets #2, turns = [{'from_s': 0.0, 'g': 6.0, 'to_s': 5.0}, {'from_s': 4.0, 'g': 1.0, 'to_s': 9.0}]"
            ": #2 begins at 4 s, before #1 ends at 5 s",
        ),
        (
            STATE,
            f"{STATE}\nturns = [{{ from_s = 0.0, to_s = 5.0, g = 21.0 }}]",
            "world.targets #2, turns #1, g = 21.0: must be a number >= -20 and <= 20",
        ),
        # tracks and targets
        ("tracks = 2", "tracks = 3", "radar.tracks = 3: must be the number of world.targets, 2"),
        # missing
        ("n_tx = 16 ", "# ", f"radar.array.n_tx: missing, {INTEGER}"),
        ("[radar.detector]\np_fa = 1e-4 ", "# ", "radar.detector: missing, must be a table"),
        ('fidelity = "robust"', "", "radar.fidelity: missing, must be one of paper, robust, best, best-range"),
        # several: the first is named, an unknown key before all, since a misspelt key is missing as well
        (
            "n_particle = 500\nmax_tries = 100",
            "n_particle = 0\nmax_tries = 0",
            "radar.belief.n_particle = 0: must be an integer >= 10 and <= 1000000 (and 1 more)",
        ),
        (
            "n_tx = 16 ",
            "n_xt = 16 #",
            f"radar.array.n_xt = 16: {ARRAY_KEYS} (and 1 more)",
        ),
    ],
)
def test_what_is_wrong_is_one_line_with_key_value_and_what_is_allowed(
    tmp_path: Path, old: str, new: str, expected: str
) -> None:
    file = tmp_path / "s.toml"
    file.write_text(edited(old, new))
    assert refusal(file) == expected


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"[array\nn_tx = 1", "not valid TOML: Expected ']' at the end of a table declaration (at line 1, column 7)"),
        (b"x = " + b"[" * 5000 + b"]" * 5000, "not valid TOML: nested too deeply"),
        (
            b"\x7fELF\x00\xff\xfe",
            "not valid TOML: 'utf-8' codec can't decode byte 0xff in position 5: invalid start byte",
        ),
        (b"", 'empty; begin with extends = "paper", or see `scenarios --show paper`'),
        (b"\xff\xfen\x00", "not valid TOML: 'utf-8' codec can't decode byte 0xff in position 0: invalid start byte"),
        (b"#" * (2**22 + 1), "larger than 4194304 bytes, too large"),
    ],
)
def test_broken_files(tmp_path: Path, content: bytes, expected: str) -> None:
    file = tmp_path / "s.toml"
    file.write_bytes(content)
    assert refusal(file) == expected


def test_an_integer_of_thousands_of_digits_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "s.toml"
    file.write_text(edited("n_tx = 16 ", f"n_tx = {'1' * 5000} #"))
    assert refusal(file).startswith("not valid TOML: ")
    file.write_text(edited("n_tx = 16 ", f"n_tx = 0x{'1' * 5000} #"))
    assert refusal(file) == f"radar.array.n_tx = (too large to show): {INTEGER}"


def test_files_that_are_not_there_or_no_files(tmp_path: Path) -> None:
    known = ", ".join(sorted(path.stem for path in SCENARIO_DIR.glob("*.toml")))
    for missing in ("nowhere", str(tmp_path / "nowhere.toml")):
        with pytest.raises(ScenarioError) as caught:
            load(missing)
        assert str(caught.value) == f"{missing}: no such scenario or .toml file; the built-in ones are: {known}"
    folder = tmp_path / "folder.toml"
    folder.mkdir()
    assert refusal(folder) == "not a regular file"
    for odd in ("", "a\0b.toml", "x" * 5000 + ".toml", "a\nb"):
        with pytest.raises(ScenarioError) as caught:
            load(odd)
        assert str(caught.value).isprintable()


def test_the_source_is_named_for_documents_that_are_no_files() -> None:
    document: dict[str, Any] = tomllib.loads(SMOKE)
    document["radar"]["array"]["n_rx"] = 0
    with pytest.raises(ScenarioError, match=r"^scenario: radar\.array\.n_rx = 0: must be an integer >= 2 and <= 512$"):
        parse(document, source="scenario")


def sized(**sizes: int) -> dict[str, Any]:
    """The smoke scenario with other sizes."""
    document: dict[str, Any] = tomllib.loads(SMOKE)
    for section, key in (("array", "n_bin"), ("belief", "n_particle"), ("planner", "n_sim")):
        document["radar"][section][key] = sizes.get(key, document["radar"][section][key])
    return document


def test_a_planner_s_memory_is_limited_by_all_that_it_depends_on() -> None:
    """Each key at its own limit is fine with the others as they are."""
    for allowed in ({"n_sim": 10_000_000, "n_bin": 3}, {"n_bin": 1024}, {"n_particle": 1_000_000}):
        parse(sized(**allowed), source="s")
    with pytest.raises(ScenarioError) as caught:
        parse(sized(n_sim=10_000_000, n_bin=1024, n_particle=1_000_000), source="s")
    assert str(caught.value) == (
        "s: radar: a planner would need 123.76 GB for its search tree (planner.n_sim = 10000000, array.n_bin = 1024)"
        " and 0.45 GB for the beliefs (belief.n_particle = 1000000, tracks = 2), must be at most 2 GB together"
    )


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
    document = sized()
    document["radar"]["planner"] |= {"looks": looks} if looks else {}
    document["radar"]["allocation"] |= allocation
    assert parse(document, source="s").radar.allocation.objective == expected


def test_looks_objective_and_solver_must_go_together() -> None:
    document = sized()
    document["radar"]["planner"]["looks"] = "joint"
    document["radar"]["allocation"]["objective"] = "max-min"
    with pytest.raises(ScenarioError, match=r'^s: radar: planner\.looks = "joint": allocation\.objective must be'):
        parse(document, source="s")
    document["radar"]["allocation"] = {"objective": "urgency", "solver": "sdp"}
    with pytest.raises(ScenarioError, match=r'^s: radar: allocation\.solver = "sdp": solves "max-min" only'):
        parse(document, source="s")
    document["radar"]["allocation"] = {"objective": "most", "solver": "barrier"}
    with pytest.raises(ScenarioError, match="must be one of max-min, detections, urgency"):
        parse(document, source="s")


def test_only_joint_looks_are_widened_and_they_are_unless_it_is_said() -> None:
    document = sized()
    assert not parse(document, source="s").radar.planner.wide_looks
    document["radar"]["planner"]["looks"] = "joint"
    assert parse(document, source="s").radar.planner.wide_looks
    document["radar"]["planner"]["wide_looks"] = False
    assert not parse(document, source="s").radar.planner.wide_looks
    document["radar"]["planner"] |= {"looks": "single", "wide_looks": True}
    with pytest.raises(ScenarioError, match=r'^s: radar: planner\.wide_looks = true: planner\.looks must be "joint"'):
        parse(document, source="s")


def test_a_rule_that_knows_the_truth_leaves_no_cells_to_choose_among() -> None:
    document = sized()
    document["radar"]["planner"] |= {"rule": "oracle", "looks": "joint"}
    with pytest.raises(ScenarioError, match=r'^s: radar: planner\.rule = "oracle": .* planner\.looks must be "single"'):
        parse(document, source="s")
    document["radar"]["planner"]["looks"] = "single"
    assert parse(document, source="s").radar.planner.rule == "oracle"


def test_the_beliefs_of_many_targets_are_limited_together() -> None:
    def crowded(n_target: int) -> dict[str, Any]:
        angles = np.linspace(-1.2, 1.2, n_target)
        states = [[50 * np.cos(angle), 0.0, 50 * np.sin(angle), 0.0] for angle in angles]
        document = sized(n_bin=400, n_particle=1_000_000)
        document["radar"]["tracks"], document["world"]["targets"] = n_target, [{"state": state} for state in states]
        return document

    few = (MAX_PLANNER_BYTES - beliefs_bytes(1_000_000, 0)) // (
        beliefs_bytes(1_000_000, 1) - beliefs_bytes(1_000_000, 0)
    )
    assert parse(crowded(few - 1), source="s").radar.tracks == few - 1
    with pytest.raises(ScenarioError, match=rf"1000000, tracks = {few + 1}\), must be at most 2 GB together$"):
        parse(crowded(few + 1), source="s")


def test_every_fault_of_a_file_has_a_line(tmp_path: Path) -> None:
    file = tmp_path / "s.toml"
    file.write_text(edited("n_tx = 16 ", "n_xt = 16 #").replace("gamma = 0.8", "gamma = 2"))
    with pytest.raises(ScenarioError) as caught:
        load(str(file))
    assert caught.value.faults == (
        f"{file}: radar.array.n_xt = 16: {ARRAY_KEYS}",
        f"{file}: radar.array.n_tx: missing, {INTEGER}",
        f"{file}: radar.planner.gamma = 2: must be a number >= 0 and < 1",
    )
    assert str(caught.value) == f"{caught.value.faults[0]} (and 2 more)"
    with pytest.raises(ScenarioError) as caught:
        load("nowhere")
    assert caught.value.faults == (str(caught.value),)


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (
            ["radar.tracks=unknown"],
            'radar: tracks = "unknown": receiver.cells must be "steered", is "bins"; radar.fidelity = "best"',
        ),
        (["radar.max_tracks=7"], 'radar: tracks = 2: max_tracks must be left out, need tracks = "unknown"'),
        (
            [
                "radar.initiation={confirmations=2,window=3,false_tracks_per_hour=1.0}",
                'radar.search={share="auto",beams=2,pattern="swept"}',
            ],
            'radar: tracks = 2: search and initiation must be left out, need tracks = "unknown"',
        ),
        ([*UNKNOWN, "radar.search.share=1.0"], 'radar.search.share=1.0: must be a number > 0 and < 1 or "auto"'),
        ([*UNKNOWN, "radar.search.share=all"], 'radar.search.share=all: must be a number > 0 and < 1 or "auto"'),
        (
            [*UNKNOWN, "radar.initiation.confirmations=4"],
            "radar.initiation: confirmations = 4: must be at most window, 3",
        ),
        ([*UNKNOWN, "radar.max_tracks=0"], "radar.max_tracks=0: must be an integer >= 1 and <= 300"),
    ],
)
def test_what_tracks_of_an_unknown_number_need_and_others_must_not_have(settings: list[str], expected: str) -> None:
    """With other faults in the document it is said as well."""
    with pytest.raises(ScenarioError) as caught:
        load("smoke", settings)
    assert expected in str(caught.value)
    if "left out" in expected or "at most window" in expected:
        window = [] if "left out" in expected else ["radar.initiation.window=3"]
        with pytest.raises(ScenarioError) as caught:
            load("smoke", [*settings, *window, "radar.planner.gamma=2"])
        assert any(expected in fault for fault in caught.value.faults)


def test_the_most_tracks_there_may_be() -> None:
    assert [load("smoke", UNKNOWN + more).radar.most_tracks for more in ([], ["radar.max_tracks=7"])] == [100, 7]
    known = load("smoke").radar
    assert (known.most_tracks, known.max_tracks) == (2, None)
    assert RadarConfig.model_validate(known.model_dump()) == known


def test_the_world_is_as_the_radar_assumes_unless_it_is_said() -> None:
    document: dict[str, Any] = tomllib.loads(SMOKE)
    as_assumed = parse(document, source="s").simulated
    assert (as_assumed.motion.sigma_s_km_s2, as_assumed.echo.amplitude_db) == (0.004, 70.0)
    document["world"]["motion"] = {"sigma_s_km_s2": 0.1}
    other = parse(document, source="s")
    assert (other.simulated.motion.sigma_s_km_s2, other.simulated.echo.amplitude_db) == (0.1, 70.0)
    assert other.radar == parse(tomllib.loads(SMOKE), source="s").radar


def test_a_real_front_end_has_no_world() -> None:
    document: dict[str, Any] = tomllib.loads(SMOKE)
    del document["world"]
    scenario = parse(document, source="s")
    assert scenario.world is None
    assert parse(scenario.model_dump(), source="dump") == scenario
    with pytest.raises(ValueError, match=r"smoke has no \[world\]"):
        _ = scenario.simulated


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
