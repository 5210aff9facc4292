"""ASTERIX, EUROCONTROL's format of surveillance data: category 062 (ed. 1.20, tracks) and 034 (ed. 1.29, the radar).

Records have one layout, so that NumPy packs those of a picture together: 1 000 tracks in less than 1 ms. The library
`libasterix` takes 0.9 ms for each; the tests read with it what is written here.
"""

from collections import deque
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.services.feed.output import Output
from cogradar.services.feed.picture import Picture, Track

NUMBERS: Final = 1 << 12  # of tracks, at a time
PAUSE_S = 60.0  # of UTC, before the number of a track that has ended is another's
MAX_BYTES = 1400  # of a datagram: it fits into a frame of Ethernet
DAY_S = 86_400
DEGREE_62, DEGREE_34 = (1 << 25) / 180.0, (1 << 23) / 180.0  # units of a latitude or longitude in each category

# Of a record, big-endian, in the order of the categories' tables; the items that are there, by bits (FSPEC).
_TRACK = np.dtype(
    [
        ("fspec", "u1", 4),
        ("source", "u1", 2),  # I062/010
        ("service", "u1"),  # I062/015
        ("time", "u1", 3),  # I062/070, 1/128 s since midnight
        ("position", ">i4", 2),  # I062/105, latitude and longitude
        ("place", "u1", (2, 3)),  # I062/100, to the east and to the north of the radar, 0.5 m
        ("velocity", ">i2", 2),  # I062/185, 0.25 m/s
        ("number", ">u2"),  # I062/040
        ("status", "u1", 4),  # I062/080
        ("ages", "u1", 2),  # I062/290, age of the primary radar's last report, 0.25 s
        ("accuracy", "u1"),  # I062/500: that
        ("sigmas", ">u2", 2),  # ... of the place, 0.5 m
        ("covariance", ">i2"),  # ... with its covariance
        ("velocity_sigmas", "u1", 2),  # ... and of the velocity, 0.25 m/s, have values
    ]
)
_END = np.dtype(
    [
        ("fspec", "u1", 2),
        ("source", "u1", 2),
        ("service", "u1"),
        ("time", "u1", 3),
        ("number", ">u2"),
        ("status", "u1", 2),
    ]
)
_RADAR = np.dtype(
    [
        ("fspec", "u1", 2),
        ("source", "u1", 2),  # I034/010
        ("type", "u1"),  # I034/000
        ("time", "u1", 3),  # I034/030
        ("period", ">u2"),  # I034/041, 1/128 s
        ("height", ">i2"),  # I034/120, m
        ("position", "u1", (2, 3)),  # ... latitude, longitude
    ]
)
_FSPEC = {_TRACK: (0xBF, 0x0F, 0x01, 0x04), _END: (0xB1, 0x0C), _RADAR: (0xE9, 0x10)}
_NORTH_MARKER = 1  # the message by which a radar says that a cycle begins
# Octets of I062/080, with the bit that another one follows.
_MORE, _MONOSENSOR, _TENTATIVE = 0x01, 0x80, 0x02
_SIMULATED, _LAST, _FIRST = 0x80, 0x40, 0x20
_COASTED = 0x80


class Source(NamedTuple):
    """The codes that a system has among all: of its area and its own, each 0 .. 255."""

    sac: int
    sic: int


class Numbers:
    """Numbers of 12 bits for tracks. That of a track that has ended rests before another one has it."""

    def __init__(self) -> None:
        self._of: dict[int, int] = {}
        self._free = deque((number, float("-inf")) for number in range(NUMBERS))  # and since when, the oldest first

    def give(self, track: int, utc_s: float) -> tuple[int, bool] | None:
        """The number of a track, and whether it is new; None: all are in use, or rest."""
        if track in self._of:
            return self._of[track], False
        # The time of another run may be earlier.
        if not self._free or 0.0 <= utc_s - self._free[0][1] < PAUSE_S:
            return None
        self._of[track], _ = self._free.popleft()
        return self._of[track], True

    def end(self, track: int, utc_s: float) -> int:
        """Take back the number of a track that has ended."""
        number = self._of.pop(track)
        self._free.append((number, utc_s))
        return number

    @property
    def tracks(self) -> list[int]:
        """Those that have a number."""
        return list(self._of)


class Asterix:
    """For each picture a datagram of category 034, then category 062 with its tracks and the tracks that ended."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._numbers = Numbers()
        self._run = ""

    def encode(self, picture: Picture) -> list[Output]:
        """Data blocks, each a datagram."""
        found = [_block(34, self._radar(picture))]
        shown = {track.number for track in picture.tracks}
        ended = [number for number in self._numbers.tracks if number not in shown or picture.run != self._run]
        self._run = picture.run
        found += _blocks(self._ends([self._numbers.end(number, picture.utc_s) for number in ended], picture))
        given = [(track, self._numbers.give(track.number, picture.utc_s)) for track in picture.tracks]
        found += _blocks(self._tracks([(track, *number) for track, number in given if number is not None], picture))
        return found

    def _begun(self, n: int, kind: "np.dtype[np.void]", utc_s: float) -> NDArray[np.void]:
        records = np.zeros(n, kind)
        records["fspec"], records["source"] = _FSPEC[kind], self._source
        records["time"] = _three(np.full(n, round(utc_s % DAY_S * 128.0) % (DAY_S * 128)))
        return records

    def _radar(self, picture: Picture) -> NDArray[np.void]:
        records, site = self._begun(1, _RADAR, picture.utc_s), picture.site
        records["type"], records["period"] = _NORTH_MARKER, min(round(picture.period_s * 128.0), 0xFFFF)
        records["height"] = round(site.height_m)
        records["position"] = _three(np.array([[site.latitude_deg, site.longitude_deg]]) * DEGREE_34)
        return records

    def _ends(self, numbers: Sequence[int], picture: Picture) -> NDArray[np.void]:
        records = self._begun(len(numbers), _END, picture.utc_s)
        records["number"] = numbers
        records["status"] = _MONOSENSOR | _MORE, _LAST | (_SIMULATED if picture.is_simulated else 0)
        return records

    def _tracks(self, tracks: Sequence[tuple[Track, int, bool]], picture: Picture) -> NDArray[np.void]:
        records = self._begun(len(tracks), _TRACK, picture.utc_s)
        if not tracks:
            return records
        of = [track for track, _, _ in tracks]
        covariances = np.array([track.covariance for track in of])
        sigmas = np.sqrt(np.maximum(np.diagonal(covariances, axis1=1, axis2=2), 0.0))
        seen_s = np.array([track.seen_s for track in of])
        records["position"] = np.rint(np.array([(track.latitude, track.longitude) for track in of]) * DEGREE_62)
        records["place"] = _three(np.array([(track.east_km, track.north_km) for track in of]) * 2000.0)
        records["velocity"] = _within(np.array([track.velocity for track in of]) * 4.0, np.int16)
        records["number"] = [number for _, number, _ in tracks]
        status = records["status"]
        status[:, 0] = [_MONOSENSOR | _MORE | (0 if track.confirmed else _TENTATIVE) for track in of]
        status[:, 1] = [_MORE | (_FIRST if is_new else 0) for _, _, is_new in tracks]
        status[:, 1] |= _SIMULATED if picture.is_simulated else 0
        status[:, 2] = _MORE
        status[:, 3] = np.where(seen_s > 0.0, _COASTED, 0)
        records["ages"][:, 0], records["ages"][:, 1] = 0x40, _within(seen_s * 4.0, np.uint8)
        records["accuracy"] = 0xC4
        records["sigmas"] = _within(sigmas[:, ::2] * 2.0, np.uint16)
        product = covariances[:, 0, 2]
        records["covariance"] = _within(np.sign(product) * np.sqrt(np.abs(product)) * 2.0, np.int16)
        records["velocity_sigmas"] = _within(sigmas[:, 1::2] * 4.0, np.uint8)
        return records


def _blocks(records: NDArray[np.void]) -> list[Output]:
    """Data blocks of category 062, none longer than a datagram may be."""
    most = (MAX_BYTES - 3) // records.dtype.itemsize
    return [_block(62, records[i : i + most]) for i in range(0, len(records), most)]


def _block(category: int, records: NDArray[np.void]) -> Output:
    data = records.tobytes()
    return Output(bytes((category,)) + (len(data) + 3).to_bytes(2, "big") + data)


def _within(values: NDArray[np.float64], kind: type[np.integer]) -> NDArray[np.float64]:
    """Whole numbers that a type can hold: the nearest ones."""
    limits = np.iinfo(kind)
    return np.asarray(np.clip(np.rint(values), limits.min, limits.max))


def _three(values: NDArray[np.float64] | NDArray[np.int64]) -> NDArray[np.uint8]:
    """Whole numbers as three octets, the last axis."""
    whole = np.clip(np.rint(values), -(1 << 23), (1 << 24) - 1).astype(">i4")
    return whole.view(np.uint8).reshape(*whole.shape, 4)[..., 1:]
