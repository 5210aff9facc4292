"""The messages between the processes: one frozen, validated type each. Arrays carry their shape beside them.

`k` counts transmit-receive cycles from the first acquisition scan; `t` is the paper's clock, which starts when every
target is held: 0 during acquisition, then 1 .. dwells. M = number of targets (tracks), n = cells looked at, L = most
cells lit for a track.
"""

import uuid
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from shared.protocol.fields import (
    FAR,
    MAX_HISTORY,
    MAX_RATE_HZ,
    MAX_SIDE,
    Beams,
    Cells,
    Chances,
    Complexes,
    Covariance,
    Factor,
    FloatLists,
    Floats,
    Index,
    Ints,
    Particles,
    RunId,
    Seed,
    State,
    States,
)
from shared.scenario.files import parse, parse_radar, parse_world
from shared.scenario.radar_config import Strategy
from shared.scenario.scenario import Scenario

SCHEMA = 2


class Refused(ValueError):
    """A valid message that makes no sense in its run; it is dropped, counted and logged like a bad one."""


class Message(BaseModel):
    """Common to all: the run it belongs to. Messages are equal if they are so bit for bit, arrays included."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, arbitrary_types_allowed=True
    )

    run: RunId

    def _content(self) -> tuple[object, ...]:
        values = (getattr(self, name) for name in type(self).model_fields)
        # repr tells 0.0 from -0.0 and 1 from 1.0, as the encoding does
        return tuple((v.dtype, v.shape, v.tobytes()) if isinstance(v, np.ndarray) else repr(v) for v in values)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Message) and type(self) is type(other) and self._content() == other._content()

    def __hash__(self) -> int:
        return hash((type(self), self._content()))


class _Settings(Message):
    """How a run is played."""

    strategy: Annotated[Strategy, Field(strict=False)]
    dwells: Annotated[int, Field(ge=1, le=1_000_000)]
    rate_hz: Annotated[float, Field(ge=0, le=MAX_RATE_HZ)] = 0.0  # dwells per second in real time; 0: in lockstep


class RunStart(_Settings):
    """A run is to begin: operator -> recorder, which announces it to all others by its first checkpoint."""

    scenario: dict[str, Any]  # complete: every key with its value, in one order
    seed: Seed  # of the world; the radar's is a one-way function of it

    @classmethod
    def of(cls, scenario: Scenario, strategy: Strategy, seed: int, dwells: int | None, rate_hz: float = 0.0) -> Self:
        """Start of a new run; dwells None: the scenario's. Its id is opaque: nobody could draw the world from it."""
        return cls(
            run=f"{scenario.name}-{uuid.uuid4().hex[:12]}",
            scenario=scenario.model_dump(),
            strategy=strategy,
            seed=seed,
            dwells=scenario.dwells if dwells is None else dwells,
            rate_hz=rate_hz,
        )

    @field_validator("scenario")
    @classmethod
    def _complete(cls, document: dict[str, Any]) -> dict[str, Any]:
        return parse(document, source="scenario").model_dump()


class RunCancel(Message):
    """A run is to end before its time: operator -> recorder, which announces it by the run's last checkpoint."""


class Checkpoint(_Settings):
    """How far a run is in the journal: recorder -> planners, allocator, metrics, operator.

    All messages of dwells 0 .. k-1 are acknowledged: they are durable and will never be needed again, except by a
    planner that rebuilds a track, which recalls them. So a process that joins late begins here. A k that is lower than
    before: the journal was restored from an older state, and in lockstep all begin the run anew at k.

    It carries what the radar knows and nothing of the world: neither targets nor disturbance nor the world's seed.
    """

    radar: dict[str, Any]  # complete
    seed: Seed  # of the radar's own random numbers
    k: Index  # acknowledged up to, not including, this dwell
    t: Index  # clock of dwell k-1; 0 if k = 0
    resend: bool = False  # the recorder lacks messages of dwell k or later: send again what is not acknowledged
    ended: bool = False  # the run is over and complete in the journal: forget it

    @field_validator("radar")
    @classmethod
    def _complete(cls, document: dict[str, Any]) -> dict[str, Any]:
        return parse_radar(document, source="radar").model_dump()


class EmulatorCheckpoint(Checkpoint):
    """A checkpoint with what only the emulator may know: recorder -> emulator."""

    world: dict[str, Any] | None  # complete; None: a real front end has no configuration of the world
    world_seed: Seed

    @field_validator("world")
    @classmethod
    def _world_complete(cls, document: dict[str, Any] | None) -> dict[str, Any] | None:
        return None if document is None else parse_world(document, source="world").model_dump()


class Scan(Message):
    """What the receiver reports of the cells of dwell k: emulator -> planners, recorder."""

    k: Index
    t: Index
    bins: Ints  # (n,) cells looked at, ascending
    statistic: Floats  # (n,) Wald-type statistic Lambda
    alpha_hat: Complexes  # (n,) estimated echo amplitude
    sigma_hat: Floats  # (n,) its estimated standard deviation
    signature_power: Floats  # (n,) ||v||^2 of the waveform actually sent
    beams: Beams  # (M, L) cells lit for each track, brightest first; -1: no more, or acquisition

    @model_validator(mode="after")
    def _aligned(self) -> Self:
        columns = (self.statistic, self.alpha_hat, self.sigma_hat, self.signature_power)
        if {column.size for column in columns} != {self.bins.size}:
            raise ValueError("bins, statistic, alpha_hat, sigma_hat and signature_power must have one length")
        if self.bins.size == 0 or self.bins[0] < 0 or (self.bins[1:] <= self.bins[:-1]).any():
            raise ValueError("bins must be ascending, from 0, and at least one")
        if not np.isin(self.beams[self.beams != -1], self.bins).all():
            raise ValueError("every beam must be one of bins, or -1")
        if min(self.statistic.min(), self.sigma_hat.min(), self.signature_power.min()) < 0.0:
            raise ValueError("statistic, sigma_hat and signature_power must be >= 0")
        if ((self.statistic > 0.0) & (self.sigma_hat == 0.0)).any():
            raise ValueError("a statistic > 0 needs a sigma_hat > 0")
        return self


class Truth(Message):
    """Where the targets are at dwell k, if the front end knows: emulator -> recorder only."""

    k: Index
    t: Index
    states: States  # (M, 4) [x, vx, y, vy], km and km/s
    bins: Ints  # (M,)
    snr_db: Floats  # (M,) per virtual channel, before array gain
    waveform_k: Annotated[int, Field(ge=-1)]  # dwell whose waveform was radiated: k-1, less if that came late; -1: none

    @model_validator(mode="after")
    def _aligned(self) -> Self:
        if self.states.shape != (self.bins.size, 4) or self.snr_db.shape != self.bins.shape:
            raise ValueError("states must be (M, 4) and bins, snr_db (M,)")
        return self


class Plan(Message):
    """What one track asks for after dwell k: planner -> allocator, recorder."""

    k: Index
    t: Index
    target: Index  # track number, 0 .. M-1
    status: Literal["searching", "tracking"]
    bins: Cells = Field(default_factory=lambda: np.empty(0, np.int32))  # (c,) asked for; none while searching
    chances: Chances = Field(default_factory=lambda: np.empty(0))  # (c,) probability of the target in each at k+1
    best_bin: Annotated[int, Field(ge=-1, le=MAX_SIDE)] = -1  # the most probable one at k+1; -1 while searching
    outlook: Annotated[float, Field(ge=0, le=1)] = 0.0  # probability of the most probable bin some dwells later
    gain: Annotated[float, Field(ge=0)] = 0.0  # zeta of the cell with the target, over its beam power
    range_km: Annotated[float, Field(ge=0, le=FAR)] = 0.0  # expected range at k+1
    estimate: State = Field(default_factory=lambda: np.zeros(4))  # (4,) belief mean at k
    covariance: Covariance = Field(default_factory=lambda: np.zeros((4, 4)))  # (4, 4) of the belief at k
    detected: bool = False  # the track's cell of dwell k was over the threshold
    depleted: bool = False  # no particle explained the observation of dwell k
    n_sim: Index = 0  # simulations behind the choice; fewer than the scenario's if a deadline cut them short

    @model_validator(mode="after")
    def _asks_for_cells(self) -> Self:
        fits = (self.bins.size > 0) == (self.best_bin >= 0) == (self.status == "tracking")
        if not fits or self.chances.size != self.bins.size:
            raise ValueError("bins, as many chances and best_bin must be given while tracking, and not while searching")
        return self


class Waveform(Message):
    """What is radiated at dwell k+1: R = isotropic/n_tx I + factor factor^H; allocator -> emulator, recorder."""

    k: Index
    tracking: bool  # False: acquisition goes on
    isotropic: Annotated[float, Field(ge=0)]  # power spread evenly over all directions
    factor: Factor  # (n_tx, r)
    beams: Beams  # (M, L) cells lit for each track, brightest first; -1: no more, or acquisition
    shares: FloatLists  # (M, L) power on each beam, sums to the power not isotropic
    status: Literal["acquisition", "fixed", "optimal", "inaccurate"]
    late: Ints  # (M,) 1 where the plan of dwell k was not there in time and an older one was extrapolated, else 0

    @model_validator(mode="after")
    def _aligned(self) -> Self:
        if self.beams.shape != self.shares.shape or self.beams.shape[:1] != self.late.shape:
            raise ValueError("beams and shares must have one shape, a row for each of late")
        if (self.beams >= 0).any() != self.tracking or self.beams.min(initial=-1) < -1:
            raise ValueError("some beams must be >= 0 while tracking, all -1 during acquisition")
        if (self.shares < 0.0).any() or self.shares[self.beams < 0].any():
            raise ValueError("shares must be >= 0, and 0 where no cell is lit")
        return self


class RunEnd(Message):
    """The run is over: emulator -> recorder."""

    k: Index
    t: Index
    status: Literal["complete", "failed"]
    reason: Annotated[str, Field(max_length=500)] = ""


class Snapshot(Message):
    """All that a track is after dwell k: planner -> recorder.

    Its fields are those of `shared.tracking.model.TrackState`. All owners of a track send the same. Not part of the
    digest, and never resent: if one is lost, the next one or the whole history does as well.
    """

    target: Index
    k: Index
    particles: Particles  # (n, 4)
    detected: bool
    depleted: bool
    sigma_hat: Annotated[float, Field(ge=0)]
    in_beam: bool
    level: Annotated[float, Field(ge=0)]
    power: Annotated[float, Field(ge=0)]
    echo: Annotated[float, Field(ge=0)]
    remembered: Particles  # (n, 4), or (0, 4): the particles themselves
    hit_bin: Annotated[int, Field(ge=-1, le=MAX_SIDE)]
    hit_amplitude: Annotated[float, Field(ge=0)]
    looked: States  # (n_miss, n_bin)
    log_evidence: float
    attempts: Index

    @model_validator(mode="after")
    def _aligned(self) -> Self:
        n = self.particles.shape[0]
        if self.particles.shape[1] != 4 or self.remembered.shape not in {(n, 4), (0, 4)} or n == 0:
            raise ValueError("particles must be (n, 4), remembered (n, 4) or (0, 4)")
        if (self.looked < 0.0).any():
            raise ValueError("looked must be >= 0")
        if self.hit_bin >= self.looked.shape[1]:
            raise ValueError("hit_bin must be one of n_bin, or -1")
        if self.hit_bin >= 0 and self.sigma_hat == 0.0:
            raise ValueError("a detection needs a sigma_hat > 0")
        return self


class ScanRecall(Message):
    """A planner lacks the scans of a run from dwell k on: planner -> recorder.

    The answer is the snapshots of these tracks of dwell k or later, and the scans if a track has none.
    """

    k: Index
    targets: Annotated[list[Index], Field(min_length=1, max_length=MAX_SIDE)]  # tracks that wait for dwell k


class WaveformRecall(Message):
    """The emulator lacks the waveforms of a run from dwell k on: emulator -> recorder."""

    k: Index


class History(Message):
    """Journalled messages of one topic, in order of dwells: recorder -> whoever recalled them."""

    topic: Literal["scan", "waveform", "snapshot"]
    k: Index  # dwell of the first; in lockstep the others follow without a gap
    payloads: Annotated[list[bytes], Field(max_length=MAX_HISTORY)]
