"""One position as a file has it, and the count of what was read, kept and dropped."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, NamedTuple


class Report(NamedTuple):
    """A position of an aircraft."""

    row: int  # line of a table, entry of a JSON file, record of ASTERIX, from 1
    time: float  # s, as a rule since 1970
    address: str  # 24-bit address, or "" if unknown
    name: str  # callsign or track number; at least one of both is known
    latitude: float  # degrees
    longitude: float  # degrees, -180 .. 360
    height_km: float | None = None
    source: int = 0  # number of the column that has the height: one aircraft should use one column
    speed_km_s: float | None = None
    on_ground: bool = False


class Why(Enum):
    """Why a row is dropped: words, and what would keep it."""

    HEADER = "the header again", ""
    NO_POSITION = "no latitude or longitude", ""
    NO_TIME = "no time", ""
    NO_AIRCRAFT = "no identifier of an aircraft", ""
    UNREADABLE = "a value cannot be read", ""
    IMPOSSIBLE = "no such latitude and longitude", ""
    GROUND = "on the ground", "--ground keeps it"
    OUTSIDE = "outside --start and --minutes", ""
    BEYOND = "farther than --range from the radar", ""
    ELSEWHEN = "hours from the other rows", "--start selects another time"
    DUPLICATE = "same aircraft, time and position as another row", ""
    REPEATED = "the last position again, of an aircraft that moves", ""
    OUTLIER = "a jump that no aircraft flies", ""
    CLOCK = "a second clock, seconds off", "split the file by receiver, or keep one of them"
    BEHIND = "behind the radar", "--boresight turns it"
    LONE = "the only position of a flight", ""
    EARLY = "flights that end before the run begins", ""
    DENSE = "less than a step after another row", ""
    FEW = "aircraft beyond --aircraft", ""

    @property
    def words(self) -> str:
        return self.value[0]

    @property
    def cure(self) -> str:
        return self.value[1]


@dataclass
class Dropped:
    """The rows that were dropped for one reason."""

    rows: int = 0
    first: int = 0
    last: int = 0
    example: str = ""  # what the first one says

    def add(self, row: int, example: str = "") -> None:
        if not self.rows or row < self.first:
            self.first, self.example = row, example or self.example
        self.last = max(self.last, row)
        self.rows += 1

    def __str__(self) -> str:
        which = f"{self.first}" if self.rows == 1 else f"{self.first} .. {self.last}"
        return f"{which}: {self.example}" if self.example else which


@dataclass
class Tally:
    """What became of the rows of a file: each is kept, or dropped for one reason."""

    form: str = ""
    rows: int = 0
    dropped: dict[Why, Dropped] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def drop(self, why: Why, row: int, example: str = "") -> None:
        self.dropped.setdefault(why, Dropped()).add(row, example)

    def drop_all(self, why: Why, rows: Iterable[int]) -> None:
        for row in rows:
            self.drop(why, row)

    def note(self, text: str) -> None:
        """Something to say about the whole file; once."""
        if text not in self.notes:
            self.notes.append(text)

    @property
    def kept(self) -> int:
        return self.rows - sum(dropped.rows for dropped in self.dropped.values())

    @property
    def lines(self) -> list[dict[str, Any]]:
        """A row per reason, in the order of the reading."""
        found = [(why, self.dropped[why]) for why in Why if why in self.dropped]
        return [
            {"why": why.words, "rows": d.rows, "first": d.first, "last": d.last, "example": d.example, "cure": why.cure}
            for why, d in found
        ]

    @property
    def reasons(self) -> str:
        """All that was dropped, in a line."""
        found = [
            f"{d.rows} {why.words} ({'row' if d.rows == 1 else 'rows'} {d}{'; ' + why.cure if why.cure else ''})"
            for why in Why
            if (d := self.dropped.get(why))
        ]
        return "; ".join(found)

    @property
    def document(self) -> Mapping[str, Any]:
        """What `--json` prints of it."""
        return {"form": self.form, "rows": self.rows, "kept": self.kept, "dropped": self.lines, "notes": self.notes}
