"""What `cogradar sky` was asked for, checked, and the file that comes of it."""

from pathlib import Path
from typing import Any, NamedTuple

from cogradar.services.errors import BadInput
from cogradar.services.skies import files
from cogradar.services.skies.place import Place
from cogradar.services.skies.readers.report import Tally
from cogradar.services.skies.recorded import Recording, recorded, recording
from cogradar.services.skies.selection import MOST_AIRCRAFT, Selection, count
from cogradar.services.skies.traffic import traffic
from cogradar.shared.scenario.faults import printable
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.world_config import WorldConfig
from cogradar.shared.world.targets import Flights

HEIGHT_MAX_KM = 12.0  # the radar assumes it of aircraft with heights; higher if one of them is


MINUTES, AIRCRAFT = 20, 12  # of made-up traffic


class Asked(NamedTuple):
    """The options of the command."""

    aircraft: str | None  # how many; of a recording also which
    minutes: int | None
    seed: int
    positions: Path | None  # a recording; None: made-up traffic
    origin: str | None  # latitude and longitude
    boresight: float
    range_km: float
    heights: bool = False  # of a recording are used
    start: str | None = None  # of a recording: UTC
    ground: bool = False  # with the aircraft of a recording that are on the ground

    @property
    def n(self) -> int:
        """How many aircraft are made up. Raises BadInput."""
        if self.aircraft is None:
            return AIRCRAFT
        if (n := count(self.aircraft)) is None:
            raise BadInput(f"--aircraft {self.aircraft}: must be 1 .. {MOST_AIRCRAFT}; names of aircraft need --from")
        return n

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


class Made(NamedTuple):
    """What was written."""

    said: str
    document: dict[str, Any]  # what `--json` prints
    tally: Tally | None = None  # of a recording


def write(asked: Asked, file: Path, *, force: bool) -> Made:
    """Write a scenario, or with the suffix .csv a recording; returns what is in it. Raises BadInput."""
    if file.suffix not in {".toml", ".csv"} or (file.suffix == ".csv" and asked.positions is not None):
        raise BadInput(f"--out {file}: must end with .toml{'' if asked.positions is not None else ' or .csv'}")
    alone = {"--heights": asked.heights, "--start": asked.start is not None, "--ground": asked.ground}
    if asked.positions is None and (given := [name for name, is_given in alone.items() if is_given]):
        raise BadInput(f"{given[0]}: needs --from, a recording")
    if asked.positions is not None:
        return _of_recording(asked, asked.positions, file, force=force)
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
    said = f"positions of {len(sky.targets)} aircraft in {sky.seconds // 60} minutes"
    return Made(said, {"file": str(file), "aircraft": len(sky.targets), "seconds": sky.seconds})


def _write(sky: files.Sky, file: Path, *, force: bool, found: Recording | None = None) -> Made:
    scenario = files.save(files.text(sky), file, force=force, check=lambda part: load(str(part)))
    there, n = len(scenario.starting), scenario.n_target
    aircraft = found.aircraft if found is not None else n
    what = f"{aircraft} aircraft" + (f" on {n} flights" if n != aircraft else "")
    document = {"file": str(file), "aircraft": aircraft, "flights": n, "dwells": scenario.dwells, "at_the_start": there}
    if found is not None:
        document |= {"begin_utc": found.begin_utc, **found.tally.document}
    said = f"{what} in {scenario.dwells} dwells, {there} of them there at the start"
    return Made(said, document, found.tally if found is not None else None)


def _made_up(asked: Asked) -> files.Sky:
    n, minutes = asked.n, asked.minutes or MINUTES
    command = f"cogradar sky --aircraft {n} --seed {asked.seed} --minutes {minutes}"
    title = f"{n} aircraft that come and go within {asked.range_km:g} km, seed {asked.seed}"
    targets = traffic(n, 60 * minutes, asked.range_km, asked.seed)
    return files.Sky(title, f"{command} --range {asked.range_km:g}", targets, 60 * minutes, asked.range_km)


def _of_recording(asked: Asked, positions: Path, file: Path, *, force: bool) -> Made:
    place = asked.place
    selection = Selection.of(asked.start, asked.minutes, asked.aircraft, ground=asked.ground)
    found = recorded(positions, place, asked.range_km, heights=asked.heights, selection=selection)
    given = [
        f"--from {positions.name or positions}",
        f"--origin {place.latitude:g},{place.longitude:g} --boresight {place.boresight:g}",
        f"--range {asked.range_km:g}",
        "--heights" if asked.heights else "",
        f"--start {asked.start}" if asked.start is not None else "",
        f"--minutes {asked.minutes}" if asked.minutes is not None else "",
        f"--aircraft {asked.aircraft}" if asked.aircraft is not None else "",
        "--ground" if asked.ground else "",
    ]
    command = printable(f"cogradar sky {' '.join(text for text in given if text)}")
    title = f"{found.aircraft} recorded aircraft within {asked.range_km:g} km"
    heights = [row[3] for target in found.targets for row in target["trajectory"]] if asked.heights else []
    highest_km = max([HEIGHT_MAX_KM, *heights]) if heights else 0.0
    sky = files.Sky(
        title,
        command,
        found.targets,
        found.seconds,
        asked.range_km,
        highest_km,
        place,
        aircraft=found.aircraft,
        begin_utc=found.begin_utc,
    )
    return _write(sky, file, force=force, found=found)
