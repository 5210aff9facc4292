"""What a feed costs: each format is timed with tracks that it tells, and far below the goal."""

from cogradar.services.feed.cost import PICTURES, Cost, measure, table
from cogradar.services.feed.feed import FORMATS
from tests.services.tables import assert_shown_whole


def test_each_format_tells_all_tracks_in_a_fraction_of_what_a_core_can_do() -> None:
    costs = {cost.step: cost for cost in measure(50, 3, lambda _: None)}
    assert list(costs) == [PICTURES, *FORMATS]
    for cost in costs.values():
        assert cost.ms is not None
        assert 1.0 <= 1e3 * cost.ms / 50 < 1000.0  # microseconds for a track; 200 are a fifth of a core for a thousand


def test_a_format_without_its_package_has_no_figure() -> None:
    shown = table([Cost("asterix", 1000, 3.0), Cost("sapient", 1000, None)])
    assert_shown_whole([shown])
    assert [column.cell(row) for row in shown.rows for column in shown.columns] == [
        *("asterix", "1000", "3.0", "3.0", "0.003"),
        *("sapient", "1000", "-", "-", "-"),
    ]
