"""Bytes of a file as text: encoding and delimiter, found out or named with the cure."""

import csv
import io
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import IO

from cogradar.services.errors import BadInput
from cogradar.services.skies.readers import table
from cogradar.services.skies.readers.report import Report, Tally

HEAD = 1 << 16  # bytes from which the form is seen
DELIMITERS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars"}
SBS = ("MSG", "AIR", "SEL", "ID", "STA", "CLK")  # of a BaseStation line
SBS_HEADER = (
    "kind,type,session,number,icao24,flight_number,date,time,logged_date,logged,callsign,altitude,groundspeed,track,"
    "lat,lon,climb,squawk,alert,emergency,spi,onground"
)
_BOMS = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}


def encoding(head: bytes) -> str:
    """The encoding of a text that begins so."""
    for mark, name in _BOMS.items():
        if head.startswith(mark):
            return name
    if len(head) >= 4 and b"\0" in head:
        return "utf-16-le" if head[1::2].count(0) > head[::2].count(0) else "utf-16-be"
    return "utf-8"


def lines(stream: IO[bytes], head: bytes) -> Iterator[str]:
    """The lines of a text, with their ends."""
    with io.TextIOWrapper(stream, encoding=encoding(head), errors="replace", newline="") as text:
        yield from text


def read_table(file: Path, stream: IO[bytes], head: bytes, tally: Tally) -> Iterator[Report]:
    """The reports of a table of delimited text. Raises BadInput."""
    source = lines(stream, head)
    skipped, first = 0, ""
    for line in source:
        if line.strip() and not line.startswith("#") and not line.lower().startswith("sep="):
            first = line
            break
        skipped += 1
    if not first.strip():
        raise BadInput(f"{file}: is empty: must have a header, such as time,icao24,lat,lon, and a row per position")
    delimiter = _delimiter(first)
    reader = csv.reader(chain([first], source), delimiter=delimiter)
    try:
        header = next(reader)
        rows: Iterator[list[str]] = reader
        tally.form = f"text, {DELIMITERS[delimiter]}, {encoding(head)}"
        if header[0].strip() in SBS and len(header) >= 11:
            header, rows = SBS_HEADER.split(","), chain([header], reader)
            tally.form = "BaseStation (SBS)"
            tally.note("times of BaseStation are of the receiver's clock: they are taken for UTC")
        elif (names := table.headless(header)) is not None:
            header, rows = names, chain([header], reader)
            tally.note(f"there is no header: the first columns are taken for {', '.join(names)}")
        columns = table.Table.of(header, comma=delimiter != ",")
        yield from table.read(columns, ((skipped + reader.line_num, cells) for cells in rows if cells), tally)
    except csv.Error as error:
        raise BadInput(f"{file}: line {skipped + reader.line_num}: no CSV file: {error}") from None
    except BadInput as error:
        raise BadInput(f"{file}: {error}{_without_header(header)}") from None


def _delimiter(first: str) -> str:
    """The character between the names of a header; of several, the one that gives most names that are known."""
    known = table.known_names()

    def names(delimiter: str) -> tuple[int, int]:
        cells = next(csv.reader([first], delimiter=delimiter), [])
        return sum(table.plain_name(cell) in known for cell in cells), len(cells)

    return max(DELIMITERS, key=names)


def _without_header(header: Sequence[str]) -> str:
    """The cure for a first line that names nothing that is known."""
    if len(header) < 2:
        return "; columns must be divided by commas, semicolons, tabs or bars"
    if {table.plain_name(name) for name in header}.isdisjoint(table.known_names()):
        return "; if the table has no header, put one before it, such as time,icao24,lat,lon"
    return ""
