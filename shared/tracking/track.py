"""One track: from the scans it hears to the bin it asks for. What a planner holds per target, and all that it holds.

A track is a function of (scenario, strategy, seed, target, scans): random numbers are keyed by (target, dwell) and the
search tree is dropped after each decision. So any process that has the scans can rebuild it, and equals the others.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shared.numerics.seeds import Purpose, generator
from shared.planning.policies import Choice, most_probable_bin, searched_bin
from shared.planning.radar_pomdp import problem_of
from shared.protocol.messages import MAX_PARTICLES, Scan, Snapshot
from shared.scenario.scenario import Scenario, Strategy
from shared.signal.receiver import threshold
from shared.tracking.initiation import initial_belief, initiate
from shared.tracking.motion import Motion, mean_state, predicted_bins, predicted_mean, propagate_into
from shared.tracking.particle_filter import Observation, Sensor, update, update_predicted
from shared.tracking.recovery import Memory, reacquire
from shared.tracking.sensor import level_of

REHEARSED_MISSES = 12  # more than a strong target needs to be looked for anew twice


@dataclass(frozen=True)
class Decision:
    """What a track asks for after a dwell."""

    bin: int  # angle bin to illuminate next
    range_km: float  # expected range at the next dwell
    estimate: NDArray[np.float64]  # (4,) belief mean now
    detected: bool
    depleted: bool
    n_sim: int  # simulations behind the choice


def confirmed_bins(scenario: Scenario, scans: Sequence[Scan]) -> NDArray[np.int64] | None:
    """Bins of the targets once the acquisition scans confirm them all, else None; (n_target,), ascending."""
    statistic = np.array([scan.statistic for scan in scans])
    detected = statistic >= threshold(scenario.detector.p_fa)
    return initiate(detected, statistic, scenario.n_target, scenario.acquisition.confirmations)


def rehearse(scenario: Scenario, strategy: Strategy) -> None:
    """Track nothing for some dwells: a hit, a gap, misses until the track begins again, and again.

    The first call of a compiled kernel loads it, and all of them together take a second.
    """
    n, p_fa = scenario.array.n_bin, scenario.detector.p_fa
    scan = Scan(
        run="rehearsal",
        k=0,
        t=0,
        bins=np.arange(n, dtype=np.int32),
        statistic=np.full(n, 2.0 * threshold(p_fa)),
        alpha_hat=np.full(n, 0.1, dtype=np.complex64),
        sigma_hat=np.full(n, 0.01),
        signature_power=np.full(n, scenario.array.power * scenario.array.n_rx),
        beams=np.full(scenario.n_target, n // 2, dtype=np.int32),
    )
    track = Track(scenario, strategy, 0, 0, n // 2, [scan])
    track.observe(scan.model_copy(update={"k": 1, "t": 1}))
    track.coast(3)
    nothing = {"statistic": np.zeros(n)}
    for k in range(3, 3 + REHEARSED_MISSES):
        track.observe(scan.model_copy(update={"k": k, "t": k, **nothing}))
        track.decide(lambda: False)


class Track:
    """Belief of one target, advanced scan by scan."""

    def __init__(
        self, scenario: Scenario, strategy: Strategy, seed: int, target: int, bin_: int, scans: Sequence[Scan]
    ):
        """Begin in `bin_`, with what all acquisition scans said of that cell (they test every cell, in order)."""
        self._settle(scenario, strategy, seed, target)
        self._k = scans[-1].k
        self._detected, self._depleted = True, False
        sigma_hat = np.array([scan.sigma_hat[bin_] for scan in scans])
        last = max(i for i, scan in enumerate(scans) if scan.statistic[bin_] >= self._threshold)
        self._remember(scans[last], bin_)
        self._power = float(scans[-1].signature_power[bin_])  # ||v||^2 of the last look at the target
        self.particles = initial_belief(
            bin_,
            scenario.array.n_bin,
            np.array([scan.alpha_hat[bin_] for scan in scans]),
            sigma_hat,
            scenario.acquisition,
            scenario.echo.amplitude_db,
            scenario.belief.n_particle,
            generator(seed, Purpose.INITIATION, target, self._k),
        )
        self._memory = Memory(self.particles, self._hit(scans[last], bin_, np.zeros(scenario.array.n_bin)))

    def _settle(self, scenario: Scenario, strategy: Strategy, seed: int, target: int) -> None:
        """What is the same in all dwells."""
        self._scenario = scenario
        self._strategy = strategy
        self._seed = seed
        self._target = target
        self._threshold = threshold(scenario.detector.p_fa)
        self._sensor = Sensor(scenario.array.n_bin, scenario.echo.amplitude_db, self._threshold)
        self._motion = Motion(scenario.motion.dt_s, scenario.motion.sigma_s_km_s2)
        self._ahead: tuple[NDArray[np.float64], np.random.Generator] | None = None  # prediction of the next dwell

    @classmethod
    def restored(cls, scenario: Scenario, strategy: Strategy, seed: int, snapshot: Snapshot) -> Self:
        """The track that a snapshot of this scenario was taken of, bit for bit."""
        track = cls.__new__(cls)
        track._settle(scenario, strategy, seed, snapshot.target)
        track._k, track._detected, track._depleted = snapshot.k, snapshot.detected, snapshot.depleted
        track._sigma_hat, track._level, track._power = snapshot.sigma_hat, snapshot.level, snapshot.power
        track.particles = snapshot.particles
        hit = Observation(snapshot.hit_bin, snapshot.hit_level, snapshot.looked[0])
        track._memory = Memory(
            snapshot.remembered if snapshot.remembered.size else snapshot.particles,
            hit if snapshot.hit_bin >= 0 else None,
            [Observation(-1, 0, sigma) for sigma in snapshot.looked[1:]],
            snapshot.log_evidence,
            snapshot.attempts,
        )
        return track

    def snapshot(self, run: str) -> Snapshot | None:
        """All that the track is; None if that is too much for a message."""
        if self.particles.shape[0] > MAX_PARTICLES:
            return None
        memory = self._memory
        hit = memory.hit or Observation(-1, 0, np.zeros(self._scenario.array.n_bin))
        is_fresh = memory.particles is self.particles
        return Snapshot(
            run=run,
            k=self._k,
            target=self._target,
            particles=self.particles.copy(),
            detected=self._detected,
            depleted=self._depleted,
            sigma_hat=self._sigma_hat,
            level=self._level,
            power=self._power,
            remembered=np.empty((0, 4)) if is_fresh else memory.particles.copy(),
            hit_bin=hit.hit_bin,
            hit_level=hit.level,
            looked=np.array([hit.sigma, *(miss.sigma for miss in memory.misses)]),
            log_evidence=memory.log_evidence,
            attempts=memory.attempts,
        )

    def prepare(self) -> bool:
        """Predict the next dwell before its scan is there; false if there is nothing to do. Results are the same."""
        if self._ahead is not None or self._scenario.belief.update == "rejection":
            return False
        self._ahead = self._predict(self._k + 1)
        return True

    def observe(self, scan: Scan) -> None:
        """Update the belief with the next scan."""
        observation = self._observation(scan)
        belief, acquisition = self._scenario.belief, self._scenario.acquisition
        if self._ahead is not None and scan.k == self._k + 1:
            predicted, rng = self._ahead
            updated = update_predicted(predicted, observation, self._sensor, belief, acquisition, rng)
        else:
            rng = generator(self._seed, Purpose.BELIEF, self._target, scan.k)
            updated = update(self.particles, observation, self._sensor, self._motion, belief, acquisition, rng)
        self._ahead = None
        updated = reacquire(self._memory, updated, observation, self._sensor, self._motion, belief, acquisition, rng)
        self.particles, self._depleted = updated.particles, updated.depleted
        self._detected = observation.hit_bin >= 0
        self._k = scan.k

    def coast(self, k: int) -> None:
        """Let the belief move on to just before dwell k, without an observation of the dwells in between."""
        for missing in range(self._k + 1, k):
            self.particles, _ = self._predict(missing)
        self._ahead = None
        self._k = k - 1

    def _predict(self, k: int) -> tuple[NDArray[np.float64], np.random.Generator]:
        """Particles of dwell k before its observation, and the generator that goes on with it."""
        rng, moved = generator(self._seed, Purpose.BELIEF, self._target, k), np.empty_like(self.particles)
        propagate_into(self.particles, self._motion, rng, moved)
        return moved, rng

    def decide(self, has_time: Callable[[], bool] | None = None) -> Decision:
        """Choose the bin to look at next: POMCP, or where the belief is densest when every cell is tested anyway.

        has_time : false as soon as the search must end (real time); without it, it makes all its simulations
        """
        estimate = mean_state(self.particles)
        predicted = predicted_mean(estimate, self._motion.dt)
        if self._strategy is Strategy.ORTHOGONAL:
            choice = Choice(most_probable_bin(self.particles, self._sensor.n_bin, self._motion.dt), 0)
        else:
            rng = generator(self._seed, Purpose.SEARCH, self._target, self._k)
            sigma_hat = float(self._expected_sigma(self._power))
            problem = problem_of(self.particles, sigma_hat, self._sensor, self._motion)
            choice = searched_bin(problem, self._scenario.planner, rng, has_time)
        return Decision(
            choice.bin,
            float(np.hypot(predicted[0], predicted[2])),
            estimate,
            self._detected,
            self._depleted,
            choice.n_sim,
        )

    def _observation(self, scan: Scan) -> Observation:
        """What the scan says of this track: its own cell, or, when every cell was tested, all of them."""
        n_bin = self._scenario.array.n_bin
        sigma = np.zeros(n_bin)
        if scan.bins.size == n_bin:
            cells = np.arange(n_bin)
            hit = self._claimed(scan)
        else:
            cells = np.searchsorted(scan.bins, scan.beams[self._target : self._target + 1])
            hit = int(cells[0]) if scan.statistic[cells[0]] >= self._threshold else -1
        sigma[scan.bins[cells]] = self._expected_sigma(scan.signature_power[cells])
        self._power = float(scan.signature_power[cells].mean())
        if hit < 0:
            return Observation(-1, 0, sigma)
        self._remember(scan, hit)
        return self._hit(scan, hit, sigma)

    @staticmethod
    def _hit(scan: Scan, cell: int, sigma: NDArray[np.float64]) -> Observation:
        """Observation of a detection in a cell of the scan; `sigma` is that of the cells looked at."""
        hit_bin, sigma_hit = int(scan.bins[cell]), float(scan.sigma_hat[cell])
        sigma[hit_bin] = sigma_hit
        return Observation(hit_bin, level_of(abs(scan.alpha_hat[cell]) / sigma_hit), sigma)

    def _claimed(self, scan: Scan) -> int:
        """Detected cell where most particles are expected, -1 if none is expected in any."""
        moving = predicted_bins(self.particles, self._sensor.n_bin, self._motion.dt)
        expected = np.where(scan.statistic >= self._threshold, moving, 0)
        best = int(np.argmax(expected))
        return best if expected[best] > 0 else -1

    def _remember(self, scan: Scan, cell: int) -> None:
        """Keep sigma_hat of a detection, and the disturbance level S = sigma_hat^2 ||v||^2 that outlives a waveform."""
        self._sigma_hat = float(scan.sigma_hat[cell])
        self._level = self._sigma_hat**2 * float(scan.signature_power[cell])

    def _expected_sigma(self, signature_power: ArrayLike) -> NDArray[np.float64]:
        """Standard deviation of alpha_hat expected with waveforms of these ||v||^2; (...) -> (...)."""
        power = np.asarray(signature_power, dtype=np.float64)
        variance = np.full(power.shape, self._sigma_hat**2)
        if self._scenario.belief.noise_memory == "level":
            np.divide(self._level, power, out=variance, where=power > 0.0)
        return np.asarray(np.sqrt(variance))
