"""Which part of a recording is asked for: a time, aircraft, whether those on the ground."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from math import inf
from pathlib import Path
from typing import Self

from cogradar.services.errors import BadInput
from cogradar.services.skies.readers.report import Report, Tally, Why
from cogradar.services.skies.readers.table import Unread, seconds
from cogradar.shared.scenario.limits import MAX_TARGETS

MOST_AIRCRAFT = MAX_TARGETS  # a larger number is the name of one


@dataclass(frozen=True)
class Selection:
    """What the options select."""

    start_s: float | None = None
    minutes: float | None = None
    most: int | None = None  # aircraft, those longest in view
    names: Sequence[str] = ()  # addresses or callsigns, in lower case; none: all
    ground: bool = False  # with aircraft on the ground

    @classmethod
    def of(cls, start: str | None, minutes: float | None, aircraft: str | None, *, ground: bool) -> Self:
        """What the texts of options say. Raises BadInput."""
        try:
            start_s = None if start is None else seconds(start.strip())
        except Unread:
            raise BadInput(
                f"--start {start}: must be UTC, such as 2024-05-01T12:00:00Z, or seconds as the recording has them"
            ) from None
        most = count(aircraft)
        names = tuple(name.strip().lower() for name in (aircraft or "").split(",") if name.strip()) if not most else ()
        if aircraft is not None and not (most or names):
            raise BadInput(f"--aircraft {aircraft}: must be 1 .. {MOST_AIRCRAFT}, or addresses or callsigns")
        return cls(start_s, minutes, most, names, ground)

    def has(self, time_s: float) -> bool:
        """Whether a time is asked for; minutes count from the start, or if none is given from the first position."""
        return self.start_s is None or 0.0 <= time_s - self.start_s <= 60.0 * (self.minutes or inf)

    def in_time(self, found: list[Report], tally: Tally) -> list[Report]:
        """Reports in the order of their times, without those after the minutes that are asked for."""
        if self.minutes is None or not found:
            return found
        end_s = found[0].time + 60.0 * self.minutes
        tally.drop_all(Why.OUTSIDE, (one.row for one in found if one.time > end_s))
        return [one for one in found if one.time <= end_s]

    def among(
        self, found: dict[str, list[Report]], addresses: Mapping[str, set[str]], file: Path, tally: Tally
    ) -> dict[str, list[Report]]:
        """The aircraft that are asked for. Raises BadInput if there is none of a name."""
        if not self.names:
            return found
        wanted = set[str]()
        for name in self.names:
            meant = {name, *addresses.get(name, ())} & set(found)
            if not meant:
                near = get_close_matches(name, [*found, *addresses], n=3, cutoff=0.5) or list(found)[:3]
                raise BadInput(f"--aircraft {name}: {file} has no such aircraft near the radar, but {', '.join(near)}")
            wanted |= meant
        for name, mine in found.items():
            if name not in wanted:
                tally.drop_all(Why.FEW, (one.row for one in mine))
        return {name: mine for name, mine in found.items() if name in wanted}


def count(aircraft: str | None) -> int | None:
    """The number of aircraft that a text says; None: it says none."""
    text = (aircraft or "").strip()
    is_count = (
        text.isascii() and text.isdecimal() and len(text) <= len(str(MOST_AIRCRAFT)) and 1 <= int(text) <= MOST_AIRCRAFT
    )
    return int(text) if is_count else None
