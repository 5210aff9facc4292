"""The answers as types, for their description: one for each kind of row that metrics gives, under the same names."""

from typing import Literal

from pydantic import BaseModel, ConfigDict

from shared.protocol.fields import RunId
from shared.scenario.radar_config import Strategy


class _Document(BaseModel):
    model_config = ConfigDict(extra="forbid")


class RunRow(_Document):
    """A run."""

    run: RunId
    scenario: str
    strategy: Strategy
    seed: int
    dwells: int
    rate_hz: float
    targets: int
    acquisition_scans: int | None
    conflicts: int
    status: Literal["running", "complete", "failed", "quarantined"]
    reason: str
    digest: str | None
    t: int
    k: int | None
    waiting_for: str


class _Flight(_Document):
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


class TrackRow(_Flight):
    """A target in a dwell; km and km/s. Null is what needs truth, or a track, where there is none."""

    run: str
    strategy: Strategy
    k: int
    t: int
    target: int
    track: int | None
    detected: int
    late: int | None
    stale: int | None


class _Pool(_Document):
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
    p_d: float
    p_d_low: float
    p_d_high: float


class RmseRow(_Pool):
    """Errors of a track, over runs and dwells."""

    position_rmse_km: float | None
    velocity_rmse_km_s: float | None


class SummaryRow(_Document):
    """A target of a run, over dwells."""

    run: str
    target: int
    first_dwell: int
    last_dwell: int
    n: int
    detections: int
    hit_rate: float | None
    snr_db: float | None
    share: float | None
    late: float | None
    stale: float | None
    position_rmse_km: float | None
    velocity_rmse_km_s: float | None
    p_d: float | None
    p_d_low: float | None
    p_d_high: float | None
    lost: bool | None
    false_track: bool


class BeamOfTarget(_Document):
    """The power towards the bin that a track asked for."""

    target: int
    true_bin: int | None
    bin: int
    nu: float
    angle_deg: float
    power_db: float


class Beampattern(_Document):
    """What a dwell radiated: a^T R a^* in dB over spatial frequency and angle; 0 dB is all power spread evenly."""

    run: str
    t: int
    nu: list[float]
    angle_deg: list[float]
    power_db: list[float]
    targets: list[BeamOfTarget]


class TargetOfDwell(_Flight):
    """A target in a dwell; `statistic` is that of the cell at its true bin (without truth: at the bin asked for)."""

    target: int
    track: int | None
    detected: bool
    statistic: float | None
    late: bool | None
    stale: bool | None


class Cells(_Document):
    """The cells that a dwell tested. A detection at no target's true bin is a false alarm."""

    bin: list[int]
    statistic: list[float]
    detected: list[bool]


class DwellEvent(_Document):
    """The `data` of an event: one dwell."""

    run: str
    t: int
    k: int
    threshold: float
    targets: list[TargetOfDwell]
    cells: Cells | None


class Status(_Document):
    """A service that is well."""

    status: Literal["ok"]


class ProblemDocument(_Document):
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
    "summary": SummaryRow,
}
DOCUMENTS: tuple[type[BaseModel], ...] = (*PAGES.values(), Beampattern, DwellEvent, Status, ProblemDocument)
