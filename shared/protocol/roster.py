"""The tracks of a dwell. Waveforms and scans carry it if the number of targets is unknown."""

from functools import cache
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from cogradar.shared.protocol.fields import FAR, LARGEST, Count, FloatLists, Floats, Index, Ints

BIRTH = 8  # columns of `Roster.births`
EXPECTED = 5  # ... and of `Roster.expected`


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
        if (self.ids[1:] <= self.ids[:-1]).any() or (m and not 0 <= self.ids[0] <= self.ids[-1] < self.next_id):
            raise ValueError("ids must be ascending, from 0 and below next_id")
        if not np.isin(self.confirmed, (0, 1)).all():
            raise ValueError("confirmed must be 0 or 1")
        if self.born_k.min(initial=0) < 0 or (self.born_k[1:] < self.born_k[:-1]).any():
            raise ValueError("born_k must be from 0, and never less than the track before has")
        if self.births.shape[1] != BIRTH or self.births.shape[0] > m:
            raise ValueError(f"births must be (b, {BIRTH}), at most a row for each of ids")
        _check_births(self.births)
        _check_expected(self.expected)
        if np.abs(self.searched).max(initial=0.0) > 0.5 or (self.searched[1:] <= self.searched[:-1]).any():
            raise ValueError("searched must be -0.5 .. 0.5, ascending")
        return self

    def __repr__(self) -> str:
        return f"Roster{self._content()!r}"  # of which messages are compared


def _check_births(births: NDArray[np.float64]) -> None:
    """ValueError for detections that no receiver makes."""
    nu, limit, range_km, nu_hat, nu_sigma, amplitude, sigma_hat, power = births.T
    if max(np.abs(nu).max(initial=0.0), np.abs(nu_hat).max(initial=0.0)) > 0.5:
        raise ValueError("births: directions must be -0.5 .. 0.5")
    measured = np.concatenate((limit, sigma_hat, power))
    if (measured < 1.0 / LARGEST).any() or (measured > LARGEST).any():
        raise ValueError(f"births: limit, sigma_hat and ||v||^2 must be {1.0 / LARGEST:g} .. {LARGEST:g}")
    others = np.concatenate((nu_sigma, amplitude))
    if (np.concatenate((range_km, others)) < 0.0).any() or range_km.max(initial=0.0) > FAR or (others > LARGEST).any():
        raise ValueError(f"births: range must be 0 .. {FAR:g} km, nu_sigma and |alpha_hat| 0 .. {LARGEST:g}")


def _check_expected(expected: NDArray[np.float64]) -> None:
    """ValueError for Gaussians that are none, or of directions and ranges that there are not."""
    nu, nu_sigma, range_km, range_sigma, existence = expected.T
    if np.abs(nu).max(initial=0.0) > 0.5 or (np.concatenate((nu_sigma, range_km, range_sigma)) < 0.0).any():
        raise ValueError("expected: directions must be -0.5 .. 0.5, ranges and standard deviations >= 0")
    if range_km.max(initial=0.0) > FAR:
        raise ValueError(f"expected: ranges must be at most {FAR:g} km")
    if existence.min(initial=0.0) < 0.0 or existence.max(initial=0.0) > 1.0:
        raise ValueError("expected: probabilities of existence must be 0 .. 1")


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
