"""The belief of one target: an unweighted particle filter (Bouhou et al. 2025, "The unweighted particle filter").

    predict -> likelihood table -> weigh -> resample -> regularise -> recover

Symbols: B_t belief, n particles [x, vx, y, vy]; o observation; Z = P(o | B_t) evidence; n_eff = (sum w)^2 / sum w^2
effective sample size of weights w; h bandwidth of the regularising kernel, in units of the belief's own standard
deviation.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.elementwise import hypot, power
from cogradar.shared.numerics.linear import inner, product
from cogradar.shared.tracking.belief.likelihood import Likelihood, Looks, likelihood_of, of_any_amplitude
from cogradar.shared.tracking.belief.rejection import accepted, sample_by_rejection
from cogradar.shared.tracking.belief.resampling import (
    DIM,
    Weighted,
    moments,
    optimal_bandwidth,
    regularise,
    resample,
    tempered,
    weigh,
)
from cogradar.shared.tracking.initiation import doubted, redraw, turn
from cogradar.shared.tracking.model import TrackerModel
from cogradar.shared.tracking.motion import (
    CERTAINLY_HARD,
    Motion,
    has_turns,
    modes_told,
    predicted_bins,
    propagate_into,
)
from cogradar.shared.tracking.sensor import STEP

_WIDENINGS = 4  # tries to explain a miss
IMPROBABLE = 0.05  # evidence of a detection: below, wide looks make another velocity be thought of
# ... which is believed if it explains the detection by so much better: aircraft seldom turn hard. Where directions are
# measured, chance alone makes one detection in 300 ten times likelier.
FAR_LIKELIER, FAR_LIKELIER_MEASURED = 10.0, 100.0
MIN_ESS_FRACTION = 0.1  # n_eff, of all particles, below which a detection is taken in by stages,
STAGE_ESS_FRACTION = 0.3  # ... and that each of them leaves
_STAGES, _HALVINGS = 12, 12
EXPECTED = 0.05  # share of the particles that makes a detection in their bin an expected one


class Update(NamedTuple):
    """Belief after a dwell, and whether its observation had to be explained by a recovery."""

    particles: NDArray[np.float64]  # (n, 4)
    depleted: bool
    evidence: float  # Z, how probable the observation was before any recovery
    modes: NDArray[np.float64]  # (3,) probabilities of the modes of motion


def update(
    model: TrackerModel,
    particles: NDArray[np.float64],
    looks: Looks,
    rng: np.random.Generator,
    predicted: NDArray[np.float64] | None = None,
) -> Update:
    """Belief after one dwell, B_{t+1} from B_t and o_{t+1}; never fails.

    particles : (n, 4) of B_t
    predicted : (n, 4) what `predict` made of them with the same generator, if it was called before
    """
    step = STEPS[model.belief.filter]
    predicted = step.ahead(model.motion, particles, rng) if predicted is None else predicted
    posterior = step.posterior(model, particles if predicted is None else predicted, looks, rng)
    if model.wide_looks and looks.is_hit and (posterior.depleted or posterior.evidence < IMPROBABLE):
        posterior = _turned(model, posterior, looks, rng, predicted)
    return recover(model, posterior, looks, rng) if posterior.depleted else posterior


def _turned(
    model: TrackerModel,
    posterior: Update,
    looks: Looks,
    rng: np.random.Generator,
    predicted: NDArray[np.float64] | None,
) -> Update:
    """The belief of a target that has turned, if that explains a detection far better; else the posterior as it is.

    If nothing explains the detection, the target may still have turned: recovery begins with doubted velocities.
    """
    if not posterior.depleted and predicted is None:
        return posterior
    particles = doubted(model, posterior.particles if predicted is None else predicted, rng)
    other = condition(model, particles, looks, rng)
    if other.depleted:
        return posterior._replace(particles=particles, evidence=other.evidence) if posterior.depleted else posterior
    needed = FAR_LIKELIER_MEASURED if looks.nu_sigma > 0.0 else FAR_LIKELIER
    is_better = posterior.depleted or other.evidence > needed * posterior.evidence
    return other._replace(evidence=posterior.evidence, modes=CERTAINLY_HARD) if is_better else posterior


def predict(motion: Motion, particles: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Particles one dwell later, before its observation; (n, 4) -> (n, 4)."""
    predicted = np.empty_like(particles)
    propagate_into(particles, motion, rng, predicted)
    return predicted


def condition(model: TrackerModel, predicted: NDArray[np.float64], looks: Looks, rng: np.random.Generator) -> Update:
    """Weight predicted particles, (n, 4), with the observation, resample and regularise them; as they are if depleted.

    Nothing explains the observation if rejection would be expected to keep less than one particle in all its n
    max_tries draws, n max_tries Z < 1: both updates then give up on the same evidence. With a kernel, also if n_eff
    is below 5: fewer than d + 1 points span no volume, and their covariance says nothing about the belief's.
    """
    likelihood = likelihood_of(model.sensor, looks)
    if looks.is_hit and model.hears_others:
        likelihood = likelihood._replace(foreign=_foreign(model, predicted, looks))
    return _conditioned(model, predicted, likelihood, rng)


def _foreign(model: TrackerModel, predicted: NDArray[np.float64], hit: Looks) -> float:
    """Probability of a detection's amplitude r if it is another target's echo, wherever the own one is.

        (M - 1) / n_bin  p(r),   p(r) = R / (2 r (R_max - R_min)),   r = |alpha(R)| / sigma, R uniform

    times a level's width, as for the own echo. With cells of their own choice tracks come upon the echoes of
    others. A detection that was not expected in its bin is the own one all the same: it was looked for there. If
    nothing is known of the RCS no amplitude is another's.
    """
    n_bin, prior = model.sensor.n_bin, model.acquisition
    there = predicted_bins(predicted, n_bin, 0.0)[hit.hit_bin]
    if there < EXPECTED * predicted.shape[0]:
        return 0.0
    range_km = np.sqrt(model.sensor.amplitude / hit.hit_sigma / hit.amplitude)
    density = range_km / (2.0 * hit.amplitude * (prior.range_max_km - prior.range_min_km))
    return float(STEP * (model.n_track - 1) / n_bin * density)


def _conditioned(
    model: TrackerModel,
    predicted: NDArray[np.float64],
    likelihood: Likelihood,
    rng: np.random.Generator,
) -> Update:
    """`condition` on what has this likelihood."""
    bandwidth = model.belief.kernel_bandwidth
    weighted = weigh(predicted, likelihood)
    evidence = weighted.total / predicted.shape[0]
    if weighted.total * model.belief.max_tries < 1.0:
        return Update(predicted, depleted=True, evidence=evidence, modes=model.modes)
    modes = modes_told(weighted.weights, model.motion)
    if weighted.is_uniform:  # the observation says nothing; resampling and jitter would only add noise
        return Update(predicted, depleted=False, evidence=evidence, modes=modes)
    n_eff = weighted.total * weighted.total / weighted.total_sq
    if bandwidth > 0.0 and n_eff < DIM + 1:
        return Update(predicted, depleted=True, evidence=evidence, modes=model.modes)
    if bandwidth > 0.0 and not has_turns(model.motion):
        weighted = _in_stages(weighted, likelihood, rng)
        n_eff = weighted.total * weighted.total / weighted.total_sq
    ancestors = resample(weighted, rng.random())
    if bandwidth == 0.0:
        return Update(predicted[ancestors], depleted=False, evidence=evidence, modes=modes)
    h = bandwidth * optimal_bandwidth(n_eff)
    moved = regularise(weighted, ancestors, h, likelihood, rng)
    return Update(moved, depleted=False, evidence=evidence, modes=modes)


def _in_stages(weighted: Weighted, likelihood: Likelihood, rng: np.random.Generator) -> Weighted:
    """Weights of a sharp detection, of which enough particles have a part: taken in by and by if these were too few.

        w = w^b_1 w^b_2 .., sum b_i = 1, b_i as large as n_eff >= STAGE_ESS_FRACTION n allows    (Musso et al. 2001)

    Between two stages the particles are resampled and moved by the optimal kernel. The few that a surprising detection
    leaves, weighed at once, say little of the covariance of a belief, and each dwell that builds on them makes it
    smaller. (Of a mixture of motions few particles turn, and are meant to be the few: a kernel would blend them with
    the others. So it would the two sides of a cell, where a direction is not measured.)
    """
    if likelihood.hit < 0 or likelihood.nu_precision == 0.0:
        return weighted
    rest, n, at_once = 1.0, weighted.weights.size, weighted
    for _ in range(_STAGES):
        if weighted.total * weighted.total >= MIN_ESS_FRACTION * n * weighted.total_sq:
            return weighted
        share = _stage(weighted.weights, n)
        part = tempered(weighted, share)
        h = optimal_bandwidth(part.total * part.total / part.total_sq)
        states = regularise(part, resample(part, rng.random()), h, likelihood, rng)
        rest *= 1.0 - share
        weighted = tempered(weigh(states, likelihood), rest)
        if weighted.total == 0.0:
            break
    return at_once


def _stage(weights: NDArray[np.float64], n: int) -> float:
    """The largest exponent in 0 .. 1 with which weights leave n_eff >= STAGE_ESS_FRACTION n, by bisection."""
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        part = power(weights, middle)
        low, high = (middle, high) if part.sum() ** 2 >= STAGE_ESS_FRACTION * n * inner(part, part) else (low, middle)
    return low


def recover(model: TrackerModel, posterior: Update, looks: Looks, rng: np.random.Generator) -> Update:
    """A belief that can explain the observation, from one that cannot and is only predicted.

    When no particle explains the observation the belief was wrong, not the receiver. After a hit the target is in
    that bin, wherever the particles are: positions are redrawn there, velocities kept; only bearings are, if a few
    particles did explain it. Where the belief expected its target, and the amplitude alone is what it cannot explain,
    it keeps the ranges of the particles in that bin. Two aircraft in one bin have one echo, and the track of the weaker
    one would follow the stronger one to the end. After a miss it has left the cells looked at: the belief is widened
    until enough of it lies where the target may have gone.
    """
    if looks.is_hit:
        predicted, redrawn = posterior.particles, None
        if predicted.shape[0] * model.belief.max_tries * posterior.evidence >= 1.0:
            redrawn = turn(model, predicted, looks, rng)
        if redrawn is None:
            redrawn = _kept(model, predicted, looks, rng)
        if redrawn is None:
            redrawn = redraw(model, predicted, looks, rng)
        return posterior._replace(particles=redrawn)
    result = posterior
    for _ in range(_WIDENINGS):
        result = condition(model, widen(result.particles, model.sensor.n_bin, rng), looks, rng)
        if not result.depleted:
            break
    return posterior._replace(particles=result.particles)


def _kept(
    model: TrackerModel, predicted: NDArray[np.float64], hit: Looks, rng: np.random.Generator
) -> NDArray[np.float64] | None:
    """Belief, (n, 4), after a detection of which only the place is believed; None if it was not expected there."""
    place = of_any_amplitude(likelihood_of(model.sensor, hit))
    if weigh(predicted, place).total < EXPECTED * predicted.shape[0]:
        return None
    kept = _conditioned(model, predicted, place, rng)
    return None if kept.depleted else kept.particles


def reject(model: TrackerModel, particles: NDArray[np.float64], looks: Looks, rng: np.random.Generator) -> Update:
    """The paper's update, in place of predicting, weighing and resampling.

    If fewer than n are kept in n max_tries draws they are repeated; if none is, the belief is only predicted.
    """
    real, n = accepted(model.sensor, looks), particles.shape[0]
    kept, n_kept, n_try = sample_by_rejection(particles, real, model.motion, model.belief.max_tries, rng)
    if n_kept == 0:
        return Update(predict(model.motion, particles, rng), depleted=True, evidence=0.0, modes=model.modes)
    kept[n_kept:] = kept[np.arange(n - n_kept) % n_kept]
    return Update(kept, depleted=False, evidence=n_kept / n_try, modes=model.modes)


class Step(NamedTuple):
    """How particles take a dwell in, in two steps."""

    ahead: Callable[[Motion, NDArray[np.float64], np.random.Generator], NDArray[np.float64] | None]  # before its scan
    posterior: Callable[[TrackerModel, NDArray[np.float64], Looks, np.random.Generator], Update]  # of what `ahead` made


STEPS = {  # by `radar.belief.filter`
    "likelihood": Step(predict, condition),
    "published": Step(lambda *_: None, reject),  # rejection predicts and weighs in one
}


def widen(particles: NDArray[np.float64], n_bin: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Particles spread out to twice their covariance and by the width of an angle bin at their range.

    The bin's width, 2 R/(n_bin - 1) at boresight, is what separates a cell that was missed from the next one. Without
    it a belief that has collapsed onto one ancestor would stay where it is.
    """
    n = particles.shape[0]
    _, factor = moments(Weighted(particles, np.ones(n), float(n), float(n), is_uniform=True))
    widened = particles + product(rng.standard_normal((n, DIM)), factor.T)
    width = 2.0 / (n_bin - 1) * hypot(particles[:, 0], particles[:, 2])
    widened[:, 0::2] += width[:, None] * rng.standard_normal((n, 2))
    np.maximum(widened[:, 0], 0.0, out=widened[:, 0])
    return np.asarray(widened)
