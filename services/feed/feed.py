"""The feed: pictures from a source, through a format, to a transport, until its run or its user ends it."""

import time
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

from cogradar.services.errors import BadInput, RunFailed
from cogradar.services.feed.aircraft_json import AircraftJson
from cogradar.services.feed.asterix import DEFAULT, Asterix, Source, categories_of
from cogradar.services.feed.cot import CursorOnTarget
from cogradar.services.feed.geojson import GeoJson
from cogradar.services.feed.output import Format
from cogradar.services.feed.picture import Picture
from cogradar.services.feed.sapient import Sapient
from cogradar.services.feed.transport import Transport, transport


class Options(NamedTuple):
    """What formats can be told."""

    source: Source = Source(0, 1)  # of ASTERIX
    categories: str = DEFAULT
    stale_s: float = 10.0  # of Cursor on Target


class Kind(NamedTuple):
    """A format that can be chosen."""

    make: Callable[[Options], Format]
    has_files: bool  # its outputs replace each other
    is_stream: bool  # its outputs can follow each other in a stream of bytes
    is_dialogue: bool = False  # the other side answers: it needs a connection

    def way(self, out: str, form: Format, notify: Callable[[str], None]) -> Transport:
        """The transport that --out names. Raises BadInput."""
        flags = {"has_files": self.has_files, "is_stream": self.is_stream, "is_dialogue": self.is_dialogue}
        return transport(out, form, notify, **flags)


FORMATS: Mapping[str, Kind] = {
    "aircraft-json": Kind(lambda _: AircraftJson(), has_files=True, is_stream=False),
    "asterix": Kind(
        lambda options: Asterix(options.source, categories_of(options.categories)), has_files=False, is_stream=True
    ),
    "cot": Kind(lambda options: CursorOnTarget(options.stale_s), has_files=False, is_stream=True),
    "geojson": Kind(lambda _: GeoJson(), has_files=True, is_stream=True),
    "sapient": Kind(lambda _: Sapient(), has_files=False, is_stream=True, is_dialogue=True),
}


def kind_of(name: str) -> Kind:
    """A format by its name. Raises BadInput."""
    if name not in FORMATS:
        raise BadInput(f"--to {name}: must be one of {', '.join(FORMATS)}")
    return FORMATS[name]


def feed(pictures: Iterable[Picture | None], form: Format, way: Transport, rate_hz: float) -> int:
    """Send pictures, at most `rate_hz` of them a second (0: all), the newest if there are more; returns how many.

    Whatever ends it, the last thing that is sent is a picture without tracks: none stays on a display.
    """
    last: Picture | None = None  # that was sent
    held: Picture | None = None  # that waits for its time
    due_s, n = 0.0, 0
    try:
        for picture in pictures:
            if picture is not None and last is not None and picture.run != last.run and last.tracks:
                last = last.without_tracks()
                way.send(form.encode(last))
            held = picture or held
            if held is None or (rate_hz and time.monotonic() < due_s):
                continue
            way.send(form.encode(held))
            last, held, n = held, None, n + 1
            if rate_hz:  # what came while this one was sent is looked through first, for the newest
                due_s = max(due_s + 1.0 / rate_hz, time.monotonic() + 0.25 / rate_hz)
    except RunFailed:
        last = None  # there is no way any more
        raise
    finally:
        if last is not None and (last.tracks or held is not None):
            way.send(form.encode(last.without_tracks()))
    return n
