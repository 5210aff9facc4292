"""The formats of exports: what each of them holds, and what writes it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NamedTuple

from cogradar.services.analysis.arrays.dwell_range import ALL, Dwells
from cogradar.services.analysis.arrays.result import Result
from cogradar.services.analysis.export import table_writers
from cogradar.services.analysis.export.tables import TABLES, Table, rows_of
from cogradar.services.analysis.export.whole import whole
from cogradar.services.errors import BadInput

RUN, CLIP = "run", "clip"
RATE_HZ = 10.0
CONTENTS = (*TABLES, RUN, CLIP)


@dataclass(frozen=True)
class Options:
    """How it is written."""

    dwells: Dwells = ALL  # t of the first and the last
    rate_hz: float | None = None  # of a clip: dwells a second; None: RATE_HZ
    report: Callable[[int], None] = lambda _: None  # is told how many dwells were written


Write = Callable[[Result, str, Path, Options], str]  # (run, what, file, how) -> what was written, in words


class Format(NamedTuple):
    """A format of files."""

    contents: tuple[str, ...]  # what it can hold; the first, if nothing else is asked for
    write: Write
    text: Callable[[Table, BinaryIO], None] | None = None  # writes a table to a stream that people read


def _table(write: Callable[[Table, Path], None], text: Callable[[Table, BinaryIO], None] | None = None) -> Format:
    def written(result: Result, what: str, file: Path, options: Options) -> str:
        columns = rows_of(result, what, options.dwells)
        write(columns, file)
        return f"{len(columns['run'])} rows of {what}"

    return Format(tuple(TABLES), written, text)


def _streamed(write: Callable[[Table, BinaryIO], None], *, is_text: bool = False) -> Format:
    def to_file(columns: Table, file: Path) -> None:
        with file.open("wb") as stream:
            write(columns, stream)

    return _table(to_file, write if is_text else None)


def _mcap(result: Result, _: str, file: Path, options: Options) -> str:
    from cogradar.services.analysis.export import mcap_file

    return f"{mcap_file.write(result, file, options.report, options.dwells)} dwells"


def _rrd(result: Result, _: str, file: Path, options: Options) -> str:
    from cogradar.services.analysis.export import rrd_file

    return f"{rrd_file.write(result, file, options.report, options.dwells)} dwells"


def _clip(result: Result, _: str, file: Path, options: Options) -> str:
    from cogradar.services.analysis.drawing import clip

    rate_hz = RATE_HZ if options.rate_hz is None else options.rate_hz
    n = clip.write(result, file, options.dwells, rate_hz, options.report)
    return f"{n} dwells, {rate_hz:g} a second"


FORMATS = {
    "csv": _streamed(table_writers.write_csv, is_text=True),
    "json": _streamed(table_writers.write_json, is_text=True),
    "npz": _streamed(table_writers.write_npz),
    "parquet": _streamed(table_writers.write_parquet),
    "mat": _streamed(table_writers.write_mat),
    "nc": _table(table_writers.write_netcdf),
    "mcap": Format((RUN,), _mcap),
    "rrd": Format((RUN,), _rrd),
    "gif": Format((CLIP,), _clip),
}
TEXTS = tuple(name for name, one in FORMATS.items() if one.text is not None)


def write(
    result: Result,
    file: Path,
    form: str | None = None,
    what: str | None = None,
    *,
    force: bool = False,
    options: Options | None = None,
) -> str:
    """Write a run in a format, guessed from the name of the file if None; returns what was written, in words.

    what : one of CONTENTS that the format can hold

    The file is there whole or not at all. Raises BadInput if it is there already, unless `force` is given, and if
    there is none of the dwells.
    """
    options = options or Options()
    form = form or file.suffix.removeprefix(".").lower()
    if form not in FORMATS:
        raise BadInput(f"{file}: format must be one of {', '.join(FORMATS)}, as its suffix or as --format")
    holds = _held(form, what, options)
    with whole(file, force=force) as part:
        return FORMATS[form].write(result, holds, part, options)


def send(
    result: Result, stream: BinaryIO, form: str | None, what: str | None = None, options: Options | None = None
) -> None:
    """Write a table of a run to a stream, which stays open: text only. Raises BadInput."""
    text = None if form not in FORMATS else FORMATS[form].text
    if form is None or text is None:
        raise BadInput(f"--format {form}: must be {' or '.join(TEXTS)} for --out -, standard output")
    options = options or Options()
    text(rows_of(result, _held(form, what, options), options.dwells), stream)
    stream.flush()


def _held(form: str, what: str | None, options: Options) -> str:
    """What is to be written in a format. Raises BadInput."""
    contents = FORMATS[form].contents
    if options.rate_hz is not None and CLIP not in contents:
        raise BadInput(f"--rate {options.rate_hz:g}: has no effect on {form} files: leave it out, or use --format gif")
    if what is None:
        return contents[0]
    if what not in CONTENTS:
        raise BadInput(f"--what {what}: must be one of {', '.join(CONTENTS)}")
    if what not in contents:
        forms = [name for name, one in FORMATS.items() if what in one.contents]
        raise BadInput(f"--what {what}: {form} files hold {', '.join(contents)}; use --format {', '.join(forms)}")
    return what
