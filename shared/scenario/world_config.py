"""What nature decides: the part of a scenario that only the emulator and the scoring see."""

from itertools import pairwise
from math import inf
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from cogradar.shared.scenario.document import check_rows
from cogradar.shared.scenario.limits import MAX_POSITION_KM, MAX_ROWS, MIN_ROWS
from cogradar.shared.scenario.section import Section, named_in
from cogradar.shared.scenario.tables import DISTURBANCES

MAX_SPEED_KM_S = 10.0  # per axis, of a target's state


class DisturbanceSection(Section):
    """Which disturbance the world draws."""

    model: Annotated[str, named_in(DISTURBANCES), Field(json_schema_extra={"enum": list(DISTURBANCES)})]


class WorldMotionSection(Section):
    """How the targets really move; as the radar assumes if left out."""

    sigma_s_km_s2: Annotated[float, Field(ge=0, le=1, description="acceleration noise per axis, standard deviation")]


class WorldEchoSection(Section):
    """How strong the echoes really are; as the radar assumes if left out."""

    amplitude_db: Annotated[float, Field(ge=-100, le=200, description="20 log10|alpha| at 1 km")]


class TurnSection(Section):
    """A manoeuvre of an aircraft, at constant rate; before and after it the aircraft flies straight on."""

    from_s: Annotated[float, Field(ge=0, le=1e6, description="time after the acquisition at which it begins")]
    to_s: Annotated[float, Field(gt=0, le=1e6, description="time at which it ends")]
    g: Annotated[
        float | None,
        Field(ge=-20, le=20, description="acceleration across the flight path; above 0: from +x towards +y"),
    ] = None
    rate_deg_s: Annotated[
        float | None, Field(ge=-180, le=180, description="instead of `g`: the rate of turn, with the same sign")
    ] = None
    speed_km_s: Annotated[
        float | None, Field(gt=0, le=MAX_SPEED_KM_S, description="speed that is reached evenly by the end of the turn")
    ] = None

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.to_s <= self.from_s:
            raise ValueError(f"to_s = {self.to_s:g} must be above from_s = {self.from_s:g}")
        if (self.g is not None) + (self.rate_deg_s is not None) > 1:
            raise ValueError("must have g or rate_deg_s, not both")
        if (self.g, self.rate_deg_s, self.speed_km_s) == (None, None, None):
            raise ValueError("must have one of g, rate_deg_s, speed_km_s")
        return self


class TargetSection(Section):
    """One aircraft: its state at its birth and what it does then, or its whole trajectory."""

    state: Annotated[
        list[float] | None, Field(min_length=4, max_length=4, description="[x, vx, y, vy] when it begins to fly")
    ] = None
    trajectory: Annotated[
        list[Annotated[list[float], Field(min_length=3, max_length=3)]] | None,
        Field(
            min_length=MIN_ROWS,
            description="instead of `state`: its rows [t_s, x_km, y_km], ascending, or the name of a CSV file, relative"
            " to this one, with the header `t_s,x_km,y_km`. It is there from its first to its last row; a smooth"
            " curve through all rows says where",
        ),
    ] = None
    born_s: Annotated[
        float, Field(ge=0, le=1e6, description="time after the acquisition from which on it is there; 0: all along")
    ] = 0.0
    gone_s: Annotated[
        float | None, Field(gt=0, le=1e6, description="time up to which it is there; else until it has x < 0")
    ] = None
    turns: Annotated[list[TurnSection], Field(max_length=1000)] = Field(default_factory=list)
    sigma_s_km_s2: Annotated[
        float | None, Field(ge=0, le=1, description="its own acceleration noise, instead of that of `world.motion`")
    ] = None
    rcs_db: Annotated[
        float, Field(ge=-100, le=100, description="gain of its echo's power over that of `world.echo`")
    ] = 0.0
    rcs: Annotated[
        Literal["constant", "swerling1", "swerling3"] | None, Field(description="its own law, instead of `world.rcs`")
    ] = None
    stays: Annotated[
        bool, Field(description="x is clipped at 0, as in the published model, instead of leaving the field of view")
    ] = False

    @property
    def first_s(self) -> float:
        """Time from which on it may be there."""
        return self.born_s if self.trajectory is None else max(self.born_s, self.trajectory[0][0])

    @property
    def last_s(self) -> float:
        """Time up to which it may be there."""
        ends = [inf if self.gone_s is None else self.gone_s, inf if self.trajectory is None else self.trajectory[-1][0]]
        return min(ends)

    @property
    def begin(self) -> list[float]:
        """State [x, vx, y, vy] with which it begins; of a trajectory that between the first two rows."""
        if self.trajectory is None:
            return self.state or []
        (t, x, y), (t_next, x_next, y_next) = self.trajectory[:2]
        return [x, (x_next - x) / (t_next - t), y, (y_next - y) / (t_next - t)]

    @field_validator("state")
    @classmethod
    def _in_view(cls, state: list[float] | None) -> list[float] | None:
        if state is None:
            return None
        if state[0] < 0:
            raise ValueError("x must be >= 0: the target is behind the array")
        if state[0] == 0 and state[2] == 0:
            raise ValueError("x and y must not both be 0: the target is at the array itself")
        if max(abs(state[0]), abs(state[2])) > MAX_POSITION_KM:
            raise ValueError(f"x and y must be within {MAX_POSITION_KM:g} km")
        if max(abs(state[1]), abs(state[3])) > MAX_SPEED_KM_S:
            raise ValueError(f"vx and vy must be within +-{MAX_SPEED_KM_S:g} km/s")
        return state

    @field_validator("trajectory")
    @classmethod
    def _flown_forwards(cls, rows: list[list[float]] | None) -> list[list[float]] | None:
        check_rows(rows or [], [f"row {i}" for i in range(1, len(rows or []) + 1)])
        return rows

    @field_validator("turns")
    @classmethod
    def _one_after_the_other(cls, turns: list[TurnSection]) -> list[TurnSection]:
        for i, (one, next_) in enumerate(pairwise(turns)):
            if next_.from_s < one.to_s:
                raise ValueError(f"#{i + 2} begins at {next_.from_s:g} s, before #{i + 1} ends at {one.to_s:g} s")
        return turns

    @model_validator(mode="after")
    def _one_way_of_flying(self) -> Self:
        if (self.state is None) == (self.trajectory is None):
            raise ValueError(f"must have state or trajectory, has {'both' if self.state is not None else 'neither'}")
        own = [name for name, value in (("turns", self.turns), ("stays", self.stays)) if value]
        own += ["sigma_s_km_s2"] if self.sigma_s_km_s2 is not None else []
        if self.trajectory is not None and own:
            raise ValueError(f"{own[0]}: means nothing with a trajectory, which says where the target is")
        if self.first_s >= self.last_s:
            raise ValueError(f"is there from {self.first_s:g} s to {self.last_s:g} s, must end after it begins")
        return self


class WorldConfig(Section):
    """The table `[world]`."""

    rcs: Annotated[
        Literal["constant", "swerling1", "swerling3"],
        Field(
            description="radar cross section of the targets: constant, or drawn anew in each dwell about that mean, of"
            " exponential (Swerling I) or of gamma distribution with shape 2 (Swerling III)"
        ),
    ] = "constant"
    disturbance: DisturbanceSection
    motion: WorldMotionSection
    echo: WorldEchoSection
    targets: Annotated[list[TargetSection], Field(min_length=1, max_length=1000)]

    @field_validator("targets")
    @classmethod
    def _fit_into_a_message(cls, targets: list[TargetSection]) -> list[TargetSection]:
        rows = sum(len(target.trajectory or ()) for target in targets)
        if rows > MAX_ROWS:
            raise ValueError(f"their trajectories have {rows} rows together, must have at most {MAX_ROWS}")
        return targets

    def initial_states(self) -> NDArray[np.float64]:
        """States [x, vx, y, vy] with which the targets begin, whenever that is, (n_target, 4), km and km/s."""
        return np.array([target.begin for target in self.targets], dtype=np.float64)
