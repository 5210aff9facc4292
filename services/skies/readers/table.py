"""A table of positions, whatever it was written as: names of its columns, and cells as texts."""

import re
from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime
from math import isfinite
from typing import NamedTuple

from cogradar.services.errors import BadInput
from cogradar.services.skies.readers.report import Report, Tally, Why
from cogradar.shared.scenario.limits import MAX_HEIGHT_KM

# Names that the field uses, in lower case, the best ones first.
TIMES = (
    *("lastposupdate", "time_position", "last_position", "seen_at", "time", "timestamp", "time_utc", "timestamp_utc"),
    *("datetime", "datetime_utc", "date_time", "utc", "ts", "t", "epoch", "unixtime", "snapshot_time", "time_s"),
    *("timestamp_s", "time_ms", "timestamp_ms", "time_us", "timestamp_us", "time_ns", "timestamp_ns"),
)
ADDRESSES = ("icao24", "hex", "icao", "icao_24", "hexident", "hex_ident", "icao_address", "icao_hex", "mode_s", "modes")
NAMES = (
    *("callsign", "flight", "aircraft", "aircraft_id", "flight_id", "registration", "tail", "ident", "track_number"),
    *("track_id", "id"),
)
LATITUDES = ("lat", "latitude", "lat_deg", "latitude_deg")
LONGITUDES = ("lon", "longitude", "long", "lng", "lon_deg", "longitude_deg")
POSITIONS = ("position",)  # "48.35,11.79"
GROUND = ("onground", "on_ground", "is_on_ground", "ground", "gnd")
DATES = ("date",)  # beside a time of day
FOOT_KM, KNOT_KM_S = 0.3048e-3, 1.852 / 3600.0
# Columns of altitudes, and how many km their unit has. OpenSky has metres; readsb, and the package traffic, whose files
# have `altitude` beside `geoaltitude`, feet.
HEIGHTS = {
    "z_km": 1.0,
    "altitude_km": 1.0,
    "altitude_m": 1e-3,
    "altitude_ft": FOOT_KM,
    "altitude_feet": FOOT_KM,
    "alt_m": 1e-3,
    "alt_ft": FOOT_KM,
    "altitude": FOOT_KM,
    "alt_geom": FOOT_KM,
    "alt_baro": FOOT_KM,
    "alt": FOOT_KM,
    "geoaltitude": 1e-3,
    "geo_altitude": 1e-3,
    "geoaltitude_m": 1e-3,
    "geoaltitude_ft": FOOT_KM,
    "baroaltitude": 1e-3,
    "baro_altitude": 1e-3,
    "baroaltitude_m": 1e-3,
    "baroaltitude_ft": FOOT_KM,
}
SPEEDS = {
    "velocity": 1e-3,
    "velocity_m_s": 1e-3,
    "speed_m_s": 1e-3,
    "groundspeed": KNOT_KM_S,
    "ground_speed": KNOT_KM_S,
    "gs": KNOT_KM_S,
    "speed": KNOT_KM_S,
    "speed_kt": KNOT_KM_S,
    "speed_kts": KNOT_KM_S,
    "gs_kt": KNOT_KM_S,
    "groundspeed_kt": KNOT_KM_S,
    "speed_km_h": 1.0 / 3600.0,
    "speed_kmh": 1.0 / 3600.0,
}
ON_GROUND = "ground"
UNKNOWN = frozenset(
    {
        *("", "nan", "none", "null", "<na>", "na", "n/a", "#n/a", "nat", "nil", "-", "--", "?", ".", "*", "unknown"),
        *("undefined", "missing", "\\n", "<null>", "(null)", "#value!"),
    }
)
NO_ADDRESS = "000000"  # in the place of one that is unknown
TRUE = frozenset({"1", "true", "t", "yes", "y", "-1", "1.0", ON_GROUND})
POWERS = {1e17: 1e9, 1e14: 1e6, 1e11: 1e3}  # a larger time counts ns, us, ms; seconds of the next 1000 years do not
UNITS = {"_ms": 1e3, "_us": 1e6, "_ns": 1e9}
_CLOCK = re.compile(r"\d{1,2}:\d\d(:\d\d([.,]\d+)?)?")
_UNIT = re.compile(r"\s*[\[(]\s*([^\])]*)[\])]\s*$")
_ADDRESS = re.compile(r"~?[0-9a-f]{6}")


def known_names() -> frozenset[str]:
    """All names of columns that are looked at."""
    return frozenset(
        (*TIMES, *ADDRESSES, *NAMES, *LATITUDES, *LONGITUDES, *POSITIONS, *GROUND, *DATES, *HEIGHTS, *SPEEDS)
    )


def plain_name(text: str) -> str:
    """A column's name in one form: `Altitude (ft)` is altitude_ft."""
    name = _UNIT.sub(r"_\1", text.strip().strip("\ufeff\"'")).lower()
    return re.sub(r"[^a-z0-9]+", "_", name).strip("_")


class Unusable(ValueError):
    """A row that says nothing."""

    def __init__(self, why: Why, example: str = "") -> None:
        super().__init__(example)
        self.why, self.example = why, example


class Unread(Unusable):
    """A cell that cannot be read; the text has its column and what it must be."""

    def __init__(self, example: str) -> None:
        super().__init__(Why.UNREADABLE, example)


class Table(NamedTuple):
    """Where a table has what it says."""

    names: list[str]
    times: list[int]
    dates: list[int]
    addresses: list[int]
    callsigns: list[int]
    where: list[list[int]]  # columns of latitudes and of longitudes; of both in one
    ground: list[int]
    heights: list[int]
    speeds: list[int]
    comma: bool  # decimal

    @classmethod
    def of(cls, header: Sequence[str], *, comma: bool = False) -> "Table":
        """The table with this header. Raises BadInput if it says no time, aircraft or position."""
        names = [plain_name(name) for name in header]

        def among(known: Iterable[str]) -> list[int]:
            return [names.index(name) for name in known if name in names]

        where = [among(LATITUDES), among(LONGITUDES)]
        where = where if all(where) else [among(POSITIONS)]
        found = cls(
            names=names,
            times=among(TIMES),
            dates=among(DATES),
            addresses=among(ADDRESSES),
            callsigns=among(NAMES),
            where=where,
            ground=among(GROUND),
            heights=among(HEIGHTS),
            speeds=among(SPEEDS),
            comma=comma,
        )
        missing = [
            f"no column for the {what}, must have one of {', '.join(known[:8])}"
            for what, known, columns in (
                ("time", TIMES, found.times),
                ("aircraft", (*ADDRESSES, *NAMES), found.addresses or found.callsigns),
                ("latitude", LATITUDES, among(LATITUDES) or found.where[0]),
                ("longitude", LONGITUDES, among(LONGITUDES) or found.where[0]),
            )
            if not columns
        ]
        if missing:
            raise BadInput(f"its header has {missing[0]}; it has {', '.join(header)[:200] or 'nothing'}")
        return found

    def report(self, row: int, cells: Sequence[str]) -> Report:
        """What a row says. Raises Unusable."""
        latitude, longitude = self._where(cells)
        if abs(latitude) > 90.0 or abs(longitude) > 360.0:
            raise Unusable(Why.IMPOSSIBLE, f"{latitude:g}, {longitude:g}")
        time = self._time(cells)
        address, name = _first(cells, self.addresses).lower(), _first(cells, self.callsigns).lower()
        address = "" if address == NO_ADDRESS else address
        if not (address or name):
            raise Unusable(Why.NO_AIRCRAFT)
        height, source, down = self._height(cells)
        down = down or _first(cells, self.ground).lower() in TRUE
        height = 0.0 if down else height
        return Report(row, time, address, name, latitude, longitude, height, source, self._speed(cells), down)

    def is_header(self, cells: Sequence[str]) -> bool:
        """Whether a row says the names of the columns again, as in files that were put together."""
        return all(plain_name(cell) == name for cell, name in zip(cells, self.names, strict=False))

    def _where(self, cells: Sequence[str]) -> tuple[float, float]:
        texts = [_first(cells, columns) for columns in self.where]
        if len(texts) == 1:
            texts = texts[0].split(",") if texts[0].count(",") == 1 else [texts[0], ""]
        if not all(texts):
            raise Unusable(Why.NO_POSITION)
        return self._number("latitude", texts[0]), self._number("longitude", texts[1])

    def _number(self, what: str, text: str) -> float:
        try:
            value = float(text.replace(",", ".") if self.comma else text)
        except ValueError:
            value = float("nan")
        if not isfinite(value):
            raise Unread(f"{what} = {text[:40]!r}: must be a number")
        return value

    def _height(self, cells: Sequence[str]) -> tuple[float | None, int, bool]:
        """Height in km, the column that has it, and whether it is said to be on the ground; no impossible one."""
        for column in self.heights:
            text = _first(cells, [column])
            if text.lower() == ON_GROUND:
                return 0.0, column, True
            try:
                z = self._number(self.names[column], text) * self._height_km(column) if text else float("nan")
            except Unread:
                continue
            if z <= MAX_HEIGHT_KM:  # a NaN is not
                return max(z, 0.0), column, False
        return None, -1, False

    def _height_km(self, column: int) -> float:
        name = self.names[column]
        return FOOT_KM if name == "geoaltitude" and "altitude" in self.names else HEIGHTS[name]

    def _speed(self, cells: Sequence[str]) -> float | None:
        for column in self.speeds:
            if text := _first(cells, [column]):
                try:
                    return SPEEDS[self.names[column]] * self._number("speed", text)
                except Unread:
                    continue
        return None

    def _time(self, cells: Sequence[str]) -> float:
        for column in self.times:
            if text := _first(cells, [column]):
                date = _first(cells, self.dates) if _CLOCK.fullmatch(text) else ""
                unit = UNITS.get(self.names[column][-3:])
                return seconds(f"{date} {text}" if date else text, unit, comma=self.comma)
        raise Unusable(Why.NO_TIME)


def seconds(text: str, unit: float | None = None, *, comma: bool = False) -> float:
    """Seconds of a time in a unit per second, or as large as it is, or as ISO 8601 has it. Raises Unread."""
    try:
        value = float(text.replace(",", ".") if comma else text)
    except ValueError:
        plain = text.replace("/", "-").removesuffix("UTC").strip()
        try:
            moment = datetime.fromisoformat(plain)
            return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
        except (ValueError, OverflowError):
            value = float("nan")
    if not isfinite(value) or abs(value) > 1e19:
        raise Unread(f"time = {text[:40]!r}: must be seconds or as ISO 8601 has it")
    if unit is None:
        unit = next((power for least, power in POWERS.items() if value > least), 1.0)
    return value / unit


def headless(cells: Sequence[str]) -> list[str] | None:
    """Names for a table whose first row is data already, if it begins as state vectors do; None: it does not."""
    try:
        time, latitude, longitude = seconds(cells[0]), float(cells[2]), float(cells[3])
    except (Unread, ValueError, IndexError):
        return None
    is_one = time > 0.0 and _ADDRESS.fullmatch(cells[1].strip().lower())
    return ["time", "icao24", "lat", "lon"] if is_one and abs(latitude) <= 90.0 and abs(longitude) <= 180.0 else None


def read(table: Table, rows: Iterable[tuple[int, Sequence[str]]], tally: Tally) -> Iterator[Report]:
    """The reports of numbered rows; what says nothing is counted."""
    for row, cells in rows:
        tally.rows += 1
        try:
            yield table.report(row, cells)
        except Unusable as error:
            again = error.why is Why.UNREADABLE and table.is_header(cells)
            tally.drop(Why.HEADER if again else error.why, row, "" if again else error.example)


def _first(cells: Sequence[str], columns: Sequence[int]) -> str:
    """What a row says in the first of these columns that says anything."""
    for column in columns:
        if column < len(cells) and (text := cells[column].strip()).lower() not in UNKNOWN:
            return text
    return ""
