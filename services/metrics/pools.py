"""What many targets and runs come to together: consistency of the beliefs by acceleration, time to confirmation."""

from collections.abc import Mapping, Sequence
from typing import Any

from cogradar.services.metrics.scoring import sums
from cogradar.services.metrics.scoring.sums import CONSISTENCY, OF_FLIGHTS
from cogradar.services.metrics.selection import Run
from cogradar.services.metrics.store import Store
from cogradar.shared.scoring.errors import FLIGHTS
from cogradar.shared.scoring.figures import Discovery

Rows = list[dict[str, Any]]


def consistency(found: Sequence[Mapping[str, Any]]) -> Rows:
    """A row for each of FLIGHTS, over all rows of sums (`cogradar.services.metrics.scoring.sums.query`).

    n, the dwells with a NEES in this kind of flight; mean NEES of the state, the position and the velocity; the share
    beyond the 99 % bound. Means of nothing are None.
    """
    rows = Rows()
    for flight, columns in zip(FLIGHTS, OF_FLIGHTS, strict=True):
        total = {
            name: sum(row[column] or 0.0 for row in found) for name, column in zip(CONSISTENCY, columns, strict=True)
        }
        n = int(total.pop("n"))
        means = {name: value / n if n else None for name, value in total.items()}
        rows.append({"flight": flight.name, "n": n, **means})
    return rows


def confirmation(store: Store, runs: Sequence[Run]) -> Discovery:
    """How soon the visible targets of runs of an unknown number got a confirmed track."""
    names = [run["run"] for run in runs]
    store.derive(names)
    query = "SELECT run, dt_s FROM run"
    dt_s = {row["run"]: row["dt_s"] for row in store.read(query)}
    lives = [row for row in store.summed(*sums.lives(names)) if row["visible_t"] is not None]
    return Discovery.of([(row["visible_t"], row["confirmed_t"], row["visible"], dt_s[row["run"]]) for row in lives])
