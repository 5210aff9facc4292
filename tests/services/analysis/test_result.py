"""A stored run as arrays: they are what its messages say, and its beliefs are those that its planners had."""

from collections.abc import Iterator
from functools import partial

import numpy as np
import pytest

from cogradar.services.analysis.arrays.result import Result
from cogradar.services.analysis.stored_run import StoredRun
from cogradar.services.errors import BadInput
from cogradar.services.metrics import messages as pages
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.recording import take
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.runs import in_process
from cogradar.shared.protocol.messages import Plan, RunStart, Scan, Truth, Waveform
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.signal.array import bin_centres
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.tracking.motion import mean_state
from cogradar.shared.wire.codec import decode

DWELLS, TARGETS, BINS, ANTENNAS = 40, 2, 16, 16
SMOKE = load("smoke")


@pytest.fixture(scope="module")
def store() -> Iterator[Store]:
    made = in_memory()
    for strategy in (Strategy.ORTHOGONAL, Strategy.POWER_AWARE):
        in_process.play(RunStart.of(SMOKE, strategy, 4, DWELLS), store=made)
    yield made
    made.close()


def _result(store: Store, strategy: Strategy = Strategy.POWER_AWARE) -> Result:
    (row,) = answer(store, "runs", {"strategy": strategy})
    return Result(StoredRun(partial(answer, store), row["run"]))


@pytest.fixture(scope="module")
def result(store: Store) -> Result:
    return _result(store)


def test_the_newest_run_is_meant_if_none_is_named(store: Store, result: Result) -> None:
    newest = Result(StoredRun(partial(answer, store)))
    assert (newest.run, newest.seed, newest.status) == (result.run, 4, "complete")
    assert newest.t.tolist() == list(range(1, DWELLS + 1))
    assert newest.times_s.tolist() == [t * SMOKE.radar.motion.dt_s for t in newest.t]


def test_beliefs_are_those_of_the_planners(result: Result) -> None:
    """Bit for bit: a track is a function of the scans."""
    for target, dwell in ((1, 1), (2, 17), (1, DWELLS)):
        particles = result.particles(target, dwell)
        assert particles.shape == (SMOKE.radar.belief.n_particle, 4)
        assert np.array_equal(mean_state(particles), result.estimates[dwell - 1, target - 1])
        covariance = result.covariance[dwell - 1, target - 1]
        assert covariance == pytest.approx(np.cov(particles.T, bias=True), rel=1e-12)
    assert result.covariance.shape == (DWELLS, TARGETS, 4, 4)
    assert np.linalg.eigvalsh(result.covariance).min() > 0.0


@pytest.mark.parametrize("strategy", [Strategy.ORTHOGONAL, Strategy.POWER_AWARE])
def test_statistics_are_those_of_the_cells_that_were_tested(strategy: Strategy, store: Store) -> None:
    result = _result(store, strategy)
    assert result.statistics.shape == result.alpha_hat.shape == result.sigma_hat.shape == (DWELLS, BINS)
    if strategy is Strategy.ORTHOGONAL:
        assert result.tested.all()
    else:
        beams = [set(row) for row in result.bins.tolist()]
        assert [set(np.flatnonzero(row)) for row in result.tested] == beams
    at_target = np.take_along_axis(result.statistics, result.true_bins, axis=1)
    assert np.array_equal(at_target >= threshold(SMOKE.radar.detector.p_fa), result.detected)
    known = result.tested
    assert result.statistics[known] == pytest.approx(
        2.0 * (np.abs(result.alpha_hat[known]) / result.sigma_hat[known]) ** 2, rel=1e-5
    )


def test_beampatterns_have_the_power_that_the_tracks_asked_for(store: Store) -> None:
    flat = _result(store, Strategy.ORTHOGONAL)
    nu = bin_centres(BINS)
    assert flat.factors.shape == (DWELLS, ANTENNAS, 0)
    assert flat.beampatterns(nu) == pytest.approx(np.ones((DWELLS, BINS)))
    result = _result(store)
    assert result.isotropic.tolist() == [0.0] * DWELLS
    power = np.sum(np.abs(result.factors) ** 2, axis=(1, 2))
    assert power == pytest.approx(np.full(DWELLS, SMOKE.radar.array.power), rel=1e-5)
    assert result.beampatterns(nu).argmax(axis=1).tolist() == pytest.approx(
        result.bins[np.arange(DWELLS), result.shares.argmax(axis=1)].tolist()
    )


@pytest.mark.parametrize("nu", [0.51, [0.0, -0.7], [np.nan]])
def test_directions_that_there_are_not_are_bad_input(nu: float | list[float], result: Result) -> None:
    with pytest.raises(BadInput, match=r"^nu = (0\.51|-0\.7|nan): must be -0\.5 \.\. 0\.5, half the sine"):
        result.beampatterns(nu)


def test_pages_of_messages_are_bounded_and_together_the_whole(
    store: Store, result: Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    stored, topics = StoredRun(partial(answer, store), result.run), ("plan", "scan", "truth", "waveform")
    whole = list(stored.messages(*topics))
    assert [k for k, _ in whole] == list(range(len(whole)))
    kinds = {type(decode(payload)) for _, payloads in whole for payload in payloads}
    assert kinds == {Plan, Scan, Truth, Waveform}
    monkeypatch.setattr(pages, "PAGE_BYTES", 4000)
    parameters = {"run": result.run, "topics": "scan,waveform"}
    (first, *more) = answer(store, "messages", parameters)
    assert (first["k"], 1 + len(more)) == (0, pages.AT_ONCE)
    assert list(stored.messages(*topics)) == whole


def test_what_is_not_there_is_bad_input(store: Store, result: Result) -> None:
    for target, dwell, words in (
        (0, 1, "target = 0"),
        (3, 1, "target = 3"),
        (1, 0, "dwell = 0"),
        (1, 99, "dwell = 99"),
    ):
        with pytest.raises(BadInput, match=words):
            result.particles(target, dwell)
    for run, words in (("nobody", "no such run"), ("all", "one run, please")):
        with pytest.raises(BadInput, match=words):
            StoredRun(partial(answer, store), run)
    for parameters in (
        {"run": result.run},
        {"run": result.run, "topics": "snapshot"},
        {"topics": "scan", "colour": "x"},
    ):
        with pytest.raises(BadInput, match="`messages` takes"):
            answer(store, "messages", parameters)
    with pytest.raises(BadInput, match="there is no run yet"):
        StoredRun(partial(answer, in_memory()))


def test_a_campaigns_run_has_its_scores_and_says_what_it_lacks(store: Store, result: Result) -> None:
    kept, recording = in_memory(), take(store, result.run)
    assert recording is not None
    kept.journal.add_recording(recording, 1)
    other = Result(StoredRun(partial(answer, kept)))
    assert np.array_equal(other.true_states, result.true_states)
    assert np.array_equal(other.shares, result.shares)
    with pytest.raises(BadInput, match="no scan is stored"):
        _ = other.statistics
    with pytest.raises(BadInput, match="no plan is stored"):
        _ = other.covariance
    with pytest.raises(BadInput, match="no scan is stored"):
        other.particles(1, 5)
    known = ~np.isnan(other.isotropic)
    assert np.flatnonzero(known).tolist() == [DWELLS // 4 - 1, 2 * DWELLS // 3 - 1, DWELLS - 1]
    assert np.array_equal(other.factors[known], result.factors[known])


def test_a_run_that_has_not_begun_to_track_is_empty(result: Result) -> None:
    begun = in_memory()
    begun.journal.add_run(RunStart.of(SMOKE, Strategy.UNIFORM, 1, 5))
    empty = Result(StoredRun(partial(answer, begun)))
    assert repr(empty) == f"<Result {empty.run}: uniform, seed 1, 0 dwells of {TARGETS} targets, running>"
    assert (empty.status, empty.t.size, empty.true_states.shape) == ("running", 0, (0, TARGETS, 4))
    assert (empty.statistics.shape, empty.covariance.shape) == ((0, BINS), (0, TARGETS, 4, 4))
    assert empty.status != result.status
