"""Scenario files: the values of the paper, and one line for everything that can be wrong with a file."""

import re
import tomllib
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cogradar.shared.scenario.cross_checks import check_apart
from cogradar.shared.scenario.files import SCENARIO_DIR, ScenarioError, load, parse
from cogradar.shared.scenario.limits import MAX_PLANNER_BYTES, beliefs_bytes
from cogradar.shared.scenario.plugins.names import names_of
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scenario.tables import DISTURBANCES, FIDELITY

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


def test_a_site_may_have_a_date_of_toml() -> None:
    place = ["site.latitude_deg=1.0", "site.longitude_deg=0.0", "site.boresight_deg=0.0"]
    for text in ("2026-01-01T12:00:00Z", '"2026-01-01T12:00:00Z"', "2026-01-01T13:00:00+01:00"):
        site = load("smoke", [*place, f"site.begin_utc={text}"]).site
        assert site is not None
        assert (site.begin_utc, site.begin_s) == ("2026-01-01T12:00:00Z", 1767268800.0)


@pytest.mark.parametrize("fidelity", ["paper", "robust"])
def test_fidelity_fills_what_a_file_leaves_out_and_nothing_else(tmp_path: Path, fidelity: str) -> None:
    file = tmp_path / "s.toml"
    file.write_text(edited('fidelity = "robust"', f'fidelity = "{fidelity}"'))
    scenario = load(str(file)).model_dump()
    said = {"belief": {"n_particle": 500}}  # in the file
    for section, filled in FIDELITY[fidelity].items():
        assert {key: scenario["radar"][section][key] for key in filled} == filled | said.get(section, {})
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
        # where the radar is
        (
            "[radar.detector]",
            "[site]\nlatitude_deg = 91.0\nlongitude_deg = 0.0\nboresight_deg = 0.0\n[radar.detector]",
            "site.latitude_deg = 91.0: must be a number >= -90 and <= 90",
        ),
        (
            "[radar.detector]",
            "[site]\nlatitude_deg = 1.0\nlongitude_deg = 0.0\n[radar.detector]",
            "site.boresight_deg: missing, must be a number >= 0 and <= 360",
        ),
        (
            "[radar.detector]",
            '[site]\nlatitude_deg = 1.0\nlongitude_deg = 0.0\nboresight_deg = 0.0\nbegin_utc = "2026-02-30T00:00:00Z"\n'
            "[radar.detector]",
            "site.begin_utc = '2026-02-30T00:00:00Z': must be a date and a time of day that exist, from 1970 to 2199",
        ),
        (
            "[radar.detector]",
            "[site]\nlatitude_deg = 1.0\nlongitude_deg = 0.0\nboresight_deg = 0.0\nbegin_utc = '9999-12-31T23:59:59Z'\n"
            "[radar.detector]",
            "site.begin_utc = '9999-12-31T23:59:59Z': must be a date and a time of day that exist, from 1970 to 2199",
        ),
        (
            "[radar.detector]",
            "[site]\nlatitude_deg = 1.0\nlongitude_deg = 0.0\nboresight_deg = 0.0\nbegin_utc = 7\n[radar.detector]",
            'site.begin_utc = 7: must be UTC of clock 0, "YYYY-MM-DDThh:mm:ssZ"; left out: the time of a dwell is not'
            " stated",
        ),
        # wrong type: nothing is converted silently
        ("n_tx = 16 ", "n_tx = 16.0 #", f"radar.array.n_tx = 16.0: {INTEGER}"),
        ("n_tx = 16 ", "n_tx = true #", f"radar.array.n_tx = True: {INTEGER}"),
        ("n_tx = 16 ", 'n_tx = "16" #', f"radar.array.n_tx = '16': {INTEGER}; write 16, without quotes and unit"),
        ("dwells = 12", 'dwells = "12"', "dwells = '12': must be an integer >= 1 and <= 1000000 or \"unlimited\""),
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
        (
            '"ar6-t"',
            '"ar7"',
            f"world.disturbance.model = 'ar7': must be one of {names_of(DISTURBANCES)}",
        ),
        ("[world.disturbance]", '[world]\nrcs = "swerling2"\n[world.disturbance]', f"world.rcs = 'swerling2': {RCS}"),
        ("[world.disturbance]", "[world]\nrcs = 1\n[world.disturbance]", f"world.rcs = 1: {RCS}"),
        ("[radar.belief]", '[radar.assumes]\nrcs = "none"\n[radar.belief]', f"radar.assumes.rcs = 'none': {ASSUMED}"),
        (
            "[radar.belief]",
            "[radar.assumes]\nrsc = 1\n[radar.belief]",
            "radar.assumes.rsc = 1: unknown key (did you mean radar.assumes.rcs?), must be one of rcs, height_max_km",
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
        (b"\x7fELF\x00\n\xff\xfe", "line 2: byte 0xff is no UTF-8: save the file as UTF-8"),
        (b"", 'empty; begin with extends = "paper", or see `scenarios --show paper`'),
        (b"\xff\xfen\x00", "line 1: byte 0xff is no UTF-8: save the file as UTF-8"),
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


def test_a_target_without_a_state_is_one_fault_and_not_a_message_of_numpy(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    targets = "[[world.targets]]\ngone_s = 10.0\n[[world.targets]]\nstate = [20.0, 0.05, 5.0, 0.1]\n"
    file.write_text(f'extends = "smoke"\n{targets}')
    with pytest.raises(ScenarioError) as raised:
        load(str(file))
    (fault,) = raised.value.faults
    said = "must have state or trajectory, has neither: set state = [x, vx, y, vy], in km and km/s"
    assert fault == f"{file}: world.targets #1: {said}"


@pytest.mark.parametrize("key", ["radar.tracks", "radar.array.n_bin", "radar.planner.n_sim"])
def test_a_number_beyond_all_numbers_has_a_line(key: str) -> None:
    document = load("smoke").model_dump()
    *tables, last = key.split(".")
    table = document
    for name in tables:
        table = table[name]
    table[last] = 10**400
    with pytest.raises(ScenarioError, match=f"{key} = "):
        parse(document, source="mine")


def test_a_real_front_end_has_no_world() -> None:
    document: dict[str, Any] = tomllib.loads(SMOKE)
    del document["world"]
    scenario = parse(document, source="s")
    assert scenario.world is None
    assert parse(scenario.model_dump(), source="dump") == scenario
    with pytest.raises(ValueError, match=r"smoke has no \[world\]"):
        _ = scenario.simulated


@pytest.mark.parametrize(
    ("cells", "must"), [("bins", "in two"), ("steered", '2 bins apart with receiver.cells = "steered"')]
)
def test_targets_at_both_ends_start_in_one_direction(cells: str, must: str) -> None:
    states = {0: [1.0, 0.0, -40.0, 0.0], 1: [20.0, 0.0, 0.0, 0.0], 2: [1.0, 0.0, 40.0, 0.0]}
    said = f"world.targets #1 and #3 start in angle bins 0 and 15 of 16, must start {must}: bins at both ends are one"
    with pytest.raises(ValueError, match=re.escape(said)):
        check_apart(states, 16, cells, 3)
    check_apart(states, 16, cells, "unknown")


def test_a_date_before_all_dates_of_python_is_a_fault() -> None:
    document = load("smoke").model_dump() | {
        "site": {
            "latitude_deg": 1.0,
            "longitude_deg": 0.0,
            "boresight_deg": 0.0,
            "begin_utc": datetime(1, 1, 1, tzinfo=timezone(timedelta(hours=14))),
        }
    }
    with pytest.raises(ScenarioError, match="must be a date and a time of day that exist, from 1970 to 2199"):
        parse(document, source="early")
