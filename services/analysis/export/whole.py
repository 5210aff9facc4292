"""Files that are there whole or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from cogradar.services.errors import BadInput


def fault_of_file(given: str | Path) -> str:
    """Why no file of this name can be written; empty if one can."""
    file = Path(given)
    if given == "":
        return "has no name: name a file"
    try:
        _look(file)
        if file.is_dir() or str(given).endswith(os.sep):
            return f"{file}: is a folder: name a file in it"
        if file.is_symlink() and not file.exists():
            return f"{file}: is a link that leads to no file: name another one"
        if not file.parent.is_dir():
            return f"{file}: there is no folder {file.parent}: make it first, or name another one"
        above = file if file.exists() else file.parent
    except OSError as error:
        return f"{file}: {_reason(error)}: name another one"
    return "" if os.access(above, os.W_OK) else f"{file}: {above} may not be written to: name another file"


def fault_of_folder(given: str | Path) -> str:
    """Why no files can be written into a folder of this name; empty if they can: it is made if it is not there."""
    folder = Path(given)
    if given == "":
        return "has no name: name a folder; . is this one"
    try:
        _look(folder)
        if folder.is_symlink() and not folder.exists():
            return f"{folder}: is a link that leads to no folder: name another one"
        above = next(one for one in (folder, *folder.absolute().parents) if one.exists())
    except OSError as error:
        return f"{folder}: {_reason(error)}: name another one"
    if not above.is_dir():
        return f"{folder}: {'is' if above == folder else f'{above} is'} a file: name a folder, which is made if need be"
    return "" if os.access(above, os.W_OK) else f"{folder}: {above} may not be written to: name another folder"


def _look(path: Path) -> None:
    """Raises OSError for a name that is too long, or in a folder that may not be entered: some Pythons say no more
    than that nothing is there.
    """
    with suppress(FileNotFoundError, NotADirectoryError):
        path.stat()


def _reason(error: OSError) -> str:
    return (error.strerror or str(error)).lower()


def made(folder: Path) -> None:
    """Make a folder, unless it is there. Raises BadInput, OSError."""
    if fault := fault_of_folder(folder):
        raise BadInput(fault)
    folder.mkdir(parents=True, exist_ok=True)


@contextmanager
def whole(file: Path, *, force: bool) -> Iterator[Path]:
    """Another name for a file, under which it is written; it gets its own when all of it is there. Raises BadInput."""
    if fault := fault_of_file(file):
        raise BadInput(fault)
    if file.exists() and not force:
        raise BadInput(f"{file}: is there already; --force replaces it")
    if file.exists() and not file.is_file():
        raise BadInput(f"{file}: is no regular file, and would be replaced by one: name another one")
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
