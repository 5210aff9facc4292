"""Looks in any direction: how probable they are, what they leave of a belief, whose detection it is."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import kstest, truncnorm

from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.signal.array import bin_centres, spatial_frequency
from cogradar.shared.signal.looks import n_range_cells
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.signal.response import FAR_KM, BinResponse, LobeResponse
from cogradar.shared.signal.scan import Detections
from cogradar.shared.tracking.association import associate
from cogradar.shared.tracking.belief.likelihood import Looks, likelihood_of, missed_looks
from cogradar.shared.tracking.belief.particle_filter import condition, update
from cogradar.shared.tracking.belief.resampling import weigh
from cogradar.shared.tracking.initiation import draw_places
from cogradar.shared.tracking.model import TrackerModel, TrackState
from cogradar.shared.tracking.motion import Motion
from cogradar.shared.tracking.sensor import Sensor
from cogradar.shared.tracking.track import Acquisition, observe, start
from tests.oracles import steered as oracle
from tests.shared.tracking.models import in_bins, paper_model, smoke_model

PAPER = paper_model(n_particle=4000)
SENSOR, LIMIT = PAPER.sensor, PAPER.sensor.threshold
LOBE, NARROW = LobeResponse(100, 100, 100, np.inf), LobeResponse(100, 100, 100, 0.5)
NU, RANGE_KM, SIGMA = 0.0657, 60.0, 0.05  # u is 5.5 on axis
EVERYWHERE = 0.0, FAR_KM
STILL = np.array([1.0, 0.0, 1.0, 0.0])


def rng(*seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(seed))


def at(nu: NDArray[np.float64], range_km: NDArray[np.float64], seed: int = 1) -> NDArray[np.float64]:
    """States in these directions and at these ranges, (n, 4), their velocities within 0.35 km/s."""
    x, y = range_km * np.sqrt(1.0 - 4.0 * nu**2), 2.0 * range_km * nu
    velocities = rng(seed).uniform(-0.35, 0.35, (2, nu.size))
    return np.column_stack((x, velocities[0], y, velocities[1]))


def spread(n: int, nu_sigma: float, range_sigma: float, seed: int = 2) -> NDArray[np.float64]:
    generator = rng(seed)
    return at(NU + nu_sigma * generator.standard_normal(n), RANGE_KM + range_sigma * generator.standard_normal(n))


def hit(response: LobeResponse = LOBE, **changed: Any) -> Looks:
    """One look that found an echo, and nothing measured but its amplitude."""
    looks = Looks(response, 0, 5.4, 0.0, 0.0, 0.0, np.array([NU]), np.array([SIGMA]), LIMIT, *EVERYWHERE)
    return looks._replace(**changed)


def miss(*nus: float, gate: tuple[float, float] = EVERYWHERE, sigma: float = SIGMA) -> Looks:
    return missed_looks(LOBE, np.array(nus), np.full(len(nus), sigma), LIMIT, gate)


LOOKS = {
    "a hit": hit(),
    "beside a miss": hit(nus=np.array([NU, NU + 0.012]), sigma=np.array([SIGMA, 0.08])),
    "direction measured": hit(nu_hat=NU + 0.001, nu_sigma=0.002),
    "range measured": hit(NARROW, range_km=60.25, low_km=58.0, high_km=62.0, limit=22.0),
    "both": hit(NARROW, range_km=60.25, nu_hat=NU + 0.001, nu_sigma=0.002, low_km=58.0, high_km=62.0, limit=22.0),
    "misses": miss(NU - 0.006, NU + 0.006),
    "a miss in a gate": miss(NU, gate=(59.0, 61.0)),
}


@pytest.mark.parametrize("exact", [True, False], ids=["amplitude", "level"])
@pytest.mark.parametrize("name", LOOKS)
def test_weights_against_a_loop_over_particles_and_cells(name: str, exact: bool) -> None:
    states, sensor = spread(80, 0.006, 1.0), SENSOR._replace(is_exact=exact)
    weights = weigh(states, likelihood_of(sensor, LOOKS[name])).weights
    expected = oracle.likelihood(states, LOOKS[name], sensor)
    np.testing.assert_allclose(weights, expected, rtol=2e-3, atol=1e-9)  # the tables' stated errors
    assert np.ptp(expected) > 0.2


@pytest.mark.parametrize("is_hit", [True, False])
def test_infinitely_wide_beams_are_bins(is_hit: bool) -> None:
    """One antenna loses nothing anywhere; three bins, and all particles far from the borders of the middle one."""
    sensor = Sensor(n_bin=3, amplitude_db=60.0, threshold=LIMIT, is_exact=True)
    model = replace(PAPER, sensor=sensor, response=BinResponse(3), motion=Motion(1.0, 0.004))
    states, sigma = spread(2000, 0.01, 2.0), np.array([0.0, SIGMA, 0.0])
    in_bin = in_bins(1, 5.4, sigma) if is_hit else in_bins(-1, 0.0, sigma)
    steered = hit(LobeResponse(3, 1, 1, np.inf), nus=np.zeros(1))
    if not is_hit:
        steered = missed_looks(steered.response, np.zeros(1), np.array([SIGMA]), LIMIT, EVERYWHERE)
    one, other = weigh(states, likelihood_of(sensor, in_bin)), weigh(states, likelihood_of(sensor, steered))
    np.testing.assert_array_equal(one.weights, other.weights)
    assert one[2:] == other[2:]
    if is_hit:  # a miss restricts where a kernel may move particles in other ways
        np.testing.assert_array_equal(
            condition(model, states, in_bin, rng(3)).particles, condition(model, states, steered, rng(3)).particles
        )


def test_a_measured_direction_narrows_the_belief_as_kalman_says_and_a_range_to_its_cell() -> None:
    """Gaussian prior and measurement: variances add as precisions; one antenna has no loss off axis to tell more."""
    before, nu_sigma = spread(20_000, 0.002, 0.4, seed=5), 0.001
    looks = hit(LobeResponse(100, 1, 1, 0.5), nus=np.zeros(1), nu_hat=NU + 0.001, nu_sigma=nu_sigma, range_km=60.25)
    after = condition(PAPER, before, looks, rng(6))
    assert not after.depleted
    nu, range_km = spatial_frequency(after.particles), np.hypot(after.particles[:, 0], after.particles[:, 2])
    assert nu.std() == pytest.approx((0.002**-2 + nu_sigma**-2) ** -0.5, rel=0.05)
    assert nu.mean() == pytest.approx(NU + 0.001 * 0.002**2 / (0.002**2 + nu_sigma**2), abs=1e-4)
    assert np.abs(range_km - 60.25).max() <= 0.25
    assert range_km.std() == pytest.approx(truncnorm.std(0.0, 0.5 / 0.4, scale=0.4), rel=0.05)
    unmeasured = condition(PAPER, before, looks._replace(nu_sigma=0.0, range_km=0.0), rng(6)).particles
    assert spatial_frequency(unmeasured).std() == pytest.approx(0.002, rel=0.05)


def test_a_belief_split_by_a_miss_is_not_filled_again() -> None:
    """Two halves on either side of a look in vain, whose common kernel spans it."""
    generator = rng(8)
    side = np.where(generator.random(5000) < 0.5, -1.0, 1.0)
    states = at(NU + side * generator.uniform(0.009, 0.012, 5000), RANGE_KM + 0.2 * generator.standard_normal(5000))
    looks = miss(NU, sigma=0.005)
    after = condition(PAPER, states, looks, rng(9)).particles
    before, likely = (oracle.likelihood(each[::50], looks, SENSOR) for each in (states, after))
    assert likely.min() > 0.4 * before.min()
    assert (np.abs(spatial_frequency(after) - NU) > 0.006).all()


@pytest.mark.parametrize(
    ("looks", "range_sigma"),
    [(hit(nu_hat=NU, nu_sigma=0.0005), None), (hit(NARROW, nu_hat=NU, nu_sigma=0.0005, range_km=60.25), 0.5 / 12**0.5)],
)
def test_a_detection_that_nothing_explains_redraws_about_what_was_measured(
    looks: Looks, range_sigma: float | None
) -> None:
    states = at(np.full(4000, NU + 0.2), np.full(4000, 20.0))
    after = update(PAPER, states, looks, rng(10))
    assert after.depleted
    nu, range_km = spatial_frequency(after.particles), np.hypot(after.particles[:, 0], after.particles[:, 2])
    assert nu.mean() == pytest.approx(NU, abs=5 * 0.0005 / 4000**0.5)
    assert nu.std() == pytest.approx(0.0005, rel=0.1)
    if range_sigma is not None:
        assert range_km.std() == pytest.approx(range_sigma, rel=0.1)
        assert np.abs(range_km - 60.25).max() <= 0.25
    assert range_km.mean() == pytest.approx(RANGE_KM, abs=5.0)
    np.testing.assert_allclose(after.particles[:, 1::2].std(axis=0), 0.35 / 3**0.5, rtol=0.1)  # velocities are kept


def test_a_detection_in_an_unexpected_direction_keeps_the_ranges() -> None:
    """Few particles were expected there: the belief turns."""
    generator = rng(11)
    nus = NU + np.where(np.arange(4000) < 4, 0.0, 0.02) + 0.0005 * generator.standard_normal(4000)
    states = STILL * at(nus, RANGE_KM + 0.3 * generator.standard_normal(4000))
    after = update(PAPER, states, hit(nu_hat=NU, nu_sigma=0.0005), rng(12))
    assert after.depleted
    assert spatial_frequency(after.particles).mean() == pytest.approx(NU, abs=1e-4)
    assert np.hypot(after.particles[:, 0], after.particles[:, 2]).std() == pytest.approx(0.3, rel=0.15)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_direction_measured_beyond_an_end_leaves_the_track_at_its_end(side: float) -> None:
    """Drawn anew about what was measured, it was at the other end, where its target is not."""
    beyond = hit(NARROW, nus=np.array([0.498 * side]), nu_hat=-0.4998 * side, nu_sigma=0.001, range_km=90.25)
    for range_km in (60.0, 90.2):  # a range that the belief did not expect, and one that a few particles have
        nus = (0.47 + 0.003 * rng(5).standard_normal(2000)) * side
        ranges_km = range_km + 0.3 * rng(6).standard_normal(2000)
        after = update(PAPER, at(nus, ranges_km), beyond, rng(7)).particles
        found = spatial_frequency(after) * side
        assert found.min() > 0.49
        assert found.mean() == pytest.approx(0.4992, abs=4e-4)


def test_an_amplitude_that_nothing_explains_keeps_what_is_expected() -> None:
    states = STILL * spread(4000, 0.001, 0.3)
    after = update(PAPER, states, hit(amplitude=60.0, nu_hat=NU, nu_sigma=0.001), rng(13))
    assert after.depleted
    assert np.hypot(after.particles[:, 0], after.particles[:, 2]).mean() == pytest.approx(RANGE_KM, abs=0.1)
    assert spatial_frequency(after.particles).std() == pytest.approx(0.001 / 2**0.5, rel=0.1)


def remembered(looks: Looks, nu: float) -> Looks:
    row = looks.response.row_of(looks.nus, looks.sigma, (looks.limit, looks.low_km, looks.high_km), nu)
    nus, sigma, (limit, *gate) = looks.response.looks_of(row, 0.0)
    return missed_looks(looks.response, nus, sigma, limit, (gate[0], gate[1]))


def test_remembered_looks_are_the_looks() -> None:
    few = miss(0.1, 0.2, gate=(40.0, 44.0))
    back = remembered(few, 0.1)
    assert [np.asarray(a).tolist() for a in back] == [np.asarray(a).tolist() for a in few]
    many = miss(*bin_centres(100).tolist())
    kept = remembered(many, 0.0).nus
    assert np.sort(kept).tolist() == bin_centres(100)[42:58].tolist()


# A whole track, of the small scenario: scans by hand.

BEST, BEST_RANGE = smoke_model("best"), smoke_model("best-range")
CENTRE = float(bin_centres(100)[42])
CENTRES, ALPHA = bin_centres(16), 10.0 ** (70.0 / 20.0) / 50.0**2


def scan(
    k: int,
    echoes: dict[float, float],
    beam_nus: list[list[float]] | None = None,
    gates: list[list[float]] | None = None,
    ranges_km: dict[float, float] | None = None,
) -> Detections:
    """Cells at bin centres, or those of the beams; `echoes` are amplitudes in units of ALPHA by direction."""
    nus = CENTRES if beam_nus is None else np.unique(beam_nus)
    strengths = np.array([echoes.get(nu, 0.0) for nu in nus.tolist()])
    alpha_hat, n = (ALPHA * strengths).astype(np.complex64), nus.size
    beams = np.full((2, 1), -1) if beam_nus is None else np.floor((np.array(beam_nus) + 0.5) * 15 + 0.5)
    return Detections(
        k=k,
        bins=np.floor((nus + 0.5) * 15 + 0.5).astype(np.int32),
        statistic=2.0 * np.abs(alpha_hat.astype(np.complex128)) ** 2 / 0.1**2,
        alpha_hat=alpha_hat,
        sigma_hat=np.full(n, 0.1),
        signature_power=np.full(n, 16.0),
        beams=beams.astype(np.int32),
        nus=nus,
        limits=np.full(n, LIMIT),
        ranges_km=np.array([(ranges_km or {}).get(nu, 0.0) for nu in nus.tolist()]),
        nu_hats=nus,
        nu_sigmas=np.where(strengths > 0.0, 0.002, 0.0),
        beam_nus=np.zeros((2, 1)) if beam_nus is None else np.array(beam_nus),
        gates=np.zeros((2, 2)) if gates is None else np.array(gates),
    )


A, B = CENTRES[3], CENTRES[9]
ACQUISITION = [scan(k, {A: 1.0, B: 1.0}) for k in range(2)]


def begun(model: TrackerModel = BEST, target: int = 1) -> TrackState:
    return start(model, target, (3, 9)[target], ACQUISITION)


def confirmed(model: TrackerModel, scans: list[Detections]) -> NDArray[np.int64] | None:
    """Bins of the tracks after these scans of an acquisition."""
    acquisition = Acquisition(model)
    return [acquisition.add(one) for one in scans][-1]


def associated(model: TrackerModel, state: TrackState, seen: Detections) -> Looks:
    return associate(model, state, seen).looks


def test_a_target_between_two_cells_is_confirmed_in_either_and_is_one_track() -> None:
    between = [scan(0, {A: 1.0, CENTRES[9]: 0.3}), scan(1, {A: 1.0, CENTRES[10]: 0.6, CENTRES[9]: 0.4})]
    assert confirmed(BEST, between[:1]) is None
    found = confirmed(BEST, between)
    assert found is not None
    assert found.tolist() == [3, 10]
    state = start(BEST, 1, 10, between)
    nu = spatial_frequency(state.belief.rows)
    assert CENTRES[9] < nu.mean() < CENTRES[10]
    assert nu.std() < 0.25 / 99  # much better than a bin, of 1 / 99


def test_first_beliefs_are_as_sure_as_they_may_be() -> None:
    """The truth is anywhere among the particles alike, for targets anywhere in range and in or beside a bin.

    80 scans of all cells, whose amplitudes are D_T D_R of the echo and complex normal noise of variance 1.
    """
    noise, ranks, model = rng(31), [], replace(paper_model(n_particle=2000), response=LOBE)
    centres, (near_km, far_km) = bin_centres(100), model.acquisition.ranges_km
    none, nothing = np.full((3, 1), -1, np.int32), (np.zeros(100), np.zeros((3, 1)), np.zeros((3, 2)))
    for trial in range(60):
        range_km, nu = noise.uniform(near_km, far_km), CENTRE + noise.uniform(-0.75, 0.75) / 99
        u = SENSOR.amplitude / range_km**2 / SIGMA * LOBE.loss(nu - centres)
        scans = []
        for k in range(80):
            r = u + noise.standard_normal((100, 2)) @ np.array([1.0, 1j]) / 2**0.5
            cells = 2.0 * np.abs(r) ** 2, (SIGMA * r).astype(np.complex64), np.full(100, SIGMA), np.ones(100), none
            columns = centres, np.full(100, LIMIT), np.zeros(100), centres, *nothing
            scans.append(Detections(k, np.arange(100, dtype=np.int32), *cells, *columns))
        nus, ranges_km = draw_places(model, 42, scans, rng(trial))
        ranks.append([(ranges_km < range_km).mean(), (nus < nu).mean()])
    for each in np.array(ranks).T:
        assert kstest(each, "uniform").pvalue > 0.01


def test_detections_of_a_target_agree_in_range() -> None:
    n_range = n_range_cells(*BEST_RANGE.acquisition.ranges_km, BEST_RANGE.response.range_cell_km)
    limits = np.full(16, threshold(BEST_RANGE.p_fa, 2 * n_range))  # two looks a bin

    def scans_at(*at: float) -> list[Detections]:
        ranges = ({A: 50.25, B: range_km} for range_km in at)
        return [scan(k, {A: 1.0, B: 0.3}, ranges_km=one)._replace(limits=limits) for k, one in enumerate(ranges)]

    assert confirmed(BEST_RANGE, scans_at(50.25, 70.25, 90.25, 110.25)) is None
    scans = scans_at(50.25, 50.25, 50.25, 50.25)
    found = confirmed(BEST_RANGE, scans)
    assert found is not None
    assert found.tolist() == [3, 9]
    particles = start(BEST_RANGE, 1, 9, scans, 50.25).belief.rows
    assert np.abs(np.hypot(particles[:, 0], particles[:, 2]) - 50.25).max() <= 0.25


def test_a_track_reads_its_own_looks_in_its_gate() -> None:
    seen = scan(2, {A: 1.0, B + 0.01: 1.0}, [[A, A], [B, B + 0.05]], [[0.0, 0.0], [48.0, 52.0]])
    looks = associated(BEST, begun(), seen)
    assert (looks.hit, looks.nus.tolist()) == (-1, [B, B + 0.05])
    seen = scan(2, {B: 1.0}, [[A, A], [B, B + 0.05]], [[0.0, 0.0], [48.0, 52.0]], {B: 50.25, B + 0.05: 48.25})
    looks = associated(BEST_RANGE, begun(BEST_RANGE), seen)
    assert (looks.hit, looks.nus.tolist(), looks.range_km) == (0, [B, B + 0.05], 50.25)
    assert (looks.low_km, looks.high_km) == (48.0, 52.0)
    assert looks.amplitude == pytest.approx(ALPHA / 0.1, rel=1e-6)


def test_of_two_cells_with_one_echo_the_stronger_counts_and_the_other_tells_nothing() -> None:
    seen = scan(2, {B: 0.9, B + 0.04: 0.8}, [[A, A, A], [B, B + 0.04, B - 0.1]])
    looks = associated(BEST, begun(), seen)
    assert (looks.hit, looks.nus.tolist()) == (0, [B, B - 0.1])


def test_of_two_echoes_the_more_probable_one_counts_though_it_is_weaker() -> None:
    seen = scan(2, {B: 0.9, B - 0.2: 2.0}, [[A, A], [B, B - 0.2]])
    looks = associated(BEST, begun(), seen)
    assert looks.nus.tolist() == [B]


def test_while_every_cell_is_tested_detections_belong_to_the_nearest_requests() -> None:
    model = smoke_model("best", Strategy.ORTHOGONAL)
    seen = scan(2, {A: 1.0, CENTRES[9]: 0.8, CENTRES[10]: 0.7})._replace(beams=np.array([[3], [9]], dtype=np.int32))
    one, other = (associated(model, begun(model, target), seen) for target in range(2))
    assert (one.nus[one.hit], other.nus[other.hit]) == (CENTRES[3], CENTRES[9])
    assert one.nus.size == other.nus.size == 14  # 13 misses beside the own detection


def test_a_track_follows_its_echo() -> None:
    state, nu = begun(), B
    for k in range(2, 10):
        nu += 0.002
        asked = B + 0.002 * (k - 2)
        seen = scan(k, {asked: 1.0}, [[A], [asked]])
        state = observe(BEST, state, seen._replace(nu_hats=np.where(seen.nus == asked, nu, A)))
        assert state.detected
    assert spatial_frequency(state.belief.rows).mean() == pytest.approx(nu, abs=0.002)
    assert not observe(BEST, state, scan(10, {}, [[A], [nu]])).detected
