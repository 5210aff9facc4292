"""A tracker of Stone Soup on this radar's detections, and the figures of both."""

import pytest

import cogradar
from studies.stone_soup import compare

DWELLS = 25


def test_both_trackers_are_judged_by_the_rule_of_this_program() -> None:
    own, other = compare("crossing", 3, DWELLS)
    result = cogradar.run("crossing", seed=3, dwells=DWELLS)
    figures = result.picture.figures
    assert own.gospa_km == pytest.approx(figures["gospa_km"], rel=1e-9)
    assert own.missed_km == pytest.approx(figures["gospa_missed_km"], rel=1e-9)
    assert other.gospa_km**2 == pytest.approx(other.localisation_km**2 + other.missed_km**2 + other.false_km**2)
    assert other.missed_km < 3.0  # 5 km without any track: two targets of 12.5 km^2
    assert 0.0 < other.localisation_km < 1.0


def test_detections_without_direction_or_range_are_refused() -> None:
    with pytest.raises(cogradar.BadInput, match="no measured direction, or no range"):
        compare("smoke", 1, 5)
