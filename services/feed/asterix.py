"""ASTERIX, EUROCONTROL's format of surveillance data: category 034 (ed. 1.29, the radar), 048 (ed. 1.32, plots and
tracks of a radar) and 062 (ed. 1.20, tracks of a system).

Records of a kind have one layout, so that NumPy packs all records of a picture together: 1 000 tracks in less than 1
ms. The library `libasterix` takes 0.9 ms for each; the tests read with it what is written here.
"""

from collections import deque
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.services.errors import BadInput
from cogradar.services.feed.output import Format, Output
from cogradar.services.feed.picture import Picture, Track

NUMBERS: Final = 1 << 12  # of tracks, at a time
PAUSE_S = 60.0  # of UTC, before the number of a track that has ended is another's
MAX_BYTES = 1400  # of a datagram: it fits into a frame of Ethernet
DAY_S = 86_400
DEGREE_62, DEGREE_34 = (1 << 25) / 180.0, (1 << 23) / 180.0  # units of a latitude or longitude in each category
RADAR, REPORTS, TRACKS = 34, 48, 62  # categories
DEFAULT = f"{RADAR:03},{TRACKS:03}"
NM_KM, MOST_NM = 1.852, 256.0  # nautical mile; category 048 tells nothing beyond this distance
TURN_48 = (1 << 16) / 360.0  # units of an azimuth

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
_POLAR = [
    ("source", "u1", 2),  # I048/010
    ("time", "u1", 3),  # I048/140, 1/128 s since midnight
    ("report", "u1"),  # I048/020
]
_PLOT = np.dtype(
    [
        ("fspec", "u1"),
        *_POLAR,
        ("measured", ">u2", 2),  # I048/040, distance in 1/256 NM and azimuth
    ]
)
_PLOT_TRACK = np.dtype(
    [
        ("fspec", "u1", 2),
        *_POLAR,
        ("position", ">u2", 2),  # I048/040 of a report without a detection: the estimate
        ("number", ">u2"),  # I048/161
        ("place", ">i2", 2),  # I048/042, to the east and to the north, 1/128 NM
        ("velocity", ">u2", 2),  # I048/200, 2^-14 NM/s and course
        ("status", "u1"),  # I048/170
    ]
)
_PLOT_END = np.dtype([("fspec", "u1", 2), *_POLAR, ("number", ">u2"), ("status", "u1", 2)])
_FSPEC = {
    _TRACK: (0xBF, 0x0F, 0x01, 0x04),
    _END: (0xB1, 0x0C),
    _RADAR: (0xE9, 0x10),
    _PLOT: (0xF0,),
    _PLOT_TRACK: (0xF1, 0x1E),
    _PLOT_END: (0xE1, 0x12),
}
_NORTH_MARKER = 1  # the message by which a radar says that a cycle begins
# Octets of I062/080, with the bit that another one follows.
_MORE, _MONOSENSOR, _TENTATIVE = 0x01, 0x80, 0x02
_SIMULATED, _LAST, _FIRST = 0x80, 0x40, 0x20
_COASTED = 0x80
# Of I048/020: a primary radar's detection, or none, and whether that is simulated; of I048/170.
_PRIMARY, _SIMULATED_48 = 0x20, 0x10
_PRIMARY_TRACK, _CLIMB_UNKNOWN, _TENTATIVE_48, _END_48 = 0x20, 0x06, 0x80, 0x80


class Source(NamedTuple):
    """The codes that a system has among all: of its area and its own, each 0 .. 255."""

    sac: int
    sic: int


class Numbers:
    """Numbers of 12 bits for tracks. The number of an ended track rests before another track has it."""

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


def categories_of(text: str) -> frozenset[int]:
    """Categories that are named, as `034,062`. Raises BadInput."""
    known = {f"{category:03}": category for category in (RADAR, REPORTS, TRACKS)}
    names = text.split(",")
    if not known.keys() >= set(names):
        raise BadInput(f"--categories {text}: must be some of {', '.join(known)}, as in {DEFAULT}")
    return frozenset(known[name] for name in names)


class Asterix(Format):
    """For each picture the radar (034), the tracks that ended and the tracks (062), its detections and tracks (048)."""

    def __init__(self, source: Source, categories: frozenset[int] = frozenset((RADAR, TRACKS))) -> None:
        self._source, self._categories = source, categories
        self.wants_plots = REPORTS in categories
        self._numbers = Numbers()
        self._run = ""

    def encode(self, picture: Picture) -> list[Output]:
        """Data blocks, each a datagram."""
        shown = {track.number for track in picture.tracks}
        ended = [number for number in self._numbers.tracks if number not in shown or picture.run != self._run]
        self._run = picture.run
        ends = [self._numbers.end(number, picture.utc_s) for number in ended]
        given = [(track, self._numbers.give(track.number, picture.utc_s)) for track in picture.tracks]
        tracks = [(track, *number) for track, number in given if number is not None]
        found = list[Output]()
        if RADAR in self._categories:
            found += _blocks(RADAR, self._radar(picture))
        if TRACKS in self._categories:
            found += _blocks(TRACKS, self._ends(ends, picture)) + _blocks(TRACKS, self._tracks(tracks, picture))
        if REPORTS in self._categories:
            near = [
                (track, number)
                for track, number, _ in tracks
                if _is_near(float(np.hypot(track.east_km, track.north_km)))
            ]
            for records in self._plots(picture), self._plot_ends(ends, picture), self._plot_tracks(near, picture):
                found += _blocks(REPORTS, records)
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

    def _reports(self, n: int, kind: "np.dtype[np.void]", picture: Picture) -> NDArray[np.void]:
        records = self._begun(n, kind, picture.utc_s)
        records["report"] = _SIMULATED_48 if picture.is_simulated else 0
        return records

    def _plots(self, picture: Picture) -> NDArray[np.void]:
        plots = [plot for plot in picture.plots if _is_near(plot.range_km)]
        records = self._reports(len(plots), _PLOT, picture)
        records["report"] |= _PRIMARY
        if plots:
            records["measured"] = _polar(np.array(plots))
        return records

    def _plot_ends(self, numbers: Sequence[int], picture: Picture) -> NDArray[np.void]:
        records = self._reports(len(numbers), _PLOT_END, picture)
        records["number"] = numbers
        records["status"] = _PRIMARY_TRACK | _CLIMB_UNKNOWN | _MORE, _END_48
        return records

    def _plot_tracks(self, tracks: Sequence[tuple[Track, int]], picture: Picture) -> NDArray[np.void]:
        records = self._reports(len(tracks), _PLOT_TRACK, picture)
        if not tracks:
            return records
        of = [track for track, _ in tracks]
        records["number"] = [number for _, number in tracks]
        places = np.array([(track.east_km, track.north_km) for track in of])
        east, north = places.T
        records["position"] = _polar(np.stack((np.hypot(east, north), np.degrees(np.arctan2(east, north))), axis=-1))
        records["place"] = _within(places * (128.0 / NM_KM), np.int16)
        speeds, courses = np.array([(track.speed, track.course_deg) for track in of]).T
        records["velocity"][:, 0] = _within(speeds * ((1 << 14) / (1e3 * NM_KM)), np.uint16)
        records["velocity"][:, 1] = np.rint(courses * TURN_48).astype(np.int64) % (1 << 16)
        state = _PRIMARY_TRACK | _CLIMB_UNKNOWN
        records["status"] = [state | (0 if track.confirmed else _TENTATIVE_48) for track in of]
        return records


def _is_near(range_km: float) -> bool:
    """Whether category 048 has room for a distance."""
    return range_km / NM_KM * 256.0 < MOST_NM * 256.0 - 0.5


def _polar(positions: NDArray[np.float64]) -> NDArray[np.int64]:
    """Distance, km, and azimuth, degrees, in units of category 048, (n, 2); 360 degrees are 0."""
    return np.asarray(np.rint(positions * (256.0 / NM_KM, TURN_48)).astype(np.int64) % (1 << 16))


def _blocks(category: int, records: NDArray[np.void]) -> list[Output]:
    """Data blocks, none longer than a datagram may be."""
    most = (MAX_BYTES - 3) // records.dtype.itemsize
    return [_block(category, records[i : i + most]) for i in range(0, len(records), most)]


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
