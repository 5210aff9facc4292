"""JSON of receivers and archives: readsb and tar1090 (snapshots, traces), OpenSky's states, lists of records."""

import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import IO, Any

from cogradar.services.errors import BadInput
from cogradar.services.skies.readers import table
from cogradar.services.skies.readers.report import Report, Tally
from cogradar.services.skies.readers.text import encoding

MOST_BYTES = 1 << 30  # of one document, which is read whole
STATES = (  # of OpenSky's REST interface, by place
    *("icao24", "callsign", "origin_country", "time_position", "last_contact", "lon", "lat", "baro_altitude"),
    *("on_ground", "velocity", "true_track", "vertical_rate", "sensors", "geo_altitude"),
)
SNAPSHOT = ("time", "hex", "flight", "lat", "lon", "alt_geom", "alt_baro", "altitude", "gs", "speed", "on_ground")
TRACE = ("time", "hex", "flight", "lat", "lon", "alt_baro", "gs")
FORMS = (
    'an aircraft.json or a trace_full_*.json of readsb or tar1090, {"time": .., "states": [..]} of OpenSky, or a list'
    " of records"
)


def read_json(file: Path, stream: IO[bytes], head: bytes, tally: Tally) -> Iterator[Report]:
    """The reports of a JSON file: one document, or one in each line. Raises BadInput."""
    text = _whole(file, stream).decode(encoding(head), "replace")
    try:
        documents = [json.loads(text.removeprefix("\ufeff"))]
    except RecursionError:
        raise BadInput(f"{file}: no JSON file: too deep") from None
    except ValueError as error:
        documents = _documents(text)
        if not documents:
            raise BadInput(f"{file}: no JSON file: {error}") from None
    if len(documents) > 1 and all(isinstance(one, dict) and not _kind(one) for one in documents):
        documents = [documents]  # a record in each line
    for document in documents:
        form, header, rows = _rows(document)
        if not header:
            raise BadInput(f"{file}: is JSON, but nothing that is known: must be {FORMS}")
        tally.form = form
        try:
            columns = table.Table.of(header)
        except BadInput as error:
            raise BadInput(f"{file}: {str(error).replace('its header has', 'its records have')}") from None
        numbered = ((tally.rows + 1, [_cell(cell) for cell in cells]) for cells in rows)
        yield from table.read(columns, numbered, tally)


def _whole(file: Path, stream: IO[bytes]) -> bytes:
    data = stream.read(MOST_BYTES + 1)
    if len(data) > MOST_BYTES:
        raise BadInput(f"{file}: is JSON of more than {MOST_BYTES >> 30} GiB: give a folder of smaller files")
    return data


def _documents(text: str) -> list[Any]:
    """The objects of all lines, if each has one; of a file that is cut short, all but the last."""
    found: list[Any] = []
    parts = text.splitlines()
    for i, line in enumerate(parts):
        if line.strip():
            try:
                found.append(json.loads(line))
            except (ValueError, RecursionError):
                if i < len(parts) - 1:
                    return []
    return found


def _kind(document: dict[str, Any]) -> str:
    """The key that says what a document is; "" for a record."""
    return next((key for key in ("trace", "states", "aircraft", "ac") if isinstance(document.get(key), list)), "")


def _rows(document: Any) -> tuple[str, Sequence[str], Iterable[Sequence[Any]]]:
    """The form of a document, names of its columns, and its rows; no names: of no form."""
    if isinstance(document, list):
        records = [one for one in document if isinstance(one, dict)]
        names = list(dict.fromkeys(str(key) for one in records for key in one))
        return "JSON, records", names, ([one.get(name) for name in names] for one in records)
    if not isinstance(document, dict):
        return "", [], []
    kind = _kind(document)
    entries = document[kind] if kind else []
    if kind == "trace":
        return "JSON, trace of readsb", TRACE, _trace(document, entries)
    if kind == "states":
        return "JSON, states of OpenSky", STATES, (one for one in entries if isinstance(one, list))
    if kind:
        now = _number(document.get("now"))
        now = now / 1e3 if now is not None and now > 1e11 else now
        return "JSON, snapshot of readsb", SNAPSHOT, (_heard(one, now) for one in entries if isinstance(one, dict))
    return "", [], []


def _heard(one: dict[str, Any], now: float | None) -> list[Any]:
    """An aircraft of a snapshot; its position is as old as it says."""
    age = _number(one.get("seen_pos", 0.0)) or 0.0
    time = one.get("time", None if now is None else now - age)
    return [time, *(one.get(name) for name in SNAPSHOT[1:])]


def _trace(document: dict[str, Any], entries: list[Any]) -> Iterator[Sequence[Any]]:
    """[s after the timestamp, latitude, longitude, altitude in feet or "ground" or null, speed in knots, ...]."""
    begin, address = _number(document.get("timestamp")) or 0.0, document.get("icao")
    for one in entries:
        if isinstance(one, list) and len(one) > 3 and (after := _number(one[0])) is not None:
            speed = one[4] if len(one) > 4 else None
            yield [begin + after, address, document.get("flight"), one[1], one[2], one[3], speed]
        else:
            yield [None, address, *[None] * (len(TRACE) - 2)]


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and abs(value) < 1e19 else None


def _cell(value: Any) -> str:
    """A value of JSON or of Parquet as the text of a cell."""
    if value is None or isinstance(value, dict | list):
        return ""
    return value.isoformat() if hasattr(value, "isoformat") else str(value)


def read_parquet(file: Path, stream: IO[bytes], tally: Tally) -> Iterator[Report]:
    """The reports of a Parquet file, as the package `traffic` writes it. Raises BadInput."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise BadInput(f"{file}: Parquet needs pyarrow: pip install 'cogradar[parquet]'") from None
    tally.form = "Parquet"
    try:
        source = pyarrow.parquet.ParquetFile(stream)
        names = list(source.schema_arrow.names)
        columns = table.Table.of(names)
        wanted = [name for name in names if table.plain_name(name) in table.known_names()]
        columns = table.Table.of(wanted)
        for batch in source.iter_batches(columns=wanted):
            cells = zip(*(column.to_pylist() for column in batch.columns), strict=True)
            numbered = ((tally.rows + 1, [_cell(cell) for cell in row]) for row in cells)
            yield from table.read(columns, numbered, tally)
    except (pyarrow.ArrowException, OSError) as error:
        raise BadInput(f"{file}: no Parquet file: {error}") from None
    except BadInput as error:
        raise BadInput(f"{file}: {error}") from None
