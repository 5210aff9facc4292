"""Options that name things of somebody's own, and places where they may be loaded from."""

from difflib import get_close_matches
from typing import Annotated

import typer

from cogradar.services.cli import completion
from cogradar.services.errors import BadInput
from cogradar.shared.scenario.plugins.kinds import STRATEGY
from cogradar.shared.scenario.plugins.names import may_be_own, names_of
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.tables import FIDELITY


def of_strategy(name: str) -> Strategy:
    """A name of a strategy, or of your own. Raises BadParameter."""
    from cogradar.services.runs.run import strategy_of

    try:
        return strategy_of(name)
    except BadInput as error:
        raise typer.BadParameter(str(error).removeprefix("strategy = ") + _cure(name)) from None


def asked_strategy(name: str | None) -> str | None:
    """A name that a run's strategy may have. Raises BadParameter."""
    if name is not None and name not in set(Strategy) and not may_be_own(name):
        raise typer.BadParameter(f"{name!r}: must be one of {names_of(list(Strategy))}{_cure(name)}")
    return name


def _cure(name: str) -> str:
    """What was probably meant by a name that no strategy has."""
    if name in FIDELITY:
        return f"; {name} is a fidelity: --set radar.fidelity={name}"
    close = get_close_matches(name, list(Strategy), n=1)
    return f"; did you mean {close[0]}?" if close and close[0] != name else ""


def allow_plugins(places: list[str] | None) -> list[str] | None:
    """Let this command load what is there."""
    from cogradar.shared.scenario.plugins.sources import allow, missing

    if places and (place := missing(*places)):
        raise typer.BadParameter(f"{place}: no such folder, .py file or module")
    allow(*(places or ()))
    return places


StrategyFilter = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        callback=asked_strategy,
        help="Only runs of this strategy.",
        autocompletion=completion.strategies,
    ),
]
StrategyOption = Annotated[
    Strategy,
    typer.Option(
        metavar="NAME",
        parser=of_strategy,
        help=f"How the power is spread: {names_of(STRATEGY.built_in)}.",
        autocompletion=completion.strategies,
    ),
]
PluginsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--plugins",
        metavar="PLACE",
        callback=allow_plugins,
        help="Your own things may be loaded from here, and from COGRADAR_PLUGINS: a folder, a .py file or a module.",
    ),
]
