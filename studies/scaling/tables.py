"""The tables of `python -m studies scaling`: for the terminal, for docs/scaling.md, as JSON."""

import os
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

from cogradar.services.analysis.tables import Column, Row, Table
from cogradar.services.campaigns.pool import n_core
from cogradar.shared.protocol.topics import Role
from studies.scaling.model import USABLE, needs, speed_up
from studies.scaling.runs import Measured

ROLES = (Role.EMULATOR, Role.PLANNER, Role.ALLOCATOR, Role.METRICS, Role.ROUTER)
TOPICS = ("scan", "truth", "plan", "waveform")
RUN = (Column("targets", "{n_target}", left=True), Column("planners", "{planners}", left=True))


def as_json(measured: Sequence[Measured]) -> dict[str, Any]:
    """Everything measured, and the model."""
    return {
        "cores": n_core(),
        "load": os.getloadavg()[0],
        "measured": [asdict(run) for run in measured],
        "model": [asdict(need) for need in needs(measured)],
    }


def tables(measured: Sequence[Measured]) -> list[Table]:
    """All that was measured, and the model."""
    return [_rates(measured), _latencies(measured), _cpu(measured), _bytes(measured), _model(measured)]


def remark() -> str:
    """What is left out."""
    return "" if n_core() > 2 else "; more than two planners share these cores with all the rest and are left out"


def _rows(measured: Iterable[Measured]) -> list[Row]:
    """Rows of the tables: runs in one process have no planners of their own."""
    return [asdict(run) | {"planners": run.planners or "local"} for run in measured]


def _rates(measured: Sequence[Measured]) -> Table:
    local = {run.n_target: run for run in measured if not run.planners}
    one = {run.n_target: run for run in measured if run.planners == 1}
    rows = []
    for run, row in zip(measured, _rows(measured), strict=True):
        single = one[run.n_target]
        bound = speed_up(single.latency, run.planners) if run.planners and single.latency is not None else None
        gains: dict[str, float | None] = {
            "rate_hz": 1e3 / run.dwell_ms,
            "of_local": local[run.n_target].dwell_ms / run.dwell_ms,
        }
        gains |= {"of_one": single.dwell_ms / run.dwell_ms if run.planners else None, "bound": bound}
        rows.append({**row, **gains})
    columns = (
        *(*RUN, Column("dwell ms", "{dwell_ms:.2f}"), Column("dwells/s", "{rate_hz:.1f}")),
        *(Column("of local", "{of_local:.2f}"), Column("of one", "{of_one:.2f}"), Column("at most", "{bound:.2f}")),
    )
    return Table("Dwell rate", columns, rows)


def _latencies(measured: Sequence[Measured]) -> Table:
    parts = {"dwell": "total", "queues": "queueing"}
    headings = ("dwell", "emulator", "planner", "allocator", "queues", "transport")
    columns = (Column(heading, f"{{latency[{parts.get(heading, heading)}]:.2f}}") for heading in headings)
    rows = _rows(run for run in measured if run.latency is not None)
    return Table("Where a dwell's time goes, ms, medians", (*RUN, *columns), rows)


def _cpu(measured: Sequence[Measured]) -> Table:
    columns = (Column(role, f"{{cpu_ms[{role}]:.2f}}") for role in ROLES)
    rows = _rows(run for run in measured if run.cpu_ms)
    return Table("CPU time per dwell, ms, with the transport's threads", (*RUN, *columns), rows)


def _bytes(measured: Sequence[Measured]) -> Table:
    rows = [
        {**row, "all": sum(row["n_byte"].values())}
        for row in _rows(run for run in measured if run.planners == 1 and run.n_byte)
    ]
    columns = (Column(topic, f"{{n_byte[{topic}]:.0f}}") for topic in TOPICS)
    return Table("Bytes sent per dwell", (RUN[0], *columns, Column("all", "{all:.0f}")), rows)


def _model(measured: Sequence[Measured]) -> Table:
    columns = (
        *(Column("targets", "{targets}"), Column("Hz", "{rate_hz:g}"), Column("radars", "{radars}")),
        *(Column("systems", "{systems}", left=True), Column("planners", "{planners}", left=True)),
        *(Column("their cores", "{planner_cores:.1f}"), Column("others", "{other_cores:.1f}")),
        *(Column("MB/s", "{megabytes_s:.2f}"), Column("dwell ms", "{dwell_ms:.0f}")),
    )
    rows = [asdict(need) for need in needs(measured)]
    rows = [row | {"planners": "never" if row["planners"] is None else row["planners"]} for row in rows]
    return Table(f"Predicted from it, no core busier than {USABLE:.0%}", columns, rows)
