"""Beginning again after too many misses: when, and with which particles."""

import numpy as np
from numpy.typing import NDArray

from shared.numerics.seeds import Purpose, generator
from shared.scenario.files import load
from shared.signal.array import angle_bin, spatial_frequency
from shared.signal.receiver import threshold
from shared.tracking.particle_filter import Motion, Observation, Sensor, Update, update
from shared.tracking.recovery import Memory, reacquire

N, BIN = 2000, 60
PAPER = load("paper")
ROBUST = PAPER.radar.belief.model_copy(update={"n_particle": N})
PLAIN = ROBUST.model_copy(update={"kernel_bandwidth": 0.0})  # without the kernel, which widens velocities a little
MOTION = Motion(1.0, 0.004)
SENSOR = Sensor(100, 60.0, threshold(1e-4))
SIGMA = 0.01  # amplitude 0.28 at 60 km: a miss in the right cell is out of the question


def rng(k: int) -> np.random.Generator:
    return generator(5, Purpose.BELIEF, 0, k)


def look(bin_: int, hit: bool = False) -> Observation:
    sigma = np.zeros(100)
    sigma[bin_] = SIGMA
    return Observation(bin_ if hit else -1, int(0.28 / (3**0.5 * SIGMA)) if hit else 0, sigma)


def in_bin(bin_: int, vy: float) -> NDArray[np.float64]:
    """A belief spread over one bin at 60 km, sure of its velocity across the line of sight."""
    nu = (bin_ + rng(0).uniform(-0.5, 0.5, N)) / 99.0 - 0.5
    theta, r = np.arcsin(2.0 * nu), 60.0 + 0.2 * rng(1).standard_normal(N)
    return np.column_stack((r * np.cos(theta), np.zeros(N), r * np.sin(theta), np.full(N, vy)))


def bins(particles: NDArray[np.float64]) -> NDArray[np.int64]:
    return angle_bin(spatial_frequency(particles), 100)


def test_evidence_is_the_share_that_explains_a_miss() -> None:
    """A miss in a cell that holds 3 of 10 particles, each sure to be seen."""
    particles = in_bin(BIN, 0.0)
    particles[: 3 * N // 10] = in_bin(BIN + 5, 0.0)[: 3 * N // 10]
    for settings in (ROBUST, ROBUST.model_copy(update={"update": "rejection"})):
        updated = update(particles, look(BIN + 5), SENSOR, MOTION, settings, PAPER.radar.acquisition, rng(2))
        # Exact but for the few that leave their bin; rejection counts tries: 5 sigma of a share of N / 0.7.
        assert abs(updated.evidence - 0.7) < (0.01 if settings.update == "resample" else 5 * (0.7 * 0.3 / 2800) ** 0.5)
        assert not updated.depleted


def test_probable_misses_change_nothing_and_draw_nothing() -> None:
    memory = Memory(in_bin(BIN, 0.0), look(BIN, hit=True))
    updated = Update(in_bin(BIN, 0.1), depleted=False, evidence=0.2)
    unused = rng(3)
    for n_miss in range(1, 6):  # 0.2^5 = 3e-4
        again = reacquire(memory, updated, look(BIN + 1), SENSOR, MOTION, ROBUST, PAPER.radar.acquisition, unused)
        assert again is updated
        assert len(memory.misses) == n_miss
    assert unused.random() == rng(3).random()
    sixth = reacquire(memory, updated, look(BIN + 1), SENSOR, MOTION, ROBUST, PAPER.radar.acquisition, unused)
    assert sixth.depleted
    assert memory.attempts == 1
    assert memory.log_evidence == 0.0


def test_a_detection_ends_the_doubt() -> None:
    memory = Memory(in_bin(BIN, 0.0), look(BIN, hit=True), [look(BIN + 1)] * 3, log_evidence=-9.0, attempts=2)
    updated = Update(in_bin(BIN + 1, 0.0), depleted=False, evidence=1e-9)
    seen = look(BIN + 1, hit=True)
    assert reacquire(memory, updated, seen, SENSOR, MOTION, ROBUST, PAPER.radar.acquisition, rng(4)) is updated
    assert memory == Memory(updated.particles, seen)


def test_never_in_the_paper() -> None:
    memory = Memory(in_bin(BIN, 0.0), look(BIN, hit=True))
    updated = Update(in_bin(BIN, 0.0), depleted=False, evidence=0.0)
    never = ROBUST.model_copy(update={"reacquire_below": 0.0})
    for _ in range(100):
        assert reacquire(memory, updated, look(BIN), SENSOR, MOTION, never, PAPER.radar.acquisition, rng(5)) is updated
    assert not memory.misses


def test_half_begins_again_where_the_target_can_have_gone() -> None:
    """Last seen in BIN, then not in it and twice not in the next; a bin is 0.6 km wide, 0.35 km/s the highest speed."""
    memory = Memory(in_bin(BIN, 0.3), look(BIN, hit=True), [look(BIN), look(BIN + 1)])
    updated = Update(in_bin(BIN + 2, 0.3), depleted=False, evidence=1e-5)
    after = reacquire(memory, updated, look(BIN + 1), SENSOR, MOTION, PLAIN, PAPER.radar.acquisition, rng(6)).particles
    np.testing.assert_array_equal(after[::2], updated.particles[::2])
    new = after[1::2]
    # They have left BIN in time and are not in BIN + 1 now, but for those too far away to be seen for sure.
    assert np.mean((bins(new) < BIN) & (bins(new) >= BIN - 3)) > 0.3
    assert np.mean(bins(new) == BIN + 1) < 0.02
    assert np.abs(new[:, 3]).max() < 0.35 + 6 * 0.004 * 3**0.5
    assert np.mean(new[:, 3] < 0.0) > 0.9  # the other half has 0.3
    # One belief has the ranges it had, 60 +- 0.2 km and two seconds at 0.35 km/s, the other those of one detection.
    far = np.abs(np.hypot(new[:, 0], new[:, 2]) - 60.0) > 2.0
    assert 0.02 < far.mean() < 0.5
    assert memory.attempts == 1


def test_later_attempts_look_farther() -> None:
    def spread(attempts: int) -> float:
        memory = Memory(in_bin(BIN, 0.0), look(BIN, hit=True), attempts=attempts)
        updated = Update(in_bin(BIN, 0.0), depleted=False, evidence=1e-5)
        after = reacquire(memory, updated, look(BIN), SENSOR, MOTION, ROBUST, PAPER.radar.acquisition, rng(7)).particles
        assert memory.attempts == attempts + 1
        return float(np.std(bins(after[1::2])))

    spreads = [spread(attempts) for attempts in range(4)]
    assert spreads == sorted(spreads)
    assert spreads[3] > 2.0 * spreads[0]


def test_a_detection_of_long_ago_is_forgotten() -> None:
    """The memory, and the cost of beginning again, stay bounded however long a target is not seen."""
    memory = Memory(in_bin(BIN, 0.0), look(BIN, hit=True))
    updated = Update(in_bin(BIN + 3, 0.0), depleted=False, evidence=1.0)
    for n_miss in range(1, 151):
        reacquire(memory, updated, look(BIN + 1), SENSOR, MOTION, ROBUST, PAPER.radar.acquisition, rng(8))
        assert len(memory.misses) == n_miss % 100
    assert memory.particles is updated.particles
