"""The formats of exports: what each of them holds, and what writes it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NamedTuple

from cogradar.services.analysis.arrays.result import Result
from cogradar.services.analysis.export import table_writers
from cogradar.services.analysis.export.tables import TABLES, Table
from cogradar.services.analysis.export.whole import whole
from cogradar.services.errors import BadInput

RUN, CLIP = "run", "clip"
CONTENTS = (*TABLES, RUN, CLIP)


@dataclass(frozen=True)
class Options:
    """How it is written."""

    dwells: tuple[int | None, int | None] = (None, None)  # of a clip: first and last
    rate_hz: float = 10.0  # of a clip: dwells a second
    report: Callable[[int], None] = lambda _: None  # is told how many dwells were written


Write = Callable[[Result, str, Path, Options], str]  # (run, what, file, how) -> what was written, in words


class Format(NamedTuple):
    """A format of files."""

    contents: tuple[str, ...]  # what it can hold; the first, if nothing else is asked for
    write: Write
    text: Callable[[Table, BinaryIO], None] | None = None  # writes a table to a stream that people read


def _table(write: Callable[[Table, Path], None], text: Callable[[Table, BinaryIO], None] | None = None) -> Format:
    def written(result: Result, what: str, file: Path, _: Options) -> str:
        columns = TABLES[what](result)
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

    return f"{mcap_file.write(result, file, options.report)} dwells"


def _rrd(result: Result, _: str, file: Path, options: Options) -> str:
    from cogradar.services.analysis.export import rrd_file

    return f"{rrd_file.write(result, file, options.report)} dwells"


def _clip(result: Result, _: str, file: Path, options: Options) -> str:
    from cogradar.services.analysis.drawing import clip

    n = clip.write(result, file, options.dwells, options.rate_hz, options.report)
    return f"{n} dwells, {options.rate_hz:g} a second"


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

    The file is there whole or not at all. Raises BadInput if it is there already, unless `force` is given.
    """
    form = form or file.suffix.removeprefix(".").lower()
    if form not in FORMATS:
        raise BadInput(f"{file}: format must be one of {', '.join(FORMATS)}, as its suffix or as --format")
    holds = _held(form, what)
    with whole(file, force=force) as part:
        return FORMATS[form].write(result, holds, part, options or Options())


def send(result: Result, stream: BinaryIO, form: str | None, what: str | None = None) -> None:
    """Write a table of a run to a stream, which stays open: text only. Raises BadInput."""
    text = None if form not in FORMATS else FORMATS[form].text
    if form is None or text is None:
        raise BadInput(f"--format {form}: must be {' or '.join(TEXTS)} for --out -, standard output")
    text(TABLES[_held(form, what)](result), stream)
    stream.flush()


def _held(form: str, what: str | None) -> str:
    """What is to be written in a format. Raises BadInput."""
    contents = FORMATS[form].contents
    if what is None:
        return contents[0]
    if what not in CONTENTS:
        raise BadInput(f"--what {what}: must be one of {', '.join(CONTENTS)}")
    if what not in contents:
        forms = [name for name, one in FORMATS.items() if what in one.contents]
        raise BadInput(f"--what {what}: {form} files hold {', '.join(contents)}; use --format {', '.join(forms)}")
    return what
