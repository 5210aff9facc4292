"""Where a user's own things come from, and what this process may load: nothing but what its operator named.

What a process may load is a setting of it, as its search path for imports is: made when it starts, by
`allow`, or by naming something on its command line. A name that comes in a message opens nothing.
"""

import hashlib
import importlib.util
import inspect
import os
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points, packages_distributions, version
from pathlib import Path
from typing import Any, NamedTuple

from cogradar.shared.scenario.faults import printable
from cogradar.shared.scenario.plugins.kinds import Kind
from cogradar.shared.scenario.plugins.names import (
    FILE,
    MAX_NAME,
    MODULE,
    N_HASH,
    OWN,
    Name,
    PluginRefused,
    is_own,
    names_of,
)

VARIABLE = "COGRADAR_PLUGINS"
MAX_BYTES = 1 << 20  # of a file
_UNTRUSTED = (
    "a scenario file names it, which by itself runs nothing: if you trust it, name its folder with --plugins or"
    f" {VARIABLE}"
)
IN_PROCESS = "__main__"  # source of an object of a Python process that has none of its own
MAX_ATTRIBUTE = 80  # characters of such an object's name
_FILE, _MODULE, _IDENTIFIER = re.compile(FILE), re.compile(MODULE), re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


class Source(NamedTuple):
    """The source of a user's own thing."""

    path: Path
    text: bytes
    digest: str
    module: str = ""  # to be imported; "": the file is executed


@dataclass
class _Allowed:
    """What this process may load."""

    places: dict[str, None] = field(default_factory=dict)  # folders, files and modules, in the order they were named
    objects: dict[tuple[str, str], Any] = field(default_factory=dict)  # of this process itself, by kind and name


_allowed = _Allowed()


def allow(*places: str) -> None:
    """Let this process load what is in these folders, files and modules; each may be several, as in a search path."""
    for place in (part for text in places for part in text.split(os.pathsep) if part):
        is_module = _MODULE.fullmatch(place) is not None and not Path(place).exists()
        _allowed.places[place if is_module else str(_settled(Path(place)))] = None


def missing(*places: str) -> str:
    """The first of these that is neither a folder, nor a file, nor the name of a module; empty if all are one."""
    parts = [part for text in places for part in text.split(os.pathsep) if part]
    return next((one for one in parts if not Path(one).exists() and not _is_module(one)), "")


def _is_module(name: str) -> bool:
    try:
        return _MODULE.fullmatch(name) is not None and importlib.util.find_spec(name) is not None
    except (ImportError, ValueError):  # of its package; __main__ has no spec
        return False


def _settled(path: Path) -> Path:
    """A whole path. A file may be a link, as in a mounted volume: its folder and its own name count."""
    return path.resolve() if path.is_dir() else path.parent.resolve() / path.name


def allowance() -> str:
    """What this process may load, in the form that `allow` takes, for processes that it starts."""
    return os.pathsep.join(_places())


def bind(kind: Kind, thing: Any) -> str:
    """Let a name of a run stand for an object of this process; for a name of a file, the object of its file."""
    named = thing if hasattr(thing, "__qualname__") else type(thing)
    attribute = named.__qualname__
    try:
        path = Path(inspect.getsourcefile(named) or "")
        source, text = path.name, _read(path, str(path))
    except (OSError, TypeError, PluginRefused):  # OSError: a class of a notebook
        source, text = "", b""
    module = sys.modules.get(getattr(named, "__module__", ""))
    name = f"{source}:{attribute}#{_hash(text)}"
    if not is_own(name) or getattr(module, attribute, None) is not thing:
        plain = re.sub(r"\W+", "_", attribute, flags=re.ASCII)[:MAX_ATTRIBUTE]
        name = f"{IN_PROCESS}:{plain}#{_hash(_text_of(named))}"
    rebind(kind, name, thing)
    return name


def rebind(kind: Kind, name: str, thing: Any) -> None:
    """Let a name stand for an object of this process."""
    _allowed.objects[kind.name, name] = thing


def _text_of(thing: Any) -> bytes:
    """The source of a function or a class, or else its code."""
    try:
        return inspect.getsource(thing).encode()
    except (OSError, TypeError):
        parts = vars(thing).values() if isinstance(thing, type) else (thing,)
        codes = [part.__code__ for part in parts if hasattr(part, "__code__")]
        return b"".join(code.co_code + repr(code.co_consts).encode() for code in codes)


def bound(kind: Kind, name: str) -> Any:
    """The object for which a name stands in this process; None: for none."""
    return _allowed.objects.get((kind.name, name))


def _places() -> list[str]:
    if given := os.environ.get(VARIABLE, ""):
        allow(given)
    return list(_allowed.places)


def settled(kind: Kind, text: str, folder: Path, file: str = "") -> str:
    """What is named TEXT on a command line or in a scenario file in this folder, as a run has it.

    file : that names it, which may be somebody else's: what it names must be allowed; "": the name alone allows it

    Raises PluginRefused.
    """
    if text in kind.built_in or not kind.protocol:
        return text
    name = Name.of(text)
    if not _IDENTIFIER.fullmatch(name.attribute) and name.source:
        raise PluginRefused(f"{printable(text)}: must be {OWN}")
    if name.is_file:
        path = folder / name.source
        if not (name.digest and not path.is_file()):  # a name of a run may mean a file of an allowed folder
            if file and not _may_load(path):
                raise PluginRefused(f"{printable(name.source)}: {_UNTRUSTED}")
            given(path)
            name = name._replace(source=path.name)
    elif _MODULE.fullmatch(name.source):
        if not file:
            allow(name.source)
    elif not _entry_points(kind, name.attribute):
        known = [*kind.built_in, *sorted(point.name for point in entry_points(group=kind.group))]
        raise PluginRefused(f"must be one of {names_of(known)}")
    found = f"{name.short}#{source_of(kind, name).digest}"
    if not is_own(found):
        raise PluginRefused(f"{found}: must have at most {MAX_NAME} characters")
    return found


def _may_load(path: Path) -> bool:
    """Whether a file, or its folder, is allowed."""
    found = _settled(path)
    return not {str(found), str(found.parent)}.isdisjoint(_places())


def given(path: Path) -> Source:
    """The source of a file that was named on a command line, or in a scenario file: this process may load it."""
    if not _FILE.fullmatch(path.name):
        raise PluginRefused(f"{printable(path.name)}: must have a name of letters, digits, hyphens, dots and _")
    text = _read(path, str(path))
    found = _settled(path)
    _allowed.places = {str(found): None} | _allowed.places  # what was named last is looked at first
    return Source(found, text, _hash(text))


def source_of(kind: Kind, name: Name) -> Source:
    """The source that this process has for a name; with the hash that the name says. Raises PluginRefused."""
    found = [_module(kind, name)] if not name.is_file else list(_files(name))
    if not found:
        raise PluginRefused(
            f"{name.source}: not here, or not allowed: this process loads {_said()}; name its folder with --plugins or"
            f" {VARIABLE}"
        )
    if name.digest and name.digest not in [source.digest for source in found]:
        raise PluginRefused(
            f"{name.short}: {found[0].path} has source {found[0].digest} here, the run has {name.digest}: bring the"
            " source of the run here"
        )
    return next((source for source in found if source.digest == name.digest), found[0])


def _said() -> str:
    return " and ".join(_places()) or "no plug-ins"


def _files(name: Name) -> Iterator[Source]:
    if not _FILE.fullmatch(name.source):
        return
    for place in map(Path, _places()):
        path = place / name.source if place.is_dir() else place
        if path.name == name.source and path.is_file():
            text = _read(path, str(path))
            yield Source(path, text, _hash(text))


def _read(path: Path, said: str) -> bytes:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise PluginRefused(f"{printable(said)}: has more than {MAX_BYTES >> 20} MiB")
        return path.read_bytes()
    except OSError as error:
        raise PluginRefused(f"{printable(said)}: {error.strerror}") from None


def _hash(*parts: bytes) -> str:
    return hashlib.sha256(b"\0".join(parts)).hexdigest()[:N_HASH]


def _entry_points(kind: Kind, name: str) -> list[EntryPoint]:
    return list(entry_points(group=kind.group, name=name))


def entry_point(kind: Kind, name: Name) -> Name:
    """What an entry point of installed packages stands for. Raises PluginRefused."""
    points = _entry_points(kind, name.attribute)
    if len(points) != 1:
        raise PluginRefused(f"{name.attribute}: {len(points) or 'no'} installed packages have it in {kind.group}")
    return Name(points[0].module, points[0].attr, name.digest)


def _module(kind: Kind, name: Name) -> Source:
    """The source of a module. To install a package with an entry point allows it to be loaded."""
    if not name.source:
        name = entry_point(kind, name)
    elif not any(name.source == place or name.source.startswith(f"{place}.") for place in _places()):
        of_process = "it is an object of the Python process that began the run" if name.source == IN_PROCESS else ""
        raise PluginRefused(
            f"{name.short}: "
            + (of_process or f"not allowed: this process loads {_said()}; name it with --plugins or {VARIABLE}")
        )
    try:
        spec = importlib.util.find_spec(name.source)
    except Exception as error:  # noqa: BLE001 - a package of somebody else may raise anything
        raise PluginRefused(f"{name.source}: cannot be imported: {type(error).__name__}: {error}") from None
    if spec is None or spec.origin is None or not Path(spec.origin).is_file():
        raise PluginRefused(f"{name.source}: no such module is installed")
    packages = packages_distributions().get(name.source.partition(".")[0], ())
    text = _read(Path(spec.origin), spec.origin)
    releases = [f"{package} {version(package)}".encode() for package in sorted(set(packages))]
    return Source(Path(spec.origin), text, _hash(*releases, text), name.source)
