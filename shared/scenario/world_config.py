"""What nature decides: the part of a scenario that only the emulator and the scoring see."""

from itertools import pairwise
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from shared.scenario.section import Section, named_in
from shared.scenario.tables import DISTURBANCES

MAX_POSITION_KM, MAX_SPEED_KM_S = 10_000.0, 10.0  # per axis, of a target's state


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
    """A turn of an aircraft at constant speed and rate; before and after it the aircraft flies straight on."""

    from_s: Annotated[float, Field(ge=0, le=1e6, description="time after the acquisition at which it begins")]
    to_s: Annotated[float, Field(gt=0, le=1e6, description="time at which it ends")]
    g: Annotated[
        float,
        Field(ge=-20, le=20, description="acceleration across the flight path; above 0: from +x towards +y"),
    ]

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.to_s <= self.from_s:
            raise ValueError(f"to_s = {self.to_s:g} must be above from_s = {self.from_s:g}")
        return self


class TargetSection(Section):
    """One aircraft: its state at t = 0, and its turns."""

    state: Annotated[list[float], Field(min_length=4, max_length=4)]
    turns: Annotated[list[TurnSection], Field(max_length=1000)] = Field(default_factory=list)

    @field_validator("state")
    @classmethod
    def _in_view(cls, state: list[float]) -> list[float]:
        if state[0] < 0:
            raise ValueError("x must be >= 0: the target is behind the array")
        if state[0] == 0 and state[2] == 0:
            raise ValueError("x and y must not both be 0: the target is at the array itself")
        if max(abs(state[0]), abs(state[2])) > MAX_POSITION_KM:
            raise ValueError(f"x and y must be within {MAX_POSITION_KM:g} km")
        if max(abs(state[1]), abs(state[3])) > MAX_SPEED_KM_S:
            raise ValueError(f"vx and vy must be within +-{MAX_SPEED_KM_S:g} km/s")
        return state

    @field_validator("turns")
    @classmethod
    def _one_after_the_other(cls, turns: list[TurnSection]) -> list[TurnSection]:
        for i, (one, next_) in enumerate(pairwise(turns)):
            if next_.from_s < one.to_s:
                raise ValueError(f"#{i + 2} begins at {next_.from_s:g} s, before #{i + 1} ends at {one.to_s:g} s")
        return turns


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
    targets: Annotated[list[TargetSection], Field(min_length=1, max_length=100)]

    def initial_states(self) -> NDArray[np.float64]:
        """Start states [x, vx, y, vy], (n_target, 4), km and km/s."""
        return np.array([target.state for target in self.targets], dtype=np.float64)
