"""Some dwells of a run, from one to another."""

from typing import Any

from cogradar.services.analysis.arrays.result import Result
from cogradar.services.errors import BadInput

Dwells = tuple[int | None, int | None]  # t of the first and of the last; None: of the run
ALL: Dwells = (None, None)


def is_among(t: Any, dwells: Dwells) -> Any:
    """Whether a dwell t is one of these, or each of an array; dwells of the acquisition are 0."""
    first, last = dwells
    return (t >= (first or 0)) & ((last is None) | (t <= (last or 0)))


def check(result: Result, dwells: Dwells) -> None:
    """Raise BadInput if only some dwells are asked for, and the run has none of them."""
    first, last = dwells
    if dwells == ALL or is_among(result.t, (first or 1, last)).any():
        return
    there = f"{result.t[0]} to {result.t[-1]}" if result.t.size else "none yet"
    asked = ":".join("" if end is None else str(end) for end in dwells)
    raise BadInput(f"--dwells {asked}: {result.run} has no such dwell; there are {there}")
