"""From a name to the thing that it stands for: one way for what is built in and for a user's own."""

import importlib
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib.machinery import ModuleSpec
from pathlib import Path
from pkgutil import resolve_name
from types import ModuleType
from typing import Any, NamedTuple

from cogradar.shared.scenario.faults import printable
from cogradar.shared.scenario.plugins.kinds import OF_RUN, STRATEGY, Kind
from cogradar.shared.scenario.plugins.names import Name, PluginFailed, PluginRefused, is_own
from cogradar.shared.scenario.plugins.sources import Source, bind, bound, entry_point, given, rebind, settled, source_of

MAX_SAID = 200  # characters of what somebody else's exception says


class Caller(NamedTuple):
    """Calls a user's own thing: whatever it raises is a PluginFailed that names its file and line."""

    short: str
    file: str

    def __call__(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """What the function answers."""
        try:
            return function(*arguments)
        except PluginFailed:
            raise
        except (Exception, SystemExit) as error:
            raise PluginFailed(f"{self.short}: {self.said(error)}") from error

    def failed(self, text: str) -> PluginFailed:
        """What is to be raised for an answer that makes no sense."""
        return PluginFailed(f"{self.short} {printable(text)[:MAX_SAID]}")

    def said(self, error: BaseException) -> str:
        """An exception in a line: its type, its text, and the line of the file that it comes from."""
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == self.file]
        where = f"{self.file}, line {lines[-1]}: " if lines else ""
        if isinstance(error, SyntaxError) and error.filename == self.file:
            where = f"{self.file}, line {error.lineno}: "
        return f"{where}{type(error).__name__}: {printable(str(error))[:MAX_SAID]}"


_found: dict[tuple[str, str], Any] = {}  # of this process, as imported modules are
_imports: dict[str, str] = {}  # hash of each module when it was imported
_modules: dict[tuple[str, str], ModuleType] = {}  # by file and hash: two names of a file are of one module


def resolve(kind: Kind, name: str) -> Any:
    """The thing of this name; of a user's own one that answers sensibly, or raises PluginFailed.

    Raises PluginRefused if it cannot be had in this process.
    """
    key = kind.name, name
    if key not in _found:
        built_in = kind.built_in.get(name)
        _found[key] = _own(kind, name) if built_in is None else resolve_name(built_in)
    return _found[key]


def named(kind: Kind, thing: Any, folder: Path) -> str:
    """The name that a run has for a thing: for a name as in a file of this folder, or for an object of this process."""
    if isinstance(thing, str):
        return settled(kind, thing, folder)
    name = bind(kind, thing)
    _found.pop((kind.name, name), None)  # another one of the same source
    return name


def needed(
    radar: Mapping[str, Any], strategy: str, world: Mapping[str, Any] | None = None
) -> Iterator[tuple[Kind, str]]:
    """Kinds and names of the user's own things that a run needs; of its tables, complete."""
    tables = {"radar": radar, "world": world}
    for kind in OF_RUN:
        name: Any = strategy
        if kind is not STRATEGY:
            name = tables
            for part in kind.stands.split("."):
                name = name[part] if name is not None else None
        if isinstance(name, str) and is_own(name):
            yield kind, name


def held(
    radar: Mapping[str, Any], strategy: str, world: Mapping[str, Any] | None = None
) -> list[tuple[Kind, str, Any]]:
    """Objects of this process among the things of a run, and the names that stand for them."""
    names = needed(radar, strategy, world)
    return [(kind, name, thing) for kind, name in names if (thing := bound(kind, name)) is not None]


def hold(objects: Iterable[tuple[Kind, str, Any]]) -> None:
    """Let names stand for these objects, though another run may have others of the same source."""
    for kind, name, thing in objects:
        if bound(kind, name) is not thing:
            rebind(kind, name, thing)
            _found.pop((kind.name, name), None)


def load_for(role: str, radar: Mapping[str, Any], strategy: str, world: Mapping[str, Any] | None = None) -> None:
    """Load what a role needs in a run; "": all of it. Raises PluginRefused."""
    for kind, name in needed(radar, strategy, world):
        if not role or role in kind.loaded_by:
            resolve(kind, name)


def _own(kind: Kind, text: str) -> Any:
    if not kind.protocol or not is_own(text):
        raise PluginRefused(f"{kind.stands} = {printable(text)}: is not known here")
    name, thing = Name.of(text), bound(kind, text)
    path = name.source
    if thing is None:
        source = source_of(kind, name)
        path = str(source.path)
        thing = _attribute(name if name.source else entry_point(kind, name), source)
    guard: Callable[[Any, Caller], Any] = resolve_name(kind.guard)
    return guard(thing, Caller(name.short, path))


def module_of(path: Path) -> ModuleType:
    """The module that a file makes. The name alone allows this process to load it. Raises PluginRefused."""
    return _imported(path.name, given(path))


def _attribute(name: Name, source: Source) -> Any:
    module = _imported(name.short, source)
    if not hasattr(module, name.attribute):
        raise PluginRefused(f"{name.short}: there is no {name.attribute} in {source.path}")
    return getattr(module, name.attribute)


def _imported(short: str, source: Source) -> ModuleType:
    caller = Caller(short, str(source.path))
    if _imports.get(source.module, source.digest) != source.digest:
        raise PluginRefused(f"{short}: {source.path} has changed since this process imported it: restart the process")
    try:
        module = importlib.import_module(source.module) if source.module else _executed(source)
    except (Exception, SystemExit) as error:
        raise PluginRefused(f"{short}: cannot be imported: {caller.said(error)}") from error
    if source.module:
        _imports[source.module] = source.digest
    return module


def _executed(source: Source) -> ModuleType:
    """The module that a file makes, of the very bytes that were hashed. Its folder is not searched for imports."""
    key = str(source.path), source.digest
    if key not in _modules:
        name = f"cogradar_plugin_{source.path.stem.replace('.', '_')}_{source.digest}"  # must not hide another module
        code = compile(source.text, str(source.path), "exec")
        spec = ModuleSpec(name, None, origin=str(source.path))
        module = importlib.util.module_from_spec(spec)
        module.__file__ = str(source.path)
        sys.modules[name] = module  # as for any module: dataclasses look themselves up there
        try:
            exec(code, module.__dict__)  # noqa: S102 - what the process's operator allowed
        except BaseException:
            del sys.modules[name]
            raise
        _modules[key] = module
    return _modules[key]
