"""One track, from the scans that it observes to its belief.

A track is a function of (radar, strategy, seed, target, scans): a frozen state, from which pure functions make the
next one, with random numbers keyed by (target, dwell). So any process that has the scans, or an earlier state and the
scans since, has the same track.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from shared.numerics.seeds import Purpose, generator
from shared.signal.array import bin_centres
from shared.signal.echo_laws import echo_after_hit, echo_after_miss, first_echo
from shared.tracking.association import associate, hit_of, is_beam, lit_cells
from shared.tracking.existence import ENDED_BELOW, UNFOUND_BELOW, Confirmation, after_hit, after_miss
from shared.tracking.initiation import initial_belief, initiate
from shared.tracking.model import TrackerModel, TrackState
from shared.tracking.motion import predicted_bins
from shared.tracking.particle_filter import predict, update
from shared.tracking.recovery import coasted, reacquire, remembered_hit
from shared.tracking.sensor import Detections, Observation
from shared.tracking.steered.association import Own, associate_looks
from shared.tracking.steered.initiation import Candidates, begin_at
from shared.tracking.steered.joint import share_of
from shared.tracking.steered.looks import Looks, shares_looked_at

WARM_UP_MISSES = 12  # more than a strong target needs to begin again twice


class Prediction(NamedTuple):
    """A belief one dwell later, made before the scan of that dwell is there."""

    prior: NDArray[np.float64]  # (n, 4) of the state that it was made of
    particles: NDArray[np.float64]  # (n, 4)
    rng_state: Any  # of the generator, after the prediction


class Acquisition:
    """The scans before the tracks begin, from the first on, each of every cell."""

    def __init__(self, model: TrackerModel) -> None:
        self.scans: list[Detections] = []
        self.bins: NDArray[np.int64] | None = None  # of the tracks, in their order, once every target is detected
        self._model = model
        self._candidates = None if model.aperture is None else Candidates(model, model.aperture)

    def add(self, scan: Detections) -> NDArray[np.int64] | None:
        """Take the next scan, unless every target is detected already; returns `bins`."""
        if self.bins is None:
            self.scans.append(scan)
            if self._candidates is None:
                self.bins = initiate(self._model, self.scans)
            else:
                self._candidates.add(scan)
                self.bins = self._candidates.bins()
        return self.bins


def start(model: TrackerModel, target: int, bin_: int, scans: Sequence[Detections]) -> TrackState:
    """State after the acquisition, in `bin_`, from what all its scans say of that cell (they test every cell)."""
    newest, rng = scans[-1], generator(model.seed, Purpose.INITIATION, target, scans[-1].k)
    hit: Observation | Looks
    if model.aperture is None:
        particles, hit, power = _begin(model, bin_, scans, rng)
    else:
        particles, hit, power = begin_at(model, model.aperture, bin_, scans, rng)
    return TrackState(
        target=target,
        k=newest.k,
        particles=particles,
        detected=True,
        depleted=False,
        sigma_hat=hit.hit_sigma,
        in_beam=False,
        level=hit.hit_sigma**2 * power,
        power=float(newest.signature_power[bin_]),
        echo=_first_echo(model, bin_, scans, hit),
        modes=model.modes,
        **remembered_hit(model, hit),
    )


def _begin(
    model: TrackerModel, bin_: int, scans: Sequence[Detections], rng: np.random.Generator
) -> tuple[NDArray[np.float64], Observation, float]:
    """First belief in a bin, (n_particle, 4); the newest detection, and ||v||^2 of that."""
    hit = next(scan for scan in reversed(scans) if scan.statistic[bin_] >= model.sensor.threshold)
    particles = initial_belief(model, bin_, *_seen(bin_, scans), rng)
    observation = hit_of(hit, bin_, np.zeros(model.sensor.n_bin))
    return particles, observation, float(hit.signature_power[bin_])


def _seen(bin_: int, scans: Sequence[Detections]) -> tuple[NDArray[np.complex64], NDArray[np.float64]]:
    """Amplitudes and their standard deviations in a bin, (n_scan,) each."""
    return np.array([scan.alpha_hat[bin_] for scan in scans]), np.array([scan.sigma_hat[bin_] for scan in scans])


def _first_echo(model: TrackerModel, bin_: int, scans: Sequence[Detections], hit: Observation | Looks) -> float:
    """Mean |alpha|^2 of a target; of range cells, only an amplitude near the range of its detection is its own."""
    if model.sensor.law.tells_range:
        return 0.0
    own = np.ones(len(scans), dtype=np.bool_)
    if isinstance(hit, Looks) and hit.range_km > 0.0:
        ranges_km = np.array([scan.ranges_km[bin_] for scan in scans if scan.ranges_km is not None])
        own = np.abs(ranges_km - hit.range_km) <= hit.aperture.range_cell_km
    return first_echo(*_seen(bin_, scans), own, model.least_echo)


def prepare(model: TrackerModel, state: TrackState) -> Prediction | None:
    """What can be computed of the next dwell before its scan is there; None with rejection, which mixes the two."""
    if model.belief.update == "rejection":
        return None
    rng, motion = _generator(model, state.target, state.k + 1), model.of_modes(state.modes).motion
    return Prediction(state.particles, predict(motion, state.particles, rng), rng.bit_generator.state)


def observe(
    model: TrackerModel, state: TrackState, scan: Detections, prediction: Prediction | None = None
) -> TrackState:
    """State after one more scan. A prediction saves time and changes nothing; one of another state is ignored.

    A dwell in which no cell was lit for the track tells it nothing: it coasts, and nothing was missed. So does one in
    which the echo of another target hides its own.
    """
    model = model.of_echo(state.echo).of_modes(state.modes)
    in_beam, in_doubt, own = is_beam(model, scan), False, Own()
    if in_beam and scan.expected is None and not lit_cells(scan, state.target).size:
        return replace(coast(model, state, scan.k + 1), detected=False, depleted=False)
    observation: Observation | Looks
    if model.aperture is None:
        observation, power = associate(model, state, scan)
    else:
        observation, power, in_doubt, own = associate_looks(model, model.aperture, state, scan)
        if scan.expected is not None and not observation.nus.size:
            return replace(coast(model, state, scan.k + 1), detected=False, depleted=False, in_doubt=in_doubt)
    rng, predicted = _generator(model, state.target, scan.k), None
    if prediction is not None and prediction.prior is state.particles and scan.k == state.k + 1:
        predicted, rng.bit_generator.state = prediction.particles, prediction.rng_state
    updated = update(model, state.particles, observation, rng, predicted)
    if not model.sensor.law.tells_range:
        state = replace(state, echo=_learned_echo(model, state.echo, observation, updated.particles))
    state = reacquire(model, state, updated, observation, rng)
    if model.confirmation is not None:
        state = _judged(model.confirmation, state, observation.is_hit, updated.evidence, own)
    if observation.is_hit:
        sigma_hat = observation.hit_sigma
        state = replace(state, sigma_hat=sigma_hat, in_beam=in_beam, level=sigma_hat**2 * power)
    modes = updated.modes if updated.modes.size else model.modes
    return replace(state, k=scan.k, detected=observation.is_hit, power=power, modes=modes, in_doubt=in_doubt)


def _judged(confirmation: Confirmation, state: TrackState, is_hit: bool, evidence: float, own: Own) -> TrackState:
    """The state with what a dwell says of whether there is a target at all."""
    existence = after_hit(state.existence, own.p_fa) if is_hit else after_miss(state.existence, evidence)
    if state.confirmed:
        return replace(state, existence=existence)
    n_look, n_hit = state.n_look + own.is_looked, state.n_hit + own.is_found
    is_confirmed = confirmation.is_confirmed(n_hit)
    return replace(state, existence=existence, n_look=n_look, n_hit=n_hit, confirmed=is_confirmed)


def is_over(model: TrackerModel, state: TrackState, chance: float) -> bool:
    """Whether a track is to be given up: no look would find its target, or it has flown out of the field of view.

    chance : probability that the target, if there is one, is in the cell where it is most probable
    """
    if model.confirmation is None:
        return False
    ranges_km = np.hypot(state.particles[:, 0], state.particles[:, 2])
    is_out = (state.particles[:, 0] == 0.0) | (ranges_km > model.acquisition.range_max_km)
    if float(is_out.mean()) > 0.5:
        return True
    if not state.confirmed:
        return model.confirmation.has_failed(state.n_look, state.n_hit)
    return state.existence < ENDED_BELOW or state.existence * chance < UNFOUND_BELOW


def coast(model: TrackerModel, state: TrackState, k: int) -> TrackState:
    """State just before dwell k, the dwells in between unobserved."""
    while state.k < k - 1:
        now = model.of_modes(state.modes)
        predicted = predict(now.motion, state.particles, _generator(model, state.target, state.k + 1))
        state = replace(coasted(now, state, predicted), k=state.k + 1, modes=now.modes)
    return state


def follow(
    model: TrackerModel,
    scans: Iterable[Detections],
    tracks: Sequence[int],
    states: Mapping[int, TrackState] = MappingProxyType({}),
) -> Iterator[dict[int, TrackState]]:
    """What these tracks, counted from 0, were after each scan, from the one that confirmed the last target on.

    scans  : all of the run in their order; with `states`, those after them
    states : of these tracks, after an earlier scan; none: they begin with the acquisition
    """
    followed, acquisition = dict(states), Acquisition(model)
    for scan in scans:
        if followed:
            followed = {m: observe(model, coast(model, state, scan.k), scan) for m, state in followed.items()}
        else:
            bins = acquisition.add(scan)
            if bins is None:
                continue
            followed = {m: start(model, m, int(bins[m]), acquisition.scans) for m in tracks}
        yield followed


def warm_up(model: TrackerModel) -> TrackState:
    """Track nothing for some dwells: a hit, a gap, misses until the track begins again, and again. Its last state.

    The first call of a compiled kernel loads it, and all of them together take a second.
    """
    n_track = max(model.n_track, 1)
    model, n = replace(model, seed=0, n_track=n_track), model.sensor.n_bin
    everywhere = np.full(n, 2.0 * model.sensor.threshold)
    scan = Detections(
        k=0,
        bins=np.arange(n, dtype=np.int32),
        statistic=everywhere,
        alpha_hat=np.full(n, 0.1, dtype=np.complex64),
        sigma_hat=np.full(n, 0.01),
        signature_power=np.full(n, 1.0),
        beams=np.full((n_track, 1), -1, dtype=np.int32),  # so that all cells are this track's
    )
    if model.aperture is not None:
        nus, beam_nus, gates = bin_centres(n), np.zeros((n_track, 1)), np.zeros((model.n_track, 2))
        limits, sigmas = np.full(n, model.sensor.threshold), np.full(n, 1e-3)
        ranges_km = np.full(n, 50.0 if model.aperture.range_cell_km > 0.0 else 0.0)
        scan = Detections(*scan[:7], nus, limits, ranges_km, nus, sigmas, beam_nus, gates)
        scan = scan._replace(statistic=np.where(np.arange(n) == n // 2, everywhere, 0.0))
        share_of(model.aperture, scan._replace(expected=np.ones((n_track, 4))), 0)
    state = start(model, 0, n // 2, [scan])
    state = observe(model, state, scan._replace(k=1), prepare(model, state))
    state = coast(model, state, 3)
    for k in range(3, 3 + WARM_UP_MISSES):
        state = observe(model, state, scan._replace(k=k, statistic=np.zeros(n)))
    return state


def _learned_echo(
    model: TrackerModel, echo: float, observation: Observation | Looks, particles: NDArray[np.float64]
) -> float:
    """What a look tells of how strong the echoes are; particles, (n, 4), of the belief after it."""
    if observation.is_hit:
        learned = echo_after_hit(echo, observation.amplitude, observation.hit_sigma)
    elif isinstance(observation, Looks):
        share = shares_looked_at(observation, particles)
        learned = echo_after_miss(echo, observation.limit, observation.sigma, share)
    else:
        cells = np.flatnonzero(observation.sigma)
        share = predicted_bins(particles, model.sensor.n_bin, 0.0)[cells] / particles.shape[0]
        learned = echo_after_miss(echo, model.sensor.threshold, observation.sigma[cells], share)
    return max(learned, model.least_echo)


def _generator(model: TrackerModel, target: int, k: int) -> np.random.Generator:
    return generator(model.seed, Purpose.BELIEF, target, k)
