"""How fast kernels and dwells are: named cases, medians of many repeats, and a fixed loop so that machines compare."""

import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import count
from statistics import median
from typing import Any

import numpy as np

from cogradar.services.analysis.tables import Column, Table
from cogradar.services.bench import dwell as bench_dwell
from cogradar.services.bench import inputs
from cogradar.services.bench.inputs import SEED, SIGMA_HAT
from cogradar.services.emulator.cycle import transmission
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.planning.pomcp import SearchSettings, search
from cogradar.shared.planning.radar_pomdp import problem_of
from cogradar.shared.planning.rules import chosen_bin
from cogradar.shared.planning.steering import directions
from cogradar.shared.power.curve import curve_of
from cogradar.shared.power.equal_antennas import allocate_equal
from cogradar.shared.power.joint import most_detections
from cogradar.shared.power.looks import detections
from cogradar.shared.power.max_min import allocate
from cogradar.shared.power.urgency import urgency
from cogradar.shared.power.wide import widened
from cogradar.shared.protocol.fields import MAX_CELLS
from cogradar.shared.protocol.messages import Plan
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.signal.array import angle_bin, bin_centres, spatial_frequency, steering_vector
from cogradar.shared.signal.detector.data_set import DataSet, Processing, wald_tests
from cogradar.shared.signal.looks import Look, range_cells
from cogradar.shared.signal.receiver import threshold, wald_test
from cogradar.shared.signal.waveform import Signatures, beam_factor
from cogradar.shared.tracking.assignment.shares import Assignment
from cogradar.shared.tracking.belief.likelihood import Likelihood, found_look, likelihood_of
from cogradar.shared.tracking.belief.particle_filter import predict, update
from cogradar.shared.tracking.belief.resampling import regularise, resample, weigh
from cogradar.shared.tracking.model import TrackerModel
from cogradar.shared.wire.codec import decode, encode
from cogradar.shared.world.array_scene import ArrayScene
from cogradar.shared.world.cell_scene import CellScene
from cogradar.shared.world.disturbance import draw
from cogradar.shared.world.scene import add_echo

STEERED = Processing(is_steered=True, monopulse=True)
N = 12_000  # particles
RUNS_MIN = 20  # repeats of a case, at least
SPEND_S = 1.0  # ... and for about so long
GOAL_LOOP_MS = 0.9  # of the reference loop, where the goals were set


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

    def loops(self, name: str) -> float:
        """The median of a case in units of the reference loop."""
        return self.cases[name].median_ms / self.reference_ms

    def as_json(self) -> dict[str, Any]:
        """The timings for `cogradar bench kernels --json` and `cogradar bench dwell --json`."""
        cases = {
            name: {"median_ms": round(t.median_ms, 4), "min_ms": round(t.min_ms, 4), "runs": t.runs}
            for name, t in self.cases.items()
        }
        return {"reference_ms": round(self.reference_ms, 4), "cases": cases}


def bench(names: Collection[str], report: Callable[[str], None] = lambda _: None) -> Report:
    """Time the named cases; `report` is told each before it starts."""
    reference, timings = _reference_times(), {}
    for name in names:
        report(name)
        timings[name] = Timing.of(CASES[name].measure())
        reference += _reference_times()
    return Report(median(reference), timings)


def _reference_times() -> list[float]:
    inputs.reference_loop(1)  # compiled
    return [_time(lambda: inputs.reference_loop(250_000)) for _ in range(5)]


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


def _pomcp_literal() -> list[float]:
    """A search as general solvers do it: all bins, random rollouts, 20 levels in all, nothing known of the problem."""
    model = TrackerModel.of(load("paper").radar, Strategy.POWER_AWARE, SEED)
    sensor = model.sensor._replace(amplitude_db=-12.0 + 40.0 * np.log10(60.47))  # -12 dB at the belief's middle
    problem = problem_of(inputs.particles(N), SIGMA_HAT, sensor, model.motion)
    settings = SearchSettings(n_sim=N, depth=20, rollout_depth=0, rollout_mean=False, gamma=0.95, ucb_c=2.0**0.5)
    actions = np.arange(100)
    return _repeat(lambda i: search(problem, actions, settings, generator(SEED, Purpose.SEARCH, 0, i)))


def _rule(name: str) -> list[float]:
    radar = load("paper", [f"radar.planner.rule={name}"]).radar
    model = TrackerModel.of(radar, Strategy.POWER_AWARE, SEED)
    problem = problem_of(inputs.particles(N), SIGMA_HAT, model.sensor, model.motion)
    return _repeat(lambda i: chosen_bin(problem, radar, generator(SEED, Purpose.SEARCH, 0, i)))


def _belief(filter_: str) -> list[float]:
    """One update after a detection with the amplitude that the middle of the belief has."""
    particles = inputs.particles(N)
    model = TrackerModel.of(load("paper", [f"radar.belief.filter={filter_}"]).radar, Strategy.POWER_AWARE, SEED)
    hit_bin = int(angle_bin(spatial_frequency(inputs.CENTRE), model.sensor.n_bin))
    nu, r = float(bin_centres(model.sensor.n_bin)[hit_bin]), inputs.expected_amplitude(model.sensor)
    hit = found_look(model.response, nu, SIGMA_HAT, model.sensor.threshold, r)
    return _repeat(lambda i: update(model, particles, hit, generator(SEED, Purpose.BELIEF, 0, i)))


def _predict() -> list[float]:
    """Of a target that may have begun to turn."""
    radar, particles = load("paper", ["radar.motion.modes=mixture"]).radar, inputs.particles(N)
    model = TrackerModel.of(radar, Strategy.POWER_AWARE, SEED)
    rngs = (generator(SEED, Purpose.BELIEF, 0, i) for i in count())
    return _repeat(lambda _: predict(model.motion, particles, next(rngs)))


def _likelihood(*, is_hit: bool) -> Likelihood:
    sensor = TrackerModel.of(load("paper-best").radar, Strategy.POWER_AWARE, SEED).sensor
    return likelihood_of(sensor, inputs.looks(sensor, is_hit=is_hit))


def _weigh_looks() -> list[float]:
    """After a hit beside a miss."""
    particles, likelihood = inputs.particles(N), _likelihood(is_hit=True)
    return _repeat(lambda _: weigh(particles, likelihood))


def _regularise_looks() -> list[float]:
    """After two misses: each particle's new place is weighed, too."""
    likelihood = _likelihood(is_hit=False)
    weighted = weigh(inputs.particles(N), likelihood)
    ancestors = resample(weighted, 0.5)
    rngs = (generator(SEED, Purpose.BELIEF, 0, i) for i in count())
    return _repeat(lambda _: regularise(weighted, ancestors, 0.2, likelihood, next(rngs)))


def _assign(n: int) -> list[float]:
    """Of a new scan each time: which detection each track has."""
    scan = inputs.crowd(n)

    def assign(_: int) -> None:
        assignment = Assignment(scan, inputs.RANGE_LOBE)
        for track in range(n):
            assignment.share(track)

    return _repeat(assign)


def _directions() -> list[float]:
    nus = spatial_frequency(inputs.particles(N))
    return _repeat(lambda _: directions(inputs.LOBE, nus, MAX_CELLS))


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


def _array_dwell() -> list[float]:
    """An acquisition dwell of the array's world: disturbance, all echoes, statistics, and what is reported of them."""
    scenario = load("paper", ["world.signal=array"])
    scene, sent = ArrayScene(scenario.simulated, scenario.radar, SEED, 0), transmission(scenario.radar, None)
    return _repeat(lambda i: scene.observe(i, sent.isotropic, sent.factor, sent.looks))


def _array_ranges() -> list[float]:
    """Disturbance and statistics of every range cell, as where interference is in all of them."""
    model, nus = load("paper").simulated.disturbance.model, bin_centres(100)
    signatures = Signatures(1.0, np.empty((100, 0), dtype=np.complex128), 100)

    def every_range(i: int) -> None:
        for cell in range(390):
            wald_tests(draw(model, 100 * 100, generator(SEED, Purpose.DISTURBANCE, cell << 16, i)), signatures, nus)

    return _repeat(every_range)


def _array_echoes() -> list[float]:
    """Echoes of -10 to 18 dB a channel found, and every bin tested beside them, its noise estimated from rows."""
    told_apart = Processing(is_steered=True, monopulse=False, by_rows=True, separates=True)
    nus, signatures = bin_centres(100), Signatures(100.0, np.empty((100, 0), np.complex128), 100)
    data = [inputs.echo(0.002, 0.0j, i) for i in range(8)]
    for y in data:
        for m in range(8):
            add_echo(y, 10.0 ** ((4.0 * m - 10.0) / 20.0), *signatures.at(0.118 * m - 0.42))
    return _repeat(lambda i: DataSet(data[i % 8], signatures, told_apart).tests(nus))


def _monopulse() -> list[float]:
    """Statistic and direction of one echo, a fifth of the lobe off the axis of its cell."""
    look, waveform = Look(0.0, 50, range(0), threshold(1e-4)), (1.0, np.empty((100, 0), np.complex128), 100)
    echoes = [inputs.echo(0.002, 0.6 + 0.8j, i) for i in range(8)]
    return _repeat(lambda i: DataSet(echoes[i % 8], Signatures(*waveform), STEERED).measure(look, 0.0))


def _sky_dwell() -> list[float]:
    """A dwell of a sky of 100 targets: they fly, each is lit and looked at, and its direction is measured."""
    scenario, nus = load("paper-best-range"), np.linspace(-0.45, 0.45, 100)
    target, array, radar = scenario.simulated.targets[0], scenario.radar.array, scenario.radar
    states = [[60.0 * np.sqrt(1.0 - 4.0 * nu * nu), 0.1, 120.0 * nu, 0.0] for nu in nus.tolist()]
    targets = [target.model_copy(update={"state": state}) for state in states]
    scene = CellScene(scenario.simulated.model_copy(update={"targets": targets}), radar, SEED, 0)
    width, bins = radar.receiver.range_cell_km, angle_bin(nus, array.n_bin).tolist()
    cells, limit = range_cells(59.0, 61.0, width), threshold(radar.detector.p_fa)
    looks = [Look(nu, bin_, cells, limit) for nu, bin_ in zip(nus.tolist(), bins, strict=True)]
    factor = beam_factor(nus, np.full(nus.size, array.power / nus.size), array.n_tx)

    def dwell(i: int) -> object:
        scene.prepare(i, ())
        return scene.observe(i, 0.0, factor, looks)

    return _repeat(dwell)


def _plan_message() -> list[float]:
    """A plan of a sky as it is made, sent, read and checked."""
    said: dict[str, Any] = {
        "run": "bench",
        "k": 1,
        "t": 1,
        "target": 7,
        "status": "tracking",
        "best_bin": 3,
        "worth": 0.2,
        "gain": 3.0,
        "bins": np.array([3], np.int32),
        "chances": np.array([0.9]),
        "range_km": 50.0,
        "nus": np.array([0.1]),
        "estimate": np.ones(4),
        "covariance": np.eye(4),
        "gate": np.array([40.0, 60.0]),
        "detected": True,
        "existence": 0.9,
        "confirmed": True,
        "in_doubt": False,
        "modes": np.array([0.8, 0.1, 0.1]),
    }
    return _repeat(lambda _: decode(encode(Plan(**said))))


def _allocate(n_target: int) -> list[float]:
    asked = [inputs.allocation_problem(n_target, i) for i in range(64)]
    return _repeat(lambda i: allocate(*asked[i % 64], power=1.0, n_tx=100))


def _allocate_equal() -> list[float]:
    asked = [inputs.allocation_problem(12, i) for i in range(64)]
    return _repeat(lambda i: allocate_equal(*asked[i % 64], power=1.0, n_tx=100))


def _joint(n_target: int) -> list[float]:
    asked, curve = [inputs.joint_problem(n_target, i) for i in range(64)], curve_of(threshold(1e-4))
    return _repeat(lambda i: most_detections(curve, *asked[i % 64], power=1.0))


def _urgency(n_target: int) -> list[float]:
    radar, asked = load("starved").radar, [inputs.requests(n_target, i) for i in range(64)]
    return _repeat(lambda i: urgency(radar, asked[i % 64]))


def _wide(n_target: int) -> list[float]:
    """What the further cells take, after cells and power of the tracks' own were chosen."""
    radar, asked = load("paper-best").radar, [inputs.requests(n_target, i, surplus=4.0) for i in range(64)]
    sent = [detections(radar, one._replace(reaches=np.zeros_like(one.reaches))) for one in asked]
    return _repeat(lambda i: widened(radar, asked[i % 64], sent[i % 64]))


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
    "belief_resample": Case("12 000 particles, resampled and regularised", 1.5, partial(_belief, "likelihood")),
    "belief_rejection": Case("12 000 particles, the paper's rejection", 5.0, partial(_belief, "published")),
    "predict_mixture": Case("12 000 particles one dwell later, some of them in turns", 0.6, _predict),
    "weigh_looks": Case("12 000 particles weighed, a hit beside a miss, steered", 0.36, _weigh_looks),
    "regularise_looks": Case("12 000 particles regularised after two misses, steered", 0.6, _regularise_looks),
    "assign_1000": Case("1000 detections assigned to 1000 tracks", 80.0, partial(_assign, 1000)),
    "directions": Case("up to three directions that cover most of 12 000 particles", 0.36, _directions),
    "cell": Case("disturbance, echo, statistic; 10^4 channels", 0.9, _cell),
    "array_dwell": Case("a data set of 10^4 channels, 100 bins tested from it", 2.0, _array_dwell),
    "array_ranges": Case("390 range cells, a data set each, 100 bins tested from it", 120.0, _array_ranges),
    "array_echoes": Case("8 echoes found in a data set, 100 bins tested beside them", None, _array_echoes),
    "monopulse": Case("statistic and direction of one detection; 10^4 channels", 0.36, _monopulse),
    "sky_dwell": Case("100 targets fly, a look at each; 10^4 channels", None, _sky_dwell),
    "plan_message": Case("a plan made, encoded, decoded", None, _plan_message),
    "allocate_3": Case("max-min power of 3 targets, gap below 1e-6", 1.0, partial(_allocate, 3)),
    "allocate_10": Case("max-min power of 10 targets, gap below 1e-6", 2.0, partial(_allocate, 10)),
    "allocate_30": Case("max-min power of 30 targets, gap below 1e-6", 10.0, partial(_allocate, 30)),
    "allocate_100": Case("max-min power of 100 targets, gap below 1e-6", 100.0, partial(_allocate, 100)),
    "allocate_equal_12": Case("max-min power of 12 targets, equal antennas", 100.0, _allocate_equal),
    "joint_3": Case("cells and power of 3 targets, most detections", 0.3, partial(_joint, 3)),
    "joint_12": Case("cells and power of 12 targets, most detections", 1.5, partial(_joint, 12)),
    "joint_100": Case("cells and power of 100 targets, most detections", 20.0, partial(_joint, 100)),
    "urgency_100": Case("cells and power of 100 targets, a few bright looks", 20.0, partial(_urgency, 100)),
    "wide_12": Case("looks of 12 targets widened", 0.36, partial(_wide, 12)),
    "scores": Case(
        "scores of a dwell of three targets, from a stored run",
        None,
        lambda: bench_dwell.scoring(bench_dwell.paper_run(), _repeat),
    ),
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
    """The timings beside their goals, and both in units of the reference loop, which are the same on every machine."""
    columns = (
        *(Column("case", "{case}", left=True), Column("median", "{median_ms:.3f}"), Column("least", "{min_ms:.3f}")),
        *(Column("goal", "{goal_ms:g}"), Column("in loops", "{loops:.3f}")),
        *(Column("goal in loops", "{goal_loops:.3f}"), Column("runs", "{runs}"), Column("", "{verdict}", left=True)),
    )
    rows = [_row(name, timing, report.reference_ms) for name, timing in report.cases.items()]
    over = frozenset(i for i, row in enumerate(rows) if row["verdict"])
    title = f"milliseconds; this machine's reference loop takes {report.reference_ms:.2f} ms"
    return Table(title, columns, rows, bold=over)


def _row(name: str, timing: Timing, reference_ms: float) -> dict[str, Any]:
    """A line of the table; a goal is missed if a case takes more reference loops than on the machine of the goals."""
    goal_ms, loops = CASES[name].goal_ms, timing.median_ms / reference_ms
    goal_loops = None if goal_ms is None else goal_ms / GOAL_LOOP_MS
    row = asdict(timing) | {"case": name, "goal_ms": goal_ms, "loops": loops, "goal_loops": goal_loops}
    return row | {"verdict": "" if goal_loops is None or loops <= goal_loops else "over"}


def remarks(report: Report) -> list[str]:
    """What the table has no column for: the problems, and what the transport adds to a dwell."""
    lines = [f"{name}: {CASES[name].what}" for name in report.cases]
    if {"dwell_in_process", "dwell_zenoh"} <= set(report.cases):
        added = report.cases["dwell_zenoh"].median_ms - report.cases["dwell_in_process"].median_ms
        lines.append(f"Zenoh and separate processes add {added:+.2f} ms to a dwell (goal: at most 2)")
    return lines
