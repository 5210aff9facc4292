"""What `cogradar sky` was asked for, checked, and the file that comes of it."""

from pathlib import Path
from typing import NamedTuple

from cogradar.services.errors import BadInput
from cogradar.services.skies import files
from cogradar.services.skies.place import Place
from cogradar.services.skies.recorded import recorded, recording
from cogradar.services.skies.traffic import traffic
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.world_config import WorldConfig
from cogradar.shared.world.targets import Flights

HEIGHT_MAX_KM = 12.0  # the radar assumes it of aircraft with heights; higher if one of them is


class Asked(NamedTuple):
    """The options of the command."""

    aircraft: int
    minutes: int
    seed: int
    positions: Path | None  # a recording; None: made-up traffic
    origin: str | None  # latitude and longitude
    boresight: float
    range_km: float
    heights: bool = False  # of a recording are used

    @property
    def place(self) -> Place:
        """Where the radar is. Raises BadInput."""
        if self.origin is None:
            raise BadInput("--origin LAT,LON: must be given with --from and with --out FILE.csv")
        try:
            latitude, longitude = (float(part) for part in self.origin.split(","))
        except ValueError:
            latitude = longitude = float("nan")
        if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):
            raise BadInput(f"--origin {self.origin}: must be LAT,LON in degrees, such as 48.35,11.79")
        return Place(latitude, longitude, self.boresight)


def write(asked: Asked, file: Path, *, force: bool) -> str:
    """Write a scenario, or with the suffix .csv a recording; returns what is in it. Raises BadInput."""
    if file.suffix not in {".toml", ".csv"} or (file.suffix == ".csv" and asked.positions is not None):
        raise BadInput(f"--out {file}: must end with .toml{'' if asked.positions is not None else ' or .csv'}")
    if asked.heights and asked.positions is None:
        raise BadInput("--heights: needs --from, a recording with altitudes")
    if asked.positions is not None:
        return _write(_of_recording(asked, asked.positions), file, force=force)
    sky = _made_up(asked)
    if file.suffix == ".toml":
        return _write(sky, file, force=force)
    scenario = load(files.BASE)
    world = scenario.simulated.model_dump() | {
        "targets": sorted(sky.targets, key=files.begins_s),  # in the order of the scenario file
        "motion": {"sigma_s_km_s2": files.SIGMA_S},
    }
    flights = Flights(WorldConfig.model_validate(world), 1.0, asked.seed)
    files.save(recording(flights, sky.seconds, asked.place), file, force=force, check=lambda _: None)
    return f"positions of {len(sky.targets)} aircraft in {asked.minutes} minutes"


def _write(sky: files.Sky, file: Path, *, force: bool) -> str:
    scenario = files.save(files.text(sky), file, force=force, check=lambda part: load(str(part)))
    there = len(scenario.starting)
    return f"{scenario.n_target} aircraft in {scenario.dwells} dwells, {there} of them there at the start"


def _made_up(asked: Asked) -> files.Sky:
    seconds = 60 * asked.minutes
    command = f"cogradar sky --aircraft {asked.aircraft} --seed {asked.seed} --minutes {asked.minutes}"
    title = f"{asked.aircraft} aircraft that come and go within {asked.range_km:g} km, seed {asked.seed}"
    targets = traffic(asked.aircraft, seconds, asked.range_km, asked.seed)
    return files.Sky(title, f"{command} --range {asked.range_km:g}", targets, seconds, asked.range_km)


def _of_recording(asked: Asked, positions: Path) -> files.Sky:
    place = asked.place
    found = recorded(positions, place, asked.range_km, heights=asked.heights)
    where = f"--origin {place.latitude:g},{place.longitude:g} --boresight {place.boresight:g}"
    name = "".join(character if character.isprintable() else "?" for character in positions.name)
    command = f"cogradar sky --from {name} {where} --range {asked.range_km:g}"
    command += " --heights" if asked.heights else ""
    title = f"{found.aircraft} recorded aircraft within {asked.range_km:g} km"
    heights = [row[3] for target in found.targets for row in target["trajectory"]] if asked.heights else []
    highest_km = max([HEIGHT_MAX_KM, *heights]) if heights else 0.0
    return files.Sky(title, command, found.targets, found.seconds, asked.range_km, highest_km, place)
