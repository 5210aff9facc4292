"""A sky as a scenario file: its targets, and a radar that can find them."""

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from math import log10
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from cogradar.services.errors import BadInput
from cogradar.services.skies.place import Place
from cogradar.shared.scenario.files import ScenarioError, load

BASE = "paper-best-range"  # which the file extends
EDGE_SNR_DB = -8.0  # per virtual channel, from the edge: with all power everywhere seen in about every other scan
SIGMA_S = 0.0005  # km/s^2 of aircraft that fly straight on
Checked = TypeVar("Checked")
Target = dict[str, Any]  # a table of `world.targets`


class Sky(NamedTuple):
    """What flies."""

    title: str
    made_by: str  # the command
    targets: Sequence[Target]
    seconds: int
    range_km: float  # of the edge
    height_max_km: float = 0.0  # that the radar assumes
    place: Place | None = None  # None: made up, and nowhere
    aircraft: int | None = None  # None: as many as targets; else some of them fly several times
    begin_utc: str | None = None  # of clock 0


def begins_s(target: Target) -> float:
    """When a target comes, s."""
    first = target["trajectory"][0][0] if "trajectory" in target else 0.0
    return max(float(target.get("born_s", 0.0)), first, 0.0)


def text(sky: Sky) -> str:
    """The scenario file of a sky."""
    dt_s = load(BASE).radar.motion.dt_s
    targets, echo_db = sorted(sky.targets, key=begins_s), 40.0 * log10(sky.range_km) + EDGE_SNR_DB
    aircraft = len(targets) if sky.aircraft is None else sky.aircraft
    flights = f" on {len(targets)} flights" if aircraft != len(targets) else ""
    lines = [
        f"# Made by `{sky.made_by}`: {aircraft} aircraft{flights}, of which the radar is told nothing.",
        f'extends = "{BASE}"',
        f'title = "{sky.title}"',
        f"dwells = {max(1, int(sky.seconds / dt_s))}",
        "",
        "[radar]",
        'tracks = "unknown"',
        "",
        "[radar.echo]",
        f"amplitude_db = {echo_db:.1f}  # an echo from the edge, at {sky.range_km:g} km, is seen in every other scan",
        "",
        "[radar.acquisition]",
        f"range_max_km = {sky.range_km:g}",
        "",
        *(["[radar.assumes]", f"height_max_km = {sky.height_max_km:g}", ""] if sky.height_max_km > 0.0 else []),
        *(_site(sky.place, sky.begin_utc) if sky.place is not None else ()),
        "[world.motion]",
        f"sigma_s_km_s2 = {SIGMA_S}",
    ]
    for target in targets:
        lines += ["", "[[world.targets]]", *(f"{key} = {_toml(value)}" for key, value in target.items())]
    return "\n".join(lines) + "\n"


def _site(place: Place, begin_utc: str | None) -> list[str]:
    """The table of where the radar of a recording is."""
    return [
        "[site]",
        f"latitude_deg = {place.latitude!r}",
        f"longitude_deg = {place.longitude!r}",
        f"boresight_deg = {place.boresight % 360.0!r}",
        *([f'begin_utc = "{begin_utc}"'] if begin_utc is not None else ()),
        "",
    ]


def _toml(value: Any) -> str:
    """Numbers, lists of them, and lists of tables of them; a row of a longer list on a line of its own."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(inner)}" for key, inner in value.items()) + " }"
    if isinstance(value, list) and value and isinstance(value[0], list | dict):
        return "[\n" + "".join(f"    {_toml(inner)},\n" for inner in value) + "]"
    return str(value)


def save(content: str, file: Path, *, force: bool, check: Callable[[Path], Checked]) -> Checked:
    """Write a file whole or not at all. Raises BadInput if it is there already, unless `force` is given.

    check : of what is written, before it takes its place; what it returns, if it raises no ScenarioError
    """
    if file.exists() and not force:
        raise BadInput(f"{file}: is there already; --force replaces it")
    part = file.with_name(f".{file.stem}.{os.getpid()}.part{file.suffix}")
    try:
        part.write_text(content, encoding="utf-8")
        checked = check(part)
        part.replace(file)
    except ScenarioError as error:
        raise BadInput(str(error).replace(str(part), str(file))) from None
    except OSError as error:
        raise BadInput(f"{file}: {error.strerror or error}") from None
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)
    return checked
