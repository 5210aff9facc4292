"""The answers as types, for their description: one for each kind of row that metrics gives, under the same names."""

from typing import Annotated, Any, Literal, get_type_hints

from pydantic import BaseModel, Field, create_model

from cogradar.services.web.views.schemas import CELLS, FLAGS, VIEWS, Document, with_columns
from cogradar.shared.protocol.fields import RunId
from cogradar.shared.protocol.orders import (
    LEAST_POWER,
    MAX_LOOK_DWELLS,
    MAX_LOOKS,
    MAX_PAUSE_DWELLS,
    PRIORITIES,
)
from cogradar.shared.protocol.topics import Role
from cogradar.shared.protocol.words.orders import forms
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scoring.columns import SCORE, SHOWN
from cogradar.shared.scoring.figures import Figures

Flights = Literal["all", "straight", "0.1-1 g", "1-3 g", "over 3 g"]


class RunRow(Document):
    """A run."""

    run: RunId
    scenario: str
    strategy: Strategy
    seed: int
    dwells: int | None = Field(description="After the acquisition; null: until it is ended.")
    rate_hz: float
    targets: int
    tracks: int | None
    confirmed: int | None
    acquisition_scans: int | None
    conflicts: int
    status: Literal["running", "complete", "stopped", "failed", "quarantined"]
    reason: str
    fault: str | None = Field(description="Why nothing was measured in the newest dwell of a run that goes on.")
    digest: str | None
    t: int
    oldest_t: int = Field(description="The oldest dwell that is kept of a run without an end; else 1.")
    began: str = Field(description="When the recorder had its start, in UTC.")
    ended: str | None = Field(description="When it ended, in UTC.")
    length_s: float | None = Field(description="So far, after the acquisition, by its clock; null: it cannot be read.")
    k: int | None
    waiting_for: str


@with_columns((column for column in SHOWN if column.name != "run"), cells=CELLS, **FLAGS)
class TrackRow(Document):
    """A target in a dwell; km and km/s. Null is what needs truth, the target, or a track, where there is none."""

    run: str
    strategy: Strategy


class _Pool(Document):
    scenario: str
    strategy: Strategy
    target: int
    runs: int
    first_dwell: int
    last_dwell: int
    n: int


class PdRow(_Pool):
    """Detections of a target, over runs and dwells, and Wilson's 95 % interval of their probability."""

    detections: int
    p_d: float | None
    p_d_low: float | None
    p_d_high: float | None
    in_bin: float | None


class RmseRow(_Pool):
    """Errors of a track, over runs and dwells."""

    position_rmse_km: float | None
    velocity_rmse_km_s: float | None


class ConsistencyRow(Document):
    """Normalised estimation errors squared (NEES) over targets, runs and dwells, by the acceleration of the target."""

    scenario: str
    strategy: Strategy
    runs: int
    first_dwell: int
    last_dwell: int
    flight: Flights = Field(description="Straight: below 0.1 g.")
    n: int = Field(description="Dwells of targets that fly so and have a NEES.")
    nees: float | None = Field(description="Mean of the whole state; 4 of honest beliefs.")
    nees_position: float | None = Field(description="Mean of the position alone; 2 of honest beliefs.")
    nees_velocity: float | None = Field(description="Mean of the velocity alone; 2 of honest beliefs.")
    beyond_99: float | None = Field(description="Share of the dwells with a NEES beyond 13.28; 0.01 of honest beliefs.")


class ConfirmationRow(Document):
    """Visible targets that got a confirmed track, over targets and runs of an unknown number of targets."""

    scenario: str
    strategy: Strategy
    runs: int
    targets: int = Field(description="Visible in one dwell at least.")
    confirmed: int = Field(description="Of them, those that a confirmed track has followed.")
    confirmation_median_s: float | None = Field(description="From visible to confirmed; null: half were never found.")
    confirmation_95_s: float | None = Field(description="95 % did not wait longer.")
    long_visible: int = Field(description="Visible in 20 dwells or more.")
    never_found: int = Field(description="Of these, those without a confirmed track.")


_MEANS = tuple(column._replace(null=True) for column in SCORE if column.mean)


@with_columns(_MEANS, **{column.name: float for column in _MEANS})
class SummaryRow(Document):
    """A target of a run, over dwells."""

    run: str
    target: int
    first_dwell: int
    last_dwell: int
    n: int
    detections: int
    hit_rate: float | None
    in_bin: float | None
    outage: int | None
    outage_longest: int | None
    position_rmse_km: float | None
    velocity_rmse_km_s: float | None
    p_d: float | None
    p_d_low: float | None
    p_d_high: float | None
    born_t: int | None
    gone_t: int | None
    visible_t: int | None
    confirmed_t: int | None
    lost: bool | None
    tracked: bool
    false_track: bool


class _OfPicture(Document):
    """All tracks and targets of a run together. Null is what needs truth, or is a share or mean of nothing."""

    run: str
    scenario: str
    strategy: Strategy
    seed: int
    dwells: int
    tracks: int
    blind_cells: int = Field(description="Tested cells whose noise had no estimate, over dwells after the acquisition.")
    blind_dwells: int = Field(description="Dwells with a blind cell.")
    blind_share: float | None = Field(description="Of all tested cells.")
    unmeasured_looks: int = Field(description="Looks that were asked for and not measured.")
    unmeasured_dwells: int = Field(description="Dwells in which nothing was measured.")
    unmeasured_fault: str | None = Field(description="Why, in the last of them.")


_FIGURES: dict[str, Any] = {name: (hint | None, ...) for name, hint in get_type_hints(Figures).items()}
del _FIGURES["tracks"]  # known without truth, too
PictureRow = create_model("PictureRow", __base__=_OfPicture, __doc__=_OfPicture.__doc__, **_FIGURES)


class AntennaRow(Document):
    """A transmit antenna of a run, over the waveforms that are stored, 256 at equal steps if there are more."""

    run: str
    strategy: Strategy
    first_dwell: int
    last_dwell: int
    n: int = Field(description="Waveforms.")
    antenna: int
    power: float = Field(description="Mean; all antennas together have the array's power.")
    power_max: float
    papr_db: float = Field(
        description="Peak over mean power within a dwell, mean over dwells; shifts of a Zadoff-Chu sequence."
    )
    papr_max_db: float


class CommandRow(Document):
    """A command of a run, and what became of it."""

    run: str
    n: int = Field(description="Its number in the run; a waveform names those that it obeys.")
    by: str = Field(description="Who asked.")
    asked: str = Field(description="When the recorder received it, in UTC.")
    action: str = Field(description="As `cogradar command` takes it.")
    k: int | None = Field(description="The first dwell under it, counted from 0; null: it was refused.")
    t: int | None = Field(description="The same by the clock of the run, from 1; null during an acquisition.")
    state: Literal["pending", "in force", "awaits the allocator", "over", "refused"]
    reason: str = Field(description="Why it was refused.")
    id: str


class PowerDocument(Document):
    """Transmit with at most this share of the array's power, until another limit is set."""

    kind: Literal["power"]
    share: float = Field(ge=LEAST_POWER, le=1.0)


class SectorDocument(Document):
    """Search a sector never, once or twice in each sweep; bearings are in degrees from boresight."""

    kind: Literal["sector"]
    from_deg: float = Field(ge=-90, le=90)
    to_deg: float = Field(ge=-90, le=90)
    search: Literal["blank", "normal", "double"]


class LookDocument(Document):
    """One more beam in this direction, for some dwells."""

    kind: Literal["look"]
    bearing_deg: float = Field(ge=-90, le=90)
    dwells: int = Field(ge=1, le=MAX_LOOK_DWELLS)
    share: float = Field(ge=LEAST_POWER, le=MAX_LOOKS, description="Of the power.")


class DropDocument(Document):
    """End a track, counted from 1."""

    kind: Literal["drop"]
    track: int = Field(ge=1, lt=2**31)


class PriorityDocument(Document):
    """Want so many times the signal-to-noise ratio of a track, counted from 1, that the radar would."""

    kind: Literal["priority"]
    track: int = Field(ge=1, lt=2**31)
    weight: float = Field(ge=PRIORITIES[0], le=PRIORITIES[1])


class SettingDocument(Document):
    """Set the run's strategy, the action-selection policy or the objective of allocation, until it is set again."""

    kind: Literal["set"]
    key: Literal["strategy", "rule", "objective"]
    value: str = Field(max_length=40, description="A name that a scenario may have.")


class PauseDocument(Document):
    """Radiate nothing, for some dwells or until transmission is resumed."""

    kind: Literal["pause"]
    dwells: int | None = Field(default=None, ge=1, le=MAX_PAUSE_DWELLS, description="Null: until it is resumed.")


class ResumeDocument(Document):
    """End a pause."""

    kind: Literal["resume"]


class EndDocument(Document):
    """End the run, complete with the dwells before."""

    kind: Literal["end"]


class CommandDocument(Document):
    """What is asked of a run."""

    action: (
        Annotated[
            PowerDocument
            | SectorDocument
            | LookDocument
            | DropDocument
            | PriorityDocument
            | SettingDocument
            | PauseDocument
            | ResumeDocument
            | EndDocument,
            Field(discriminator="kind"),
        ]
        | Annotated[str, Field(description="; ".join(forms()))]
    )
    at: int = Field(default=0, ge=0, lt=2**31, description="Not before this dwell, counted from 0.")


class Commander(Document):
    """A client that may command."""

    name: str


class ProcessRow(Document):
    """A process.

    Times are over the last seconds, from the buckets of histograms: `dwell`, `margin` and `front_end` are within a
    quarter, `handling` within a factor of 2.5. What a role does not count, and what has not happened, is null. Counts
    are since the process began.
    """

    role: Role
    name: str = Field(description="Empty: this role has no process.")
    alive: bool = Field(description="Whether it is there: it shows itself alive, or did half a second ago.")
    answers: bool = Field(description="Whether it answered within two seconds; else all numbers are null.")
    began_utc_s: float | None = Field(
        description="When it was started, by its own clock: another number, another start."
    )
    starting: bool = Field(description="It owns tracks, and has sent no plan since it was started.")
    dwells_per_s: float | None
    dwell_p50_ms: float | None = Field(description="From one transmission of a run to the next.")
    dwell_p99_ms: float | None
    handling_of: str | None = Field(description="Topic, or other kind of event, that it spends most time on.")
    handling_p50_ms: float | None = Field(description="From such an event to the last answer to it.")
    handling_p99_ms: float | None
    margin_p50_ms: float | None = Field(description="In real time: from a waveform's arrival to its transmission.")
    margin_p99_ms: float | None = Field(description="99 % of the dwells that were in time have at least this margin.")
    front_end_p50_ms: float | None = Field(description="In real time: from a transmission to its scan.")
    front_end_p99_ms: float | None
    late: float | None = Field(description="Plans that were late, and extrapolated.")
    stale: float | None = Field(description="Dwells with an older waveform.")
    redelivered: float | None
    dropped: float | None
    full: float | None
    certificate_days: float | None = Field(description="Until its certificate ends; null without one.")
    cpu_seconds: float | None
    rss_bytes: float | None


class Processes(Document):
    """Every process, and which tracks of the running runs it owns."""

    utc_s: float = Field(description="When this was, by the clock of metrics.")
    window_s: float | None = Field(description="That rates and times are over; null: since the processes began.")
    processes: list[ProcessRow]
    owners: dict[str, dict[int, str]] = Field(
        description="By run: the planner of each track there is; empty if there is no planner."
    )


class Status(Document):
    """A service that is up; `status` is `ok`, or says what runs are held for."""

    status: str


class ProblemDocument(Document):
    """What went wrong (RFC 9457)."""

    type: Literal["about:blank"]
    title: str
    status: int
    detail: str


PAGES: dict[str, type[BaseModel]] = {
    "runs": RunRow,
    "tracks": TrackRow,
    "p_d": PdRow,
    "rmse": RmseRow,
    "consistency": ConsistencyRow,
    "confirmation": ConfirmationRow,
    "antennas": AntennaRow,
    "commands": CommandRow,
    "summary": SummaryRow,
    "picture": PictureRow,
}
DOCUMENTS: tuple[type[BaseModel], ...] = (
    *PAGES.values(),
    *VIEWS,
    CommandDocument,
    Commander,
    Processes,
    Status,
    ProblemDocument,
)
