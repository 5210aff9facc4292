"""Which settings go together, and what is said of others."""

from itertools import product
from typing import Any

import pytest

from cogradar.shared.scenario.combinations import A_NUMBER, A_WIDTH, KEYS, ROWS, cures
from cogradar.shared.scenario.files import ScenarioError, load
from cogradar.shared.scenario.plugins.names import OWN
from tests.golden import SHIPPED, VARIANTS


def faults(*settings: str) -> tuple[str, ...]:
    with pytest.raises(ScenarioError) as caught:
        load("smoke", [f"radar.{setting}" for setting in settings])
    return caught.value.faults


@pytest.mark.parametrize("name", [*SHIPPED, *VARIANTS])
def test_what_has_a_digest_is_supported(name: str) -> None:
    scenario, _, _, settings = VARIANTS.get(name, (name, "", 0, ()))
    assert cures(load(scenario, settings).radar.model_dump()) == []


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (
            ("planner.looks=joint", "allocation.objective=max-min"),
            'allocation.objective = "max-min": no supported combination; nearest: set allocation.objective ='
            ' "detections", "urgency" or your own ("robust filter, joint looks")',
        ),
        (
            ("allocation.objective=urgency", "allocation.solver=sdp"),
            'allocation.solver = "sdp": no supported combination; nearest: set allocation.solver = "barrier"'
            ' ("robust filter, joint looks")',
        ),
        (
            ("allocation.objective=urgency", "allocation.solver=sdp", "planner.looks=single"),
            'allocation.objective = "urgency", allocation.solver = "sdp": no supported combination; nearest: set'
            ' allocation.objective = "max-min" ("robust filter, semidefinite program"); or set allocation.solver ='
            ' "barrier" ("robust filter, single looks for detections")',
        ),
        (
            ("allocation.antennas=equal", "allocation.solver=sdp"),
            'allocation.solver = "sdp", allocation.antennas = "equal": no supported combination; nearest: set'
            ' allocation.solver = "barrier" ("robust filter, single looks"); or set allocation.antennas = "sum"'
            ' ("robust filter, semidefinite program")',
        ),
        (
            ("allocation.beams=conventional", "allocation.solver=sdp"),
            'allocation.solver = "sdp", allocation.beams = "conventional": no supported combination; nearest: set'
            ' allocation.solver = "barrier" ("robust filter, single looks"); or set allocation.beams = "optimal"'
            ' ("robust filter, semidefinite program")',
        ),
        (
            ("planner.wide_looks=true",),
            "planner.wide_looks = true: no supported combination; nearest: set planner.wide_looks = false"
            ' ("robust filter, single looks")',
        ),
        (
            ("planner.rule=oracle", "planner.looks=joint"),
            'planner.rule = "oracle": no supported combination; nearest: set planner.rule = "pomcp", "mode", "mean",'
            ' "exact" or your own ("robust filter, joint looks")',
        ),
        (
            ("receiver.cells=steered", "planner.rule=oracle"),
            'receiver.cells = "steered", planner.rule = "oracle": no supported combination; nearest: set'
            ' receiver.cells = "bins" ("robust filter, single looks"); or set planner.rule = "pomcp", "mode", "mean",'
            ' "exact" or your own ("steered cells, single looks")',
        ),
        (
            ("tracks=unknown",),
            'receiver.cells = "bins": no supported combination; nearest: set receiver.cells = "steered"'
            ' ("unknown number of targets, single looks")',
        ),
        (
            ("fidelity=paper", "tracks=unknown"),
            'tracks = "unknown": no supported combination; nearest: set tracks = the number of targets'
            ' ("published filter, single looks")',
        ),
        (
            ("receiver.monopulse=true",),
            'receiver.cells = "bins", receiver.monopulse = true: no supported combination; nearest: set'
            ' receiver.monopulse = false ("robust filter, single looks"); or set receiver.cells = "steered"'
            ' ("steered cells, single looks")',
        ),
        (
            ("receiver.range_cell_km=0.5",),
            'receiver.cells = "bins", receiver.range_cell_km = 0.5: no supported combination; nearest: set'
            ' receiver.range_cell_km = 0.0 ("robust filter, single looks"); or set receiver.cells = "steered"'
            ' ("range cells, single looks")',
        ),
        (
            ("fidelity=best", "belief.filter=published"),
            'belief.filter = "published": no supported combination; nearest: set belief.filter = "likelihood"'
            ' or your own ("steered cells, joint looks")',
        ),
        (
            ("fidelity=paper", "receiver.cells=steered"),
            'belief.filter = "published", receiver.cells = "steered": no supported combination; nearest: set'
            ' receiver.cells = "bins" ("published filter, single looks"); or set belief.filter = "likelihood"'
            ' or your own ("steered cells, single looks")',
        ),
    ],
)
def test_a_refused_combination_names_the_nearest(settings: tuple[str, ...], expected: str) -> None:
    (line,) = faults(*settings)
    assert line.endswith(f": radar: {expected}")
    assert line.startswith("--set radar.")


def test_other_faults_do_not_hide_a_combination_and_those_of_its_keys_do() -> None:
    lines = faults("planner.wide_looks=true", "planner.gamma=2")
    assert len(lines) == 2
    assert "planner.wide_looks = true: no supported combination" in lines[0]
    hidden = "--set radar.allocation.objective=most: must be one of max-min, detections, urgency, or your own: " + OWN
    assert faults("planner.wide_looks=true", "allocation.objective=most") == (hidden,)
    (line,) = faults("tracks=unknown", "fidelity=exact")
    assert "must be one of paper, robust, best, best-range" in line


def test_every_cure_leads_to_a_supported_combination_and_none_is_shorter() -> None:
    """All pairs of rows, each with some keys of the other one."""
    seen = 0
    for (one, other), step in product(product(ROWS.values(), repeat=2), (2, 3)):
        radar = filled({key: (other if i % step else one)[key] for i, key in enumerate(KEYS)})
        least = min(sum(kind(radar, key) not in row[key] for key in KEYS) for row in ROWS.values())
        for cure in cures(radar):
            mended = radar
            for key, allowed in cure.changes.items():
                mended = changed(mended, key, next(iter(allowed)))
            assert cures(mended) == []
            assert len(cure.changes) == least
            seen += 1
        assert bool(cures(radar)) == (least > 0)
    assert seen > 100


def filled(row: dict[str, Any]) -> dict[str, Any]:
    """A table with the first value that each key may have."""
    radar: dict[str, Any] = {}
    for key, allowed in row.items():
        radar = changed(radar, key, next(iter(allowed)))
    return radar


def changed(radar: dict[str, Any], key: str, value: Any) -> dict[str, Any]:
    section, _, name = key.rpartition(".")
    value = {A_NUMBER: 3, A_WIDTH: 0.25}.get(value, value)
    return radar | ({section: radar.get(section, {}) | {name: value}} if section else {name: value})


def kind(radar: dict[str, Any], key: str) -> Any:
    section, _, name = key.rpartition(".")
    value = radar[section][name] if section else radar[name]
    return {3: A_NUMBER, 0.25: A_WIDTH}.get(value, value)
