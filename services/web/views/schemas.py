"""The answers that the page asks for, as types for their description; columns as in `services.web.schemas`."""

from pydantic import BaseModel, ConfigDict, Field

from shared.protocol.fields import RunId
from shared.protocol.topics import Role
from shared.scenario.radar_config import Strategy


class Document(BaseModel):
    """What has these fields and no others."""

    model_config = ConfigDict(extra="forbid")


class Flight(Document):
    """Where a target is, and what its track says; km and km/s."""

    x: float | None
    vx: float | None
    y: float | None
    vy: float | None
    x_hat: float | None
    vx_hat: float | None
    y_hat: float | None
    vy_hat: float | None
    true_bin: int | None
    bin: int | None
    snr_db: float | None
    share: float | None
    best_bin: int | None
    outage: int | None
    cells: list[tuple[int, float]] = Field(
        description="bins lit for the track, the brightest first, each with its power"
    )


class BeamOfTarget(Document):
    """The power towards a bin that was lit for a track; `hit`: one of them was the true one."""

    target: int
    true_bin: int | None
    bin: int
    hit: bool | None
    nu: float
    angle_deg: float
    power_db: float


class Beampattern(Document):
    """What a dwell radiated: a^T R a^* in dB over spatial frequency and angle; 0 dB is all power spread evenly."""

    run: str
    t: int
    nu: list[float]
    angle_deg: list[float]
    power_db: list[float]
    targets: list[BeamOfTarget]


class TargetOfDwell(Flight):
    """A target in a dwell; `statistic` is the largest of a cell that holds it (without truth: of its beam)."""

    target: int
    track: int | None
    detected: bool | None = Field(description="null: the target is not there")
    statistic: float | None
    late: bool | None
    stale: bool | None
    lost: bool | None = Field(description="Whether the track was out of its target's bin for the last 20 dwells.")
    hit: bool | None = Field(description="Whether the true bin, or within half a bin of it, was lit.")
    beam_deg: float | None  # direction of the brightest beam that was lit for the track
    beams_deg: list[tuple[float, float]] = Field(description="of each of `cells`: edges of the beam, a bin wide")
    error_km: float | None
    covariance: list[float] | None = Field(description="[xx, xy, yy] of the belief's position, km^2.")


class Cells(Document):
    """The cells that a dwell tested. A detection at no target's true bin is a false alarm."""

    bin: list[int]
    statistic: list[float]
    detected: list[bool]


class DwellEvent(Document):
    """One dwell: the `data` of an event. `isotropic` is the power that was spread evenly over all directions."""

    run: str
    t: int
    k: int
    threshold: float
    isotropic: float | None
    targets: list[TargetOfDwell]
    cells: Cells | None
    false_alarms: list[int] | None = Field(description="Bins of detections where no target was.")


class Dwells(Document):
    """Dwells of a run, in their order."""

    dwells: list[DwellEvent]


class Radar(Document):
    """What does not change in a run, and its status."""

    run: RunId
    scenario: str
    strategy: Strategy
    seed: int
    status: str
    rate_hz: float
    dt_s: float
    dwells: int
    acquisition_scans: int | None
    targets: int
    n_bin: int
    bin_edges_deg: list[float]
    max_range_km: float
    has_truth: bool
    threshold: float
    p_fa: float
    fidelity: str
    rule: str = Field(description="Among which bins a track chooses: `belief` or `all`.")


class History(Document):
    """The course of a target, in columns of at most 500 points: every n-th dwell, and the newest one."""

    run: str
    target: int
    every: int
    t: list[int]
    share: list[float]
    snr_db: list[float | None]
    statistic: list[float | None]
    threshold: list[float]
    detected: list[bool | None] = Field(description="null: the target is not there")
    p_d: list[float | None] = Field(description="In all dwells so far.")
    p_d_low: list[float | None] = Field(description="Of Wilson's 95 % interval.")
    p_d_high: list[float | None]
    error_km: list[float | None]
    floor_km: list[float | None] = Field(
        description="Cramer-Rao bound of the range; null until the data outweigh the prior."
    )
    late: list[bool]
    stale: list[bool | None]


class Timeline(Document):
    """A whole run in columns of at most 600 buckets of dwells."""

    run: str
    t: int = Field(description="The newest dwell.")
    width: int = Field(description="Dwells of a bucket.")
    first: list[int]
    last: list[int]
    detected: list[float | None] = Field(description="Share of the targets that are there; null: there is none.")
    lost: list[int | None] = Field(
        description="Tracks whose bin was not their target's in most of the last 20 dwells, or of a longer bucket's;"
        " in the last bucket always of the last 20 dwells."
    )
    late: list[int] = Field(description="Plans.")
    stale: list[int | None] = Field(description="Dwells.")
    error_km: list[float | None] = Field(description="The largest root mean square of any track.")


class Particles(Document):
    """At most 1500 particles of the belief about a target after a dwell, km; each as likely as the others."""

    run: str
    target: int
    t: int
    x: list[float]
    y: list[float]


class ProcessRow(Document):
    """A process.

    Times are over the last seconds, from the buckets of histograms: those of `dwell` and `margin` are within a quarter,
    those of `handling` within a factor of 2.5. What a role does not count, and what has not happened, is null. Counts
    are since the process began.
    """

    role: Role
    name: str = Field(description="Empty: nobody plays this role.")
    alive: bool = Field(description="Whether it answers.")
    dwells_per_s: float | None
    dwell_p50_ms: float | None = Field(description="From one transmission of a run to the next.")
    dwell_p99_ms: float | None
    handling_of: str | None = Field(description="Topic, or other kind of event, that it spends most time on.")
    handling_p50_ms: float | None = Field(description="From such an event to the last answer to it.")
    handling_p99_ms: float | None
    margin_p50_ms: float | None = Field(description="In real time: from a waveform's arrival to its transmission.")
    margin_p99_ms: float | None = Field(description="99 % of the dwells that were in time have at least this margin.")
    late: float | None = Field(description="Plans that were late, and extrapolated.")
    stale: float | None = Field(description="Dwells with an older waveform.")
    redelivered: float | None
    dropped: float | None
    cpu_seconds: float | None
    rss_bytes: float | None


class Processes(Document):
    """Every process, and who owns which track of the runs that go on."""

    window_s: float | None = Field(description="That rates and times are over; null: since the processes began.")
    processes: list[ProcessRow]
    owners: dict[str, list[str]] = Field(description="By run: the planner of each track; empty if there is no planner.")


VIEWS: tuple[type[BaseModel], ...] = (Beampattern, DwellEvent, Dwells, Radar, History, Timeline, Particles, Processes)
