"""Past figures of the benchmark, in units of its reference loop: they say what has become slower, on any machine."""

import tomllib
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from cogradar.services.bench.kernels import Report
from cogradar.services.errors import BadInput
from cogradar.shared.protocol.build import build

FILE = Path(__file__).with_name("figures.toml")
SLOWER = 1.05  # times the past figure, from which on a case is reported


class Figure(NamedTuple):
    """What a case took."""

    loops: float
    date: str
    program: str  # digest of the build


def read(file: Path = FILE) -> dict[str, Figure]:
    """Past figures by case; none if the file is missing. Raises BadInput."""
    try:
        tables = tomllib.loads(file.read_text(encoding="utf-8"))
        return {name: Figure(float(table["loops"]), table["date"], table["program"]) for name, table in tables.items()}
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BadInput(f"{file}: must have tables [CASE] with loops, date, program ({error!r}); use --update") from None


def slower(report: Report, past: Mapping[str, Figure]) -> dict[str, float]:
    """The cases that have become slower, and how many times the past figure they take."""
    ratios = {name: report.loops(name) / past[name].loops for name in report.cases if name in past}
    return {name: ratio for name, ratio in ratios.items() if ratio > SLOWER}


def remarks(report: Report, past: Mapping[str, Figure]) -> list[str]:
    """A line for each case that has become slower, or that none has."""
    lines = [
        f"{name}: {report.loops(name):.3f} loops, {100.0 * (ratio - 1.0):.0f} % slower than {past[name].loops:.3f} on"
        f" {past[name].date} (program {past[name].program})"
        for name, ratio in slower(report, past).items()
    ]
    return lines or [f"no case is more than {100.0 * (SLOWER - 1.0):.0f} % slower than its past figure"]


def write(report: Report, file: Path = FILE) -> None:
    """Replace the figures of the cases that were timed. Raises BadInput."""
    today, program = f"{datetime.now(UTC):%Y-%m-%d}", build()[:16]
    figures = read(file) | {name: Figure(round(report.loops(name), 4), today, program) for name in report.cases}
    tables = (
        f'[{name}]\nloops = {figure.loops}\ndate = "{figure.date}"\nprogram = "{figure.program}"\n'
        for name, figure in sorted(figures.items())
    )
    head = "# Medians in reference loops: cogradar bench kernels --update, cogradar bench dwell --update\n"
    try:
        file.write_text("\n".join([head, *tables]), encoding="utf-8")
    except OSError as error:
        raise BadInput(f"{file}: {error.strerror}; --update needs a checkout that you may write to") from None
