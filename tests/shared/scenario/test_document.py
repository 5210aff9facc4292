"""Scenario files that extend others, settings on top, and scenarios written out."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cogradar.shared.scenario.document import MAX_CHAIN, read
from cogradar.shared.scenario.files import ScenarioError, built_in, load, written
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scenario.trajectories.csv_files import trajectory


def refusal(name: str, *settings: str) -> tuple[str, ...]:
    with pytest.raises(ScenarioError) as caught:
        load(name, settings)
    assert all(line.isprintable() for line in caught.value.faults)
    return caught.value.faults


def saved(folder: Path, **files: str) -> dict[str, str]:
    """Files with a text each; returns their paths."""
    for name, text in files.items():
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")
    return {name: str(folder / f"{name}.toml") for name in files}


def changed(scenario: Scenario, **changes: Any) -> Scenario:
    """The scenario with other values; keys with __ for a dot."""
    document = scenario.model_dump()
    for key, value in changes.items():
        *tables, last = key.split("__")
        place = document
        for table in tables:
            place = place[table]
        place[last] = value
    return Scenario.model_validate(document)


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("night", "night"),
        ("Paris_2018 evening", "paris-2018-evening"),
        ("a" * 30, "a" * 20),
        ("b" * 19 + "_c", "b" * 19),
        ("é", "smoke"),
    ],
)
def test_a_scenario_is_named_after_its_file_as_far_as_a_name_may(tmp_path: Path, file: str, name: str) -> None:
    """Runs of two skies of one base are told apart."""
    assert load(str(saved(tmp_path, **{file: 'extends = "smoke"\n'})[file])).name == name


def test_a_file_has_what_it_leaves_out_from_the_one_that_it_extends(tmp_path: Path) -> None:
    (tmp_path / "inner").mkdir()
    base = saved(tmp_path, base='extends = "smoke"\n[radar.array]\nn_tx = 8\nn_bin = 12\n')["base"]
    child = saved(tmp_path / "inner", child='extends = "../base.toml"\ndwells = 3\n[radar.array]\nn_tx = 4\n')["child"]
    as_base = changed(load("smoke"), name="base", radar__array__n_tx=8, radar__array__n_bin=12)
    assert load(base) == as_base
    assert load(child) == changed(as_base, name="child", dwells=3, radar__array__n_tx=4)


def test_fidelity_and_the_world_are_filled_in_when_all_is_together(tmp_path: Path) -> None:
    text = 'extends = "paper"\n[radar]\nfidelity = "paper"\necho.amplitude_db = 50.0\n'
    scenario = load(saved(tmp_path, one=text)["one"])
    assert scenario.radar.belief.filter == "published"
    assert scenario.simulated.echo.amplitude_db == 50.0
    assert scenario.radar == changed(load("paper-literal"), radar__echo__amplitude_db=50.0).radar


def test_a_list_is_replaced_as_a_whole(tmp_path: Path) -> None:
    text = 'extends = "paper"\nradar.tracks = 1\n[[world.targets]]\nstate = [9.0, 0.0, 1.0, 0.0]\n'
    assert [t.state for t in load(saved(tmp_path, one=text)["one"]).simulated.targets] == [[9.0, 0.0, 1.0, 0.0]]


def test_a_byte_order_mark_is_no_part_of_a_file(tmp_path: Path) -> None:
    file = saved(tmp_path, one='\ufeffextends = "smoke"\nname = "marked"\n')["one"]
    assert load(file) == changed(load("smoke"), name="marked")


def test_a_fault_is_of_the_file_that_says_it(tmp_path: Path) -> None:
    files = saved(
        tmp_path,
        base='extends = "smoke"\n[radar.array]\nn_tx = 1\n',
        child='extends = "base.toml"\n[radar.array]\nn_rx = 1\n[radar]\ntracks = 3\n',
    )
    integer = "must be an integer >= 2 and <= 512"
    assert refusal(files["child"]) == (
        f"{files['base']}: radar.array.n_tx = 1: {integer}",
        f"{files['child']}: radar.array.n_rx = 1: {integer}",
        f"{files['child']}: radar.tracks = 3: must be the number of world.targets, 2",  # although there are others
    )


def test_a_world_misses_nothing_of_a_radar_that_is_no_table(tmp_path: Path) -> None:
    """What it leaves out is as the radar assumes, which is unknown: only the key `radar` is at fault."""
    files = saved(tmp_path, mine='extends = "smoke"\nradar = 5\n')
    assert refusal(files["mine"]) == (f"{files['mine']}: radar = 5: must be a table",)


def test_what_was_probably_meant_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    saved(tmp_path, mine='extends = "smoke"\n')
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hello.txt").touch()
    assert refusal(str(tmp_path / "hello.txt"))[0].endswith(
        "is there, but no scenario's file, whose name ends in .toml"
    )
    assert refusal("papr")[0].startswith("papr: no such scenario or .toml file (did you mean paper?); the built-in")
    assert "(did you mean mine.toml?)" in refusal("mine")[0]
    assert f"(did you mean {tmp_path}/mine.toml?)" in refusal(f"{tmp_path}/mime.toml")[0]
    assert "did you mean" not in refusal("zzz")[0]
    for name, leads_to in (("gone.toml", "nowhere.toml"), ("loop.toml", "loop.toml")):
        (tmp_path / name).symlink_to(leads_to)
        assert refusal(name) == (f"{name}: a symbolic link that leads to no file",)
    assert refusal(str(tmp_path)) == (
        f"{tmp_path}: a directory, must be a .toml file or the name of a built-in scenario",
    )


def test_every_fault_is_named_at_once(tmp_path: Path) -> None:
    """Those of settings without a place, and checks that the other faults would hide."""
    file = saved(
        tmp_path,
        bad="""extends = "smoke"
        [radar]
        tracks = 3
        [radar.acquisition]
        range_min_km = 500.0
        v_max_km_s = -1.0
        [[world.targets]]
        state = [40.0, 0.0, 0.0, 0.0]
        [[world.targets]]
        state = [50.0, 0.0, 0.0, 0.0]
        colour = "red"
        """,
    )["bad"]
    with pytest.raises(ScenarioError, match=r"\(and 7 more\)$") as caught:
        load(str(file), ["speed", "world.targets.9.state=3"], ["radar.array.n_tx=1"])
    assert caught.value.faults == (
        "--set speed: must be KEY=VALUE, such as radar.array.n_tx=32 or world.targets.2.state=[60.0, 0.2, 7.5, 0.1]",
        "--set world.targets.9.state=3: world.targets has no entry 9, must be 1 to 2",
        f"{file}: radar.acquisition.v_max_km_s = -1.0: must be a number > 0 and <= 10",
        f"{file}: radar.acquisition: range_max_km = 200 must be above range_min_km = 500",
        f"{file}: world.targets #2, colour = 'red': unknown key, must be one of state, trajectory, height_km,"
        " born_s, gone_s, turns, sigma_s_km_s2, rcs_db, rcs, stays",
        "--over radar.array.n_tx=1: must be an integer >= 2 and <= 512",
        f"{file} --over radar.array.n_tx=1: radar.tracks = 3: must be the number of world.targets, 2",
        f"{file} --over radar.array.n_tx=1: world.targets #1 and #2 start in the same angle bin 8 of 16, must start in"
        " two",
    )


def test_chains_that_lead_nowhere(tmp_path: Path) -> None:
    known = ", ".join(built_in())
    files = saved(
        tmp_path,
        orphan='extends = "none-such"\n',
        lost='extends = "gone/a.toml"\n',
        odd="extends = 3\n",
        a='extends = "b.toml"\n',
        b='extends = "./a.toml"\n',
        **{f"long{i}": f'extends = "long{i + 1}.toml"\n' for i in range(MAX_CHAIN + 1)},
    )
    for name, wanted in (("orphan", "none-such"), ("lost", "gone/a.toml")):
        none = f"no such scenario or .toml file; the built-in ones are: {known}"
        assert refusal(files[name]) == (f"{files[name]}: extends = '{wanted}': {none}",)
    what = "must be the name of a built-in scenario or the path of a .toml file"
    assert refusal(files["odd"]) == (f"{files['odd']}: extends = 3: {what}",)
    assert refusal(files["a"]) == (f"{files['b']}: extends = './a.toml': extends itself: a.toml -> b.toml -> a.toml",)
    last = files[f"long{MAX_CHAIN - 1}"]
    long = f"{last}: extends = 'long{MAX_CHAIN}.toml': the chain is too long, must be at most {MAX_CHAIN} files"
    assert refusal(files["long0"]) == (long,)


@pytest.mark.parametrize(
    ("wanted", "meant"),
    [
        ("papr", "paper"),
        ("paper.toml", "paper"),  # a built-in one, which is no file here
        ("base", "base.toml"),
        ("bse.toml", "base.toml"),
        ("mine", ""),  # its own file would extend itself
    ],
)
def test_what_is_extended_and_is_not_there_is_guessed(wanted: str, meant: str, tmp_path: Path) -> None:
    files = saved(tmp_path, mine=f'extends = "{wanted}"\n', base='extends = "paper"\n')
    (line,) = refusal(files["mine"])
    assert line.startswith(f"{files['mine']}: extends = '{wanted}': no such scenario or .toml file")
    assert (f"(did you mean {meant}?)" in line) is bool(meant), line
    assert ("did you mean" in line) is bool(meant), line


def test_the_rule_of_an_option_is_named_as_it_was_given() -> None:
    with pytest.raises(ScenarioError, match=r"^--rule mod: must be one of pomcp, mode, .*; did you mean mode\?$"):
        load("smoke", rule="mod")
    with pytest.raises(ScenarioError, match=r"^--rule no\.py:x: no\.py: No such file or directory$"):
        load("smoke", rule="no.py:x")


def test_settings_go_on_top_of_everything() -> None:
    settings = [
        "radar.array.n_tx=32",
        "radar.fidelity=paper",
        "name = other",
        "world.targets.2.state=[50, 0.0, 21.5, 0.0]",
        "world.targets.2.state.2=0.25",
        "world.motion.sigma_s_km_s2=0.01",
        "world.disturbance.model='white'",
    ]
    scenario = load("smoke", settings)
    assert (scenario.name, scenario.radar.array.n_tx, scenario.radar.belief.filter) == ("other", 32, "published")
    assert scenario.simulated.targets[1].state == [50, 0.25, 21.5, 0.0]
    assert scenario.simulated.motion.sigma_s_km_s2 == 0.01
    assert scenario.simulated.disturbance.model == "white"
    assert load("smoke", ["radar.array.n_tx=8", "radar.array.n_tx=32"]).radar.array.n_tx == 32


@pytest.mark.parametrize(
    ("setting", "expected"),
    [
        ("radar.array.n_tx=abc", "must be an integer >= 2 and <= 512"),
        ("radar.array.n_tx=1\nx = 2", "must be an integer >= 2 and <= 512"),
        ("radar.fidelity=exact", "must be one of paper, robust, best, best-range"),
        ("world.targets.2.state=[1.0]", "must be a list of 4"),
        (
            "n_tx=3",
            "unknown key (did you mean radar.array.n_tx?), must be one of name, title, dwells, radar, world, site",
        ),
        (
            "radra.tracks=3",
            "radra: unknown key (did you mean radar?), must be one of name, title, dwells, radar, world, site",
        ),
        ("world.targets.9.state=[1.0]", "world.targets has no entry 9, must be 1 to 2"),
        ("world.targets.0.state=[1.0]", "world.targets has no entry 0, must be 1 to 2"),
        ("dwells.x=3", "dwells is no table"),
        (
            "world.targets.1.state.1=-5.0",
            "world.targets #1, state = [-5.0, 0.1, -30.0, 0.05]: x must be >= 0: the target is behind the array",
        ),
    ],
)
def test_a_setting_that_makes_no_sense(setting: str, expected: str) -> None:
    assert refusal("smoke", setting) == (f"--set {setting}: {expected}".replace("\n", "?"),)


@pytest.mark.parametrize("setting", ["", "x", "=3", "a..b=3", ".=1"])
def test_a_setting_that_is_none(setting: str) -> None:
    (line,) = refusal("smoke", setting)
    assert line.startswith(f"--set {setting}: must be KEY=VALUE, such as radar.array.n_tx=32")


def test_what_no_single_value_decides_names_the_file_and_the_settings() -> None:
    (line,) = refusal("smoke", "world.targets=[{state=[40.0, 0.1, -30.0, 0.05]}]")
    assert line.endswith("smoke.toml --set world.targets=[{state=[40.0, 0.1, -30.0, 0.05]}]: radar.tracks = 2: must be"
                         " the number of world.targets, 1")  # fmt: skip


@pytest.mark.parametrize("name", built_in())
def test_a_scenario_that_is_written_out_is_the_same_scenario(name: str, tmp_path: Path) -> None:
    text = written(load(name), read(name).files)
    assert load(saved(tmp_path, again=text)["again"]) == load(name)
    assert "kernel_bandwidth = " in text  # also what the file leaves out
    assert "extends" not in text


def test_comments_stay_beside_values_that_stay() -> None:
    text = written(load("paper-literal", ["radar.array.n_tx=32"]), read("paper-literal").files)
    assert text.startswith("# The paper's scenario with the published algorithm")
    assert "n_rx = 100            # receive antennas; n_tx * n_rx = 10^4 virtual channels" in text
    assert "\nn_tx = 32\n" in text
    assert 'filter = "published"  # from fidelity\n' in text


def test_odd_texts_survive(tmp_path: Path) -> None:
    odd = changed(load("smoke"), title='a "quoted" \\ # title \x7f \t \U0001f6e9 \u00fc')
    assert load(saved(tmp_path, odd=written(odd))["odd"]) == odd


def test_trajectory_files_are_read_no_further_than_there_may_be_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of all files together; what follows is not looked at."""
    monkeypatch.setattr("cogradar.shared.scenario.files.MAX_ROWS", 5)
    rows = [f"{t},{10 + t},{t}" for t in range(3)]
    for name, more in (("one", []), ("two", ["nonsense"])):
        (tmp_path / f"{name}.csv").write_text("\n".join(["t_s,x_km,y_km", *rows, *more]))
    targets = "".join(f'[[world.targets]]\ntrajectory = "{name}.csv"\n' for name in ("one", "two"))
    file = saved(tmp_path, sky=f'extends = "smoke"\n{targets}')["sky"]
    (fault,) = refusal(file)
    assert fault.endswith("two.csv: line 4: trajectories must have at most 100000 rows together")


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ("0,10,10\n\n0,10,11\n", "line 4: t_s = 0 must be above 0, the time of line 2"),
        ("0,10,10\n1,10,20000\n", "line 3: x_km and y_km must be within 10000 km, t_s within 1e+06 s"),
        ("0,10,10\n", "has 1 rows of numbers, must have at least 2"),
        ("0,10,10\n1,10\n", "line 3, '1,10': must be 3 numbers, t_s,x_km,y_km"),
    ],
)
def test_what_is_wrong_with_a_trajectory_is_said_with_its_line(rows: str, expected: str, tmp_path: Path) -> None:
    file = tmp_path / "flown.csv"
    file.write_text(f"t_s,x_km,y_km\n{rows}")
    with pytest.raises(ScenarioError) as raised:
        trajectory(file, 100)
    assert str(raised.value) == f"{file}: {expected}"


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ("0,10,10,1\n1,10,10,101\n", "line 3: z_km = 101: must be 0 .. 100"),
        ("0,10,10,-1\n1,10,10,1\n", "line 2: z_km = -1: must be 0 .. 100"),
        ("0,10,10,1\n1,10,10\n", "line 3, '1,10,10': must be 4 numbers, t_s,x_km,y_km,z_km"),
    ],
)
def test_what_is_wrong_with_heights_of_a_trajectory(rows: str, expected: str, tmp_path: Path) -> None:
    file = tmp_path / "flown.csv"
    file.write_text(f"t_s,x_km,y_km,z_km\n{rows}")
    with pytest.raises(ScenarioError) as raised:
        trajectory(file, 100)
    assert str(raised.value) == f"{file}: {expected}"
    file.write_text("t_s,x_km,y_km,z_km\n0,10,10,1\n1,10,10,2\n")
    assert trajectory(file, 100).tolist() == [[0.0, 10.0, 10.0, 1.0], [1.0, 10.0, 10.0, 2.0]]


def test_rows_of_a_trajectory_have_heights_all_or_none_and_no_other_height(tmp_path: Path) -> None:
    def said(rows: str, more: str = "") -> str:
        text = f'extends = "smoke"\n[[world.targets]]\ntrajectory = {rows}\n{more}'
        return refusal(saved(tmp_path, sky=text)["sky"])[0]

    assert "row 2: all rows must have z_km, or none of them" in said("[[0, 9, 9, 1.5], [1, 9, 9]]")
    mixed = said("[[0, 9, 9, 1.5], [1, 9, 9, 1.5]]", "height_km = 3.0\n")
    assert "height_km: means nothing with a trajectory that has z_km" in mixed


@pytest.mark.parametrize("form", ["trajectory = {}", "  trajectory={}  ", "trajectory = {}  # of a recording"])
def test_many_rows_on_one_line_are_read_however_the_line_is_written(form: str, tmp_path: Path) -> None:
    rows = [[float(i), 10.0 + i * 1e-3, 10.0] for i in range(9000)]
    text = f'extends = "smoke"\n[radar]\ntracks = 1\n[[world.targets]]\n{form.format(rows)}\n'
    world = load(saved(tmp_path, sky=text)["sky"]).world
    assert world is not None
    assert np.array(world.targets[0].trajectory).tolist() == rows
