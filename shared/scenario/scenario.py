"""Scenario files: everything that defines a run except its seed and strategy, checked when they are read."""

import errno
import tomllib
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from shared.scenario.faults import explain, explain_all, printable
from shared.signal.array import angle_bin, spatial_frequency

SCENARIO_DIR = Path(__file__).resolve().parents[2] / "deploy" / "scenarios"
MAX_FILE_BYTES = 1 << 20
MAX_POSITION_KM, MAX_SPEED_KM_S = 10_000.0, 10.0  # per axis, of a target's state
MAX_PLANNER_BYTES = 2 * 10**9  # of one search tree, and of the beliefs of a planner that holds every track

# What `fidelity` means for the keys that a scenario leaves out. "paper" is the published algorithm to the letter;
# "robust" has this project's cures for lost tracks (docs/adr/0003-robust-belief.md, 0006-reacquisition.md).
FIDELITY: dict[str, dict[str, dict[str, Any]]] = {
    "paper": {
        "acquisition": {"confirmations": 1},
        "belief": {
            "update": "rejection",
            "kernel_bandwidth": 0.0,
            "noise_memory": "sigma_hat",
            "reacquire_below": 0.0,
        },
        "planner": {"rollout": "random"},
    },
    "robust": {
        "acquisition": {"confirmations": 2},
        "belief": {
            "update": "resample",
            "kernel_bandwidth": 0.3,
            "noise_memory": "level",
            "reacquire_below": 1e-4,
        },
        "planner": {"rollout": "mean"},
    },
}


class Strategy(StrEnum):
    """How the transmit power is spread; the three strategies of the paper."""

    ORTHOGONAL = "orthogonal"
    UNIFORM = "uniform"
    POWER_AWARE = "power-aware"


class ScenarioError(ValueError):
    """A scenario file that cannot be used; the text is one line: file, key, value, allowed.

    `faults` has such a line for each thing that is wrong.
    """

    def __init__(self, text: str, faults: Sequence[str] = ()) -> None:
        super().__init__(text)
        self.faults = tuple(faults) or (text,)


class Section(BaseModel):
    """A table of the scenario file: immutable, no unknown keys, no silent conversion."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class ArraySection(Section):
    """Half-wavelength uniform linear arrays and the grid of angle bins."""

    n_tx: Annotated[int, Field(ge=2, le=512)]
    n_rx: Annotated[int, Field(ge=2, le=512)]
    n_bin: Annotated[int, Field(ge=3, le=1024)]
    power: Annotated[float, Field(gt=0, le=1e6)]


class DisturbanceSection(Section):
    """Which disturbance the world draws; the radar never reads this."""

    model: Literal["ar6-t", "ar3-t", "compound-ar6", "white"]


class DetectorSection(Section):
    """The Wald-type test."""

    p_fa: Annotated[float, Field(ge=1e-9, le=0.1)]


class MotionSection(Section):
    """Nearly constant velocity."""

    dt_s: Annotated[float, Field(gt=0, le=60)]
    sigma_s_km_s2: Annotated[float, Field(ge=0, le=1)]


class EchoSection(Section):
    """Radar equation: 20 log10|alpha| = amplitude_db - 40 log10(R / km)."""

    amplitude_db: Annotated[float, Field(ge=-100, le=200)]


class AcquisitionSection(Section):
    """From the first scan to the initial beliefs."""

    range_min_km: Annotated[float, Field(gt=0, le=10_000)]
    range_max_km: Annotated[float, Field(gt=0, le=10_000)]
    v_max_km_s: Annotated[float, Field(gt=0, le=10)]
    max_scans: Annotated[int, Field(ge=1, le=100_000)]
    confirmations: Annotated[int, Field(ge=1, le=10)]

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.range_max_km <= self.range_min_km:
            low, high = self.range_min_km, self.range_max_km
            raise ValueError(f"range_max_km = {high:g} must be above range_min_km = {low:g}")
        return self


class BeliefSection(Section):
    """The unweighted particle filter."""

    n_particle: Annotated[int, Field(ge=10, le=1_000_000)]
    max_tries: Annotated[int, Field(ge=1, le=10_000)]
    update: Literal["resample", "rejection"]
    kernel_bandwidth: Annotated[float, Field(ge=0, le=1)]
    noise_memory: Literal["level", "sigma_hat"]
    reacquire_below: Annotated[float, Field(ge=0, le=0.1)]  # probability of the misses in a row; 0: never


class PlannerSection(Section):
    """POMCP."""

    n_sim: Annotated[int, Field(ge=1, le=10_000_000)]
    depth: Annotated[int, Field(ge=1, le=100)]
    gamma: Annotated[float, Field(ge=0, lt=1)]
    ucb_c: Annotated[float, Field(ge=0, le=1000)]
    rollout_depth: Annotated[int, Field(ge=0, le=1000)]
    rollout: Literal["mean", "random"]
    actions: Literal["belief", "all"]
    widen_bins: Annotated[int, Field(ge=0, le=100)]


class AllocationSection(Section):
    """The max-min power allocation."""

    solver: Literal["barrier", "sdp"]


class TargetSection(Section):
    """One aircraft at t = 0."""

    state: Annotated[list[float], Field(min_length=4, max_length=4)]

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


class Scenario(Section):
    """A whole scenario file."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9-]{0,19}$")]
    title: Annotated[str, Field(max_length=200)]
    dwells: Annotated[int, Field(ge=1, le=1_000_000)]
    fidelity: Literal["paper", "robust"]
    array: ArraySection
    disturbance: DisturbanceSection
    detector: DetectorSection
    motion: MotionSection
    echo: EchoSection
    acquisition: AcquisitionSection
    belief: BeliefSection
    planner: PlannerSection
    allocation: AllocationSection
    targets: Annotated[list[TargetSection], Field(min_length=1, max_length=100)]

    @property
    def n_target(self) -> int:
        """Number of targets, known to the radar as in the paper."""
        return len(self.targets)

    def initial_states(self) -> np.ndarray:
        """Start states [x, vx, y, vy], (n_target, 4), km and km/s."""
        return np.array([target.state for target in self.targets], dtype=np.float64)

    @model_validator(mode="before")
    @classmethod
    def _fill_from_fidelity(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        filled, fidelity = dict(data), data.get("fidelity")
        known = fidelity if isinstance(fidelity, str) and fidelity in FIDELITY else "robust"  # else: one error, not six
        for section, defaults in FIDELITY[known].items():
            given = filled.get(section)
            if isinstance(given, dict):
                filled[section] = defaults | given
        return filled

    @model_validator(mode="after")
    def _one_target_per_bin(self) -> Self:
        bins = angle_bin(spatial_frequency(self.initial_states()), self.array.n_bin)
        for m, bin_ in enumerate(bins):
            earlier = np.flatnonzero(bins[:m] == bin_)
            if earlier.size:
                pair, n_bin = f"#{earlier[0] + 1} and #{m + 1}", self.array.n_bin
                raise ValueError(f"targets {pair} start in the same angle bin {bin_} of {n_bin}, must start in two")
        return self

    @model_validator(mode="after")
    def _fits_into_memory(self) -> Self:
        n_sim, n_bin, n_particle = self.planner.n_sim, self.array.n_bin, self.belief.n_particle
        tree, beliefs = tree_bytes(n_sim, n_bin), beliefs_bytes(n_particle, self.n_target)
        if tree + beliefs > MAX_PLANNER_BYTES:
            raise ValueError(
                f"a planner would need {tree / 1e9:.2f} GB for its search tree (planner.n_sim = {n_sim},"
                f" array.n_bin = {n_bin}) and {beliefs / 1e9:.2f} GB for the beliefs (belief.n_particle = {n_particle},"
                f" {self.n_target} targets), must be at most {MAX_PLANNER_BYTES / 1e9:g} GB together"
            )
        return self


def tree_bytes(n_sim: int, n_action: int) -> int:
    """Most that a search of so many simulations and actions allocates, whatever its depth.

    Per simulation a node, a block of edges of 12 bytes each, a root of a visit count, and two to four slots of the hash
    table, a power of two. There is one tree at a time: it is dropped with the decision.
    """
    n_slot = 1 << max(4, (2 * n_sim + 1).bit_length())
    return n_sim * (48 + 12 * n_action) + 32 + 8 * n_action + 24 + 12 * n_slot


def beliefs_bytes(n_particle: int, n_target: int) -> int:
    """Most that the beliefs of all targets take, and an update's work.

    Three per track: now, at its last detection, and as it will be before the next scan.
    """
    return 32 * n_particle * (3 * n_target + 8)


def load(name_or_path: str) -> Scenario:
    """Read and check a scenario: a name under deploy/scenarios, or the path of a TOML file.

    Raises ScenarioError with a one-line text that names the file, the key, the value and what is allowed.
    """
    path = Path(name_or_path)
    if path.suffix != ".toml":
        path = SCENARIO_DIR / f"{name_or_path}.toml"
    try:
        document = tomllib.loads(_text(path))
    except FileNotFoundError:
        known = ", ".join(sorted(p.stem for p in SCENARIO_DIR.glob("*.toml")))
        text = f"{name_or_path}: no such scenario or .toml file; the built-in ones are: {known}"
        raise ScenarioError(printable(text)) from None
    except OSError as error:
        raise ScenarioError(printable(f"{path}: {error.strerror}")) from None
    except RecursionError:
        raise ScenarioError(printable(f"{path}: not valid TOML: nested too deeply")) from None
    except ValueError as error:  # also of decoding, and of integers with thousands of digits
        raise ScenarioError(printable(f"{path}: not valid TOML: {error}")) from None
    return parse(document, source=str(path))


def parse(document: dict[str, Any], source: str) -> Scenario:
    """Check a decoded scenario; `source` is named in the error."""
    try:
        return Scenario.model_validate(document)
    except ValidationError as error:
        faults = [printable(f"{source}: {fault}") for fault in explain_all(error, Scenario)]
        raise ScenarioError(printable(f"{source}: {explain(error, Scenario)}"), faults) from None


def _text(path: Path) -> str:
    if not path.is_file():
        raise OSError(errno.EINVAL, "not a regular file") if path.exists() else FileNotFoundError
    if path.stat().st_size > MAX_FILE_BYTES:
        raise OSError(errno.EFBIG, f"larger than {MAX_FILE_BYTES} bytes, too large for a scenario")
    return path.read_text(encoding="utf-8")
