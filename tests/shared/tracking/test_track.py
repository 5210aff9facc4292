"""One track: all that `fidelity` fills in reaches the belief and the decision; randomness is keyed by dwell.

Each setting is seen through the Track, from scans alone: the parts that it is passed on to have tests of their own.
"""

import tomllib
from typing import Any

import numpy as np
import pytest

from shared.numerics.seeds import Purpose, generator
from shared.planning.policies import searched_bin
from shared.planning.radar_pomdp import RadarPomdp
from shared.protocol.messages import Scan
from shared.scenario.scenario import FIDELITY, SCENARIO_DIR, PlannerSection, Scenario, Strategy, load, parse
from shared.signal.receiver import threshold
from shared.tracking import track as tracks
from shared.tracking.particle_filter import Motion, Observation, Sensor, update, update_rejection, update_resample
from shared.tracking.recovery import reacquire
from shared.tracking.track import Track, confirmed_bins, rehearse

SEED, TARGET, BIN, OTHER = 5, 1, 9, 3
N_BIN, RANGE_KM = 16, 50.0
ALPHA = 10.0 ** (70.0 / 20.0) / RANGE_KM**2  # 1.26, the scenario's echo at that range
LAST = 2  # dwell of the last acquisition scan


def _scenario(fidelity: str, **belief: Any) -> Scenario:
    """The small scenario with all that a fidelity stands for, some settings of the belief changed."""
    document = tomllib.loads((SCENARIO_DIR / "smoke.toml").read_text(encoding="utf-8"))
    document["belief"] |= belief
    return parse(document | {"fidelity": fidelity}, source="smoke")


def _scan(k: int, detected: list[int], power: float, sigma_hat: float, bins: list[int] | None = None) -> Scan:
    """Cells, those of `detected` with an echo as strong as expected at RANGE_KM, the others with nothing."""
    cells = np.array(sorted(bins or range(N_BIN)), dtype=np.int32)
    alpha_hat = np.where(np.isin(cells, detected), ALPHA, 0.0).astype(np.complex64)
    return Scan(
        run="r",
        k=k,
        t=0 if bins is None else k - LAST,
        bins=cells,
        statistic=2.0 * np.abs(alpha_hat.astype(np.complex128)) ** 2 / sigma_hat**2,
        alpha_hat=alpha_hat,
        sigma_hat=np.full(cells.size, sigma_hat),
        signature_power=np.full(cells.size, power),
        beams=np.array([-1, -1] if bins is None else [OTHER, BIN], dtype=np.int32),
    )


ACQUISITION = [_scan(k, [OTHER, BIN], power=16.0, sigma_hat=0.25) for k in range(LAST + 1)]
HIT = _scan(LAST + 1, [OTHER, BIN], power=128.0, sigma_hat=0.09, bins=[OTHER, BIN])
MISS = _scan(LAST + 2, [OTHER], power=4.0, sigma_hat=0.5, bins=[OTHER, BIN])
SURE = threshold(1e-4)


def _track(scenario: Scenario, strategy: Strategy = Strategy.UNIFORM) -> Track:
    return Track(scenario, strategy, SEED, TARGET, BIN, ACQUISITION)


def _parts(scenario: Scenario) -> tuple[Sensor, Motion]:
    motion = scenario.motion
    return Sensor(N_BIN, scenario.echo.amplitude_db, SURE), Motion(motion.dt_s, motion.sigma_s_km_s2)


def _observation(hit: bool, sigma: float) -> Observation:
    """What a scan of one cell tells the track, by hand: the level is |alpha_hat| in steps of sqrt 3 sigma_hat."""
    sigmas = np.zeros(N_BIN)
    sigmas[BIN] = sigma
    return Observation(BIN if hit else -1, int(np.float32(ALPHA) / (np.sqrt(3.0) * sigma)) if hit else 0, sigmas)


def _rng(purpose: Purpose, k: int) -> np.random.Generator:
    return generator(SEED, purpose, TARGET, k)


def test_confirmations_are_the_scans_that_a_target_must_be_seen_in() -> None:
    assert {name: settings["acquisition"]["confirmations"] for name, settings in FIDELITY.items()} == {
        "paper": 1,
        "robust": 2,
    }
    for fidelity, needed in (("paper", 1), ("robust", 2)):
        scenario = _scenario(fidelity)
        assert confirmed_bins(scenario, ACQUISITION[: needed - 1] or [_scan(0, [BIN], 16.0, 0.25)]) is None
        found = confirmed_bins(scenario, ACQUISITION[:needed])
        assert found is not None
        assert found.tolist() == [OTHER, BIN]


@pytest.mark.parametrize(("fidelity", "update_"), [("paper", "rejection"), ("robust", "resample")])
def test_the_belief_is_updated_as_the_fidelity_says(fidelity: str, update_: str) -> None:
    scenario = _scenario(fidelity)
    track, (sensor, motion) = _track(scenario), _parts(scenario)
    before, observed, belief = track.particles.copy(), _observation(True, 0.09), scenario.belief
    track.observe(HIT)
    rejected = update_rejection(before, observed, sensor, motion, belief.max_tries, _rng(Purpose.BELIEF, HIT.k))
    resampled = update_resample(before, observed, sensor, motion, 0.3, _rng(Purpose.BELIEF, HIT.k))
    expected = {"rejection": rejected, "resample": resampled}
    for name, result in expected.items():
        assert np.array_equal(track.particles, result.particles) == (name == update_)


@pytest.mark.parametrize(("fidelity", "jittered"), [("paper", False), ("robust", True)])
def test_the_kernel_of_the_fidelity_tells_copies_of_one_ancestor_apart(fidelity: str, jittered: bool) -> None:
    """Both with resampling: without a kernel a surprising hit leaves copies."""
    track = _track(_scenario(fidelity, update="resample"))
    track.observe(HIT)
    distinct = np.unique(track.particles, axis=0).shape[0]
    assert (distinct == track.particles.shape[0]) == jittered


@pytest.mark.parametrize(("fidelity", "sigma"), [("paper", 0.09), ("robust", 0.09 * np.sqrt(128.0 / 4.0))])
def test_a_miss_is_read_with_the_noise_that_the_fidelity_remembers(fidelity: str, sigma: float) -> None:
    """The last detection's sigma_hat itself, or scaled to the waveform of this dwell: sigma ~ 1/||v||."""
    scenario = _scenario(fidelity)
    track, (sensor, motion) = _track(scenario), _parts(scenario)
    track.observe(HIT)
    before = track.particles.copy()
    track.observe(MISS)
    settings = (scenario.belief, scenario.acquisition, _rng(Purpose.BELIEF, MISS.k))
    expected = update(before, _observation(False, sigma), sensor, motion, *settings)
    np.testing.assert_array_equal(track.particles, expected.particles)
    assert not track.decide().detected


@pytest.mark.parametrize(("fidelity", "predicts"), [("paper", False), ("robust", True)])
def test_a_prediction_made_ahead_changes_nothing(fidelity: str, predicts: bool) -> None:
    plain, prepared = _track(_scenario(fidelity)), _track(_scenario(fidelity))
    for scan in (HIT, MISS):
        assert [prepared.prepare(), prepared.prepare()] == [predicts, False]
        for track in (plain, prepared):
            track.observe(scan)
        np.testing.assert_array_equal(prepared.particles, plain.particles)
        assert prepared.decide().bin == plain.decide().bin


def test_a_prediction_of_another_dwell_is_dropped() -> None:
    plain, prepared = _track(_scenario("robust")), _track(_scenario("robust"))
    prepared.prepare()
    for track in (plain, prepared):
        track.coast(MISS.k)
        track.observe(MISS)
    np.testing.assert_array_equal(prepared.particles, plain.particles)
    skipping, other = _track(_scenario("robust")), _track(_scenario("robust"))
    skipping.prepare()
    for track in (skipping, other):
        track.observe(MISS)  # without the dwell before, nor a word of it
    np.testing.assert_array_equal(skipping.particles, other.particles)


class Planned:
    """Stands for the planner: what it was asked with, and how many numbers it drew."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.sigma: list[float] = []
        self.states: list[Any] = []
        monkeypatch.setattr(tracks, "searched_bin", self)

    def __call__(self, problem: RadarPomdp, planner: PlannerSection, rng: Any, has_time: None) -> Any:
        self.sigma.append(_parts(_scenario("robust"))[0].amplitude / problem.gain)
        result = searched_bin(problem, planner, rng, has_time)
        self.states.append(rng.bit_generator.state["state"]["state"].tolist())
        return result


@pytest.mark.parametrize(("fidelity", "sigma"), [("paper", 0.09), ("robust", 0.09 * np.sqrt(128.0 / 4.0))])
def test_the_search_expects_the_noise_that_the_fidelity_remembers(
    fidelity: str, sigma: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    planned, track = Planned(monkeypatch), _track(_scenario(fidelity))
    track.observe(HIT)
    track.observe(MISS)
    track.decide()
    assert planned.sigma == [pytest.approx(sigma, rel=1e-12)]


def test_the_rollout_of_the_fidelity_reaches_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Random rollouts draw numbers, their mean draws none: the two leave the generator in different states."""
    planned, robust = Planned(monkeypatch), _scenario("robust")
    assert {name: settings["planner"]["rollout"] for name, settings in FIDELITY.items()} == {
        "paper": "random",
        "robust": "mean",
    }
    literal = robust.model_copy(update={"planner": _scenario("paper").planner})
    for scenario in (robust, literal, robust):
        _track(scenario).decide()
    assert planned.states[0] == planned.states[2] != planned.states[1]


def test_every_draw_is_keyed_by_seed_purpose_target_and_dwell(monkeypatch: pytest.MonkeyPatch) -> None:
    keys: list[tuple[int, Purpose, int, int]] = []

    def keyed(*key: Any) -> np.random.Generator:
        keys.append(key)
        return generator(*key)

    monkeypatch.setattr(tracks, "generator", keyed)
    track = _track(_scenario("robust"))
    track.decide()
    for scan in (HIT, MISS):
        track.observe(scan)
        track.decide()
    expected = [(Purpose.INITIATION, LAST), (Purpose.SEARCH, LAST)]
    expected += [(purpose, k) for k in (HIT.k, MISS.k) for purpose in (Purpose.BELIEF, Purpose.SEARCH)]
    assert keys == [(SEED, purpose, TARGET, k) for purpose, k in expected]


def test_the_orthogonal_strategy_searches_nothing_and_says_where_the_belief_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracks, "searched_bin", lambda *_: pytest.fail("searched"))
    decision = _track(_scenario("robust"), Strategy.ORTHOGONAL).decide()
    assert decision.bin == BIN
    assert decision.range_km == pytest.approx(np.hypot(decision.estimate[0], decision.estimate[2]), abs=1.0)


def test_a_track_coasts_over_dwells_that_never_happened() -> None:
    """The mean moves at constant velocity, x(t + n) = x(t) + n dt vx, up to the noise of 500 particles' mean."""
    track, n = _track(_scenario("robust")), 4
    before = track.decide().estimate
    track.coast(LAST + 1 + n)
    after = track.decide().estimate
    dt, sigma_s = 1.0, 0.004
    noise = 5.0 * sigma_s * n**1.5 / np.sqrt(500)
    assert after[[0, 2]] == pytest.approx(before[[0, 2]] + n * dt * before[[1, 3]], abs=noise)
    assert after[[1, 3]] == pytest.approx(before[[1, 3]], abs=noise)
    track.observe(HIT.model_copy(update={"k": LAST + 1 + n}))  # goes on with the next scan


def test_a_rehearsal_meets_a_track_that_begins_again_more_than_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """So every kernel that a run in real time may need is loaded before it begins."""
    attempts: list[int] = []

    def observed(memory: Any, *arguments: Any) -> Any:
        updated = reacquire(memory, *arguments)
        attempts.append(memory.attempts)
        return updated

    monkeypatch.setattr(tracks, "reacquire", observed)
    for scenario in (load("smoke"), load("paper")):
        attempts.clear()
        rehearse(scenario, Strategy.POWER_AWARE)
        assert max(attempts) >= 2
