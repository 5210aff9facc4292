"""The messages between the processes: one frozen, validated type each. Arrays carry their shape beside them.

`k` counts transmit-receive cycles from the first acquisition scan; `t` is the paper's clock, which starts when every
target is held: 0 during acquisition, then 1 .. dwells. M = number of targets (tracks), n = cells looked at, L = most
cells lit for a track.

Cells are angle bins, or, with steered cells, directions nu = 0.5 sin(theta) of their own; `bins` then are those nearest
to the directions. Optional fields belong to parts: the fields of a part are all sent, or none is
(`Message.PARTS`, `cogradar.shared.protocol.admission.check_parts`).
"""

import uuid
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from cogradar.shared.protocol.fields import (
    FAR,
    MAX_SIDE,
    Beams,
    Cells,
    Chances,
    Complexes,
    Covariance,
    Epoch,
    Factor,
    FloatLists,
    Floats,
    Gate,
    Index,
    Ints,
    Lacking,
    Measured,
    OwnName,
    Radar,
    Rate,
    Revision,
    RunId,
    Seed,
    Size,
    Skipped,
    State,
    States,
    Unseen,
    UtcSeconds,
    World,
    check_different,
    is_any,
)
from cogradar.shared.protocol.orders import Action, Orders, Settings
from cogradar.shared.protocol.roster import Compared, Roster, announced_roster
from cogradar.shared.scenario.files import parse
from cogradar.shared.scenario.limits import NO_END
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.signal.array import in_plane

SCHEMA = 2
MAX_FAULT = 200  # characters
MAX_LEADS = 8  # epochs of a run that its checkpoints say
MAX_REASON = 500  # characters that say why a run ended
BY_USER = "by user"
Reason = Annotated[str, Field(max_length=MAX_REASON)]
ABSENT = -1  # bin of a target that is not there
Parts = dict[str, tuple[str, ...]]


class Refused(ValueError):
    """A valid message that makes no sense in its run; it is dropped, counted and logged like a bad one."""


class Message(Compared):
    """Common to all: the run it belongs to."""

    PARTS: ClassVar[Parts] = {}  # optional fields; a key of `admission.IS_NEEDED` for each part

    run: RunId


class _Settings(Message):
    """How a run is played."""

    strategy: Annotated[Strategy, Field(strict=False)]
    dwells: Annotated[int, Field(ge=1, le=NO_END)]  # 2^31 - 1: until it is ended
    rate_hz: Rate = 0.0  # dwells per second in real time; 0: in lockstep


class RunStart(_Settings):
    """A run is to begin: operator -> recorder, which announces it to all others by its first checkpoint."""

    scenario: dict[str, Any]  # complete: every key with its value, in one order
    seed: Seed  # of the world; the radar's is a one-way function of it

    @classmethod
    def of(cls, scenario: Scenario, strategy: Strategy, seed: int, dwells: int | None, rate_hz: float = 0.0) -> Self:
        """Start of a new run; dwells None: the scenario's. Its id is opaque: the world cannot be drawn from it."""
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
        return parse(document, "scenario").model_dump()


class RunCancel(Message):
    """A run is to end before its time: operator -> recorder, which announces it by the run's last checkpoint."""

    reason: Reason = BY_USER


class Command(Message):
    """What somebody asks of a run that goes on: operator, commander or metrics -> recorder.

    The recorder grants it as an order, from a dwell that its checkpoints say, or refuses it. Its journal says which.
    Sent again under the same id it changes nothing.
    """

    id: Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]  # unique
    by: Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[ -~]+$")]  # the client that asks
    action: Action
    at: Index = 0  # not before this dwell


class Lead(Compared):
    """A recorder that led a run: its epoch, and the run's revision in the journal when it began."""

    epoch: Epoch
    revision: Revision


Leads = Annotated[list[Lead], Field(max_length=MAX_LEADS)]


class Checkpoint(_Settings):
    """How far a run is in the journal: recorder -> planners, allocator, metrics, operator.

    All messages of dwells 0 .. k-1 are acknowledged: they are durable and will never be needed again, except by a
    planner that rebuilds a track, which recalls them. So a process that joins late begins here. A k that is lower than
    before: the journal was restored from an older state, and in lockstep all begin the run anew at k.

    It carries what the radar knows and nothing of the world: neither targets nor disturbance nor the world's seed.
    """

    radar: Radar  # complete: [radar] of a scenario
    seed: Seed  # of the radar's own random numbers
    k: Index  # acknowledged up to, not including, this dwell
    t: Index  # clock of dwell k-1; 0 if k = 0
    resend: bool = False  # the recorder lacks messages of dwell k or later: send again what is not acknowledged, ...
    lacking: Lacking = None  # ... or of it only scans, truth, waveforms, and the plans of these tracks
    ended: bool = False  # the run is over and complete in the journal: forget it
    held: bool = False  # the journal's disk is full: nothing more is acknowledged until there is room
    overdue: list[Index] = Field(default_factory=list, max_length=MAX_SIDE)  # tracks whose owner brings no plans
    orders: Orders = Field(default_factory=list)  # in force, or that will be; nothing else is
    epoch: Epoch = 0  # of the recorder that says it; dropped after a higher one of this run
    revision: Revision = 0  # of the run in the journal: dwells acknowledged, and commands; what this tells of
    leads: Leads = Field(default_factory=list)  # the last ones: what was made of more, before one of them, is void


class EmulatorCheckpoint(Checkpoint):
    """A checkpoint with what only the emulator may know: recorder -> emulator."""

    world: World | None  # complete: [world] of a scenario; none: a real front end, which has no such table
    world_seed: Seed
    # In real time the newest dwell whose scan the recorder has; None: it has none, or the run is in lockstep.
    newest_k: Index | None = None
    newest_t: Index = 0  # ... its clock, 0 while targets are acquired,
    # ... and the dwell with which an emulator that comes back goes on. By the recorder's clock since then it is due,
    # if the radar keeps its rate. The dwells between never happened.
    due_k: Index = 0


class Scan(Message):
    """What the receiver reports of the cells of dwell k: emulator -> planners, recorder.

    Without rows nothing was measured in the dwell: that says nothing of any target.
    """

    PARTS: ClassVar[Parts] = {
        "directions": ("nus", "limits", "ranges_km", "nu_hats", "nu_sigmas", "beam_nus", "gates"),
        "roster": ("roster",),
    }

    k: Index
    t: Index
    bins: Ints  # (n,) cells looked at, ascending
    statistic: Measured  # (n,) Wald-type statistic Lambda
    alpha_hat: Complexes  # (n,) estimated echo amplitude
    sigma_hat: Measured  # (n,) its estimated standard deviation
    signature_power: Measured  # (n,) ||v||^2 of the waveform actually sent
    beams: Beams  # (M, L) cells lit for each track, brightest first; -1: no more, or acquisition
    # Steered cells only; a look may have several rows, of different ranges.
    nus: Floats | None = None  # (n,) directions of the cells, ascending
    limits: Measured | None = None  # (n,) what the statistic was compared with
    ranges_km: Measured | None = None  # (n,) centre of the range cell; 0: there are none
    nu_hats: Floats | None = None  # (n,) measured direction of the echo,
    nu_sigmas: Measured | None = None  # (n,) ... its standard deviation; 0: not measured
    beam_nus: FloatLists | None = None  # (M, L) directions of `beams`; 0 where there is none
    gates: FloatLists | None = None  # (M, 2) ranges that were tested for each track, km; (0, 0): all
    roster: Roster | None = None  # of the waveform, if the number of tracks is unknown
    # (u,) directions of the looks that were asked for and were not measured, ascending; None: all were measured.
    unmeasured: Floats | None = None
    # (v,) centres of range cells that were asked for and not received, ascending; None: all were received.
    lost_km: Measured | None = None
    fault: Annotated[str, Field(max_length=MAX_FAULT)] | None = None  # why nothing was measured, if that is known
    # Dwell whose waveform was radiated, and whose looks these are, if it is older than k-1; -1: there was none.
    waveform_k: Annotated[int, Field(ge=-1)] | None = None
    skipped: Skipped | None = None  # so many dwells before it never happened, as the radar was away; None: none
    settings: Settings | None = None  # of the waveform, so that planners are told
    utc_s: UtcSeconds | None = None  # when it was measured, since 1970 in UTC, if the receiver knows
    front_end: OwnName | None = None  # the user's own class that measured it, with the hash of its source

    @model_validator(mode="after")
    def _aligned(self) -> Self:
        _check_whole_parts(self)
        columns = (self.statistic, self.alpha_hat, self.sigma_hat, self.signature_power)
        if {self.bins.size} != {column.size for column in columns}:
            raise ValueError("bins, statistic, alpha_hat, sigma_hat and signature_power must have one length")
        if is_any(self.bins < 0) or not self._ascends():
            raise ValueError("bins must be from 0, and they, or else nus, ascending")
        if self.unmeasured is not None:
            self._check_unmeasured(self.unmeasured)
        elif self.bins.size == 0 or self.fault is not None:
            raise ValueError("bins must be at least one, without a fault, unless something is unmeasured")
        elif not {-1, *self.bins.tolist()}.issuperset(self.beams.ravel().tolist()):
            raise ValueError("every beam must be one of bins, or -1")
        if self.lost_km is not None and (self.lost_km.size == 0 or is_any(self.lost_km[1:] <= self.lost_km[:-1])):
            raise ValueError("lost_km must be ranges, at least one, ascending")
        if self.waveform_k is not None and self.waveform_k >= self.k - 1:
            raise ValueError(f"waveform_k must be below {self.k - 1}, where the usual waveform is not said")
        if is_any((self.statistic > 0.0) & (self.sigma_hat == 0.0)):
            raise ValueError("a statistic > 0 needs a sigma_hat > 0")
        _check_beams(self.beams, self.beam_nus, self.gates, self.roster)
        return self

    def _check_unmeasured(self, nus: NDArray[np.float64]) -> None:
        """ValueError unless these may be directions of looks that are not among the rows."""
        if nus.size == 0 or is_any(nus[1:] <= nus[:-1]) or is_any(np.abs(nus) > 0.5):
            raise ValueError("unmeasured must be directions, -0.5 .. 0.5, at least one, ascending")
        # With range cells another look may have the direction, at other ranges.
        rows = np.empty(0) if self.nus is None else self.nus[np.asarray(self.ranges_km) == 0.0]
        if np.isin(nus, rows).any():
            raise ValueError("what is unmeasured must have no row")

    def _ascends(self) -> bool:
        """Whether a bin has one row, or the directions of looks ascend. ValueError if columns of looks do not fit."""
        if self.nus is None:
            return not is_any(self.bins[1:] <= self.bins[:-1])
        columns = (self.nus, self.limits, self.ranges_km, self.nu_hats, self.nu_sigmas)
        if {np.asarray(column).size for column in columns} != {self.bins.size}:
            raise ValueError("nus, limits, ranges_km, nu_hats and nu_sigmas must have one length with bins")
        return not is_any(self.nus[1:] < self.nus[:-1])


class Truth(Message):
    """Where the targets are at dwell k, if the front end knows: emulator -> recorder only.

    All targets of the run are in it, in one order; of one that is not there the bin is -1, all else 0.
    """

    k: Index
    t: Index
    states: States  # (M, 4) [x, vx, y, vy] on the ground, km and km/s
    heights_km: Floats  # (M,) of each target; range and direction are measured of the position with it
    bins: Ints  # (M,); -1: not there
    snr_db: Floats  # (M,) per virtual channel, before array gain
    waveform_k: Annotated[int, Field(ge=-1)]  # dwell whose waveform was radiated: k-1, less if that came late; -1: none

    @model_validator(mode="after")
    def _aligned(self) -> Self:
        shapes = {self.snr_db.shape, self.heights_km.shape}
        if self.states.shape != (self.bins.size, 4) or shapes != {self.bins.shape}:
            raise ValueError("states must be (M, 4) and bins, snr_db, heights_km (M,)")
        absent = self.bins == ABSENT
        if is_any(self.bins < ABSENT) or is_any(self.states[absent] != 0.0) or is_any(self.heights_km[absent] != 0.0):
            raise ValueError("bins must be from 0, or -1 of targets that are not there, whose states must be 0")
        return self

    @property
    def measured_states(self) -> NDArray[np.float64]:
        """States where the array measures the targets, (M, 4): with the range and direction of their height."""
        return in_plane(self.states, self.heights_km)


class Plan(Message):
    """What one track asks for after dwell k: planner -> allocator, recorder."""

    PARTS: ClassVar[Parts] = {
        "directions": ("nus", "gate"),
        "existence": ("existence", "confirmed", "in_doubt"),
        "modes": ("modes",),
        "plane": ("plane_estimate", "plane_covariance"),
    }

    k: Index
    t: Index
    target: Index  # track number, 0 .. M-1; its id, if their number is unknown
    status: Literal["searching", "tracking", "ended"]  # ended: the track is given up
    bins: Cells = Field(default_factory=lambda: np.empty(0, np.int32))  # (c,) asked for; none while searching
    chances: Chances = Field(default_factory=lambda: np.empty(0))  # (c,) probability of the target in each at k+1
    best_bin: Annotated[int, Field(ge=-1, le=MAX_SIDE)] = -1  # the most probable one at k+1; -1 while searching
    worth: Annotated[float, Field(ge=0, le=1)] = 0.0  # what a look adds to P of the best bin some dwells later
    gain: Size = 0.0  # zeta of the cell with the target, over its beam power
    range_km: Annotated[float, Field(ge=0, le=FAR)] = 0.0  # expected range at k+1
    estimate: State = Field(default_factory=lambda: np.zeros(4))  # (4,) belief mean at k, on the ground
    covariance: Covariance = Field(default_factory=lambda: np.zeros((4, 4)))  # (4, 4) of the belief at k
    detected: bool = False  # the track's cell of dwell k was over the threshold
    depleted: bool = False  # no particle explained the observation of dwell k
    reach: Annotated[int, Field(ge=0, le=MAX_SIDE)] = 0  # cells to either side of `bins` where it may be, too
    astray: bool = False  # the belief cannot explain its misses since the last detection
    n_sim: Index = 0  # simulations behind the choice; fewer than the scenario's if a deadline cut them short
    nus: Floats | None = None  # (c,) directions of the cells, if they are steered
    gate: Gate | None = None  # (2,) ranges to be tested, km; (0, 0): all
    # In real time: dwells whose scans the belief went without since the track began, the newest ones; None: it has all.
    unseen: Unseen | None = None
    # Of tracks of an unknown number only.
    existence: Annotated[float | None, Field(ge=0, le=1)] = None  # probability that there is a target
    confirmed: bool | None = None  # or tentative
    in_doubt: bool | None = None  # dwell k does not say which detection is this track's and which another's
    modes: Floats | None = None  # (modes,) probabilities of `cogradar.shared.tracking.motion`
    # If heights are assumed only.
    plane_estimate: State | None = None  # (4,) mean in the plane of the array, with the range and direction measured
    plane_covariance: Covariance | None = None  # (4, 4)

    @property
    def in_plane(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Estimate and covariance in the plane of the array, with the range and direction that it measures."""
        if self.plane_estimate is None or self.plane_covariance is None:
            return self.estimate, self.covariance
        return self.plane_estimate, self.plane_covariance

    @model_validator(mode="after")
    def _asks_for_cells(self) -> Self:
        fits = (self.bins.size > 0) == (self.best_bin >= 0) == (self.status == "tracking")
        _check_whole_parts(self)
        if not fits or self.chances.size != self.bins.size:
            raise ValueError("bins, as many chances and best_bin must be given while tracking, and not while searching")
        if self.nus is None:
            check_different(self.bins[np.newaxis])
        elif self.nus.size != self.bins.size or max(map(abs, self.nus.tolist()), default=0.0) > 0.5:
            raise ValueError("nus must be as many as bins, -0.5 .. 0.5")
        return self


class Waveform(Message):
    """What is radiated at dwell k+1: R = isotropic/n_tx I + factor factor^H; allocator -> emulator, recorder."""

    PARTS: ClassVar[Parts] = {"directions": ("nus", "gates"), "roster": ("roster",)}

    k: Index
    tracking: bool  # False: acquisition goes on
    isotropic: Annotated[float, Field(ge=0)]  # power spread evenly over all directions
    factor: Factor  # (n_tx, r)
    beams: Beams  # (M, L) cells lit for each track, brightest first; -1: no more, or acquisition
    shares: FloatLists  # (M, L) power on each beam, sums to the power not isotropic
    status: Literal["acquisition", "fixed", "optimal", "inaccurate"]
    late: Ints  # (M,) k less the dwell of the plan that was used; 0 where the plan of dwell k was in time
    nus: FloatLists | None = None  # (M, L) directions of `beams`, if they are steered; 0 where there is none
    gates: FloatLists | None = None  # (M, 2) ranges to be tested for each track, km; (0, 0): all
    roster: Roster | None = None  # the tracks, if their number is unknown
    orders: Ints | None = None  # numbers of the orders that it obeys, ascending; none: there are none
    settings: Settings | None = None  # ... what they set; None: all is as the run began
    begins_none: Literal[True] | None = None  # in real time: its allocator has just come back, and no track begins yet

    @model_validator(mode="after")
    def _aligned(self) -> Self:
        if self.beams.shape != self.shares.shape or self.beams.shape[:1] != self.late.shape:
            raise ValueError("beams and shares must have one shape, a row for each of late")
        is_lit = is_any(self.beams >= 0) if self.roster is None else True
        if is_lit != self.tracking or is_any(self.beams < -1):
            raise ValueError("some beams must be >= 0 while tracking, all -1 during acquisition")
        _check_whole_parts(self)
        if is_any(self.shares < 0.0) or is_any(self.shares[self.beams < 0] != 0.0):
            raise ValueError("shares must be >= 0, and 0 where no cell is lit")
        _check_beams(self.beams, self.nus, self.gates, self.roster)
        return self


def roster_of(message: Scan | Waveform) -> Roster:
    """The tracks of a scan or a waveform; announced tracks, which are not sent, have a fixed roster."""
    return message.roster or announced_roster(message.beams.shape[0])


def _check_whole_parts(message: Message) -> None:
    """ValueError if some fields of a part are there and others are not."""
    values = vars(message)
    for names in message.PARTS.values():
        is_missing = values[names[0]] is None
        for name in names:
            if (values[name] is None) is not is_missing:
                raise ValueError(f"{', '.join(names)} must be there or not, all of them")


def _check_beams(beams: Beams, nus: FloatLists | None, gates: FloatLists | None, roster: Roster | None) -> None:
    """ValueError unless directions and gates fit the beams, and a roster has a track for each row of them."""
    if roster is not None and roster.ids.size != beams.shape[0]:
        raise ValueError("beams must have a row for each track of the roster")
    if nus is None or gates is None:
        check_different(beams)
        return
    if nus.shape != beams.shape or is_any(np.abs(nus) > 0.5) or gates.shape != (beams.shape[0], 2):
        raise ValueError("directions must have a beam each, -0.5 .. 0.5, and gates (M, 2)")
    if is_any((gates < 0.0) | (gates > FAR)) or is_any(gates[:, 1] < gates[:, 0]):
        raise ValueError(f"gates must be 0 <= low <= high <= {FAR:g}")


class RunEnd(Message):
    """The run is over: emulator -> recorder."""

    k: Index
    t: Index
    status: Literal["complete", "stopped", "failed"]
    reason: Reason = ""
