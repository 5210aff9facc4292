"""What the shell offers when a word is completed: nothing that takes longer than looking into a folder."""

from collections.abc import Iterable
from glob import escape
from pathlib import Path

from cogradar.shared.scenario.files import built_in
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.tables import RULES

METRICS = ("runs", "tracks", "p_d", "rmse", "consistency", "confirmation", "summary", "picture", "antennas", "commands")


def scenarios(incomplete: str) -> list[str]:
    """Built-in scenarios, and TOML files."""
    return _beginning_with(incomplete, built_in()) + _files(incomplete, ".toml")


def stores(incomplete: str) -> list[str]:
    """Store files."""
    return _files(incomplete, ".db")


def metrics(incomplete: str) -> list[str]:
    """What `cogradar query` can be asked for."""
    return _beginning_with(incomplete, METRICS)


def checked(incomplete: str) -> list[str]:
    """Scenarios, and Python files."""
    return scenarios(incomplete) + _files(incomplete, ".py")


def rules(incomplete: str) -> list[str]:
    """Action-selection policies, and Python files with one's own."""
    return _beginning_with(incomplete, RULES) + _files(incomplete, ".py")


def kinds(incomplete: str) -> list[str]:
    """Kinds of things of one's own."""
    from cogradar.services.plugins.templates import kinds as there

    return _beginning_with(incomplete, there())


def strategies(incomplete: str) -> list[str]:
    """Lists of strategies, the last one of which is being typed; also Python files with one's own."""
    before, comma, last = incomplete.rpartition(",")
    given = before.split(",")
    found = [*_beginning_with(last, Strategy), *_files(last, ".py")]
    return [f"{before}{comma}{name}" for name in found if name not in given]


def _beginning_with(incomplete: str, names: Iterable[str]) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]


def _files(incomplete: str, suffix: str) -> list[str]:
    folder, slash, begun = incomplete.rpartition("/")
    found = sorted(Path(f"{folder}{slash}").glob(f"{escape(begun)}*"))
    names = [f"{path.name}/" if path.is_dir() else path.name for path in found]
    return [f"{folder}{slash}{name}" for name in names if name.endswith(("/", suffix))]
