"""How much a scenario may ask for, and how much memory and time it asks of a planner."""

from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field, PlainSerializer, ValidatorFunctionWrapHandler, WithJsonSchema, WrapValidator

if TYPE_CHECKING:
    from cogradar.shared.scenario.radar_config import BeliefSection, RadarConfig

MAX_DWELLS = 1_000_000  # of a run with an end, whose every dwell is kept
# Dwells of a run without an end: the last one that a clock can count, after 6.8 years at 10 Hz. As a number it needs no
# case where a dwell is compared with the last one.
NO_END = 2**31 - 1
UNLIMITED = "unlimited"  # ... as people read and write it
MAX_PLANNER_BYTES = 2 * 10**9  # of one search tree, and of the beliefs of a planner that owns every track
MAX_TRACKS = 1000  # of a run at once
MAX_TARGETS = 2 * MAX_TRACKS  # of a world: some come when others have gone
MAX_MESSAGE_BYTES = 4 << 20
MAX_CELLS = 3  # that a track asks for: a target near a border is in one of two, or its belief is spread
_ROW_BYTES = 256  # of a track in a waveform, beside what its beams need in the factor
MAX_ROWS = 100_000  # of all trajectories of a world, which travel in one message
MAX_TURNS = 3000  # of all targets of a world: each takes some microseconds to check
MAX_POSITION_KM = 10_000.0  # per axis, of a target
MAX_HEIGHT_KM = 100.0  # of a target
MAX_TIME_S = 1e6  # of a trajectory
MIN_ROWS = 2  # of one
ALERTS = 0.25  # detections of noise in the search, per dwell: more false tracks than these cannot be asked for
SECONDS_PER_HOUR = 3600.0
CONTAINER_BYTES = 512 * 2**20  # of a container, in docker-compose.yml and in deploy/kubernetes
MIXTURE_STATES = 512  # that stand for a belief of Gaussians where states are asked for
MOST_STATES, MOST_NUMBERS = 50_000, 200_000  # of a belief of a user's own: states that stand for it; its numbers
FAR = 1e9  # km and km/s: beyond any target, yet small enough to extrapolate; and of a number of such a belief
PROCESS_BYTES = 190 * 2**20  # of a planner without any track: the interpreter, its libraries, compiled kernels


def said_dwells(dwells: int) -> int | str:
    """A number of dwells as people read it."""
    return UNLIMITED if dwells == NO_END else dwells


def _counted(value: Any, check: ValidatorFunctionWrapHandler) -> Any:
    return NO_END if value == UNLIMITED else check(value)


_FINITE = {"type": "integer", "minimum": 1, "maximum": MAX_DWELLS}
Dwells = Annotated[
    int,
    Field(ge=1, le=MAX_DWELLS),
    WrapValidator(_counted),
    PlainSerializer(said_dwells),
    WithJsonSchema({"anyOf": [_FINITE, {"type": "string", "const": UNLIMITED}]}),
]


def tree_bytes(n_sim: int, n_action: int) -> int:
    """Most that a search of so many simulations and actions allocates, whatever its depth.

    Per simulation a node, a block of edges of 12 bytes each, a root of a visit count, and two to four slots of the hash
    table, a power of two. There is one tree at a time: it is dropped with the decision.
    """
    n_slot = 1 << max(4, (2 * n_sim + 1).bit_length())
    return n_sim * (48 + 12 * n_action) + 32 + 8 * n_action + 24 + 12 * n_slot


def n_state(belief: "BeliefSection") -> int:
    """Number of states that stand for a belief."""
    return MIXTURE_STATES if belief.filter == "gaussian" else belief.n_particle


def beliefs_bytes(n_state: int, n_target: int) -> int:
    """Most that the beliefs of all targets take, of so many states each, and an update's work.

    Three per track: now, at its last detection, and as it will be before the next scan.
    """
    return 32 * n_state * (3 * n_target + 8)


def waveform_bytes(n_tx: int, n_column: int, n_track: int) -> int:
    """Most that a waveform of so many tracks takes whose factor has these columns, one for each direction."""
    return 8 * n_tx * n_column + _ROW_BYTES * n_track


def dwell_s(radar: "RadarConfig") -> float:
    """About how long a dwell takes with one planner, from what `cogradar bench` shows of the paper's sizes, s."""
    simulation = 1e-6 if radar.belief.filter == "published" else 2e-7
    array, belief, planner = radar.array, radar.belief, radar.planner
    track = planner.n_sim * simulation + n_state(belief) * 1.5e-7 + array.n_tx * array.n_rx * 2e-8
    return 2e-3 + radar.most_tracks * track
