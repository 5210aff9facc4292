"""ASTERIX recordings: categories 021 (ADS-B), 048 (a radar's plots) and 062 (tracks), with 034 for a radar's place.

The library `libasterix` decodes a record in about 1 ms. Times are seconds since midnight. The packet in which a record
came gives the day. A recording without packets has no date, and its days are counted from day 0.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from math import cos, radians, sin, sqrt
from pathlib import Path
from typing import IO, Any, NamedTuple

from cogradar.services.errors import BadInput
from cogradar.services.skies.place import Place
from cogradar.services.skies.readers.packets import Capture
from cogradar.services.skies.readers.report import Report, Tally, Why
from cogradar.services.skies.readers.table import FOOT_KM, NO_ADDRESS
from cogradar.shared.scenario.limits import MAX_HEIGHT_KM

EDITIONS = {  # newest first: a recording does not say its own
    21: ("021_2_7", "021_2_6", "021_2_4", "021_2_1", "021_0_26", "021_0_23"),
    34: ("034_1_29", "034_1_27"),
    48: ("048_1_32", "048_1_30", "048_1_27"),
    62: ("062_1_21", "062_1_19", "062_1_16"),
}
DAY_S, HALF_S = 86_400.0, 43_200.0
APART_S = 600.0  # between the clocks of packets and records, from which it is said
NM_KM, LEVEL_KM = 1.852, 100.0 * FOOT_KM


class _Block(NamedTuple):
    """A data block."""

    category: int
    records: bytes
    received_s: float | None = None  # since 1970, UTC; None: nothing says it


class _Said(NamedTuple):
    """What a record of one category says, before days are counted."""

    time_s: float | None
    where: tuple[float, float] | None
    height_km: float | None
    address: str
    number: str  # of its track, with its source
    on_ground: bool = False


def is_asterix(head: bytes) -> bool:
    """Whether a file begins with a data block of a known category, shorter than what a text's characters would say."""
    return len(head) > 3 and head[0] in EDITIONS and head[1] < 0x20 and head[1] not in b"\t\n\r" and head[3] > 0


def read_asterix(file: Path, stream: IO[bytes], tally: Tally, place: Place) -> Iterator[Report]:
    """The reports of a recording: data blocks one after the other. Raises BadInput.

    A radar whose place is not recorded (I034/120) is taken to stand at `place`.
    """
    yield from _read(file, _blocks(file, stream, tally), "ASTERIX", tally, place)


def read_packets(file: Path, stream: IO[bytes], tally: Tally, place: Place) -> Iterator[Report]:
    """The reports of a capture of packets, whose times give the day; as `read_asterix`."""
    capture = Capture(file, stream)
    blocks = _blocks_of_packets(file, capture, tally)
    yield from _read(file, blocks, f"ASTERIX in packets ({capture.form})", tally, place)


def _read(file: Path, blocks: Iterable[_Block], form: str, tally: Tally, place: Place) -> Iterator[Report]:
    try:
        from asterix import base, generated
    except ImportError:
        raise BadInput(f"{file}: ASTERIX needs libasterix: pip install 'cogradar[asterix]'") from None
    parsers = {
        category: [getattr(generated, f"Cat_{name}").cv_uap for name in names] for category, names in EDITIONS.items()
    }
    days, radars, seen = _Days(), dict[str, Place](), set[int]()
    for category, records, received_s in blocks:
        seen.add(category)
        if category not in parsers:
            continue
        found = next(
            (
                parsed
                for parser in parsers[category]
                if not isinstance(parsed := parser.parse(base.Bits.from_bytes(records)), ValueError)
            ),
            None,
        )
        if found is None:
            tally.rows += 1
            tally.drop(Why.UNREADABLE, tally.rows, f"a block of category {category:03}")
            continue
        if category == 34:
            _place_radars(found, radars)
            continue
        for record in found:
            tally.rows += 1
            said = _SAID[category](record, radars, place, tally)
            if isinstance(report := _report(said, tally.rows, days, received_s), Report):
                yield report
            else:
                tally.drop(report, tally.rows)
    tally.form = f"{form}, categories {', '.join(f'{category:03}' for category in sorted(seen))}"
    tally.note(days.note)


def _blocks(file: Path, stream: IO[bytes], tally: Tally) -> Iterator[_Block]:
    n = 0
    while len(head := stream.read(3)) == 3:
        n += 1
        length = int.from_bytes(head[1:])
        body = stream.read(max(length - 3, 0))
        if length <= 3 or len(body) < length - 3:
            break
        yield _Block(head[0], body)
    else:
        if not head:
            return
    if n <= 1:
        raise BadInput(f"{file}: no ASTERIX: its first block has no valid length")
    tally.note(f"the recording ends within data block {n}: what was read up to there is used")


def _blocks_of_packets(file: Path, capture: Capture, tally: Tally) -> Iterator[_Block]:
    """The data blocks in the UDP datagrams of a capture. A datagram that is not whole blocks has something else."""
    found = False
    for received_s, payload in capture.datagrams():
        blocks = _whole_blocks(payload)
        found = found or bool(blocks)
        if not blocks:
            capture.left["have something else than ASTERIX"] += 1
        for category, records in blocks:
            yield _Block(category, records, received_s)
    if not found:
        raise BadInput(f"{file}: is a capture of {capture.n} packets without ASTERIX in UDP: {capture.reasons}")
    for words, n in capture.left.most_common(5):
        tally.note(f"{n} of {capture.n} packets are left out: they {words}")
    if capture.is_cut:
        tally.note(f"the capture ends within packet {capture.n + 1}: what was read up to there is used")


def _whole_blocks(payload: bytes) -> list[tuple[int, bytes]]:
    """Category and records of the data blocks that a datagram is; empty if it is something else."""
    found = list[tuple[int, bytes]]()
    begin = 0
    while begin < len(payload):
        end = begin + int.from_bytes(payload[begin + 1 : begin + 3])
        if end <= begin + 3 or end > len(payload) or payload[begin] == 0:
            return []
        found.append((payload[begin], payload[begin + 3 : end]))
        begin = end
    return found


def _report(said: _Said, row: int, days: "_Days", received_s: float | None) -> Report | Why:
    if said.where is None:
        return Why.NO_POSITION
    if said.time_s is None:
        return Why.NO_TIME
    if not (said.address or said.number):
        return Why.NO_AIRCRAFT
    height = 0.0 if said.on_ground else said.height_km
    if height is not None and height > MAX_HEIGHT_KM:
        height = None
    address = "" if said.address == NO_ADDRESS else said.address
    return Report(
        row,
        days(said.time_s, received_s),
        address,
        said.number,
        *said.where,
        None if height is None else max(height, 0.0),
        on_ground=said.on_ground,
    )


class _Days:
    """Times since midnight as times of a recording, which passes midnight: since 1970 where packets say the day."""

    def __init__(self) -> None:
        self._last: float | None = None  # time of the record before, s
        self._offset: float | None = None  # s by which the first packet came after the time of its record

    def __call__(self, time_s: float, received_s: float | None) -> float:
        if received_s is not None:
            if self._offset is None:
                self._offset = (received_s - time_s + HALF_S) % DAY_S - HALF_S
            time_s += DAY_S * round((received_s - self._offset - time_s) / DAY_S)
        elif self._last is not None:
            time_s += DAY_S * round((self._last - time_s) / DAY_S)
        self._last = time_s
        return time_s

    @property
    def note(self) -> str:
        """Where the days are from."""
        if self._offset is None:
            return "ASTERIX has no date: times are since midnight UTC of the first day"
        came = f", which came {self._offset / 60.0:.0f} min after what their records say"
        return f"ASTERIX has no date: the packets give the day{came if abs(self._offset) > APART_S else ''}"


def _part(record: Any, *path: str) -> Any:
    """The content of an item, or of a part of it; None if it is not there."""
    try:
        found = record.get_item(path[0])
        for name in path[1:]:
            found = found if found is None else found.variation.get_item(name)
    except (KeyError, AttributeError):
        return None
    return None if found is None else found.variation


def _quantity(record: Any, unit: str, *paths: tuple[str, ...]) -> float | None:
    """The first of these that is there, in its unit."""
    for path in paths:
        if (found := _part(record, *path)) is not None:
            return float(found.content.as_quantity(unit))
    return None


def _whole(record: Any, *path: str) -> int | None:
    found = _part(record, *path)
    return None if found is None else int(found.as_uint())


def _address(record: Any, *path: str) -> str:
    found = _whole(record, *path)
    return "" if found is None else f"{found:06x}"


def _source(record: Any) -> str:
    return f"{_whole(record, '010', 'SAC') or 0}/{_whole(record, '010', 'SIC') or 0}"


def _number(record: Any, *path: str) -> str:
    found = _whole(record, *path)
    return "" if found is None else f"track {found} of {_source(record)}"


def _latitude_longitude(record: Any, *items: str) -> tuple[float, float] | None:
    for item in items:
        latitude, longitude = (_quantity(record, "°", (item, name)) for name in ("LAT", "LON"))
        if latitude is not None and longitude is not None:
            return latitude, longitude
    return None


def _of_21(record: Any, _radars: Mapping[str, Place], _place: Place, _tally: Tally) -> _Said:
    height_ft = _quantity(record, "ft", ("140",))
    level = _quantity(record, "FL", ("145",))
    height = height_ft * FOOT_KM if height_ft is not None else None if level is None else level * LEVEL_KM
    return _Said(
        _quantity(record, "s", ("071",), ("073",), ("075",), ("077",), ("030",)),
        _latitude_longitude(record, "131", "130"),
        height,
        _address(record, "080"),
        _number(record, "161", "TRNUM"),
        bool(_whole(record, "040", "GBS")),
    )


def _of_48(record: Any, radars: Mapping[str, Place], place: Place, tally: Tally) -> _Said:
    level, source = _quantity(record, "FL", ("090", "FL")), _source(record)
    height = None if level is None else level * LEVEL_KM
    rho, theta = _quantity(record, "NM", ("040", "RHO")), _quantity(record, "°", ("040", "THETA"))
    where = None
    if rho is not None and theta is not None:
        if source not in radars:
            tally.note(f"radar {source} does not say where it is (I034/120): it is taken to stand at --origin")
        radar = radars.get(source, place)._replace(boresight=0.0)
        flat = sqrt(max((rho * NM_KM) ** 2 - (height or 0.0) ** 2, 0.0))  # from the slant range
        where = radar.position(flat * cos(radians(theta)), flat * sin(radians(theta)))
    return _Said(
        _quantity(record, "s", ("140",)), where, height, _address(record, "220"), _number(record, "161", "TRN")
    )


def _of_62(record: Any, _radars: Mapping[str, Place], _place: Place, _tally: Tally) -> _Said:
    feet = _quantity(record, "ft", ("130",))
    level = _quantity(record, "FL", ("136",))
    height = feet * FOOT_KM if feet is not None else None if level is None else level * LEVEL_KM
    return _Said(
        _quantity(record, "s", ("070",)),
        _latitude_longitude(record, "105"),
        height,
        _address(record, "380", "ADR"),
        _number(record, "040"),
    )


_SAID: Mapping[int, Callable[[Any, Mapping[str, Place], Place, Tally], _Said]] = {21: _of_21, 48: _of_48, 62: _of_62}


def _place_radars(records: list[Any], radars: dict[str, Place]) -> None:
    """Note where radars say that they stand."""
    for record in records:
        if (where := _latitude_longitude(record, "120")) is not None:
            radars[_source(record)] = Place(*where, 0.0)
