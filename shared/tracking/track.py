"""One track, from the scans that it observes to its belief.

A track is a function of (radar, strategy, seed, target, scans): a frozen state, from which pure functions make the
next one, with random numbers keyed by (target, dwell). So any process that has the scans, or an earlier state and the
scans since, has the same track.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.signal.looks import NEIGHBOURS
from cogradar.shared.signal.scan import Detections, Strongest
from cogradar.shared.tracking.acquisition import Candidates
from cogradar.shared.tracking.assignment.shares import share_of, unclaimed
from cogradar.shared.tracking.assignment.solver import load_solver
from cogradar.shared.tracking.association import Association, associate, is_beam
from cogradar.shared.tracking.belief.interface import Belief
from cogradar.shared.tracking.belief.likelihood import Looks, shares_looked_at
from cogradar.shared.tracking.belief.recovery import remembered_hit
from cogradar.shared.tracking.filters import Dwell, Observed, Random, filter_of
from cogradar.shared.tracking.initiation import begin_at
from cogradar.shared.tracking.model import TrackerModel, TrackState

# Probability of a miss where another's echo may hide the own, and does not: no belief is weighed there.
IF_HIDDEN = 0.3
WARM_UP_MISSES = 12  # more than a strong target needs to begin again twice


class Prediction(NamedTuple):
    """A belief one dwell later, made before the scan of that dwell is there."""

    prior: Belief  # of the state that it was made of
    predicted: NDArray[np.float64] | None  # (n, 4); None: nothing is
    rng_state: Any  # of the generator, after the prediction


class Acquisition:
    """The scans before the tracks begin, from the first on, each of every cell."""

    def __init__(self, model: TrackerModel) -> None:
        self.scans: list[Detections] = []
        self.strongest: Strongest | None = None  # of these scans
        self.bins: NDArray[np.int64] | None = None  # of the tracks, in their order, once every target is detected
        self.ranges_km: list[float] = []  # ... and at which ranges; 0: not measured
        self._candidates, self._n_bin, self._n_track = Candidates(model), model.sensor.n_bin, model.n_track

    @property
    def progress(self) -> str:
        """How near the targets are to being found, in words; "": all are."""
        if self.bins is not None or not self.scans:
            return ""
        n_target, n_blank = self._n_track, sum(not scan.sigma_hat.any() for scan in self.scans)
        blank = f", in {n_blank} of them nothing was measured" if n_blank else ""
        said = f"{len(self.scans)} scans{blank}: {self._candidates.n_confirmed} of {n_target} targets confirmed"
        return said if self.strongest is None else f"{said}; {self.strongest}"

    def add(self, scan: Detections) -> NDArray[np.int64] | None:
        """Take the next scan, unless every target is detected already; returns `bins`."""
        if self.bins is None:
            self.strongest = Strongest.of(scan, self.strongest)
            scan = scan.everywhere(self._n_bin)
            self.scans.append(scan)
            self._candidates.add(scan)
            if (found := self._candidates.found()) is not None:
                self.bins, self.ranges_km = np.array([bin_ for bin_, _ in found]), [range_km for _, range_km in found]
        return self.bins


def start(
    model: TrackerModel, target: int, bin_: int, scans: Sequence[Detections], range_km: float = 0.0
) -> TrackState:
    """State after the acquisition, in `bin_`, from what all its scans say of that cell (they test every cell).

    range_km : where the target was confirmed, if ranges are measured
    """
    newest, rng = scans[-1], generator(model.seed, Purpose.INITIATION, target, scans[-1].k)
    particles, hit, power = begin_at(model, bin_, range_km, scans, rng)
    return TrackState(
        target=target,
        k=newest.k,
        belief=filter_of(model).begun(model, particles, rng),
        detected=True,
        depleted=False,
        sigma_hat=hit.hit_sigma,
        in_beam=False,
        level=hit.hit_sigma**2 * power,
        power=next((power for scan in reversed(scans) if (power := float(scan.signature_power[bin_])) > 0.0), 0.0),
        echo=_first_echo(model, bin_, scans, hit),
        modes=model.modes,
        **remembered_hit(hit),
    )


def _first_echo(model: TrackerModel, bin_: int, scans: Sequence[Detections], hit: Looks) -> float:
    """Mean |alpha|^2 of a target; of range cells, only an amplitude near the range of its detection is its own."""
    off_km = np.abs(np.array([scan.ranges_km[bin_] for scan in scans]) - hit.range_km)
    own = off_km < NEIGHBOURS * hit.response.range_cell_km
    seen = np.array([scan.alpha_hat[bin_] for scan in scans]), np.array([scan.sigma_hat[bin_] for scan in scans])
    return model.sensor.law.first_echo(*seen, own, model.least_echo)


def prepare(model: TrackerModel, state: TrackState) -> Prediction | None:
    """What can be computed of the next dwell before its scan is there; None: nothing."""
    rng = cache(_random(model, state.target, state.k + 1))
    predicted = filter_of(model).ahead(model, state, rng)
    return None if predicted is None else Prediction(state.belief, predicted, rng().bit_generator.state)


def observe(
    model: TrackerModel, state: TrackState, scan: Detections, prediction: Prediction | None = None
) -> TrackState:
    """State after one more scan.

    associate : which looks are the track's, and which detection
    condition : the belief that they leave, predicted and weighed
    recover   : from misses in a row that are too improbable, where the filter must
    judge     : whether there is a target at all

    A prediction saves time and changes nothing; one of another state is ignored. A dwell in which no cell was lit for
    the track tells it nothing: it coasts, and nothing was missed. So does one in which the echo of another target hides
    its own, and one in which nothing was measured.
    """
    model = model.of_echo(state.echo)
    association = associate(model, state, scan)
    if not association.is_looked:
        unseen = coast(model, state, scan.k + 1)
        judged = model.existence.after(unseen.existence, unseen.confirmed, association.own, IF_HIDDEN)
        return unseen._replace(detected=False, depleted=False, in_doubt=association.in_doubt, **judged)
    if prediction is None or prediction.prior is not state.belief or scan.k != state.k + 1:
        prediction = Prediction(state.belief, None, None)
    rng = _random(model, state.target, scan.k, prediction.rng_state)
    observed = filter_of(model).observed(model, state, Dwell(association.looks, rng, prediction.predicted))
    return _noted(model, state, observed, scan, association)


def _noted(
    model: TrackerModel, before: TrackState, observed: Observed, scan: Detections, association: Association
) -> TrackState:
    """The state with what it keeps of a dwell beside its belief: noise, power, echo, modes, existence."""
    state, looks, power = observed.state, association.looks, association.power
    left = before.existence * model.existence.survival(before.belief, state.belief)
    noise = dict[str, Any]()
    if looks.is_hit:
        noise = {"sigma_hat": looks.hit_sigma, "in_beam": is_beam(model, scan), "level": looks.hit_sigma**2 * power}
    return state._replace(
        **noise,
        k=scan.k,
        detected=looks.is_hit,
        power=power,
        echo=_learned_echo(model, state.echo, looks, observed.updated),
        modes=observed.modes,
        in_doubt=association.in_doubt,
        **model.existence.after(left, before.confirmed, association.own, observed.evidence),
    )


def coast(model: TrackerModel, state: TrackState, k: int) -> TrackState:
    """State just before dwell k, the dwells in between unobserved."""
    while state.k < k - 1:
        coasted = filter_of(model).coasted(model, state, _random(model, state.target, state.k + 1))
        left = state.existence * model.existence.survival(state.belief, coasted.belief)
        state = coasted._replace(k=state.k + 1, existence=left)
    return state


def warm_up(model: TrackerModel) -> TrackState:
    """Track nothing for some dwells: a hit, a gap, misses until the track begins again, and again. Its last state.

    The first call of a compiled kernel loads it, and all of them together take a second.
    """
    n_track = max(model.n_track, 1)
    model, n = replace(model, seed=0, n_track=n_track), model.sensor.n_bin
    scan = Detections.of(
        {
            "k": 0,
            "bins": np.arange(n, dtype=np.int32),
            "statistic": np.where(np.arange(n) == n // 2, 2.0 * model.sensor.threshold, 0.0),
            "alpha_hat": np.full(n, 0.1, dtype=np.complex64),
            "sigma_hat": np.full(n, 0.01),
            "signature_power": np.full(n, 1.0),
            "beams": np.full((n_track, 1), -1, dtype=np.int32),  # so that all cells are this track's
        },
        n,
        model.sensor.threshold,
    )
    if not model.response.is_box:
        ranges_km = np.full(n, 50.0 if model.response.measures_range else 0.0)
        scan = scan._replace(ranges_km=ranges_km, nu_sigmas=np.full(n, 1e-3))
        load_solver()
        nu = float(scan.nus[n // 2])
        expected = np.tile([nu, 1e-3, 50.0, 1.0, 0.5], (n_track, 1))
        told = scan._replace(expected=expected, beam_nus=np.full((n_track, 1), nu))
        share_of(model.response, told, 0)
        unclaimed(model.response, told)
    state = start(model, 0, n // 2, [scan])
    state = observe(model, state, scan._replace(k=1), prepare(model, state))
    state = coast(model, state, 3)
    for k in range(3, 3 + WARM_UP_MISSES):
        state = observe(model, state, scan._replace(k=k, statistic=np.zeros(n)))
    return state


def _learned_echo(model: TrackerModel, echo: float, looks: Looks, belief: Belief) -> float:
    """What a look tells of how strong the echoes are, with the belief after it."""
    law, least = model.sensor.law, model.least_echo
    if looks.is_hit:
        return law.echo_after_hit(echo, looks.amplitude, looks.hit_sigma, least)
    return law.echo_after_miss(echo, looks.limit, looks.sigma, lambda: shares_looked_at(looks, belief.sample()), least)


def _random(model: TrackerModel, target: int, k: int, state: Any = None) -> Random:
    """What makes the generator of a track and dwell, in a state in which it was left."""

    def make() -> np.random.Generator:
        made = generator(model.seed, Purpose.BELIEF, target, k)
        if state is not None:
            made.bit_generator.state = state
        return made

    return make
