"""CSV files beside a scenario: trajectories of targets, and errors of antennas."""

from collections.abc import Sequence
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic_core import from_json

from cogradar.shared.scenario.document import ScenarioError, text_of
from cogradar.shared.scenario.faults import printable
from cogradar.shared.scenario.limits import MAX_ROWS, MIN_ROWS
from cogradar.shared.scenario.trajectories.rows import check_rows

MAX_BYTES = 1 << 23
MAX_LINES = 2 * MAX_ROWS  # half of them may be empty
TRAJECTORY = ["t_s", "x_km", "y_km"]  # header of its file
ELEMENT_ERRORS = ["gain_db", "phase_deg"]  # header of a file with errors of antennas
MAX_ELEMENTS = 512
TRAJECTORIES = (TRAJECTORY, [*TRAJECTORY, "z_km"])


def trajectory(path: Path, most: int) -> NDArray[np.float64]:
    """Rows [t_s, x_km, y_km], or with z_km, of a CSV file with this header, at most so many. Raises ScenarioError.

    Returns (n, 3 or 4), km and s.
    """
    rows, lines = _csv_rows(path, TRAJECTORIES, most, f"trajectories must have at most {MAX_ROWS} rows together")
    if len(rows) < MIN_ROWS:
        raise ScenarioError(printable(f"{path}: has {len(rows)} rows of numbers, must have at least {MIN_ROWS}"))
    try:
        check_rows(rows, lambda i: f"line {lines[i]}")
    except ValueError as error:
        raise ScenarioError(printable(f"{path}: {error}")) from None
    return rows


def element_errors(path: Path) -> list[list[float]]:
    """Rows [gain_db, phase_deg] of a CSV file with this header. Raises ScenarioError."""
    found, _ = _csv_rows(path, (ELEMENT_ERRORS,), MAX_ELEMENTS, f"must have at most {MAX_ELEMENTS} rows")
    rows: list[list[float]] = found.tolist()
    return rows


def _csv_rows(
    path: Path, headers: Sequence[Sequence[str]], most: int, too_many: str
) -> tuple[NDArray[np.float64], Sequence[int]]:
    """Rows of numbers of a CSV file with one of these headers, and the line of each. Raises ScenarioError."""
    try:
        text = text_of(path, MAX_BYTES)
    except FileNotFoundError:
        raise ScenarioError(printable(f"{path}: no such file")) from None
    except OSError as error:
        raise ScenarioError(printable(f"{path}: {error.strerror}")) from None
    except ValueError as error:  # also of what is no text
        raise ScenarioError(printable(f"{path}: {error}")) from None
    if (n := text.count("\n")) > MAX_LINES:
        raise ScenarioError(printable(f"{path}: has {n} lines, must have at most {MAX_LINES}"))
    first, *rest = text.split("\n")
    header = [cell.strip() for cell in first[:200].split(",")]
    if header not in headers:
        begins = f"begins with {first[:60]!r}" if first else "is empty"
        must = " or ".join(map(",".join, headers))
        raise ScenarioError(printable(f"{path}: {begins}, must have the header {must}"))
    while rest and not rest[-1]:
        rest.pop()
    lines: Sequence[int] = range(2, len(rest) + 2)
    if not all(rest) or any(map(str.isspace, rest)):
        lines = [i for i in lines if rest[i - 2] and not rest[i - 2].isspace()]
        rest = [rest[i - 2] for i in lines]
    body = rest[: most + 1]
    rows = _numbers(body, len(header))
    if rows is None:
        at = _first_wrong(body, len(header))
        numbers = f"{len(header)} numbers, {','.join(header)}"
        raise ScenarioError(printable(f"{path}: line {lines[at]}, {body[at][:60]!r}: must be {numbers}"))
    if len(body) > most:
        raise ScenarioError(printable(f"{path}: line {lines[most]}: {too_many}"))
    return rows, lines


def _first_wrong(body: Sequence[str], width: int) -> int:
    """Place of the first line that is no such row; there is one. By halves it takes as long as to read all of them."""
    low, high = 0, len(body)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if _numbers(body[low:middle], width) is None else (middle, high)
    return low


def _numbers(body: Sequence[str], width: int) -> NDArray[np.float64] | None:
    """Lines as rows of so many finite numbers, (n, width); None if one is something else.

    Nearly all numbers are JSON's, too, which is read three times as fast.
    """
    if not set(map(str.count, body, repeat(","))) <= {width - 1}:
        return None
    try:
        found: list[Any] = from_json(f"[{','.join(body)}]")
    except ValueError:
        found = []
    try:
        if not {*map(type, found)} <= {int, float} or len(found) != len(body) * width:
            found = list(map(float, ",".join(body).split(","))) if body else []
        rows = np.array(found, dtype=np.float64).reshape(-1, width)
    except (ValueError, OverflowError):
        return None
    return rows if np.isfinite(rows).all() else None
