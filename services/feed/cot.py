"""Cursor on Target, the events that TAK clients and servers show (MITRE MP090284; ATAK's own type for a deletion)."""

from datetime import UTC, datetime
from xml.sax.saxutils import quoteattr

import numpy as np

from cogradar.services.feed.output import Format, Output
from cogradar.services.feed.picture import Picture, Track

TYPE = "a-u-A"  # an atom, of unknown affiliation, in the air
DROP = "t-x-d-d"  # a task: delete
HOW = "m-f"  # found by machines, fused
SIMULATED = "m-s"
UNKNOWN = "9999999.0"  # height, and its error
PERIODS = 2.0  # between pictures, at least until an event is stale


class CursorOnTarget(Format):
    """An event for each track in each picture; one that deletes it when the track ends."""

    def __init__(self, stale_s: float) -> None:
        """stale_s : after which a display may take a track away that it hears no more of."""
        self._stale_s = stale_s
        self._shown: dict[str, Track] = {}  # by uid

    def encode(self, picture: Picture) -> list[Output]:
        """Events, each a datagram."""
        shown = {f"cogradar.{picture.run}.{track.number}": track for track in picture.tracks}
        ended = [(uid, track) for uid, track in self._shown.items() if uid not in shown]
        self._shown = shown
        how = SIMULATED if picture.is_simulated else HOW
        times = _time(picture.utc_s), _time(picture.utc_s + max(self._stale_s, PERIODS * picture.period_s))
        found = [_event(f"{uid}.drop", DROP, how, track, times, _deletion(uid)) for uid, track in ended]
        return found + [_event(uid, TYPE, how, track, times, _detail(track)) for uid, track in shown.items()]


def _event(uid: str, kind: str, how: str, track: Track, times: tuple[str, str], detail: str) -> Output:
    now, stale = times
    largest = max(float(np.linalg.eigvalsh(track.covariance[::2, ::2])[-1]), 0.0)
    return Output(
        f'<?xml version="1.0" encoding="UTF-8"?>\n<event version="2.0" uid={quoteattr(uid)} type="{kind}"'
        f' how="{how}" time="{now}" start="{now}" stale="{stale}">'
        f'<point lat="{track.latitude:.7f}" lon="{track.longitude:.7f}" hae="{UNKNOWN}"'
        f' ce="{largest**0.5:.1f}" le="{UNKNOWN}"/><detail>{detail}</detail></event>\n'.encode()
    )


def _detail(track: Track) -> str:
    existence = "" if track.existence is None else f", existence {track.existence:.3f}"
    return (
        f'<contact callsign="T{track.number}"/><track course="{track.course_deg:.2f}" speed="{track.speed:.2f}"/>'
        f"<remarks>last detected {track.seen_s:g} s ago{existence}</remarks>"
    )


def _deletion(uid: str) -> str:
    return f'<link uid={quoteattr(uid)} type="{TYPE}" relation="none"/><__forcedelete/>'


def _time(utc_s: float) -> str:
    return datetime.fromtimestamp(utc_s, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
