"""A report as tables: on the terminal, or in a Markdown file between the markers of its scenario."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from services.analysis.report import Rows
from services.cli.display import in_metres
from services.errors import BadInput

Row = dict[str, Any]
Column = tuple[str, Callable[[Row], str]]


@dataclass(frozen=True)
class Sheet:
    """A table before it is drawn."""

    title: str
    headings: list[str]
    cells: list[list[str]]
    grouped: bool  # a blank line where the first cell changes


def _number(name: str, digits: int, sign: str = "") -> Callable[[Row], str]:
    return lambda row: _text(row[name], digits, sign)


def _interval(name: str, digits: int, sign: str = "") -> Callable[[Row], str]:
    return lambda row: f"{_text(row[f'{name}_low'], digits, sign)} {_text(row[f'{name}_high'], digits, sign)}"


def _text(value: float | None, digits: int, sign: str) -> str:
    return "-" if value is None else f"{value:{sign}.{digits}f}"


def _as_is(name: str) -> Callable[[Row], str]:
    return lambda row: str(row[name])


INDEPENDENT = (
    "95 % intervals take runs as independent, not their dwells: a lost track misses all of them; "
    "only Wilson's interval of P_D takes dwells"
)
TARGET: Column = ("target", _as_is("target"))
STRATEGY: Column = ("strategy", _as_is("strategy"))
DWELLS: Column = ("dwells", lambda row: f"{row['first_dwell']}-{row['last_dwell']}")
DETECTION: list[Column] = [
    ("P_D", _number("p_d", 3)),
    ("95 %, runs", _interval("p_d", 3)),
    ("95 %, Wilson", _interval("p_d_wilson", 3)),
    ("bin hits", _number("hit_rate", 3)),
    ("power", _number("share", 3)),
]
ERRORS: list[Column] = [
    ("RMSE km", _number("position_rmse_km", 3)),
    ("95 %", _interval("position_rmse_km", 3)),
    ("RMSE m/s", _number("velocity_rmse_m_s", 1)),
    ("95 %", _interval("velocity_rmse_m_s", 1)),
]
IN_TIME: list[Column] = [
    *DETECTION[:2],
    ("RMSE km", _number("position_rmse_km", 2)),
    ("95 %", _interval("position_rmse_km", 2)),
    ERRORS[2],
]
DIFFERENCES: list[Column] = [
    ("difference", lambda row: f"{row['strategy']} - {row['minus']}"),
    ("P_D", _number("p_d", 3, "+")),
    ("95 %", _interval("p_d", 3, "+")),
    ("RMSE km", _number("position_rmse_km", 2, "+")),
    ("95 %", _interval("position_rmse_km", 2, "+")),
]
LOST: list[Column] = [
    ("lost", lambda row: f"{row['lost']} of {row['runs']}"),
    ("share", _number("share", 3)),
    ("95 %, Wilson", _interval("share", 3)),
]
ACQUISITION: list[Column] = [
    ("runs", _as_is("runs")),
    ("scans, mean", _number("mean", 1)),
    ("95 %", _interval("mean", 1)),
    ("median", _number("median", 1)),
    ("most", _as_is("max")),
]


def sheets(report: dict[str, Any], *, in_time: bool) -> list[Sheet]:
    """The tables of a report; `in_time` adds one per target with a row per window of dwells."""
    last = report["last"]
    span = f"dwells {last[0]['first_dwell']}-{last[0]['last_dwell']}"
    made = [
        _sheet(f"Detection, {span}", [TARGET, STRATEGY, *DETECTION], last),
        _sheet(f"Errors of the belief mean, {span}", [TARGET, STRATEGY, *ERRORS], last),
        _sheet(f"Differences within a seed, {span}", [TARGET, *DIFFERENCES], report["differences"]),
        _sheet("Lost tracks", [TARGET, STRATEGY, *LOST], report["lost"]),
        _sheet("Acquisition", [STRATEGY, *ACQUISITION], report["acquisition"]),
    ]
    if in_time:
        for target in dict.fromkeys(row["target"] for row in last):
            rows = [row for row in report["windows"] if row["target"] == target]
            made.append(_sheet(f"Target {target} in time", [DWELLS, STRATEGY, *IN_TIME], rows))
    return [sheet for sheet in made if sheet.cells]


def caption(report: dict[str, Any]) -> str:
    """What the report is of."""
    runs = ", ".join(f"{n} {strategy}" for strategy, n in report["runs"].items())
    lines = [f"{report['scenario']} ({report['fidelity']}): {runs} runs of {report['dwells']} dwells"]
    if report["failed"]:
        lines.append(f"{len(report['failed'])} runs failed, the first: {report['failed'][0]['reason']}")
    return "\n".join([*lines, INDEPENDENT, f"digest {report['digest']}"])


def rich_tables(made: Iterable[Sheet]) -> list[Table]:
    """Tables for the terminal."""
    return [_rich_table(sheet) for sheet in made]


def write_into(path: Path, reports: Sequence[dict[str, Any]]) -> None:
    """Replace what is between the markers `<!-- report NAME -->` and `<!-- /report NAME -->` of each scenario.

    All of them or none. Raises BadInput if the file has no markers of a scenario.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    for report in reports:
        begin, end = (f"<!-- {slash}report {report['scenario']} -->" for slash in ("", "/"))
        before, found_begin, rest = text.partition(begin)
        _, found_end, after = rest.partition(end)
        if not found_begin or not found_end:
            raise BadInput(f"{path}: has no lines {begin} and {end}")
        made = [f"```\n{caption(report)}\n```", *(_markdown(sheet) for sheet in sheets(report, in_time=True))]
        blocks = "\n\n".join(made)
        text = f"{before}{begin}\n\n{blocks}\n\n{end}{after}"
    new = path.with_suffix(path.suffix + ".new")
    try:
        new.write_text(text, encoding="utf-8")
        new.replace(path)
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}") from None


def _sheet(title: str, columns: list[Column], rows: Rows) -> Sheet:
    cells = [[text(row) for _, text in columns] for row in map(in_metres, rows)]
    return Sheet(title, [heading for heading, _ in columns], cells, grouped=columns[0] in (TARGET, DWELLS))


def _rich_table(sheet: Sheet) -> Table:
    table = Table(
        box=SIMPLE_HEAD,
        pad_edge=False,
        padding=(0, 1, 0, 0),
        title=sheet.title,
        title_justify="left",
        title_style="bold",
    )
    for i, heading in enumerate(sheet.headings):
        table.add_column(heading, justify="left" if i < 2 else "right", no_wrap=True)
    for i, row in enumerate(sheet.cells):
        ends = sheet.grouped and i + 1 < len(sheet.cells) and row[0] != sheet.cells[i + 1][0]
        table.add_row(*row, end_section=ends)
    return table


def _markdown(sheet: Sheet) -> str:
    rule = ["---" if i < 2 else "---:" for i in range(len(sheet.headings))]
    lines = [f"| {' | '.join(cells)} |" for cells in (sheet.headings, rule, *sheet.cells)]
    return "\n".join([f"**{sheet.title}**", "", *lines])
