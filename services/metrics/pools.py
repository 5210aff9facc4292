"""What the beliefs about many targets come to together: their consistency, by the acceleration of the targets."""

from collections.abc import Mapping, Sequence
from typing import Any

from cogradar.services.metrics.scoring.sums import CONSISTENCY, OF_FLIGHTS
from cogradar.shared.scoring.errors import FLIGHTS

Rows = list[dict[str, Any]]


def consistency(sums: Sequence[Mapping[str, Any]]) -> Rows:
    """A row for each of FLIGHTS, over all rows of sums (`cogradar.services.metrics.scoring.sums.query`).

    n, the dwells of targets that fly so and have a NEES; means of it, of that of the position and of the velocity
    alone; the share beyond the 99 % bound. Means of nothing are None.
    """
    rows = Rows()
    for flight, columns in zip(FLIGHTS, OF_FLIGHTS, strict=True):
        total = {
            name: sum(row[column] or 0.0 for row in sums) for name, column in zip(CONSISTENCY, columns, strict=True)
        }
        n = int(total.pop("n"))
        means = {name: value / n if n else None for name, value in total.items()}
        rows.append({"flight": flight.name, "n": n, **means})
    return rows
