"""How fast the parts are: named cases, medians of many repeats, and a fixed loop so that machines compare."""

import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.analysis.tables import Column, Table
from services.bench import dwell as bench_dwell
from shared.numerics.jit import kernel
from shared.numerics.seeds import Purpose, generator
from shared.planning.pomcp import SearchSettings, search
from shared.planning.radar_pomdp import problem_of
from shared.planning.rules import chosen_bin
from shared.power.curve import curve_of
from shared.power.joint import most_detections
from shared.power.max_min import allocate
from shared.scenario.files import load
from shared.scenario.radar_config import Strategy
from shared.signal.array import bin_centres, spatial_frequency, steering_vector
from shared.signal.radar_equation import amplitude
from shared.signal.receiver import threshold, wald_test
from shared.tracking.model import TrackerModel
from shared.tracking.particle_filter import update
from shared.tracking.sensor import Observation
from shared.world.disturbance import draw
from shared.world.scene import add_echo

SEED = 1
RUNS_MIN = 20  # repeats of a case, at least
SPEND_S = 1.0  # ... and for about so long

# The belief that all searched: target 2 near its start, R = 60.47 km; mean and standard deviation.
_CENTRE, _SPREAD = (60.0, 0.2, 7.5, 0.1), (0.5, 0.1, 0.5, 0.1)  # km, km/s
SIGMA_HAT = 3333.0**-0.5  # its echo with a third of the power: ||v||^2 = 10^4 / 3


@dataclass(frozen=True)
class Case:
    """One thing to time: `measure` gives the time of each repeat in ms."""

    what: str
    goal_ms: float | None  # on one core of the machine that the goals were set on
    measure: Callable[[], list[float]]


@dataclass(frozen=True)
class Timing:
    """What a case took."""

    median_ms: float
    min_ms: float
    runs: int

    @classmethod
    def of(cls, times_ms: Sequence[float]) -> "Timing":
        """Summary of the repeats."""
        return cls(median(times_ms), min(times_ms), len(times_ms))


@dataclass(frozen=True)
class Report:
    """Timings of the cases and of the reference loop that ran before, between and after them."""

    reference_ms: float
    cases: dict[str, Timing]

    def as_json(self) -> dict[str, Any]:
        """The object that `cogradar bench --json` prints."""
        cases = {
            name: {"median_ms": round(t.median_ms, 4), "min_ms": round(t.min_ms, 4), "runs": t.runs}
            for name, t in self.cases.items()
        }
        return {"reference_ms": round(self.reference_ms, 4), "cases": cases}


def bench(names: Collection[str] = (), report: Callable[[str], None] = lambda _: None) -> Report:
    """Time the named cases, all of them if none is named; `report` is told each before it starts."""
    reference, timings = _reference_times(), {}
    for name in names or CASES:
        report(name)
        timings[name] = Timing.of(CASES[name].measure())
        reference += _reference_times()
    return Report(median(reference), timings)


@kernel
def reference_loop(n: int) -> float:
    """What a core does in a search, without one: n steps of integer mixing, a logarithm, a root, a table look-up."""
    table = np.zeros(1 << 12)
    state, total = 88172645463325252, 0.0
    for _ in range(n):
        state ^= (state << 13) & 0x7FFFFFFFFFFFFFFF
        state ^= state >> 7
        state ^= (state << 17) & 0x7FFFFFFFFFFFFFFF
        slot = state & 4095
        table[slot] += np.sqrt(np.log(2.0 + (state & 1023)))
        total += table[slot]
    return total


def _reference_times() -> list[float]:
    reference_loop(1)  # compiled
    return [_time(lambda: reference_loop(250_000)) for _ in range(5)]


def _repeat(action: Callable[[int], object]) -> list[float]:
    """Times of `action(i)` in ms, after one that is not counted: RUNS_MIN of them, more within SPEND_S."""
    action(0)
    times: list[float] = []
    end = time.perf_counter() + SPEND_S
    while len(times) < RUNS_MIN or time.perf_counter() < end:
        times.append(_time(partial(action, len(times) + 1)))
    return times


def _time(action: Callable[[], object]) -> float:
    began = time.perf_counter()
    action()
    return 1e3 * (time.perf_counter() - began)


def _particles(n: int) -> NDArray[np.float64]:
    rng = generator(SEED, Purpose.INITIATION, 0, 0)
    return np.asarray(np.array(_CENTRE) + np.array(_SPREAD) * rng.standard_normal((n, 4)))


def _pomcp_literal() -> list[float]:
    """The search of the paper: all bins, random rollouts, 20 levels in all, nothing known of the problem used."""
    model = TrackerModel.of(load("paper").radar, Strategy.POWER_AWARE, SEED)
    sensor = model.sensor._replace(amplitude_db=-12.0 + 40.0 * np.log10(60.47))  # -12 dB at the belief's middle
    problem = problem_of(_particles(12_000), SIGMA_HAT, sensor, model.motion)
    settings = SearchSettings(n_sim=12_000, depth=20, rollout_depth=0, rollout_mean=False, gamma=0.95, ucb_c=2.0**0.5)
    actions = np.arange(100)
    return _repeat(lambda i: search(problem, actions, settings, generator(SEED, Purpose.SEARCH, 0, i)))


def _rule(name: str) -> list[float]:
    paper, particles = load("paper"), _particles(12_000)
    model = TrackerModel.of(paper.radar, Strategy.POWER_AWARE, SEED)
    problem = problem_of(particles, SIGMA_HAT, model.sensor, model.motion)
    planner = paper.radar.planner.model_copy(update={"rule": name})
    return _repeat(lambda i: chosen_bin(problem, planner, generator(SEED, Purpose.SEARCH, 0, i)))


def _belief(method: str) -> list[float]:
    """One update after a detection with the amplitude that the middle of the belief has."""
    paper, particles = load("paper"), _particles(12_000)
    amplitude_read = "levels" if method == "rejection" else "exact"
    belief = paper.radar.belief.model_copy(update={"update": method, "amplitude": amplitude_read})
    model = TrackerModel.of(paper.radar.model_copy(update={"belief": belief}), Strategy.POWER_AWARE, SEED)
    centre, sensor = np.array(_CENTRE), model.sensor
    hit_bin = int(np.argmin(np.abs(bin_centres(sensor.n_bin) - spatial_frequency(centre))))
    r = float(amplitude(sensor.amplitude / SIGMA_HAT, centre[0] ** 2 + centre[2] ** 2))
    sigma = np.zeros(sensor.n_bin)
    sigma[hit_bin] = SIGMA_HAT
    hit = Observation(hit_bin, r, sigma)
    return _repeat(lambda i: update(model, particles, hit, generator(SEED, Purpose.BELIEF, 0, i)))


def _cell() -> list[float]:
    """Disturbance, echo and statistic of one cell: 100 x 100 channels."""
    paper = load("paper")
    nu = float(bin_centres(paper.radar.array.n_bin)[56])
    u, a_rx = steering_vector(nu, paper.radar.array.n_tx) / 10.0, steering_vector(nu, paper.radar.array.n_rx)

    def cell(i: int) -> object:
        y = draw(paper.simulated.disturbance.model, u.size * a_rx.size, generator(SEED, Purpose.DISTURBANCE, 56, i))
        add_echo(y, 0.1 + 0.2j, u, a_rx)
        return wald_test(y, u, a_rx)

    return _repeat(cell)


def allocation_problem(n_target: int, i: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Spatial frequencies and weights 1/R^4 of the i-th problem: distinct bins of 100, ranges of 10 to 100 km."""
    rng = generator(SEED, Purpose.INITIATION, n_target, i)
    nus = bin_centres(100)[np.sort(rng.choice(100, n_target, replace=False))]
    return nus, rng.uniform(10.0, 100.0, n_target) ** -4.0


def _allocate(n_target: int) -> list[float]:
    problems = [allocation_problem(n_target, i) for i in range(64)]
    return _repeat(lambda i: allocate(*problems[i % 64], power=1.0, n_tx=100))


def joint_problem(n_target: int, i: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Chances and gains of the i-th problem: three cells for each target, ranges of 40 to 100 km, no cell too dear."""
    rng = generator(SEED, Purpose.INITIATION, n_target, i)
    chances = rng.dirichlet((4.0, 1.0, 0.5), n_target)
    gains = 2e10 * n_target / 3.0 * rng.uniform(40.0, 100.0, n_target) ** -4.0
    return chances.ravel(), np.repeat(gains, 3)


def _joint(n_target: int) -> list[float]:
    problems, curve = [joint_problem(n_target, i) for i in range(64)], curve_of(threshold(1e-4))
    return _repeat(lambda i: most_detections(curve, *problems[i % 64], power=1.0))


CASES = {
    "pomcp_literal": Case(
        "12 000 simulations, all 100 actions, random rollouts, 20 deep",
        12.0,
        _pomcp_literal,
    ),
    "pomcp": Case("12 000 simulations, belief's actions, exact rollout mean", 2.5, partial(_rule, "pomcp")),
    "exact": Case("depth-2 value of every bin, 12 000 particles, all levels", 0.15, partial(_rule, "exact")),
    "mode": Case("most probable bin, 12 000 particles", 0.05, partial(_rule, "mode")),
    "mean": Case("bin of the mean, 12 000 particles", None, partial(_rule, "mean")),
    "belief_resample": Case("12 000 particles, resampled and regularised", 1.5, partial(_belief, "resample")),
    "belief_rejection": Case("12 000 particles, the paper's rejection", 5.0, partial(_belief, "rejection")),
    "cell": Case("disturbance, echo, statistic; 10^4 channels", 0.9, _cell),
    "allocate_3": Case("max-min power of 3 targets, gap below 1e-6", 1.0, partial(_allocate, 3)),
    "allocate_10": Case("max-min power of 10 targets, gap below 1e-6", 2.0, partial(_allocate, 10)),
    "allocate_30": Case("max-min power of 30 targets, gap below 1e-6", 10.0, partial(_allocate, 30)),
    "allocate_100": Case("max-min power of 100 targets, gap below 1e-6", 100.0, partial(_allocate, 100)),
    "joint_3": Case("cells and power of 3 targets, most detections", 0.3, partial(_joint, 3)),
    "joint_12": Case("cells and power of 12 targets, most detections", 1.5, partial(_joint, 12)),
    "joint_100": Case("cells and power of 100 targets, most detections", 20.0, partial(_joint, 100)),
    "dwell_in_process": Case(
        "a whole dwell of three targets, one process", None, lambda: bench_dwell.in_one_process(bench_dwell.paper_run())
    ),
    "dwell_zenoh": Case(
        "a whole dwell of three targets, a process per role over Zenoh: at most 2 ms more",
        None,
        lambda: bench_dwell.over_zenoh(bench_dwell.paper_run()),
    ),
}


def table(report: Report) -> Table:
    """The timings beside their goals, and in units of the reference loop, which are the same on every machine."""
    columns = (
        *(Column("case", "{case}", left=True), Column("median", "{median_ms:.3f}"), Column("least", "{min_ms:.3f}")),
        *(Column("goal", "{goal_ms:g}"), Column("in loops", "{loops:.3f}"), Column("runs", "{runs}")),
    )
    rows = [
        asdict(timing) | {"case": name, "goal_ms": CASES[name].goal_ms, "loops": timing.median_ms / report.reference_ms}
        for name, timing in report.cases.items()
    ]
    return Table(f"milliseconds; this machine's reference loop takes {report.reference_ms:.2f} ms", columns, rows)


def remarks(report: Report) -> list[str]:
    """What the table has no column for: the problems, and what the transport adds to a dwell."""
    lines = [f"{name}: {CASES[name].what}" for name in report.cases]
    if {"dwell_in_process", "dwell_zenoh"} <= set(report.cases):
        added = report.cases["dwell_zenoh"].median_ms - report.cases["dwell_in_process"].median_ms
        lines.append(f"Zenoh and separate processes add {added:+.2f} ms to a dwell (goal: at most 2)")
    return lines
