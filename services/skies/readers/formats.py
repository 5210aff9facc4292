"""Which reader a file needs, by its first bytes; a folder is its files one after the other."""

from collections.abc import Iterator
from pathlib import Path
from typing import IO

from cogradar.services.errors import BadInput
from cogradar.services.skies.place import Place
from cogradar.services.skies.readers import packets, text, unpacked
from cogradar.services.skies.readers.asterix import is_asterix, read_asterix, read_packets
from cogradar.services.skies.readers.receiver import read_json, read_parquet
from cogradar.services.skies.readers.report import Report, Tally
from cogradar.shared.scenario.faults import printable

MOST_FILES = 100_000  # of a folder
_CURES = {
    b"SQLite format 3\0": "an SQLite database: export the table of positions as CSV",
    b"\x89HDF": "an HDF5 file: export it as Parquet or CSV",
    b"CDF": "a NetCDF file: export it as Parquet or CSV",
    b"Obj\x01": "an Avro file: export it as Parquet or CSV",
    b"%PDF": "a PDF: export it as CSV",
    b"<": "XML or KML: export it as CSV",
    b"\x1f\x8b": "compressed twice: decompress it once",
}


def reports(file: Path, place: Place, tally: Tally) -> Iterator[Report]:
    """All positions of a file or of a folder. Raises BadInput.

    What is no position is counted. `place` is where the radar of the scenario stands.
    """
    try:
        if not file.is_dir():
            yield from _of_file(file, place, tally)
            return
        inside = sorted(path for path in file.rglob("*") if path.is_file() and not path.name.startswith("."))
        if not inside:
            raise BadInput(f"{file}: the folder has no files")
        if len(inside) > MOST_FILES:
            raise BadInput(f"{file}: the folder has more than {MOST_FILES} files, must have fewer")
        for path in inside:
            yield from _of_file(path, place, tally)
        tally.form += f"; {len(inside)} files"
        tally.note(f"rows are counted through the {len(inside)} files of the folder, in the order of their names")
    except FileNotFoundError:
        raise BadInput(f"{file}: no such file") from None
    except OSError as error:
        raise BadInput(f"{file}: {error.strerror or printable(str(error))}") from None


def _of_file(file: Path, place: Place, tally: Tally) -> Iterator[Report]:
    if file.exists() and not file.is_file():  # it is read several times, and must end
        raise BadInput(f"{file}: not a regular file: save into one what it gives, and name that")
    try:
        with unpacked.opened(file) as stream:
            head = stream.read(text.HEAD)
        for magic, cure in _CURES.items():
            if head.startswith(magic):
                raise BadInput(f"{file}: is {cure}")
        if head[257:].startswith(b"ustar"):
            raise BadInput(f"{file}: is a tar archive: unpack it, tar -xf {file.name}, and name the folder")
        with unpacked.opened(file) as stream:
            yield from _of_stream(file, stream, head, place, tally)
    except unpacked.DamagedFile as error:
        raise BadInput(f"{file}: {error}") from None


def _of_stream(file: Path, stream: IO[bytes], head: bytes, place: Place, tally: Tally) -> Iterator[Report]:
    """The reports of a file that begins so."""
    if head.startswith(b"PAR1"):
        yield from read_parquet(file, stream, tally)
    elif packets.is_capture(head):
        yield from read_packets(file, stream, tally, place)
    elif is_asterix(head):
        yield from read_asterix(file, stream, tally, place)
    elif head.decode(text.encoding(head), "replace").lstrip("\ufeff \t\r\n")[:1] in ("{", "["):
        yield from read_json(file, stream, head, tally)
    else:
        yield from text.read_table(file, stream, head, tally)
