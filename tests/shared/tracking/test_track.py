"""One track: all that `fidelity` fills in reaches the belief; randomness is keyed by dwell; a state never changes.

Each setting is seen through the track, from scans alone: the parts that it is passed on to have tests of their own.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.tracking import track
from cogradar.shared.tracking.acquisition import Candidates
from cogradar.shared.tracking.belief.likelihood import Looks
from cogradar.shared.tracking.belief.particle_filter import Update, condition, predict, reject, update
from cogradar.shared.tracking.model import TrackerModel, TrackState
from cogradar.shared.tracking.motion import mean_state
from cogradar.shared.tracking.track import coast, observe, prepare, start, warm_up
from tests.shared.tracking.models import in_bins, smoke_model
from tests.shared.tracking.scans import (
    ACQUISITION,
    ALPHA,
    BIN,
    HIT,
    LAST,
    MISS,
    N_BIN,
    OTHER,
    SEED,
    TARGET,
    scan_of,
    with_beams,
)


def started(model: TrackerModel) -> TrackState:
    return start(model, TARGET, BIN, ACQUISITION)


def observed(hit: bool, sigma: float) -> Looks:
    """What a scan of one cell tells the track, by hand: the amplitude is |alpha_hat| in units of sigma_hat."""
    sigmas = np.zeros(N_BIN)
    sigmas[BIN] = sigma
    return in_bins(BIN if hit else -1, float(np.float32(ALPHA)) / sigma if hit else 0.0, sigmas)


def belief_rng(k: int) -> np.random.Generator:
    return generator(SEED, Purpose.BELIEF, TARGET, k)


def content(state: TrackState) -> list[Any]:
    """All of a state, for comparison bit for bit."""
    values = list(state)
    return [(v.shape, v.tobytes()) if isinstance(v, np.ndarray) else repr(v) for v in values]


@pytest.mark.parametrize("fidelity", ["paper", "robust"])
def test_strong_targets_are_acquired_at_once_and_weak_ones_by_several_scans(fidelity: str) -> None:
    """One rule for both fidelities, so that they can be compared from t = 0 on."""
    model = smoke_model(fidelity)
    weaker = [scan_of(k, [OTHER, BIN], power=16.0, sigma_hat=0.5) for k in range(6)]  # statistics of 13
    found = [Candidates(model, scans).bins() for scans in (ACQUISITION[:1], weaker[:1], weaker)]
    assert [None if bins is None else bins.tolist() for bins in found] == [[OTHER, BIN], None, [OTHER, BIN]]


@pytest.mark.parametrize("fidelity", ["paper", "robust"])
def test_the_belief_is_updated_as_the_fidelity_says(fidelity: str) -> None:
    model = smoke_model(fidelity)
    state, hit = started(model), observed(True, 0.09)

    def resampled() -> Update:
        rng = belief_rng(HIT.k)
        return condition(model, predict(model.motion, state.belief.rows, rng), hit, rng)

    expected = {"paper": reject(model, state.belief.rows, hit, belief_rng(HIT.k)), "robust": resampled()}
    after = observe(model, state, HIT)
    for name, result in expected.items():
        assert np.array_equal(after.belief.rows, result.particles) == (name == fidelity)


@pytest.mark.parametrize(("fidelity", "jittered"), [("paper", False), ("robust", True)])
def test_the_kernel_of_the_fidelity_tells_copies_of_one_ancestor_apart(fidelity: str, jittered: bool) -> None:
    """Both with resampling: without a kernel a surprising hit leaves copies."""
    model = smoke_model(fidelity)
    model = replace(model, belief=model.belief.model_copy(update={"filter": "likelihood"}))
    after = observe(model, started(model), HIT)
    distinct = np.unique(after.belief.rows, axis=0).shape[0]
    assert (distinct == after.belief.rows.shape[0]) == jittered


@pytest.mark.parametrize(("fidelity", "sigma"), [("paper", 0.09), ("robust", 0.5)])
def test_a_miss_is_read_with_the_noise_that_the_fidelity_says(fidelity: str, sigma: float) -> None:
    """The last detection's sigma_hat, or that of this dwell."""
    model = smoke_model(fidelity)
    state = observe(model, started(model), HIT)
    after = observe(model, state, MISS)
    expected = update(model, state.belief.rows, observed(False, sigma), belief_rng(MISS.k))
    np.testing.assert_array_equal(after.belief.rows, expected.particles)
    assert not after.detected


def test_a_state_is_not_changed_by_what_is_made_of_it() -> None:
    model = smoke_model("robust")
    states, before = [started(model)], list[Any]()
    for scan in (HIT, MISS, MISS._replace(k=MISS.k + 1)):
        before.append(content(states[-1]))
        prediction = prepare(model, states[-1])
        once, again = (observe(model, states[-1], scan, prediction) for _ in range(2))
        assert content(once) == content(again)
        states.append(coast(model, once, scan.k + 1))
    assert [content(state) for state in states[:-1]] == before


def test_a_prediction_made_ahead_changes_nothing() -> None:
    model = smoke_model("robust")
    plain = prepared = started(model)
    for scan in (HIT, MISS):
        plain, prepared = observe(model, plain, scan), observe(model, prepared, scan, prepare(model, prepared))
        assert content(plain) == content(prepared)
    literal = smoke_model("paper")
    assert prepare(literal, started(literal)) is None


def test_a_prediction_of_another_state_or_dwell_is_dropped() -> None:
    model = smoke_model("robust")
    state = started(model)
    coasted, ahead = coast(model, state, MISS.k), prepare(model, state)
    assert content(observe(model, coasted, MISS, ahead)) == content(observe(model, coasted, MISS))
    skipped = observe(model, state, MISS, ahead)  # without the dwell before, nor a word of it
    assert content(skipped) == content(observe(model, state, MISS))


def test_every_draw_is_keyed_by_seed_purpose_target_and_dwell(monkeypatch: pytest.MonkeyPatch) -> None:
    keys: list[tuple[int, Purpose, int, int]] = []

    def keyed(*key: Any) -> np.random.Generator:
        keys.append(key)
        return generator(*key)

    monkeypatch.setattr(track, "generator", keyed)
    model = smoke_model("robust")
    state = started(model)
    for scan in (HIT, MISS):
        state = observe(model, state, scan)
    expected = [(Purpose.INITIATION, LAST), (Purpose.BELIEF, HIT.k), (Purpose.BELIEF, MISS.k)]
    assert keys == [(SEED, purpose, TARGET, k) for purpose, k in expected]


def test_a_track_coasts_over_dwells_that_never_happened() -> None:
    """The mean moves at constant velocity, x(t + n) = x(t) + n dt vx, up to the noise of 500 particles' mean."""
    model, n = smoke_model("robust"), 4
    state = started(model)
    coasted = coast(model, state, LAST + 1 + n)
    before, after = mean_state(state.belief.rows), mean_state(coasted.belief.rows)
    dt, sigma_s = 1.0, 0.004
    noise = 5.0 * sigma_s * n**1.5 / np.sqrt(500)
    assert after[[0, 2]] == pytest.approx(before[[0, 2]] + n * dt * before[[1, 3]], abs=noise)
    assert after[[1, 3]] == pytest.approx(before[[1, 3]], abs=noise)
    assert coasted.k == LAST + n
    assert observe(model, coasted, HIT._replace(k=LAST + 1 + n)).detected


@pytest.mark.parametrize("name", ["smoke", "paper"])
def test_warming_up_meets_a_track_that_begins_again_more_than_once(name: str) -> None:
    """So every kernel that a run in real time may need is loaded before it begins."""
    assert warm_up(TrackerModel.of(load(name).radar, Strategy.POWER_AWARE, SEED)).attempts >= 2


@pytest.mark.parametrize("fidelity", ["paper", "robust"])
def test_a_dwell_without_a_beam_is_no_miss(fidelity: str) -> None:
    """The track coasts, as over a dwell of which nothing is known; misses in a row go on where they were."""
    model = smoke_model(fidelity)
    state = observe(model, observe(model, started(model), HIT), MISS)
    unlit = with_beams(MISS._replace(k=MISS.k + 1), np.array([[OTHER], [-1]], dtype=np.int32))
    after = observe(model, state, unlit, prepare(model, state))
    assert content(after) == content(coast(model, state, unlit.k + 1)._replace(detected=False, depleted=False))
    assert (after.k, after.log_evidence, after.attempts) == (unlit.k, state.log_evidence, state.attempts)
    assert observe(model, started(model), HIT).detected
    assert not observe(model, observe(model, started(model), HIT), unlit._replace(k=HIT.k + 1)).detected
