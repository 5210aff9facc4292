"""What a dwell costs at front ends: every way is timed, and what a link carries follows from the bytes."""

import pytest

from cogradar.services.analysis.tables import markdown
from cogradar.services.bench import front_ends
from cogradar.services.bench.front_ends import Cost


@pytest.mark.slow
@pytest.mark.zenoh
def test_every_way_to_a_front_end_is_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(front_ends, "CELLS", (1, 2))
    monkeypatch.setattr(front_ends, "SPEND_S", 0.0)
    costs = front_ends.measure(lambda _: None)
    y, tcp = "zenoh, Y in shared memory", "zenoh, Y by TCP on loopback"
    ways = [("built-in", 1), ("built-in", 2), ("Python file, Y", 1), ("Python file, Y", 2), ("zenoh, looks", 1)]
    assert [(cost.front_end, cost.range_cells) for cost in costs] == [*ways, (y, 1), (y, 2), (tcp, 1), (tcp, 2)]
    assert all(cost.ms > 0.0 for cost in costs)
    assert all(
        (cost.n_byte is None) == (cost.way_ms is None) == (not cost.front_end.startswith("zenoh")) for cost in costs
    )
    sizes = {cost.range_cells: cost.n_byte or 0 for cost in costs if cost.front_end == tcp}
    assert 80_000 < sizes[1] < 81_000
    assert 80_000 <= sizes[2] - sizes[1] < 80_020
    assert "zenoh, looks" in markdown(front_ends.table(costs))


def test_what_a_link_carries() -> None:
    cost = Cost("zenoh", 1, 1.0, 125_000, 0.5)
    assert (cost.rate(1.0), cost.rate(10.0)) == (1000.0, 10_000.0)
    assert Cost("built-in", 1, 1.0).rate(1.0) is None
