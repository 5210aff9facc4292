"""The tables of `cogradar bench scale`: for the terminal, for docs/scaling.md, as JSON."""

import os
import platform
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from services.bench.scale import Measured
from services.bench.scale_model import USABLE, needs, speed_up
from services.campaigns.campaign import n_core
from services.errors import BadInput
from shared.protocol.topics import Role

BEGIN, END = "<!-- scale -->", "<!-- /scale -->"
Sheet = tuple[str, list[str], list[list[str]]]


def as_json(measured: Sequence[Measured]) -> dict[str, Any]:
    """Everything measured, and the model."""
    return {
        "cores": n_core(),
        "load": os.getloadavg()[0],
        "measured": [asdict(run) for run in measured],
        "model": [asdict(need) for need in needs(measured)],
    }


def sheets(measured: Sequence[Measured]) -> list[Sheet]:
    """Title, headings and cells of each table."""
    return [_rates(measured), _latencies(measured), _cpu(measured), _bytes(measured), _model(measured)]


def caption() -> str:
    """What it was measured on."""
    several = (
        "" if n_core() > 2 else "; more than two planners share the same two cores with all the rest and are left out"
    )
    return f"{n_core()} cores, {platform.machine()}, load {os.getloadavg()[0]:.1f} at the end{several}"


def rich_tables(measured: Sequence[Measured]) -> list[Table]:
    """For the terminal."""
    tables = []
    for title, headings, rows in sheets(measured):
        table = Table(title=title, box=SIMPLE_HEAD, pad_edge=False, title_justify="left", title_style="bold")
        for heading in headings:
            table.add_column(heading, justify="right")
        for row in rows:
            table.add_row(*row)
        tables.append(table)
    return tables


def check_page(path: Path) -> tuple[str, str]:
    """What comes before and after the tables of a page. Raises BadInput if it has no place for them."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    before, begun, rest = text.partition(BEGIN)
    _, ended, after = rest.partition(END)
    if not begun or not ended:
        raise BadInput(f"{path}: has no lines {BEGIN} and {END}")
    return before, after


def write_into(path: Path, measured: Sequence[Measured]) -> None:
    """Replace what is between the markers of a Markdown page. Raises BadInput."""
    before, after = check_page(path)
    blocks = [f"Measured on {caption()}.", *map(_markdown, sheets(measured))]
    new = path.with_suffix(path.suffix + ".new")
    try:
        new.write_text(f"{before}{BEGIN}\n\n" + "\n\n".join(blocks) + f"\n\n{END}{after}", encoding="utf-8")
        new.replace(path)
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}") from None


def _markdown(sheet: Sheet) -> str:
    title, headings, rows = sheet
    lines = [headings, ["---:"] * len(headings), *rows]
    return f"### {title}\n\n" + "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _name(run: Measured) -> list[str]:
    return [str(run.n_target), str(run.planners) if run.planners else "local"]


def _rates(measured: Sequence[Measured]) -> Sheet:
    local = {run.n_target: run for run in measured if not run.planners}
    one = {run.n_target: run for run in measured if run.planners == 1}
    rows = []
    for run in measured:
        single = one[run.n_target]
        bound = speed_up(single.latency, run.planners) if run.planners and single.latency is not None else None
        rows.append(
            [
                *_name(run),
                f"{run.dwell_ms:.2f}",
                f"{1e3 / run.dwell_ms:.1f}",
                f"{local[run.n_target].dwell_ms / run.dwell_ms:.2f}",
                f"{single.dwell_ms / run.dwell_ms:.2f}" if run.planners else "",
                f"{bound:.2f}" if bound is not None else "",
            ]
        )
    headings = ["targets", "planners", "dwell ms", "dwells/s", "of local", "of one", "at most"]
    return "Dwell rate", headings, rows


def _latencies(measured: Sequence[Measured]) -> Sheet:
    rows = [
        [*_name(run), *(f"{value:.2f}" for value in asdict(run.latency).values())]
        for run in measured
        if run.latency is not None
    ]
    headings = ["targets", "planners", "dwell", "emulator", "planner", "allocator", "queues", "transport"]
    return "Where a dwell's time goes, ms, medians", headings, rows


def _cpu(measured: Sequence[Measured]) -> Sheet:
    roles = (Role.EMULATOR, Role.PLANNER, Role.ALLOCATOR, Role.METRICS, Role.ROUTER)
    rows = [[*_name(run), *(f"{run.cpu_ms[role]:.2f}" for role in roles)] for run in measured if run.cpu_ms]
    return "CPU time per dwell, ms, with the transport's threads", ["targets", "planners", *roles], rows


def _bytes(measured: Sequence[Measured]) -> Sheet:
    topics = ("scan", "truth", "plan", "waveform")
    rows = [
        [str(run.n_target), *(f"{run.n_byte[topic]:.0f}" for topic in topics), f"{sum(run.n_byte.values()):.0f}"]
        for run in measured
        if run.planners == 1 and run.n_byte
    ]
    return "Bytes said per dwell", ["targets", *topics, "all"], rows


def _model(measured: Sequence[Measured]) -> Sheet:
    headings = ["targets", "Hz", "radars", "systems", "planners", "their cores", "others", "MB/s", "dwell ms"]
    rows = [
        [
            *(str(n) for n in (need.targets, f"{need.rate_hz:g}", need.radars, need.systems)),
            "never" if need.planners is None else str(need.planners),
            f"{need.planner_cores:.1f}",
            f"{need.other_cores:.1f}",
            f"{need.megabytes_s:.2f}",
            f"{need.dwell_ms:.0f}",
        ]
        for need in needs(measured)
    ]
    return f"Predicted from it, no core busier than {USABLE:.0%}", headings, rows
