"""Does this installation compute what theory says? Each check: what is expected, in which interval, and what came out.

Seeds are fixed, so that a check says the same today and tomorrow. Intervals of random quantities hold 99.99 % of what a
correct program gives over all seeds; where the theory is of infinitely many channels, the expected value is that of the
finite array (`cogradar.shared.scoring.finite_size`).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtr, chdtri, gammaincinv, ncfdtr, ndtri

from cogradar.services.allocator.track_update import unchanged
from cogradar.services.allocator.waveform import waveform
from cogradar.services.analysis.tables import Column, Table
from cogradar.services.emulator.core import EmulatorCore
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.services.planner.decision import Decision, decide
from cogradar.services.planner.owned_track import detections_of
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.power.max_min import allocate, dual_bound, kkt_residuals
from cogradar.shared.protocol.messages import EmulatorCheckpoint, Message, Plan, Scan, Truth
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scoring.finite_size import FiniteSize, finite_size
from cogradar.shared.scoring.matching import associate
from cogradar.shared.signal.array import bin_centres, steering_vector
from cogradar.shared.signal.detector.data_set import DataSet, Processing
from cogradar.shared.signal.detector.levels import MOST_REFERENCES
from cogradar.shared.signal.detector.reception import receive
from cogradar.shared.signal.looks import Look
from cogradar.shared.signal.receiver import threshold, wald_test
from cogradar.shared.signal.waveform import Signatures
from cogradar.shared.tracking.model import TrackerModel, TrackState
from cogradar.shared.tracking.track import Acquisition, observe, start
from cogradar.shared.world.disturbance import draw
from cogradar.shared.world.scene import add_echo

SEED = 20  # of everything below
TAIL = 0.5e-4  # on either side of an interval

N_VECTOR = 1500  # disturbances, seen in all bins each
P_FA = 1e-2
ZETAS = (10.0, 16.0, 24.0)  # noncentralities, P_D = 0.16, 0.43, 0.76
RECEIVERS = ((20, 32), (48, 16))  # arrays on which receivers are checked that tell echoes apart
STRONG_DB = (0.0, 20.0)  # amplitudes of three echoes in each of their data sets, in an element
N_TARGETS = (3, 10, 30)  # of the allocation problems, ten of each
GAP = 1e-6
# |alpha|^2 over its mean by the law of the RCS, and weights: quantiles of gamma distributions by Gauss's rule.
_X, _W = np.polynomial.legendre.leggauss(48)
_POWERS = {"constant": (np.ones(1), np.ones(1))}
_POWERS |= {f"swerling{2 * k - 1}": (gammaincinv(k, 0.5 + 0.5 * _X) / k, 0.5 * _W) for k in (1, 2)}
TOLD_APART = Processing(is_steered=True, monopulse=False, by_rows=True, separates=True)
BY_RANGE = Processing(is_steered=True, monopulse=False, by_rows=True, by_range=True)
BY_RANGE_ARRAY = (16, 24)  # on which noise from other range cells is checked
LINE_DB, TEXTURE = 20.0, 2.0  # a line beside white noise, in an element; shape of the inverse gamma texture of both
N_RUN, N_DWELL = 12, 25  # of the consistency check


@dataclass(frozen=True)
class Check:
    """One quantity against theory."""

    name: str
    expected: float
    low: float
    high: float
    measured: float

    @property
    def passed(self) -> bool:
        """Whether the measured value lies in the interval."""
        return self.low <= self.measured <= self.high

    def as_json(self) -> dict[str, Any]:
        """One row of `cogradar verify --json`."""
        row = {"name": self.name, "expected": self.expected, "low": self.low, "high": self.high}
        return row | {"measured": self.measured, "passed": self.passed}


class EmptyCells(NamedTuple):
    """What the receiver says of cells without a target, and what is expected of it."""

    alpha_hat: NDArray[np.complex128]  # (N_VECTOR, n_bin)
    sigma_hat: NDArray[np.float64]  # (N_VECTOR, n_bin)
    signature_power: float  # ||v||^2
    theory: list[FiniteSize]  # of each bin


def verify(report: Callable[[str], None] = lambda _: None) -> list[Check]:
    """All checks, of the paper's array and disturbance; `report` is told what begins."""
    paper = load("paper")
    report("1 of 5: cells without a target")
    cells = empty_cells(paper)
    checks = [*false_alarms(cells), *detection(paper, cells), *spectrum(cells)]
    report("2 of 5: receivers that tell echoes apart")
    checks += receivers()
    report("3 of 5: noise from range cells")
    checks += noise_from_range_cells()
    report("4 of 5: power allocation")
    checks += allocation(paper)
    report("5 of 5: beliefs")
    return [*checks, *consistency(paper)]


def empty_cells(scenario: Scenario) -> EmptyCells:
    """What the receiver says of disturbances alone, in every bin, with the orthogonal waveform."""
    array, model = scenario.radar.array, scenario.simulated.disturbance.model
    pairs = [_orthogonal_signature(scenario, float(nu)) for nu in bin_centres(array.n_bin)]
    alpha_hat = np.empty((N_VECTOR, array.n_bin), dtype=np.complex128)
    sigma_hat = np.empty((N_VECTOR, array.n_bin))
    for k in range(N_VECTOR):
        c = draw(model, array.n_tx * array.n_rx, generator(SEED, Purpose.DISTURBANCE, -1, k))
        for b, (u, a_rx) in enumerate(pairs):
            cell = wald_test(c, u, a_rx)
            alpha_hat[k, b], sigma_hat[k, b] = cell.alpha_hat, cell.sigma_hat
    theory = [
        finite_size(model, float(nu), np.kron(*pair).astype(np.complex128))
        for nu, pair in zip(bin_centres(array.n_bin), pairs, strict=True)
    ]
    return EmptyCells(alpha_hat, sigma_hat, array.power * array.n_rx, theory)


def false_alarms(cells: EmptyCells) -> Iterator[Check]:
    """Cells without a target: share over the threshold of P_FA."""
    apart = slice(None, None, 4)  # far enough apart that bins of one disturbance vector alarm independently
    expected = float(np.mean([theory.false_alarm_probability(P_FA) for theory in cells.theory[apart]]))
    alarms = 2.0 * np.abs(cells.alpha_hat) ** 2 > threshold(P_FA) * cells.sigma_hat**2
    yield _share(f"P_FA {P_FA:g}", int(alarms[:, apart].sum()), alarms[:, apart].size, expected)


def detection(scenario: Scenario, cells: EmptyCells) -> Iterator[Check]:
    """Cells with a target: chance to be over the scenario's threshold, in every bin."""
    yield _echo_check(scenario)
    for rcs in _POWERS:
        for zeta in ZETAS:
            yield _worst_bin(f"P_D({zeta:g}), {rcs}", *detection_chances(scenario, cells, zeta, rcs))


def detection_chances(
    scenario: Scenario, cells: EmptyCells, zeta: float, rcs: str = "constant"
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """P_D of an echo in each bin, (n_bin,), and its chance with each of the disturbances, (N_VECTOR, n_bin).

    zeta : of the mean RCS

    An echo alpha v adds alpha to alpha_hat and cancels in sigma_hat, so that the disturbances without one serve for all
    echoes. The phase of alpha is uniform: of a disturbance that leaves the estimate n alone,

        P(|alpha + n|^2 > T) = arccos((T - |alpha|^2 - |n|^2) / (2 |alpha| |n|)) / pi,   T = lambda sigma_hat^2 / 2

    averaged over |alpha|^2, if that fluctuates.
    """
    limit, n = threshold(scenario.radar.detector.p_fa), np.abs(cells.alpha_hat)
    level = np.array([theory.level for theory in cells.theory])
    snr = zeta * level / (2.0 * cells.signature_power)
    over, chances = 0.5 * limit * cells.sigma_hat**2 - n**2, np.zeros(n.shape)
    for power, weight in zip(*_POWERS[rcs], strict=True):
        cosine = (over - power * snr) / (2.0 * np.sqrt(power * snr) * n)
        chances += weight * np.arccos(np.clip(cosine, -1.0, 1.0)) / np.pi
    p_d = [
        theory.detection_probability(float(snr[b]), cells.signature_power, limit, rcs)
        for b, theory in enumerate(cells.theory)
    ]
    return np.array(p_d), chances


def spectrum(cells: EmptyCells) -> Iterator[Check]:
    """E[B] / ||v||^2, the receiver's own estimate of the disturbance, against the spectrum that the world drew from."""
    expected = np.array([theory.band_mean for theory in cells.theory])
    yield _worst_bin("spectrum", expected, cells.sigma_hat**2 * cells.signature_power)


def receivers() -> Iterator[Check]:
    """P_FA and P_D beside strong echoes: `separation = "joint"`, `noise = "rows"`, white noise, two arrays.

    Lambda / 2 has an F distribution with 2 and 2 (n_tx - 1) degrees of freedom, with a target non-central by

        zeta = 2 |alpha|^2 P',  P' what is left of ||v||^2 beside the echoes
    """
    limit, zeta = threshold(P_FA), ZETAS[1]
    for n_tx, n_rx in RECEIVERS:
        signatures = Signatures(float(n_tx), np.empty((n_tx, 0), np.complex128), n_rx)
        amplitude, dof = np.sqrt(0.5 * zeta / (n_tx * n_rx)), 2.0 * (n_tx - 1)
        alarms = looks = found = 0
        expected, n = 0.0, max(N_VECTOR // 3, 1)
        for k in range(n):
            rng = generator(SEED, Purpose.SEARCH, n_tx, k)
            y = draw("white", n_tx * n_rx, rng)
            nus = np.mod(rng.random() + np.array([0.0, 0.31, 0.64]) + 0.05 * rng.random(3), 1.0) - 0.5
            for nu, gain_db in zip(nus.tolist(), rng.uniform(*STRONG_DB, 3).tolist(), strict=True):
                add_echo(y, 10.0 ** (gain_db / 20.0) * np.exp(2j * np.pi * rng.random()), *signatures.at(nu))
            grid = (np.arange(max(n_tx, n_rx)) + rng.random()) / max(n_tx, n_rx) - 0.5
            off = np.abs(grid[:, np.newaxis] - nus)
            clear = grid[(np.minimum(off, 1.0 - off) > 1.5 / min(n_tx, n_rx)).all(axis=1)]
            statistic = DataSet(y, signatures, TOLD_APART).tests(clear).statistic
            alarms, looks = alarms + int((statistic >= limit).sum()), looks + clear.size
            nu = float(clear[k % clear.size])
            add_echo(y, amplitude * np.exp(2j * np.pi * rng.random()), *signatures.at(nu))
            cell = DataSet(y, signatures, TOLD_APART).tests(np.array([nu])).cell(0)
            found += cell.statistic >= limit
            left = cell.signature_power / (n_tx * n_rx)
            expected += 1.0 - float(ncfdtr(2.0, dof, zeta * left, 0.5 * dof * np.expm1(limit / dof)))
        name = f"beside echoes, {n_tx} x {n_rx}"
        yield _share(f"{name}: P_FA {P_FA:g}", alarms, looks, P_FA)
        yield _share(f"{name}: P_D({zeta:g})", int(found), n, expected / n)


def noise_from_range_cells() -> Iterator[Check]:
    """P_FA and P_D with `noise = "range-cells"`, where noise is a line in one direction and levels differ by cell.

        Y_i = sqrt(tau_i) (C_i + g_i v_line),   1 / tau_i gamma distributed with mean 1, g_i ~ CN(0, LINE_DB)

    One of the looks is at the line, the others are orthogonal to it. Each dwell has other range cells of its own: their
    estimates of the noise are independent from dwell to dwell, and from look to look. In every second dwell the target
    is at the line, with the same zeta.
    """
    (n_tx, n_rx), limit, zeta, n = BY_RANGE_ARRAY, threshold(P_FA), ZETAS[1], max(N_VECTOR // 3, 1)
    signatures, size = Signatures(float(n_tx), np.empty((n_tx, 0), np.complex128), n_rx), n_tx * n_rx
    line_power, n_look, others = 10.0 ** (LINE_DB / 10.0), max(n_tx, n_rx), range(1, 1 + MOST_REFERENCES)
    alarms = found = 0
    for k in range(n):
        rng = generator(SEED, Purpose.SEARCH, size, k)
        nus = ((np.arange(n_look) + rng.random()) / n_look - 0.5).tolist()
        signatures.prepare(nus)
        looks = [Look(nu, i, range(1), limit) for i, nu in enumerate(nus)]
        texture, data = TEXTURE / rng.standard_gamma(TEXTURE, 1 + MOST_REFERENCES), dict[int, DataSet]()
        lines = np.sqrt(0.5 * line_power) * rng.standard_normal(2 * texture.size).view(np.complex128)
        for cell, (scale, line) in enumerate(zip(np.sqrt(texture).tolist(), lines.tolist(), strict=True)):
            y = draw("white", size, rng)
            add_echo(y, line, *signatures.at(nus[0]))
            data[cell] = DataSet(scale * y, signatures, BY_RANGE)
        rows = receive(looks, data.__getitem__, [0], 1.0, others=others)
        alarms += sum(row.cell.statistic >= limit for row in rows)
        look = looks[k % 2 * (1 + k // 2 % (n_look - 1))]
        level = texture[0] * (1.0 if k % 2 else 1.0 + line_power * size)
        y, alpha = data[0].data.copy(), np.sqrt(0.5 * zeta * level / size) * np.exp(2j * np.pi * rng.random())
        add_echo(y, alpha, *signatures.at(look.nu))
        data[0] = DataSet(y, signatures, BY_RANGE)
        (row,) = receive([look], data.__getitem__, [0], 1.0, others=others)
        found += row.cell.statistic >= limit
    theory = finite_size("white", 0.0, np.ones(size, np.complex128), "range-cells", n_rx)
    expected = float(theory.detection_probability(0.5 * zeta / size, size, limit))
    name = f"noise by range, {n_tx} x {n_rx}"
    yield _share(f"{name}: P_FA {P_FA:g}", alarms, n * n_look, theory.false_alarm_probability(P_FA))
    yield _share(f"{name}: P_D({zeta:g})", int(found), n, expected)


def _echo_check(scenario: Scenario) -> Check:
    """What an echo changes in a cell beyond alpha_hat by alpha, relative to what is there; the largest of all bins."""
    array, worst, alpha = scenario.radar.array, 0.0, 0.3 - 0.1j
    for b, nu in enumerate(bin_centres(array.n_bin)):
        u, a_rx = _orthogonal_signature(scenario, float(nu))
        y = draw(scenario.simulated.disturbance.model, u.size * a_rx.size, generator(SEED, Purpose.DISTURBANCE, -2, b))
        alone = wald_test(y, u, a_rx)
        add_echo(y, alpha, u, a_rx)
        cell = wald_test(y, u, a_rx)
        estimate = abs(cell.alpha_hat - alpha - alone.alpha_hat) / abs(alpha)
        worst = max(worst, estimate, abs(cell.sigma_hat / alone.sigma_hat - 1.0))
    return Check("echo in alpha_hat alone", 0.0, 0.0, 1e-9, worst)  # rounding


def allocation(scenario: Scenario) -> Iterator[Check]:
    """Relative duality gap and optimality conditions of the full program, from the waveform and multipliers alone.

    A gap of g leaves stationarity residuals of the order of sqrt g.
    """
    array = scenario.radar.array
    power, n_tx = array.power, array.n_tx
    for n_target in N_TARGETS:
        gap, kkt = 0.0, 0.0
        for i in range(10):
            rng = generator(SEED, Purpose.INITIATION, n_target, i)
            nus = bin_centres(array.n_bin)[rng.choice(array.n_bin, n_target, replace=False)]
            delta = rng.uniform(10.0, 100.0, n_target) ** -4.0
            result = allocate(nus, delta, power, n_tx)
            bound = dual_bound(result.shares / power, nus, delta, power, n_tx)
            gap = max(gap, (bound - result.value) / result.value)
            kkt = max(kkt, *map(abs, kkt_residuals(nus, delta, power, result)))
        yield Check(f"allocation of {n_target}: duality gap", 0.0, -1e-12, GAP, gap)  # -1e-12: rounding
        yield Check(f"allocation of {n_target}: KKT residual", 0.0, 0.0, GAP**0.5, kkt)


def consistency(scenario: Scenario) -> Iterator[Check]:
    """Normalised estimation error squared of the beliefs at the end of runs with random targets.

        NEES = e^T P^{-1} e, e error of the belief's mean, P its covariance    (Bar-Shalom et al. 2001, section 5.4)

    Its mean is 4 if a belief is what it claims to be. Targets are drawn from what beliefs take them to be at first;
    one value per target and run, so that the values are independent.
    """
    values = np.array([nees for i in range(N_RUN) for nees in _run_nees(_random_targets(scenario, i), SEED + i)])
    n = values.size
    low, high = (float(chdtri(4.0 * n, tail)) / n for tail in (1.0 - TAIL, TAIL))
    yield Check(f"NEES of {n} beliefs, 4 states", 4.0, low, high, float(values.mean()))


def _random_targets(scenario: Scenario, i: int) -> Scenario:
    """The scenario with three targets anywhere in view, at ranges that the orthogonal waveform sees."""
    rng = generator(SEED, Purpose.INITIATION, -1, i)
    theta = np.arcsin(rng.uniform([-0.8, -0.2, 0.4], [-0.4, 0.2, 0.8]))
    range_km, v_max = rng.uniform(20.0, 60.0, 3), scenario.radar.acquisition.v_max_km_s
    vx, vy = rng.uniform(-v_max, v_max, (2, 3))
    states = np.column_stack((range_km * np.cos(theta), vx, range_km * np.sin(theta), vy))
    document = scenario.model_dump()
    document["world"] |= {"targets": [{"state": state} for state in states.tolist()]}
    return Scenario.model_validate(document)


def _run_nees(scenario: Scenario, seed: int) -> list[float]:
    """NEES of each track after N_DWELL dwells of a run with power shared equally."""
    document, radar = scenario.model_dump(), scenario.radar
    settings = {"radar": document["radar"], "strategy": Strategy.UNIFORM, "seed": seed, "dwells": N_DWELL}
    settings |= {"world": document["world"], "world_seed": seed}
    begin = EmulatorCheckpoint.model_validate({"run": "verify", "k": 0, "t": 0} | settings)
    emulator, model = EmulatorCore(SimulatedFrontEnd.open), TrackerModel.of(radar, Strategy.UNIFORM, seed)
    acquisition = Acquisition(model)
    answers, tracks, truth = list(emulator.handle(begin)), list[TrackState](), np.empty(0)
    while answers:
        scan, truth = _of(answers)
        seen = detections_of(model, scan)
        if tracks:
            tracks = [observe(model, track, seen) for track in tracks]
        elif (bins := acquisition.add(seen)) is not None:
            tracks = [
                start(model, m, int(bin_), acquisition.scans, acquisition.ranges_km[m]) for m, bin_ in enumerate(bins)
            ]
            estimates = [track.belief.moments()[0] for track in tracks]
            target_of_track = associate(estimates, truth, radar.array.n_bin)
        if scan.t == N_DWELL:
            break
        plans = [_plan(scan, m, decide(radar, model, tracks[m]) if tracks else None) for m in range(radar.announced)]
        answers = list(emulator.handle(waveform(radar, Strategy.UNIFORM, unchanged(plans, scan.k))))
    matched = [(track, truth[m]) for track, m in zip(tracks, target_of_track, strict=True) if m >= 0]  # no false track
    errors = [track.belief.moments()[0] - state for track, state in matched]
    covariances = [np.cov(track.belief.sample(), rowvar=False) for track, _ in matched]
    return [float(e @ np.linalg.solve(P, e)) for e, P in zip(errors, covariances, strict=True)]


def _of(sent: list[Message]) -> tuple[Scan, NDArray[np.float64]]:
    """Scan and true states of a dwell."""
    (scan,) = (message for message in sent if isinstance(message, Scan))
    (truth,) = (message for message in sent if isinstance(message, Truth))
    return scan, truth.states


def _plan(scan: Scan, m: int, decision: Decision | None) -> Plan:
    searching = Plan(run=scan.run, k=scan.k, t=scan.t, target=m, status="searching")
    if decision is None:
        return searching
    return searching.model_copy(update={"status": "tracking"} | vars(decision))


def _orthogonal_signature(scenario: Scenario, nu: float) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Transmit and receive half of a cell's signature; W = sqrt(P / n_tx) I."""
    array = scenario.radar.array
    return np.sqrt(array.power / array.n_tx) * steering_vector(nu, array.n_tx), steering_vector(nu, array.n_rx)


def _worst_bin(name: str, expected: NDArray[np.float64], samples: NDArray[np.float64]) -> Check:
    """Of all bins the one whose mean is farthest from what is expected, in standard errors.

    expected : (n_bin,); samples : (n, n_bin). The interval is that of the farthest of so many.
    """
    mean, error = samples.mean(axis=0), samples.std(axis=0, ddof=1) / np.sqrt(samples.shape[0])
    b = int(np.argmax(np.abs(mean - expected) / error))
    half = -float(ndtri(TAIL / expected.size)) * float(error[b])
    low, high = float(expected[b]) - half, float(expected[b]) + half
    return Check(f"{name}: worst bin, {b}", float(expected[b]), low, high, float(mean[b]))


def _share(name: str, hits: int, n: int, p: float) -> Check:
    """A share of n trials against its probability, with the exact binomial interval."""
    below = bdtr(np.arange(n + 1), n, p)  # P(hits <= k)
    low, high = np.searchsorted(below, [TAIL, 1.0 - TAIL])
    return Check(name, p, float(low) / n, float(high) / n, hits / n)


def table(checks: Sequence[Check]) -> Table:
    """One line per check."""
    columns = (
        *(Column("", "{verdict}", left=True), Column("check", "{name}", left=True)),
        *(Column("measured", "{measured:.4g}"), Column("interval", "{low:.4g} .. {high:.4g}")),
        Column("expected", "{expected:.4g}"),
    )
    rows = [check.as_json() | {"verdict": "ok" if check.passed else "FAIL"} for check in checks]
    return Table("", columns, rows, bold=frozenset(i for i, check in enumerate(checks) if not check.passed))
