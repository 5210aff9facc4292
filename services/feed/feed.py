"""The feed: pictures from a source, through a format, to a transport, until its run or its user ends it."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from cogradar.services.errors import BadInput, RunFailed
from cogradar.services.feed.aircraft_json import AircraftJson
from cogradar.services.feed.asterix import DEFAULT, Asterix, Source, categories_of
from cogradar.services.feed.cot import CursorOnTarget
from cogradar.services.feed.geojson import GeoJson
from cogradar.services.feed.output import Format, Output
from cogradar.services.feed.picture import Picture
from cogradar.services.feed.sapient.node import Sapient
from cogradar.services.feed.sapient.tasking import Command
from cogradar.services.feed.transport import Transport, transport
from cogradar.shared.scenario.plugins.kinds import FEED
from cogradar.shared.scenario.plugins.names import PluginError, PluginFailed, PluginRefused, names_of, without_name
from cogradar.shared.scenario.plugins.resolver import Caller, resolve
from cogradar.shared.scenario.plugins.sources import settled


class Options(NamedTuple):
    """What formats can be told."""

    source: Source = Source(0, 1)  # of ASTERIX
    categories: str = DEFAULT
    stale_s: float = 10.0  # of Cursor on Target
    command: Command | None = None  # for tasks of SAPIENT; None: they are refused
    notify: Callable[[str], None] = lambda _: None  # of what is received and dropped


class Kind(NamedTuple):
    """A format that can be chosen."""

    make: Callable[[Options], Format]
    has_files: bool  # its outputs replace each other
    is_stream: bool  # its outputs can follow each other in a stream of bytes
    is_dialogue: bool = False  # the other side answers: it needs a connection
    takes_tasks: bool = False  # ... and may ask something of the radar

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
    "sapient": Kind(
        lambda options: Sapient(options.command, options.notify),
        has_files=False,
        is_stream=True,
        is_dialogue=True,
        takes_tasks=True,
    ),
}


def kind_of(name: str) -> Kind:
    """A format by its name, built in or a user's own. Raises BadInput."""
    if name in FORMATS:
        return FORMATS[name]
    try:
        found: Kind = resolve(FEED, settled(FEED, name, Path()))
    except PluginError as error:
        is_none = not all(name.rpartition(":"))  # no source, or no name in it
        said = f"must be one of {names_of(FORMATS)}" if is_none else without_name(error, name)
        raise BadInput(f"--to {name}: {said}") from None
    return found


class _Guarded(Format):
    """A user's own format, whose outputs are bytes. Whatever else it answers ends the feed."""

    def __init__(self, made: Any, call: Caller) -> None:
        self._made, self._call = made, call
        self.wants_plots = bool(getattr(made, "wants_plots", False))

    def encode(self, picture: Picture) -> Sequence[Output]:
        outputs = self._asked("encode", picture)
        if not (isinstance(outputs, list | tuple) and all(map(_is_output, outputs))):
            raise RunFailed(f"{self._call.short} returned {str(outputs)[:80]}: encode must return Outputs of bytes")
        return outputs

    def greeting(self) -> bytes:
        return self._bytes("greeting") if hasattr(self._made, "greeting") else b""

    def answer(self, data: bytes) -> bytes:
        return self._bytes("answer", data) if hasattr(self._made, "answer") else b""

    def _bytes(self, method: str, *arguments: Any) -> bytes:
        said = self._asked(method, *arguments)
        if not isinstance(said, bytes):
            raise RunFailed(f"{self._call.short} returned {str(said)[:80]}: {method} must return bytes")
        return said

    def _asked(self, method: str, *arguments: Any) -> Any:
        try:
            return self._call(getattr(self._made, method), *arguments)
        except PluginFailed as error:
            raise RunFailed(str(error)) from error


def _is_output(output: Any) -> bool:
    return isinstance(output, Output) and isinstance(output.data, bytes) and isinstance(output.file, str)


def guarded(made: Any, call: Caller) -> Kind:
    """A user's own format, or a class that makes one for each feed. Raises PluginRefused if it cannot encode."""
    if not callable(getattr(made, "encode", None)):
        raise PluginRefused(f"{call.short}: a feed needs the method encode, which it has not")
    flags = {"has_files": False, "is_stream": True, "is_dialogue": False}
    given = {name: bool(getattr(made, name, default)) for name, default in flags.items()}

    def make(_options: Options) -> Format:
        try:
            return _Guarded(call(made) if isinstance(made, type) else made, call)
        except PluginFailed as error:
            raise RunFailed(str(error)) from error

    return Kind(make, **given)


@dataclass
class Tally:
    """How many pictures a feed had to send, and how many went out; not those that drop all tracks at an end."""

    offered: int = 0
    sent: int = 0

    def words(self, way: Transport) -> str:
        """What has become of them."""
        lost = self.offered - self.sent
        if not self.sent:
            of_them = f", {lost} {'was' if lost == 1 else 'were'} lost" if lost else ""
            return f"no picture was {way.done}{of_them}"
        share = f"{self.sent} of " if lost else ""
        text = f"{share}{self.offered} {'picture' if self.offered == 1 else 'pictures'} {way.done}"
        if lost:
            text += "; the other one was lost" if lost == 1 else "; the others were lost"
        return text if way.is_answered else f"{text}; datagrams do not tell whether anything receives them"


def feed(pictures: Iterable[Picture | None], form: Format, way: Transport, rate_hz: float, tally: Tally) -> None:
    """Send pictures, at most `rate_hz` of them a second (0: all), the newest if there are more.

    tally : counts them, and is right whatever ends this

    Whatever ends it, the last thing that is sent is a picture without tracks: none stays on a display.
    """
    last: Picture | None = None  # that was sent
    held: Picture | None = None  # that waits for its time
    due_s = 0.0
    try:
        for picture in pictures:
            if picture is not None and last is not None and picture.run != last.run and last.tracks:
                last = last.without_tracks()
                way.send(form.encode(last))
            held = picture or held
            if held is None or (rate_hz and time.monotonic() < due_s):
                continue
            tally.offered += 1
            outputs, is_accepted = form.encode(held), form.is_accepted
            tally.sent += way.send(outputs) and is_accepted
            last, held = held, None
            if rate_hz:  # what came while this one was sent is looked through first, for the newest
                due_s = max(due_s + 1.0 / rate_hz, time.monotonic() + 0.25 / rate_hz)
    except RunFailed:
        last = None  # there is no way any more
        raise
    finally:
        if last is not None and (last.tracks or held is not None):
            way.send(form.encode(last.without_tracks()))
