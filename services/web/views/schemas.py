"""The answers that the page asks for, as types for their description; columns as in `cogradar.services.web.schemas`."""

from collections.abc import Callable, Iterable
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, create_model

from cogradar.shared.protocol.fields import RunId
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scoring.columns import FLAG, SHOWN, Column


class Document(BaseModel):
    """What has these fields and no others."""

    model_config = ConfigDict(extra="forbid")


def with_columns(columns: Iterable[Column], **types: Any) -> Callable[[type[Document]], type[Document]]:
    """A document with these columns of the table `score` as well; `types`: of those that are not as in the store."""

    def extended(document: type[Document]) -> type[Document]:
        fields: dict[str, Any] = {}
        for column in columns:
            type_ = types.get(column.name, column.kind.python)
            fields[column.name] = (type_ | None if column.null else type_, Field(description=column.meaning))
        return create_model(document.__name__, __base__=document, __doc__=document.__doc__, **fields)

    return extended


CELLS = list[tuple[int, float]]
FLAGS = {column.name: int for column in SHOWN if column.kind is FLAG}
_UNTOLD = {"run", "k", "t", "nees", "nees_position", "nees_velocity", "acceleration_g", "visible"}
OF_TARGET = tuple(column for column in SHOWN if column.name not in _UNTOLD)  # in an event


class Towards(Document):
    """The power towards a direction."""

    nu: float
    angle_deg: float
    power_db: float


class BeamOfTrack(Towards):
    """A beam that was lit for a track, and the power on it; `hit`: one of the track's beams was the true one."""

    track: int
    target: int | None = Field(description="The target that the track follows, if that is known.")
    true_bin: int | None
    bin: int
    hit: bool | None


class AntennaOfDwell(Document):
    """What a transmit antenna sent in a dwell."""

    antenna: int
    power: float = Field(description="The powers of all antennas sum to `radar.array.power`.")
    papr_db: float = Field(
        description="Peak over mean power, if the waveforms are cyclic shifts of one Zadoff-Chu sequence."
    )


class Beampattern(Document):
    """What a dwell radiated: a^T R a^* in dB over spatial frequency and angle; 0 dB is all power spread evenly."""

    run: str
    t: int
    nu: list[float]
    angle_deg: list[float]
    power_db: list[float]
    beams: list[BeamOfTrack]
    antennas: list[AntennaOfDwell]
    search: list[Towards] = Field(description="Beams that search for unannounced targets.")


@with_columns(OF_TARGET, cells=CELLS)
class TargetOfDwell(Document):
    """A target in a dwell; `statistic` is the largest of a cell that holds it (without truth: of its beam)."""

    statistic: float | None
    lost: bool | None = Field(description="Whether the track was out of its target's bin for the last 20 dwells.")
    beam_deg: float | None  # direction of the brightest beam that was lit for the track
    beams_deg: list[tuple[float, float]] = Field(description="of each of `cells`: edges of the beam, a bin wide")
    error_km: float | None
    covariance: list[float] | None = Field(description="[xx, xy, yy] of the belief's position, km^2.")
    latitude_deg: float | None = Field(description="WGS 84, as is `longitude_deg`; null: the scenario has no `[site]`.")
    longitude_deg: float | None
    latitude_hat_deg: float | None = Field(description="Of the estimate, as is `longitude_hat_deg`.")
    longitude_hat_deg: float | None


class TrackOfDwell(Document):
    """A track in a dwell, where their number is unknown. What its plan says is null if that came too late."""

    track: int
    target: int | None = Field(description="The target that it follows, if that is known.")
    born_t: int = Field(description="Dwell of the detection that it began with.")
    confirmed: bool = Field(description="Or tentative, which no score counts.")
    existence: float | None = Field(description="Probability that there is a target.")
    modes: list[float] | None = Field(description="... that it flies straight on, turns, turns hard; null: no mixture.")
    is_over: bool = Field(description="It ends with this dwell.")
    in_doubt: bool = Field(description="The dwell does not say which detection is this track's and which another's.")
    x_hat: float | None
    vx_hat: float | None
    y_hat: float | None
    vy_hat: float | None
    latitude_hat_deg: float | None = Field(description="WGS 84, as is `longitude_hat_deg`; null without a `[site]`.")
    longitude_hat_deg: float | None
    covariance: list[float] | None = Field(description="[xx, xy, yy] of the belief's position, km^2.")
    error_km: float | None
    detected: bool | None = Field(description="Whether what it asked for was over the threshold.")
    statistic: float | None = Field(description="Of its brightest beam, as is `threshold`.")
    threshold: float | None
    share: float
    late: bool
    cells: list[tuple[int, float]]
    beam_deg: float | None
    beams_deg: list[tuple[float, float]]


class Search(Document):
    """Where targets were searched for, with this power, if their number is unknown."""

    beams_deg: list[tuple[float, float]] = Field(description="Edges of the beams, a bin wide.")
    share: float


class PictureOfDwell(Document):
    """All tracks and targets of a dwell together; null is what needs truth."""

    targets: int | None = Field(description="Those that can be found by now.")
    tracks: int
    followed: int | None = Field(description="Targets with a track.")
    swaps: int | None = Field(description="Tracks that changed to another target in this dwell.")
    gospa_km: float | None = Field(description="p = 2, c = 5 km; its square is the sum of the squares of its parts.")
    gospa_localisation_km: float | None
    gospa_missed_km: float | None
    gospa_false_km: float | None


class Cells(Document):
    """The cells that a dwell tested. A detection at no target's true bin is a false alarm."""

    bin: list[int]
    statistic: list[float]
    detected: list[bool]
    blind: list[bool] = Field(description="Cells whose noise could not be estimated: their statistic is 0.")
    unmeasured: list[int] = Field(description="Bins of looks that were asked for and not measured.")
    fault: str | None = Field(description="Why nothing was measured.")


class DwellEvent(Document):
    """One dwell: the `data` of an event. `isotropic` is the power that was spread evenly over all directions."""

    run: str
    t: int
    k: int
    utc_s: float | None = Field(
        description="Since 1970 in UTC: as the front end says, or `[site]` if it says when the run begins."
    )
    threshold: float
    stale: bool = Field(description="In real time: it was radiated with an older waveform.")
    isotropic: float | None = Field(description="null: its waveform is not stored.")
    targets: list[TargetOfDwell]
    tracks: list[TrackOfDwell] | None = Field(description="null: their number is known.")
    search: Search | None
    cells: Cells | None
    orders: list[int] = Field(description="Numbers of the commands that its waveform obeys.")
    false_alarms: list[int] | None = Field(description="Bins of detections where no target was.")
    picture: PictureOfDwell


class Dwells(Document):
    """Dwells of a run, in their order."""

    dwells: list[DwellEvent]
    next: str | None = Field(description="Where the next of those that were asked for are: an answer has 100 at most.")


class Jammer(Document):
    """A source of noise in one direction."""

    angle_deg: float
    jnr_db: float
    on_s: float
    off_s: float | None = Field(description="Null: it stays on.")


class Site(Document):
    """Where the radar stands: the table `[site]` of the scenario."""

    latitude_deg: float
    longitude_deg: float
    height_m: float
    boresight_deg: float
    begin_utc: str | None


class Airport(Document):
    """An airport with flights that are sold."""

    code: str = Field(description="IATA.")
    name: str
    latitude_deg: float
    longitude_deg: float


class Surroundings(Document):
    """What a map shows around the site, within twice the radar's range."""

    airports: list[Airport] = Field(max_length=60, description="The nearest first.")
    lines: list[list[tuple[float, float]]] = Field(
        description="Coasts and borders, Natural Earth 1:10m: latitude and longitude of points, degrees."
    )


class Radar(Document):
    """What does not change in a run, and its status."""

    run: RunId
    scenario: str
    strategy: Strategy
    seed: int
    status: str
    rate_hz: float
    dt_s: float
    dwells: int | None = Field(description="After the acquisition; null: until it is ended.")
    acquisition_scans: int | None
    targets: int
    is_unknown: bool = Field(description="The radar is not told how many targets there are.")
    n_bin: int
    bin_edges_deg: list[float]
    max_range_km: float
    has_truth: bool
    has_processes: bool = Field(description="The service has a router, and says at /processes how processes do.")
    threshold: float
    p_fa: float
    fidelity: str
    jammers: list[Jammer] = Field(description="Of a simulation.")
    rule: str = Field(description="Among which bins a track chooses: `belief` or `all`.")
    site: Site | None
    surroundings: Surroundings | None = Field(
        description="null without a site, or without the packages of `cogradar[map]`."
    )


class Course(Document):
    """The course of a target, or of a track where their number is unknown, in columns of at most 500 points: every n-th
    dwell, and the newest one. A column that only the other one has is null.
    """

    run: str
    target: int | None
    track: int | None
    every: int
    t: list[int]
    share: list[float]
    statistic: list[float | None]
    threshold: list[float | None]
    detected: list[bool | None] = Field(description="null: the target is not there; of a track: there is no plan")
    error_km: list[float | None]
    late: list[bool]
    snr_db: list[float | None] | None = Field(description="Of a target, as are those up to `stale`.")
    p_d: list[float | None] | None = Field(description="In all dwells so far.")
    p_d_low: list[float | None] | None = Field(description="Of Wilson's 95 % interval.")
    p_d_high: list[float | None] | None
    floor_km: list[float | None] | None = Field(
        description="Cramer-Rao bound of the range; null until the data outweigh the prior."
    )
    stale: list[bool | None] | None
    existence: list[float | None] | None = Field(description="Of a track, as are those that follow.")
    confirmed: list[bool] | None
    follows: list[int | None] | None = Field(description="Its target.")


class Timeline(Document):
    """A whole run, as far as it is kept, in columns of at most 600 buckets of dwells."""

    run: str
    t: int = Field(description="The newest dwell.")
    oldest_t: int = Field(description="The oldest dwell that is kept of a run without an end; else 1.")
    width: int = Field(description="Dwells of a bucket.")
    first: list[int]
    last: list[int]
    detected: list[float | None] = Field(description="Share of the targets that are there; null: there is none.")
    lost: list[int | None] = Field(
        description="Tracks whose bin was not their target's in most of the last 20 dwells, or of a longer bucket's;"
        " in the last bucket always of the last 20 dwells."
    )
    late: list[int | None] = Field(description="Plans.")
    stale: list[int | None] = Field(description="Dwells.")
    error_km: list[float | None] = Field(
        description="The largest root mean square of any track; of all together where their number is unknown."
    )
    missed: list[float | None] = Field(
        description="Share of the targets without a track, and in place of `detected` and `lost`"
        " where the number of tracks is unknown."
    )
    swaps: list[int | None] = Field(description="Tracks that became another target's, where their number is unknown.")
    gospa_km: list[float | None] = Field(description="Root mean square, where the number of tracks is unknown.")


class Particles(Document):
    """At most 1500 particles of the belief about a target after a dwell, km; each as likely as the others.

    Of a track's belief, if one is asked for in place of a target.
    """

    run: str
    target: int | None
    track: int
    t: int
    x: list[float]
    y: list[float]


VIEWS: tuple[type[BaseModel], ...] = (Beampattern, DwellEvent, Dwells, Radar, Course, Timeline, Particles)
