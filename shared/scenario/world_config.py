"""What nature decides: the part of a scenario that only the emulator and the scoring see."""

from itertools import pairwise
from math import hypot, inf, radians, sin
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import FailFast, Field, field_validator, model_validator

from cogradar.shared.scenario.limits import MAX_HEIGHT_KM, MAX_POSITION_KM, MAX_ROWS, MAX_TARGETS, MAX_TURNS
from cogradar.shared.scenario.plugins.kinds import DISTURBANCE, SIGNAL
from cogradar.shared.scenario.plugins.names import Chosen
from cogradar.shared.scenario.section import Section, named_in
from cogradar.shared.scenario.tables import FROM_FILE
from cogradar.shared.scenario.trajectories.rows import Rows
from cogradar.shared.signal.array import in_plane
from cogradar.shared.signal.recording import AXES, Layout, Recording, read, sha256

MAX_SPEED_KM_S = 10.0  # per axis, of a target's state
OF_ARRAY = ("array", "jammers", "clutter")  # tables of `[world]` that only `signal = "array"` has a use for


class RecordingSection(Section):
    """A file of I/Q, for `model = "recorded"`: data sets of an array, one for each range cell and dwell."""

    file: Annotated[
        str,
        Field(
            min_length=1,
            max_length=4096,
            description=".npy, .npz, .mat up to version 7, or .sigmf-meta; relative to this file",
        ),
    ]
    axes: Annotated[
        list[Annotated[str, named_in(AXES)]],
        Field(
            min_length=1,
            max_length=len(AXES),
            description="what each axis of the array counts, the slowest first: dwell, range, tx, rx. Use channel in"
            " place of tx and rx together, and time for samples one after another, cut into dwells and the channels"
            " that have no axis. With real numbers, iq counts I and Q",
        ),
    ]
    variable: Annotated[str | None, Field(max_length=100, description="of a file with several arrays: which")] = None
    scale: Annotated[
        Annotated[float, Field(gt=0, le=1e12)] | Literal["unit"],
        Field(description="factor of all numbers; unit: their mean power becomes 1, as of the other disturbances"),
    ] = "unit"
    repeat: Annotated[
        bool, Field(description="a run longer than the file begins it again; else `cogradar check` refuses the run")
    ] = False
    sha256: Annotated[
        str | None,
        Field(pattern="^[0-9a-f]{64}$", description="of the file, filled in when the scenario is loaded, then checked"),
    ] = None

    @field_validator("axes")
    @classmethod
    def _names_each_once(cls, axes: list[str]) -> list[str]:
        if len(set(axes)) < len(axes):
            raise ValueError(f"{axes}: each name must be there once")
        if "time" in axes and "dwell" in axes:
            raise ValueError("time is cut into dwells: leave one of time and dwell out")
        if "channel" in axes and {"tx", "rx"} & set(axes):
            raise ValueError("channel counts tx and rx together: leave them out")
        return axes

    def layout(self, n_tx: int, n_rx: int) -> Layout:
        """How the file is read for an array."""
        scale = None if self.scale == "unit" else self.scale
        return Layout(self.variable, tuple(self.axes), scale, n_tx, n_rx)

    def read(self, n_tx: int, n_rx: int) -> Recording:
        """The file. Raises RecordingError."""
        return read(Path(self.file), self.sha256 or sha256(Path(self.file)), self.layout(n_tx, n_rx))


class DisturbanceSection(Section):
    """Which disturbance the world draws."""

    model: Annotated[str, Chosen(DISTURBANCE)]
    recording: RecordingSection | None = None

    @model_validator(mode="after")
    def _has_its_file(self) -> Self:
        if (self.model == FROM_FILE) != (self.recording is not None):
            cure = "needs a table recording" if self.recording is None else "leave recording out"
            raise ValueError(f'model = "{self.model}": {cure}, which is for model = "{FROM_FILE}"')
        return self


class WorldMotionSection(Section):
    """How the targets really move; as the radar assumes if left out."""

    sigma_s_km_s2: Annotated[float, Field(ge=0, le=1, description="acceleration noise per axis, standard deviation")]


class WorldEchoSection(Section):
    """How strong the echoes really are; as the radar assumes if left out."""

    amplitude_db: Annotated[float, Field(ge=-100, le=200, description="20 log10|alpha| at 1 km")]


ElementError = Annotated[list[Annotated[float, Field(ge=-360, le=360)]], Field(min_length=2, max_length=2)]


class WorldArraySection(Section):
    """What the antennas really are; only of `signal = "array"`."""

    pattern_exponent: Annotated[
        float,
        Field(
            ge=0,
            le=10,
            description="q of an element's power pattern cos^q(angle from boresight), sent and received; 0: isotropic",
        ),
    ] = 0.0
    gain_sigma_db: Annotated[
        float, Field(ge=0, le=20, description="standard deviation of the elements' gains, drawn once for a seed")
    ] = 0.0
    phase_sigma_deg: Annotated[
        float, Field(ge=0, le=180, description="standard deviation of the elements' phases, drawn once for a seed")
    ] = 0.0
    tx_errors: Annotated[
        list[ElementError],
        Field(
            max_length=512,
            description="rows [gain_db, phase_deg], one of each transmit antenna, besides what is drawn; or the name of"
            " a CSV file, relative to this one, with the header `gain_db,phase_deg`",
        ),
    ] = Field(default_factory=list)
    rx_errors: Annotated[list[ElementError], Field(max_length=512, description="the same of the receive antennas")] = (
        Field(default_factory=list)
    )
    dead_tx: Annotated[
        list[Annotated[int, Field(ge=1)]],
        Field(max_length=512, description="numbers, from 1, of transmit antennas that send nothing"),
    ] = Field(default_factory=list)
    dead_rx: Annotated[
        list[Annotated[int, Field(ge=1)]],
        Field(max_length=512, description="numbers, from 1, of receive antennas that receive no echo and no jammer"),
    ] = Field(default_factory=list)


class JammerSection(Section):
    """A source of noise in one direction; only with `signal = "array"`."""

    bearing_deg: Annotated[
        float | None, Field(ge=-90, le=90, description="its angle from boresight, above 0 towards +y")
    ] = None
    place_km: Annotated[
        list[float] | None,
        Field(min_length=2, max_length=2, description="instead of `bearing_deg`: its position [x, y], which gives it"),
    ] = None
    jnr_db: Annotated[
        float, Field(ge=-100, le=100, description="power in each element of the data set, over the disturbance's")
    ]
    on_s: Annotated[float, Field(ge=0, le=1e6, description="time after the acquisition at which it is switched on")] = (
        0.0
    )
    off_s: Annotated[float | None, Field(gt=0, le=1e6, description="time at which it is switched off; else never")] = (
        None
    )

    @property
    def nu(self) -> float:
        """Spatial frequency of its direction."""
        if self.place_km is None:
            return 0.5 * sin(radians(self.bearing_deg or 0.0))
        return 0.5 * self.place_km[1] / hypot(*self.place_km)

    @field_validator("place_km")
    @classmethod
    def _in_view(cls, place: list[float] | None) -> list[float] | None:
        if place is None:
            return None
        if place[0] < 0:
            raise ValueError("x must be >= 0: it is behind the array")
        if place == [0.0, 0.0]:
            raise ValueError("x and y must not both be 0: it is at the array itself")
        return place

    @model_validator(mode="after")
    def _has_one_direction_and_a_time(self) -> Self:
        if (self.bearing_deg is None) == (self.place_km is None):
            has = "neither" if self.place_km is None else "both"
            raise ValueError(f"must have bearing_deg or place_km, has {has}")
        if self.off_s is not None and self.off_s <= self.on_s:
            raise ValueError(f"off_s = {self.off_s:g} must be above on_s = {self.on_s:g}")
        return self


class ClutterSection(Section):
    """Ground that echoes the waveform, alike in all range cells; only with `signal = "array"`."""

    cnr_db: Annotated[
        float,
        Field(
            ge=-100,
            le=100,
            description="power in each element of the data set, over the disturbance's, while the power goes in"
            " all directions",
        ),
    ]
    patches: Annotated[
        int, Field(ge=1, le=1000, description="scatterers of a range cell, at equal steps of the angle")
    ] = 100
    correlation: Annotated[
        float, Field(gt=0, le=1, description="of a scatterer's echo from dwell to dwell; 1: it never changes")
    ] = 0.99


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
        Rows | None,
        Field(
            description="instead of `state`: its rows [t_s, x_km, y_km], or all of them with z_km, ascending, or the"
            " name of a CSV file, relative to this one, with the header `t_s,x_km,y_km` or `t_s,x_km,y_km,z_km`. It is"
            " there from its first to its last row; a smooth curve through all rows says where",
        ),
    ] = None
    height_km: Annotated[
        float,
        Field(
            ge=0,
            le=MAX_HEIGHT_KM,
            description="its height over the plane of the array, always; x and y are of the point below it",
        ),
    ] = 0.0
    born_s: Annotated[
        float, Field(ge=0, le=1e6, description="time after the acquisition from which on it is there; 0: all along")
    ] = 0.0
    gone_s: Annotated[
        float | None, Field(gt=0, le=1e6, description="time up to which it is there; else until it has x < 0")
    ] = None
    turns: Annotated[list[TurnSection], FailFast(), Field(max_length=1000)] = Field(default_factory=list)
    sigma_s_km_s2: Annotated[
        float | None, Field(ge=0, le=1, description="its own acceleration noise, in place of `world.motion`")
    ] = None
    rcs_db: Annotated[float, Field(ge=-100, le=100, description="gain of its echo's power over `world.echo`")] = 0.0
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
        (t, x, y), (t_next, x_next, y_next) = (self.trajectory[i][:3] for i in range(2))
        return [x, (x_next - x) / (t_next - t), y, (y_next - y) / (t_next - t)]

    @property
    def begin_height_km(self) -> float:
        """Height at which it begins."""
        has_heights = self.trajectory is not None and len(self.trajectory[0]) > 3
        return self.trajectory[0][3] if self.trajectory is not None and has_heights else self.height_km

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
            has = "both" if self.state is not None else "neither: set state = [x, vx, y, vy], in km and km/s"
            raise ValueError(f"must have state or trajectory, has {has}")
        own = [name for name, value in (("turns", self.turns), ("stays", self.stays)) if value]
        own += ["sigma_s_km_s2"] if self.sigma_s_km_s2 is not None else []
        if self.trajectory is not None and own:
            raise ValueError(f"{own[0]}: means nothing with a trajectory, which says where the target is")
        if self.trajectory is not None and len(self.trajectory[0]) > 3 and self.height_km:
            raise ValueError("height_km: means nothing with a trajectory that has z_km")
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
    signal: Annotated[
        str,
        Chosen(SIGNAL),
        Field(
            description="`cells`: each look has a disturbance of its own and hears only the targets in its main lobe,"
            " as published. `array`: all looks of a range cell are tested with one data set, which has the echoes of"
            " all targets",
        ),
    ] = "cells"
    disturbance: DisturbanceSection
    motion: WorldMotionSection
    echo: WorldEchoSection
    array: WorldArraySection | None = None
    jammers: Annotated[list[JammerSection], FailFast(), Field(max_length=100)] = Field(default_factory=list)
    clutter: ClutterSection | None = None
    targets: Annotated[list[TargetSection], FailFast(), Field(min_length=1, max_length=MAX_TARGETS)]
    repeat_s: Annotated[
        float | None,
        Field(
            gt=0,
            le=1e6,
            description="time after which all targets fly again from their begin, with other noise, for runs without an"
            " end; else never",
        ),
    ] = None

    @field_validator("targets")
    @classmethod
    def _fit_into_a_message(cls, targets: list[TargetSection]) -> list[TargetSection]:
        rows = sum(len(target.trajectory or ()) for target in targets)
        if rows > MAX_ROWS:
            raise ValueError(f"their trajectories have {rows} rows together, must have at most {MAX_ROWS}")
        if (turns := sum(len(target.turns) for target in targets)) > MAX_TURNS:
            raise ValueError(f"they have {turns} turns together, must have at most {MAX_TURNS}")
        return targets

    @model_validator(mode="after")
    def _begins_before_it_repeats(self) -> Self:
        for i, target in enumerate(self.targets, 1):
            if self.repeat_s is not None and target.first_s >= self.repeat_s:
                raise ValueError(
                    f"repeat_s = {self.repeat_s:g}: target {i} begins at {target.first_s:g} s, and must before"
                )
        return self

    @model_validator(mode="after")
    def _is_of_its_signal(self) -> Self:
        given = [name for name in OF_ARRAY if getattr(self, name)]
        given += ["disturbance.recording"] if self.disturbance.recording is not None else []
        if given and self.signal != "array":
            raise ValueError(
                f'signal = "{self.signal}": {" and ".join(given)} must be left out, or set world.signal = "array"'
            )
        return self

    def initial_states(self) -> NDArray[np.float64]:
        """States [x, vx, y, vy] with which the targets begin, whenever that is, (n_target, 4), km and km/s."""
        return np.array([target.begin for target in self.targets], dtype=np.float64)

    def measured_states(self) -> NDArray[np.float64]:
        """The same where the array measures them, with their heights: `array.in_plane`."""
        return in_plane(self.initial_states(), [target.begin_height_km for target in self.targets])
