"""Files that are there whole or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from cogradar.services.errors import BadInput


@contextmanager
def whole(file: Path, *, force: bool) -> Iterator[Path]:
    """Another name for a file, under which it is written; it gets its own when all of it is there. Raises BadInput."""
    if file.exists() and not force:
        raise BadInput(f"{file}: is there already; --force replaces it")
    part = file.with_name(f".{file.stem}.{os.getpid()}.part{file.suffix}")
    try:
        yield part
        part.replace(file)
    except OSError as error:
        raise BadInput(f"{file}: {error.strerror or error}") from None
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


@contextmanager
def as_os_error() -> Iterator[None]:
    """Libraries written in C and Rust raise RuntimeError where a file cannot be written; here it is an OSError."""
    try:
        yield
    except RuntimeError as error:
        raise OSError(str(error)) from None
