"""What the radar is and what it assumes: the part of a scenario that planners and allocator are told.

Nothing in it depends on what nature does: the number of tracks is what the radar is told to look for, motion and echo
are its assumptions.
"""

from enum import StrEnum
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from cogradar.shared.scenario.limits import MAX_TRACKS
from cogradar.shared.scenario.plugins.kinds import BELIEF, OBJECTIVE, RULE
from cogradar.shared.scenario.plugins.names import OWN, PATTERN, Chosen, is_own
from cogradar.shared.scenario.section import Section
from cogradar.shared.scenario.tables import MODES, MOST_TRACKS, with_defaults


class Strategy(StrEnum):
    """How the transmit power is spread: the power rules that are built in; a user's own one becomes a member, too."""

    ORTHOGONAL = "orthogonal"
    UNIFORM = "uniform"
    POWER_AWARE = "power-aware"

    @classmethod
    def _missing_(cls, value: object) -> Self | None:
        if not isinstance(value, str) or not is_own(value):
            return None
        own = str.__new__(cls, value)
        own._name_ = own._value_ = value
        return own

    @classmethod
    def __get_pydantic_json_schema__(cls, *_: Any) -> dict[str, Any]:
        """What there is, and what a user's own name looks like."""
        own = {"type": "string", "pattern": PATTERN, "description": f"your own: {OWN}, with its hash"}
        return {"type": "string", "title": cls.__name__, "anyOf": [{"enum": list(cls)}, own]}


class ArraySection(Section):
    """Half-wavelength uniform linear arrays and the grid of angle bins."""

    n_tx: Annotated[int, Field(ge=2, le=512)]
    n_rx: Annotated[int, Field(ge=2, le=512)]
    n_bin: Annotated[int, Field(ge=3, le=1024)]
    power: Annotated[float, Field(ge=1e-6, le=1e6)]


class DetectorSection(Section):
    """The Wald-type test."""

    p_fa: Annotated[float, Field(ge=1e-9, le=0.1)]


class MotionSection(Section):
    """Motion of the targets, as the filter and the search assume it."""

    dt_s: Annotated[float, Field(gt=0, le=60)]
    sigma_s_km_s2: Annotated[float, Field(ge=0, le=1)]
    modes: Annotated[Literal["constant-velocity", "mixture"], Field(description=MODES)] = "constant-velocity"
    sigma_straight_km_s2: Annotated[
        float,
        Field(
            ge=0,
            le=1,
            description="what the Gaussian filter has in place of sigma_s_km_s2 while a target of a mixture flies"
            " straight; turns have their own accelerations",
        ),
    ] = 0.0005


class EchoSection(Section):
    """Radar equation, as the radar assumes it: 20 log10|alpha| = amplitude_db - 40 log10(R / km)."""

    amplitude_db: Annotated[float, Field(ge=-100, le=200)]


class AssumesSection(Section):
    """What the radar assumes of its targets."""

    rcs: Annotated[
        Literal["known", "mean", "unknown"],
        Field(
            description="of the radar cross section: a known constant; the mean of one that fluctuates; or nothing, so"
            " that an amplitude says nothing of the range"
        ),
    ]
    height_max_km: Annotated[
        float,
        Field(
            ge=0,
            le=100,
            description="targets are at heights from 0 to this: estimates are on the ground, with what that leaves"
            " unknown. A linear array does not measure the height",
        ),
    ]


class AcquisitionSection(Section):
    """From the first scan to the initial beliefs."""

    range_min_km: Annotated[float, Field(gt=0, le=10_000)]
    range_max_km: Annotated[float, Field(gt=0, le=10_000)]
    v_max_km_s: Annotated[float, Field(gt=0, le=10)]
    max_scans: Annotated[int, Field(ge=1, le=100_000)]

    @property
    def ranges_km(self) -> tuple[float, float]:
        """Where targets may be."""
        return self.range_min_km, self.range_max_km


class SearchSection(Section):
    """Where tracks of an unknown number are looked for, while those there are go on."""

    share: Annotated[
        Annotated[float, Field(gt=0, lt=1)] | Literal["auto"],
        Field(description="of the power; auto: what the tracks can spare, a tenth at least"),
    ]
    beams: Annotated[
        Annotated[int, Field(ge=1, le=1024)] | Literal["auto"],
        Field(description="directions that are searched in a dwell; auto: as many as the power of the search allows"),
    ]
    pattern: Annotated[
        Literal["swept", "isotropic"],
        Field(description="beams that go through all directions in turn; or power in all of them in every dwell"),
    ]


class InitiationSection(Section):
    """From a detection of the search to a track, which is tentative until it is confirmed."""

    false_tracks_per_hour: Annotated[
        float,
        Field(gt=0, description="confirmed where nothing is, expected; it sets what confirms a track"),
    ]


class BeliefSection(Section):
    """How a track keeps its belief; all but `filter` is of particles."""

    n_particle: Annotated[int, Field(ge=10, le=1_000_000)]
    max_tries: Annotated[int, Field(ge=1, le=10_000)]
    filter: Annotated[
        str,
        Chosen(BELIEF),
        Field(
            description="`published`: the paper's rejection with amplitudes in levels and the last sigma_hat, and its"
            " search over all bins with random rollouts. `likelihood`: the same posteriors and values with less"
            " variance. `gaussian`: one Gaussian for each mode of motion, where direction and range are measured. It is"
            " the default there if the number of tracks is unknown"
        ),
    ]
    kernel_bandwidth: Annotated[
        float, Field(ge=0, le=1, description="of the kernel after resampling, relative to the optimal one; 0: none")
    ]
    reacquire_below: Annotated[
        float,
        Field(
            ge=0,
            le=0.1,
            description="probability of the misses in a row that ends a belief; 0: never. Left out: 1e-4, but 0 of "
            '"paper" with single looks',
        ),
    ]


class PlannerSection(Section):
    """The action-selection policy, and the settings of POMCP."""

    rule: Annotated[
        str,
        Chosen(RULE),
        Field(description="by which a track chooses its next bin"),
    ]
    looks: Annotated[
        Literal["single", "joint"],
        Field(
            description="cells that a track asks for. `single`: one, by its rule. `joint`: its three most probable"
            " ones, without a rule; the allocation lights the ones that pay, for all tracks together. Left out with an"
            " objective that chooses among cells, it is `joint`"
        ),
    ]
    wide_looks: Annotated[
        bool,
        Field(
            description="power to spare lights cells beside the joint looks, and the more of them after a miss"
            " that is improbable: up to the whole grid; true if left out with joint looks"
        ),
    ]
    n_sim: Annotated[int, Field(ge=1, le=10_000_000)]
    depth: Annotated[int, Field(ge=1, le=100)]
    gamma: Annotated[float, Field(ge=0, lt=1)]
    ucb_c: Annotated[float, Field(ge=0, le=1000)]
    rollout_depth: Annotated[int, Field(ge=0, le=1000)]
    widen_bins: Annotated[int, Field(ge=0, le=100)]


class AllocationSection(Section):
    """What power-aware beams are to achieve, and how max-min is solved."""

    objective: Annotated[
        str,
        Chosen(OBJECTIVE),
        Field(
            description="of power-aware beams: most echo for the weakest track; most detections expected, which joint"
            " looks mean if it is left out; or a few bright looks, those that tell most of where targets will be",
        ),
    ]
    solver: Literal["barrier", "sdp"]
    antennas: Annotated[
        Literal["sum", "equal"],
        Field(description="what limits the power: its sum over all antennas, as published; or the same power in each"),
    ]
    beams: Annotated[
        Literal["optimal", "conventional"],
        Field(
            description="of max-min: any covariance, or a sum of conventional beams, whose antennas have equal powers."
            " Other objectives always have conventional beams"
        ),
    ]


class ReceiverSection(Section):
    """What the receiver tells echoes apart by."""

    cells: Annotated[
        Literal["bins", "steered"],
        Field(description="directions of the beams and of what is received: bins, or wherever a track is expected"),
    ]
    monopulse: Annotated[bool, Field(description="a detection measures its direction; steered cells only")]
    range_cell_km: Annotated[
        float, Field(ge=0, le=100, description="width of a range cell; 0: none; steered cells only")
    ]
    separation: Annotated[
        Literal["none", "joint"],
        Field(description="what other echoes in the data of a look are: noise, or told apart and fitted with its own"),
    ] = "none"
    noise: Annotated[
        Literal["lags", "rows", "range-cells"],
        Field(
            description="how the noise is estimated: by lags, as published; from transmit channels as clusters; or from"
            " other range cells of the dwell"
        ),
    ] = "lags"


class RadarConfig(Section):
    """The table `[radar]`."""

    tracks: Annotated[
        Annotated[int, Field(ge=1, le=MAX_TRACKS)] | Literal["unknown"],
        Field(description="number of targets M, known to the radar as in the paper; or unknown to it"),
    ]
    max_tracks: Annotated[
        int | None, Field(ge=1, le=MAX_TRACKS, description="most of an unknown number at once; 100 if it is left out")
    ] = None
    fidelity: Literal["paper", "robust", "best", "best-range"]
    array: ArraySection
    detector: DetectorSection
    receiver: ReceiverSection
    motion: MotionSection
    echo: EchoSection
    acquisition: AcquisitionSection
    belief: BeliefSection
    planner: PlannerSection
    allocation: AllocationSection
    assumes: AssumesSection
    search: SearchSection | None = None  # None: the number of tracks is known
    initiation: InitiationSection | None = None

    @property
    def is_unknown(self) -> bool:
        """Whether the radar is not told how many targets there are."""
        return self.tracks == "unknown"

    @property
    def announced(self) -> int:
        """Number of tracks that the radar is told of; 0: their number is unknown."""
        return 0 if self.tracks == "unknown" else self.tracks

    @property
    def most_tracks(self) -> int:
        """As many as there are, or as there may be at once."""
        return (self.max_tracks or MOST_TRACKS) if self.tracks == "unknown" else self.tracks

    @model_validator(mode="before")
    @classmethod
    def _fill(cls, data: Any) -> Any:
        return with_defaults(data) if isinstance(data, dict) else data
