"""A whole scenario: everything that defines a run except its seed and strategy."""

from datetime import UTC, datetime
from typing import Annotated, Any

from pydantic import Field, field_validator, model_validator

from cogradar.shared.scenario.cross_checks import at_start
from cogradar.shared.scenario.document import NAME, NAME_IN_WORDS
from cogradar.shared.scenario.limits import Dwells
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.scenario.section import Section
from cogradar.shared.scenario.tables import TRUE_RULES, marked
from cogradar.shared.scenario.world_config import WorldConfig

MAX_TITLE = 200  # characters

# What nature does where the file says nothing of it: as the radar assumes.
ASSUMED = (("motion", "sigma_s_km_s2"), ("echo", "amplitude_db"))  # of [radar], where [world] leaves it out


FIRST_YEAR, LAST_YEAR = 1970, 2199  # of a site's clock
_NO_DATE = f"must be a date and a time of day that exist, from {FIRST_YEAR} to {LAST_YEAR}"


class SiteSection(Section):
    """Where the radar stands and when a simulated run begins. No planner is told; maps and other systems need it."""

    latitude_deg: Annotated[float, Field(ge=-90, le=90, description="of the array, WGS 84")]
    longitude_deg: Annotated[float, Field(ge=-180, le=180, description="of the array, WGS 84, above 0 to the east")]
    height_m: Annotated[float, Field(ge=-500, le=20_000, description="of the array above the ellipsoid")] = 0.0
    boresight_deg: Annotated[float, Field(ge=0, le=360, description="azimuth of the x axis, clockwise from north")]
    begin_utc: (
        Annotated[
            str,
            Field(
                pattern=r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ$",
                description='UTC of clock 0, "YYYY-MM-DDThh:mm:ssZ"; left out: the time of a dwell is not stated',
            ),
        ]
        | None
    ) = None

    @property
    def begin_s(self) -> float | None:
        """UTC of clock 0, s since 1970; None: not stated."""
        return None if self.begin_utc is None else datetime.fromisoformat(self.begin_utc).timestamp()

    @field_validator("begin_utc", mode="before")
    @classmethod
    def _of_toml(cls, value: Any) -> Any:
        """A date of TOML, which needs no quotes, as text."""
        is_aware = isinstance(value, datetime) and value.tzinfo is not None
        try:
            return value.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ") if is_aware else value
        except OverflowError:
            raise ValueError(_NO_DATE) from None

    @field_validator("begin_utc")
    @classmethod
    def _is_a_date(cls, text: str | None) -> str | None:
        try:
            is_date = text is None or FIRST_YEAR <= datetime.fromisoformat(text).year <= LAST_YEAR
        except ValueError:
            is_date = False
        if not is_date:
            raise ValueError(_NO_DATE)
        return text


class Scenario(Section):
    """A whole scenario file."""

    name: Annotated[str, Field(pattern=NAME, description=NAME_IN_WORDS)]
    title: Annotated[str, Field(max_length=MAX_TITLE, description="one line for people")]
    dwells: Dwells
    radar: RadarConfig
    world: WorldConfig | None = None  # None: a real front end, whose truth is unknown
    site: SiteSection | None = None  # None: x and y have no place on the earth

    @property
    def simulated(self) -> WorldConfig:
        """The world of a simulated front end; ValueError for a real one, whose world is unknown."""
        if self.world is None:
            raise ValueError(f"{self.name} has no [world]")
        return self.world

    @property
    def n_target(self) -> int:
        """Targets of the world, whenever they are there; if they are unknown, the number of tracks."""
        if self.world is not None:
            return len(self.world.targets)
        return self.radar.announced

    @property
    def data_set_shape(self) -> tuple[int, int]:
        """Transmit and receive channels of a data set."""
        return self.radar.array.n_tx, self.radar.array.n_rx

    @property
    def most_dwells(self) -> int:
        """Dwells of a run with its acquisition, if that takes as long as it may."""
        return self.dwells + (0 if self.radar.is_unknown else self.radar.acquisition.max_scans)

    @property
    def starting(self) -> dict[int, list[float]]:
        """Index and state of the targets that are there when a run begins: those that the radar acquires."""
        return at_start([vars(target) for target in self.world.targets]) if self.world is not None else {}

    @model_validator(mode="before")
    @classmethod
    def _fill_from_assumptions(cls, data: Any) -> Any:
        match data:
            case {"world": dict(world), "radar": dict(radar)}:
                filled = dict(world)
                for section, key in ASSUMED:
                    assumed = radar.get(section)
                    if section not in filled and isinstance(assumed, dict) and key in assumed:
                        filled[section] = {key: assumed[key]}
                return data | {"world": filled}
        return data

    @model_validator(mode="before")
    @classmethod
    def _say_who_knows_the_truth(cls, data: Any) -> Any:
        match data:
            case {"title": str(title), "radar": {"planner": {"rule": str(rule)}}} if rule in TRUE_RULES:
                return data | {"title": marked(title, rule, MAX_TITLE)}
        return data
