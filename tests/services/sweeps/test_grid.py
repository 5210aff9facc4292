"""The grid of a sweep: what is typed, and the scenarios that it makes."""

import pytest

from cogradar.services.errors import BadInput
from cogradar.services.sweeps.grid import Axis, axis, baseline, variants
from cogradar.shared.scenario.files import ScenarioError, load


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("radar.array.n_tx=16, 32,64", ("16", "32", "64")),
        ("radar.fidelity=paper,robust", ("paper", "robust")),
        ("title='a,b',\"c\"", ("'a,b'", '"c"')),
        ("world.targets.2.state=[60.0, 0.2, 7.5, 0.1],[70, 0, 7, 0]", ("[60.0, 0.2, 7.5, 0.1]", "[70, 0, 7, 0]")),
        ("a.b={x = 1, y = [2, 3]},4", ("{x = 1, y = [2, 3]}", "4")),
    ],
)
def test_values_are_parted_by_commas_that_are_not_their_own(text: str, values: tuple[str, ...]) -> None:
    assert axis(text) == Axis((text.partition("=")[0],), values)


@pytest.mark.parametrize(
    "text", ["radar.array.n_tx", "=1,2", "radar.array.n_tx=", "radar.array.n_tx=1,,2", "a=1,1", "a,=1", ",a=1"]
)
def test_what_is_no_axis_is_one_line(text: str) -> None:
    with pytest.raises(BadInput, match=r"^--over "):
        axis(text)


def test_every_combination_is_a_scenario_with_a_name_of_its_own() -> None:
    grid = variants("smoke", ["radar.array.n_rx=8"], [axis("radar.array.n_tx=8,16"), axis("dwells=20,30,40")])
    assert [variant.values for variant in grid] == [(n, t) for n in ("8", "16") for t in ("20", "30", "40")]
    assert [variant.scenario.name for variant in grid] == [f"smoke-{i}" for i in range(1, 7)]
    assert [(variant.scenario.radar.array.n_tx, variant.scenario.dwells) for variant in grid][3] == (16, 20)
    assert {variant.scenario.radar.array.n_rx for variant in grid} == {8}
    assert grid[0].scenario.world == load("smoke").world
    assert grid[3].scenario.title == "radar.array.n_tx = 16, dwells = 20"  # what report and figures say of it


def test_a_long_name_leaves_room_for_the_number() -> None:
    (variant,) = variants("smoke", ["name=a-name-of-20-letters"], [axis("dwells=20")])
    assert variant.scenario.name == "a-name-of-20-le-1"


@pytest.mark.parametrize(
    ("over", "why"),
    [
        ([], "must be KEY=VALUE"),
        (["dwells=20", "dwells=30"], "--over dwells: must be on one axis only"),
        (["radar.array.n_tx,dwells=20", "dwells=30"], "--over dwells: must be on one axis only"),
        (["dwells,dwells=20"], "--over dwells: must be on one axis only"),
        (["name=a,b"], "--over name: must be a setting of the radar or the world"),
        (["dwells,title=a,b"], "--over title: must be a setting of the radar or the world"),
        (["dwells=" + ",".join(map(str, range(1, 1002)))], "1001 combinations, must be at most 1000"),
        (4 * ["{}=1,2,3,4,5,6"], "1296 combinations, must be at most 1000"),
    ],
)
def test_a_grid_that_cannot_be_is_refused(over: list[str], why: str) -> None:
    with pytest.raises(BadInput, match=why):
        variants("smoke", (), [axis(text.format(f"key{i}")) for i, text in enumerate(over)])


def test_three_axes_of_which_one_links_keys() -> None:
    """Every value of one is with every value of the others; linked keys have the same value."""
    over = ["world.echo.amplitude_db,radar.echo.amplitude_db=57,60", "radar.fidelity=paper,robust", "dwells=20,30,40"]
    grid = variants("smoke", (), [axis(text) for text in over])
    assert len({variant.values for variant in grid}) == len(grid) == 2 * 2 * 3
    assert [variant.scenario.name for variant in grid] == [f"smoke-{i}" for i in range(1, 13)]
    for variant in grid:
        amplitude, fidelity, dwells = variant.values
        own = variant.scenario
        assert own.radar.echo.amplitude_db == own.simulated.echo.amplitude_db == float(amplitude)
        assert (own.radar.fidelity, own.dwells) == (fidelity, int(dwells))
    assert grid[0].scenario.title.startswith("world.echo.amplitude_db,radar.echo.amplitude_db = 57, radar.fidelity")


def test_a_baseline_is_a_value_of_an_axis() -> None:
    axes = [axis("world.echo.amplitude_db,radar.echo.amplitude_db=57,60"), axis("radar.fidelity=paper,robust")]
    assert baseline("radar.fidelity=robust", axes) == (1, "robust")
    assert baseline("radar.echo.amplitude_db=57", axes) == baseline(f"{axes[0].name}=57", axes) == (0, "57")
    for text in ("radar.fidelity=best", "dwells=57", "57"):
        with pytest.raises(BadInput, match=rf"^--against {text}: must be one value of an axis: .*=57 or .*=robust$"):
            baseline(text, axes)


def test_a_value_that_cannot_be_is_named() -> None:
    with pytest.raises(ScenarioError, match=r"^--over radar\.array\.n_tx=1: must be an integer >= 2"):
        variants("smoke", (), [axis("radar.array.n_tx=16,1")])
