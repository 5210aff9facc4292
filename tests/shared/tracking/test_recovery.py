"""Beginning again after too many misses: when, and with which particles."""

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.scenario.tables import REACQUIRE_BELOW
from cogradar.shared.signal.array import angle_bin, spatial_frequency
from cogradar.shared.tracking.belief.interface import Particles
from cogradar.shared.tracking.belief.likelihood import Looks
from cogradar.shared.tracking.belief.particle_filter import Update, update
from cogradar.shared.tracking.belief.recovery import reacquire
from cogradar.shared.tracking.model import NONE, TrackState
from cogradar.shared.tracking.track import coast
from tests.shared.tracking.models import in_bins, paper_model, sigma_of_bins

N, BIN = 2000, 60
ROBUST = paper_model(n_particle=N)
# Without the kernel, which widens velocities a little; a level says less of the range than an amplitude.
PLAIN = paper_model(n_particle=N, kernel_bandwidth=0.0, is_exact=False)
SIGMA = 0.01  # amplitude 0.28 at 60 km: a miss in the right cell is out of the question
AMPLITUDE = 0.28 / SIGMA


def rng(k: int) -> np.random.Generator:
    return generator(5, Purpose.BELIEF, 0, k)


def look(bin_: int, hit: bool = False) -> Looks:
    sigma = np.zeros(100)
    sigma[bin_] = SIGMA
    return in_bins(bin_ if hit else -1, AMPLITUDE if hit else 0.0, sigma)


def in_bin(bin_: int, vy: float) -> NDArray[np.float64]:
    """A belief spread over one bin at 60 km, sure of its velocity across the line of sight."""
    nu = (bin_ + rng(0).uniform(-0.5, 0.5, N)) / 99.0 - 0.5
    theta, r = np.arcsin(2.0 * nu), 60.0 + 0.2 * rng(1).standard_normal(N)
    return np.column_stack((r * np.cos(theta), np.zeros(N), r * np.sin(theta), np.full(N, vy)))


def seen(particles: NDArray[np.float64], misses: tuple[Looks, ...] = (), attempts: int = 0) -> TrackState:
    """A track whose belief at its detection in BIN was this, missed since."""
    return TrackState(
        target=0,
        k=9,
        belief=Particles(particles),
        detected=not misses,
        depleted=False,
        sigma_hat=SIGMA,
        in_beam=True,
        level=1.0,
        power=1.0,
        echo=0.0,
        remembered=particles if misses else NONE,
        hit_bin=BIN,
        hit_amplitude=AMPLITUDE,
        measured=np.array([BIN / 99.0 - 0.5, 0.0, 0.0, 0.0]),
        looked=np.array([sigma_of_bins(miss) for miss in misses]).reshape(-1, 100),
        log_evidence=0.0,
        attempts=attempts,
    )


def bins(particles: NDArray[np.float64]) -> NDArray[np.int64]:
    return angle_bin(spatial_frequency(particles), 100)


def test_evidence_is_the_share_that_explains_a_miss() -> None:
    """A miss in a cell that holds 3 of 10 particles, each sure to be seen."""
    particles = in_bin(BIN, 0.0)
    particles[: 3 * N // 10] = in_bin(BIN + 5, 0.0)[: 3 * N // 10]
    for model in (ROBUST, paper_model(n_particle=N, filter="published", is_exact=True)):
        updated = update(model, particles, look(BIN + 5), rng(2))
        # Exact but for the few that leave their bin; rejection counts tries: 5 sigma of a share of N / 0.7.
        within = 0.01 if model is ROBUST else 5 * (0.7 * 0.3 / 2800) ** 0.5
        assert abs(updated.evidence - 0.7) < within
        assert not updated.depleted


def test_probable_misses_change_nothing_and_draw_nothing() -> None:
    before = in_bin(BIN, 0.0)
    state, updated, unused = (
        seen(before),
        Update(in_bin(BIN, 0.1), depleted=False, evidence=0.2, modes=ROBUST.modes),
        rng(3),
    )
    for n_miss in range(1, 6):  # 0.2^5 = 3e-4
        state = reacquire(ROBUST, state, updated, look(BIN + 1), unused)
        assert state.belief.rows is updated.particles
        assert not state.depleted
        assert state.remembered is before
        assert len(state.looked) == n_miss
    assert unused.random() == rng(3).random()
    state = reacquire(ROBUST, state, updated, look(BIN + 1), unused)
    assert state.depleted
    assert (state.attempts, state.log_evidence) == (1, 0.0)


def test_a_detection_ends_the_doubt() -> None:
    state = seen(in_bin(BIN, 0.0), (look(BIN + 1),) * 3, attempts=2)._replace(log_evidence=-9.0)
    updated = Update(in_bin(BIN + 1, 0.0), depleted=False, evidence=1e-9, modes=ROBUST.modes)
    after = reacquire(ROBUST, state, updated, look(BIN + 1, hit=True), rng(4))
    assert after.belief.rows is updated.particles
    assert after.remembered.size == after.looked.size == after.attempts == after.log_evidence == 0
    assert (after.hit_bin, after.hit_amplitude) == (BIN + 1, AMPLITUDE)


def test_never_in_the_paper() -> None:
    never, state = paper_model(reacquire_below=0.0), seen(in_bin(BIN, 0.0))
    updated = Update(in_bin(BIN, 0.0), depleted=False, evidence=0.0, modes=ROBUST.modes)
    for _ in range(100):
        state = reacquire(never, state, updated, look(BIN), rng(5))
        assert state.belief.rows is updated.particles
    assert not state.looked.size


def test_half_begins_again_where_the_target_can_have_gone() -> None:
    """Last seen in BIN, then not in it and twice not in the next; a bin is 0.6 km wide, 0.35 km/s the highest speed."""
    state = seen(in_bin(BIN, 0.3), (look(BIN), look(BIN + 1)))
    updated = Update(in_bin(BIN + 2, 0.3), depleted=False, evidence=1e-5, modes=ROBUST.modes)
    after = reacquire(PLAIN, state, updated, look(BIN + 1), rng(6))
    np.testing.assert_array_equal(after.belief.rows[::2], updated.particles[::2])
    new = after.belief.rows[1::2]
    # They have left BIN in time and are not in BIN + 1 now, but for those too far away to be seen for sure.
    assert np.mean((bins(new) < BIN) & (bins(new) >= BIN - 3)) > 0.3
    assert np.mean(bins(new) == BIN + 1) < 0.02
    assert np.abs(new[:, 3]).max() < 0.35 + 6 * 0.004 * 3**0.5
    assert np.mean(new[:, 3] < 0.0) > 0.9  # the other half has 0.3
    # One belief has the ranges it had, 60 +- 0.2 km and two seconds at 0.35 km/s, the other those of one detection.
    far = np.abs(np.hypot(new[:, 0], new[:, 2]) - 60.0) > 2.0
    assert 0.02 < far.mean() < 0.5
    assert after.attempts == 1


def test_later_attempts_look_farther() -> None:
    def spread(attempts: int) -> float:
        updated = Update(in_bin(BIN, 0.0), depleted=False, evidence=1e-5, modes=ROBUST.modes)
        after = reacquire(ROBUST, seen(in_bin(BIN, 0.0), attempts=attempts), updated, look(BIN), rng(7))
        assert after.attempts == attempts + 1
        return float(np.std(bins(after.belief.rows[1::2])))

    spreads = [spread(attempts) for attempts in range(4)]
    assert spreads == sorted(spreads)
    assert spreads[3] > 2.0 * spreads[0]


def test_a_detection_of_long_ago_is_forgotten() -> None:
    """The memory, and the cost of beginning again, stay bounded however long a target is not seen."""
    state, updated = (
        seen(in_bin(BIN, 0.0)),
        Update(in_bin(BIN + 3, 0.0), depleted=False, evidence=1.0, modes=ROBUST.modes),
    )
    for n_miss in range(1, 151):
        state = reacquire(ROBUST, state, updated, look(BIN + 1), rng(8))
        assert len(state.looked) == n_miss % 100
        assert state.hit_bin == (BIN if n_miss < 100 else -1)
    assert state.remembered is updated.particles


def test_who_begins_again_lives_through_the_dwells_that_never_happened() -> None:
    """12 dwells since the detection, 10 of them without a scan: at up to 0.35 km/s that is 4.2 km, three bins."""
    before = seen(in_bin(BIN, 0.0))
    state = coast(PLAIN, before, before.k + 11)
    assert state.remembered is before.belief.rows
    assert state.looked.shape == (10, 100)
    assert state.log_evidence == 0.0
    for _ in range(2):
        updated = Update(state.belief.rows, depleted=False, evidence=5e-3, modes=ROBUST.modes)
        state = reacquire(PLAIN, state, updated, look(BIN + 30), rng(9))
    assert state.attempts == 1
    away = np.abs(bins(state.belief.rows[1::2]) - BIN)
    assert np.mean(away >= 2) > 0.3  # two dwells in place of twelve are 0.7 km, half a bin


def test_a_detection_before_a_long_gap_without_scans_is_forgotten() -> None:
    before = seen(in_bin(BIN, 0.0))
    state = coast(PLAIN, before, before.k + 131)
    assert (state.hit_bin, state.looked.shape) == (-1, (30, 100))
    never = paper_model(reacquire_below=0.0)
    assert coast(never, before, before.k + 11).looked.shape == (0, 100)


def test_a_belief_that_has_shrunk_to_a_point_at_a_border_of_bins_leaves_it() -> None:
    """Of the published filter with joint looks: each miss of one bin is explained by the few particles in the other."""
    nu = (BIN + 0.5) / 99.0 - 0.5
    at, n_bin = 60.0 * np.array([np.sqrt(1.0 - 4.0 * nu**2), 2.0 * nu]), 100
    shrunk = np.column_stack((np.full(N, at[0]), np.zeros(N), at[1] + 0.002 * rng(7).standard_normal(N), np.zeros(N)))

    def dwells_there(reacquire_below: float) -> int:
        model = paper_model(n_particle=N, filter="published", kernel_bandwidth=0.0, reacquire_below=reacquire_below)
        state = seen(shrunk)
        for k in range(60):
            here = np.bincount(bins(state.belief.rows), minlength=n_bin)
            if here[BIN] + here[BIN + 1] < N // 2:
                return k
            miss = look(int(here.argmax()))
            updated = update(model, state.belief.rows, miss, rng(10 + k))
            state = reacquire(model, state, updated, miss, rng(100 + k))
        return 60

    assert dwells_there(0.0) >= 40
    assert dwells_there(REACQUIRE_BELOW) <= 14  # half of the particles explain a miss, or fewer: 2^-14 is below 1e-4
