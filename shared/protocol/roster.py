"""The tracks of a dwell. Waveforms and scans carry it if the number of targets is unknown."""

from collections.abc import Sequence
from functools import cache
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from cogradar.shared.protocol.fields import FAR, LARGEST, Count, FloatLists, Floats, Index, Ints, is_any

_LEAST = 1.0 / LARGEST  # of what something is divided by
# Columns of `Roster.births`, and the least and the largest that each may be.
BIRTHS = {
    "nu": (-0.5, 0.5),
    "limit": (_LEAST, LARGEST),
    "range": (0.0, FAR),
    "nu_hat": (-0.5, 0.5),
    "nu_sigma": (0.0, LARGEST),
    "|alpha_hat|": (0.0, LARGEST),
    "sigma_hat": (_LEAST, LARGEST),
    "||v||^2": (_LEAST, LARGEST),
}
# ... and of `Roster.expected`.
PLACES = {
    "nu": (-0.5, 0.5),
    "sigma of nu": (0.0, LARGEST),
    "range": (0.0, FAR),
    "sigma of range": (0.0, LARGEST),
    "existence": (0.0, 1.0),
}
BIRTH, EXPECTED = len(BIRTHS), len(PLACES)
_ENDS = {"births": np.array([*BIRTHS.values()]).T, "expected": np.array([*PLACES.values()]).T}


class Compared(BaseModel):
    """Equal if they are so bit for bit, arrays included."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, arbitrary_types_allowed=True
    )

    def _content(self) -> tuple[object, ...]:
        values = (getattr(self, name) for name in type(self).model_fields)
        # repr tells 0.0 from -0.0 and 1 from 1.0, as the encoding does
        return tuple((v.dtype, v.shape, v.tobytes()) if isinstance(v, np.ndarray) else repr(v) for v in values)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Compared) and type(self) is type(other) and self._content() == other._content()

    def __hash__(self) -> int:
        return hash((type(self), self._content()))


class Roster(Compared):
    """The tracks of a dwell: allocator -> front end, which repeats the roster in the scan.

    A track has an id, from 0, that is never used again. Its rows of beams, gates, shares and late are in the order of
    `ids`. A planner that takes over a track learns here where it began.
    """

    ids: Ints  # (M,) ascending
    next_id: Index  # of the next track that begins
    confirmed: Ints  # (M,) 1, or 0 of a tentative track
    born_k: Ints  # (M,) dwell whose scan the track began with
    # (b, 8) detections of the last b of ids, which began with the scan that this answers: nu, limit, range in km,
    # nu_hat, nu_sigma, |alpha_hat|, sigma_hat, ||v||^2.
    births: FloatLists
    # (M, 5) where each track is expected in the next dwell: nu, its standard deviation, range, its standard deviation,
    # in km, and existence, 0 .. 1.
    expected: FloatLists
    searched: Floats  # (s,) directions of the search beams, ascending
    next_search: Count  # number of the next beam of the search, counted from the first one of the run
    search_share: Annotated[float, Field(ge=0)]  # power of the search, all beams together

    @model_validator(mode="after")
    def _aligned(self) -> Self:
        m = self.ids.size
        if (self.confirmed.size, self.born_k.size, self.expected.shape) != (m, m, (m, EXPECTED)):
            raise ValueError(f"confirmed and born_k must be as many as ids, expected (M, {EXPECTED})")
        if is_any(self.ids[1:] <= self.ids[:-1]) or (m and not 0 <= self.ids[0] <= self.ids[-1] < self.next_id):
            raise ValueError("ids must be ascending, from 0 and below next_id")
        if is_any((self.confirmed < 0) | (self.confirmed > 1)):
            raise ValueError("confirmed must be 0 or 1")
        if is_any(self.born_k[:1] < 0) or is_any(self.born_k[1:] < self.born_k[:-1]):
            raise ValueError("born_k must be from 0, and never less than the track before has")
        if self.births.shape[1] != BIRTH or self.births.shape[0] > m:
            raise ValueError(f"births must be (b, {BIRTH}), at most a row for each of ids")
        _check_columns("births", self.births, [*BIRTHS])
        _check_columns("expected", self.expected, [*PLACES])
        if is_any(np.abs(self.searched) > 0.5) or is_any(self.searched[1:] <= self.searched[:-1]):
            raise ValueError("searched must be -0.5 .. 0.5, ascending")
        return self

    def __repr__(self) -> str:
        return f"Roster{self._content()!r}"  # of which messages are compared


def _check_columns(what: str, rows: NDArray[np.float64], columns: Sequence[str]) -> None:
    """ValueError unless each number is between the ends of its column."""
    lowest, highest = _ENDS[what]
    if is_any(is_out := (rows < lowest) | (rows > highest)):
        i = int(np.argwhere(is_out)[0, 1])
        raise ValueError(f"{what}: {columns[i]} must be {lowest[i]:g} .. {highest[i]:g}")


@cache
def announced_roster(n: int) -> Roster:
    """The fixed roster of n announced tracks."""
    ids = np.arange(n, dtype=np.int32)
    return Roster(
        ids=ids,
        next_id=n,
        confirmed=np.ones(n, np.int32),
        born_k=np.zeros(n, np.int32),
        births=np.empty((0, BIRTH)),
        expected=np.zeros((n, EXPECTED)),
        searched=np.empty(0),
        next_search=0,
        search_share=0.0,
    )


def no_tracks() -> Roster:
    """Before the first track."""
    return announced_roster(0)
