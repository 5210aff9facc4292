"""The true targets against the motion model and the radar equation."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import gamma, kstest

from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.world_config import TargetSection, WorldConfig
from cogradar.shared.tracking.motion import Motion
from cogradar.shared.world.cell_scene import CellScene
from cogradar.shared.world.targets import Flights, echo_amplitudes, undisturbed_path
from tests.oracles.motion import propagate

Floats = NDArray[np.float64]
STATES = np.array([[20.0, 0.05, -60.0, 0.01], [60.0, 0.2, 7.5, 0.1], [0.1, -0.3, 60.0, 0.01]])
MOTION = Motion(1.0, 0.004)
STRAIGHT = [{"state": state.tolist(), "stays": True} for state in STATES]


def world(targets: Sequence[dict[str, Any]], sigma_s: float) -> WorldConfig:
    return WorldConfig.model_validate(
        load("smoke").simulated.model_dump() | {"targets": targets, "motion": {"sigma_s_km_s2": sigma_s}}
    )


def path(target: dict[str, Any], dt: float, t: int, sigma_s: float = 0.0) -> tuple[Floats, list[bool]]:
    """States at t = 0 .. t of one target, and whether it is there."""
    flights = Flights(world([target], sigma_s), dt, 7)
    states, there = [flights.start()], [bool(flights.present(flights.start(), 0)[0])]
    for k in range(1, t + 1):
        states.append(flights.moved(states[-1], k))
        there.append(bool(flights.present(states[-1], k)[0]))
    return np.concatenate(states), there


def flown(turns: list[dict[str, float]], velocity: tuple[float, float], dt: float, t: int) -> Floats:
    """States at t = 0 .. t of a target without noise."""
    return path({"state": [30.0, velocity[0], 5.0, velocity[1]], "turns": turns}, dt, t)[0]


@pytest.mark.parametrize("dt", [1.0, 0.1])
@pytest.mark.parametrize("seed", range(12))
def test_a_path_without_noise_is_the_same_bit_for_bit_at_once_and_clock_by_clock(seed: int, dt: float) -> None:
    rng = np.random.default_rng(seed)
    ends = np.cumsum(rng.uniform(0.0, 9.0, 2 * rng.integers(4)))
    kinds = {"g": (-2.0, 2.0), "rate_deg_s": (-9.0, 9.0), "speed_km_s": (0.1, 0.4)}
    turns = [
        {"from_s": round(begin, 1), "to_s": round(end, 1) + 0.1, kind: round(rng.uniform(*kinds[kind]), 2)}
        for begin, end in zip(ends[0::2] * (seed % 3 > 0), ends[1::2] - 0.2, strict=True)
        for kind in [rng.choice(list(kinds))]
        if end > begin
    ][: 1 if seed % 3 == 0 else None]
    state = [30.0, *rng.uniform(-0.3, 0.3, 3).tolist()]
    target = TargetSection.model_validate({"state": state, "turns": turns})
    np.testing.assert_array_equal(
        undisturbed_path(target, dt, 60), path({"state": state, "turns": turns}, dt, 59)[0], strict=True
    )


@pytest.mark.parametrize("wrong", [{"born_s": 3.0}, {"stays": True}])
def test_a_path_of_a_target_that_flies_otherwise_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="from the start"):
        undisturbed_path(TargetSection.model_validate({"state": [30.0, 0.1, 5.0, 0.1]} | wrong), 1.0, 5)


def test_targets_move_as_the_model_says_each_with_noise_of_its_own() -> None:
    for t in (1, 2):
        expected = [propagate(STATES[m : m + 1], MOTION, generator(7, Purpose.MOTION, m, t))[0] for m in range(3)]
        np.testing.assert_array_equal(Flights(world(STRAIGHT, 0.004), 1.0, 7).moved(STATES, t), expected)
    assert Flights(world(STRAIGHT, 0.004), 1.0, 7).moved(STATES, 1)[2, 0] == 0.0  # as published, never behind the array


def test_a_target_does_not_depend_on_the_others() -> None:
    alone, together = (Flights(world(STRAIGHT[:n], 0.004), 1.0, 7).moved(STATES[:n], 3) for n in (2, 3))
    np.testing.assert_array_equal(alone, together[:2])
    for rcs in ("constant", "swerling1", "swerling3"):
        alphas = echo_amplitudes(STATES, 1.0, 3 * [rcs], 7, 3)
        np.testing.assert_array_equal(echo_amplitudes(STATES[:2], 1.0, 2 * [rcs], 7, 3), alphas[:2])
        np.testing.assert_array_equal(echo_amplitudes(STATES[1:], 1.0, 2 * [rcs], 7, 3, [1, 2]), alphas[1:])


def test_a_turn_is_a_circle_at_constant_speed_and_its_sign_is_its_sense() -> None:
    """6 g at 280 m/s: a radius of v^2 / a = 1.33 km, round in 2 pi v / a = 29.9 s; the chords meet the circle."""
    g, speed = 9.80665e-3, 0.28
    for sense in (1.0, -1.0):
        path = flown([{"from_s": 2.0, "to_s": 42.0, "g": 6.0 * sense}], (0.0, speed), 1.0, 50)
        radius = speed**2 / (6.0 * g)
        centre = path[2, [0, 2]] + [-sense * radius, 0.0]  # from +x towards +y is to the left of +y, at -x
        np.testing.assert_allclose(np.hypot(*(path[2:43, [0, 2]] - centre).T), radius, rtol=1e-9)
        np.testing.assert_allclose(np.hypot(path[:, 1], path[:, 3]), speed, rtol=1e-9)
        angle = np.unwrap(np.arctan2(path[2:43, 3], path[2:43, 1]))
        np.testing.assert_allclose(np.diff(angle), sense * 6.0 * g / speed, rtol=1e-9)
        for straight in (path[:3], path[42:]):
            np.testing.assert_array_equal(straight[:, 1::2], np.tile(straight[0, 1::2], (len(straight), 1)))


def test_a_turn_may_begin_and_end_within_a_dwell_and_needs_a_speed() -> None:
    whole = flown([{"from_s": 1.0, "to_s": 2.0, "g": 3.0}], (0.2, 0.1), 1.0, 3)
    parted = flown([{"from_s": 0.5, "to_s": 1.0, "g": 3.0}, {"from_s": 1.0, "to_s": 1.5, "g": 3.0}], (0.2, 0.1), 1.0, 3)
    np.testing.assert_allclose(parted[-1, 1::2], whole[-1, 1::2], rtol=1e-12)
    np.testing.assert_array_equal(flown([{"from_s": 0.0, "to_s": 9.0, "g": 6.0}], (0.0, 0.0), 1.0, 3)[:, 0], 30.0)


def test_echoes_follow_the_radar_equation_with_a_uniform_phase_per_dwell() -> None:
    alphas = np.array([echo_amplitudes(STATES, 1000.0, 3 * ["constant"], 7, k) for k in range(500)])
    expected = 1000.0 / (STATES[:, 0] ** 2 + STATES[:, 2] ** 2)
    np.testing.assert_allclose(np.abs(alphas), np.tile(expected, (500, 1)), rtol=1e-12)
    assert kstest(np.angle(alphas).ravel() / (2 * np.pi), "uniform", args=(-0.5, 1.0)).pvalue > 1e-6


@pytest.mark.parametrize(("rcs", "shape"), [("swerling1", 1.0), ("swerling3", 2.0)])
def test_a_fluctuating_echo_s_power_has_the_law_s_factor_and_the_same_phase(rcs: str, shape: float) -> None:
    of = {
        name: np.array([echo_amplitudes(STATES, 1.0, 3 * [name], 7, k) for k in range(500)])
        for name in ("constant", rcs)
    }
    ratios = of[rcs] / of["constant"]
    factors = np.abs(ratios) ** 2
    np.testing.assert_allclose(np.angle(ratios), 0.0, atol=1e-9)
    assert kstest(factors.ravel(), gamma(shape, scale=1.0 / shape).cdf).pvalue > 1e-6  # of mean 1
    for pair in ((factors[1:, 0], factors[:-1, 0]), (factors[:, 0], factors[:, 1])):  # in two dwells, of two targets
        assert abs(np.corrcoef(*pair)[0, 1]) < 5.0 / np.sqrt(500)


CLIMB = [[0.0, 10.0, 5.0, 3.0], [10.0, 20.0, 5.0, 8.0]]


def test_a_target_leaves_with_x_below_0_and_not_before() -> None:
    states, there = path({"state": [2.5, -1.0, 40.0, 0.2]}, 1.0, 6)
    np.testing.assert_allclose(states[:, 0], 2.5 - np.arange(7.0))
    assert there == [True, True, True, False, False, False, False]
    noisy, gone = path({"state": [0.3, 0.0, 40.0, 0.0]}, 1.0, 40, sigma_s=0.01)
    assert ((noisy[:, 0] >= 0.0).tolist(), (noisy[:, 0] == 0.0).any()) == (gone, False)  # it sticks to nothing


def test_a_target_is_there_from_its_birth_to_its_death_and_flies_from_where_it_was_born() -> None:
    states, there = path({"state": [30.0, 0.1, 5.0, 0.2], "born_s": 2.5, "gone_s": 5.0}, 1.0, 7)
    assert there == [False, False, False, True, True, True, False, False]
    np.testing.assert_array_equal(states[:3], np.tile([30.0, 0.1, 5.0, 0.2], (3, 1)))
    np.testing.assert_allclose(states[3:6, 0], [30.05, 30.15, 30.25])  # half a dwell after its birth


def test_a_trajectory_is_flown_through_its_rows_and_between_them_as_smoothly_as_what_it_was_taken_of() -> None:
    """A circle of 5 km at 7 g, a row every two seconds: 12 m between chord and arc."""
    rate = np.sqrt(7.0 * 9.80665e-3 / 5.0)
    times = np.arange(2.0, 21.0, 2.0)
    rows = np.column_stack((times, 40.0 + 5.0 * np.cos(rate * times), 5.0 * np.sin(rate * times)))
    states, there = path({"trajectory": rows.tolist()}, 1.0, 25)
    assert there == [2 <= t <= 20 for t in range(26)]
    np.testing.assert_allclose(states[2:21:2, 0::2], rows[:, 1:], rtol=0, atol=1e-12)
    between = np.arange(5, 18)
    exact = np.column_stack((40.0 + 5.0 * np.cos(rate * between), 5.0 * np.sin(rate * between)))
    np.testing.assert_allclose(states[between][:, 0::2], exact, rtol=0, atol=0.01)
    np.testing.assert_allclose(np.hypot(states[between, 1], states[between, 3]), 5.0 * rate, rtol=0.03)
    behind = path({"trajectory": [[0.0, 1.0, 9.0], [4.0, -1.0, 9.0], [8.0, 1.0, 9.0]]}, 1.0, 8)[0][:, 0] >= 0.0
    assert path({"trajectory": [[0.0, 1.0, 9.0], [4.0, -1.0, 9.0], [8.0, 1.0, 9.0]]}, 1.0, 8)[1] == behind.tolist()
    assert 0 < behind.sum() < 9


def test_a_gap_between_rows_is_crossed_about_straight() -> None:
    """Rows of every second that are 20 m off, a minute without one: a cubic spline would be 1.3 km aside."""
    times = np.concatenate((np.arange(21.0), np.arange(80.0, 101.0)))
    course = np.column_stack((50.0 - 0.2 * times, np.where(times < 40.0, 0.0, 0.1 * (times - 80.0))))
    course += 0.02 * np.random.default_rng(1).standard_normal(course.shape)
    states, _ = path({"trajectory": np.column_stack((times, course)).tolist()}, 1.0, 100)
    for axis in range(2):
        straight = np.interp(np.arange(20, 81), times, course[:, axis])
        assert np.abs(states[20:81, 2 * axis] - straight).max() < 0.3


def test_a_trajectory_may_have_two_rows() -> None:
    states, _ = path({"trajectory": [[0.0, 10.0, 5.0], [4.0, 18.0, 1.0]]}, 1.0, 4)
    np.testing.assert_allclose(states, [[10.0 + 2.0 * t, 2.0, 5.0 - t, -1.0] for t in range(5)])


def test_a_turn_may_be_a_rate_and_change_the_speed() -> None:
    """A quarter in 30 s, from 0.2 to 0.3 km/s, evenly; then straight on."""
    turn = {"from_s": 5.5, "to_s": 35.5, "rate_deg_s": 3.0, "speed_km_s": 0.3}
    states = flown([turn], (0.2, 0.0), 1.0, 50)
    np.testing.assert_allclose(states[36:, 1::2], np.tile([0.0, 0.3], (15, 1)), atol=1e-12)
    speeds = np.hypot(states[:, 1], states[:, 3])
    np.testing.assert_allclose(speeds[6:35], 0.2 + 0.1 * (np.arange(6, 35) - 5.5) / 30.0)
    only_faster = flown([turn | {"rate_deg_s": 0.0}], (0.2, 0.0), 1.0, 50)
    assert only_faster[36, 0] - 30.0 == pytest.approx(0.2 * 5.5 + 0.25 * 30.0 + 0.3 * 0.5, abs=0.002)


def test_each_target_may_have_noise_of_its_own() -> None:
    still = {"state": [30.0, 0.0, 5.0, 0.0]}
    flights = Flights(world([still | {"sigma_s_km_s2": 0.0}, still], 0.01), 1.0, 7)
    moved = flights.moved(flights.start(), 1)
    assert (moved[0] == flights.start()[0]).all()
    assert (moved[1] != flights.start()[1]).all()


def test_a_world_that_repeats_begins_anew_with_other_noise_and_is_found_at_any_clock() -> None:
    """Once a period all is as at the start; a scene in mid-run has to fly no more than the newest period."""
    target = {"state": [30.0, 0.1, 5.0, 0.0], "born_s": 2.0, "gone_s": 8.0, "height_km": 1.0}
    repeating = world([target], 0.01).model_copy(update={"repeat_s": 10.0})
    flights = Flights(repeating, 1.0, 7)
    states, there = [flights.start()], list[bool]()
    for t in range(1, 30):
        states.append(flights.moved(states[-1], t))
        there.append(bool(flights.present(states[-1], t)[0]))
    assert all((states[t] == flights.start()).all() for t in (10, 12, 20))
    assert (states[5] != states[15]).any()
    assert there[9:19] == there[19:29] == [False, False, *7 * [True], False]
    radar = load("smoke").radar
    scene = CellScene(repeating, radar, 7, 2 * 10**6 + 25)
    assert (scene.t, scene.present.tolist()) == (2 * 10**6 + 25, [True])
    with pytest.raises(ValueError, match="target 1 begins at 2 s"):
        WorldConfig.model_validate(repeating.model_dump() | {"repeat_s": 2.0})


def test_a_height_is_constant_or_that_of_the_trajectory() -> None:
    targets = [{"state": [40.0, 0.0, 5.0, 0.0], "height_km": 7.5}, {"trajectory": CLIMB}]
    world = WorldConfig.model_validate(load("smoke").simulated.model_dump() | {"targets": targets})
    flights = Flights(world, 1.0, 1)
    np.testing.assert_allclose(flights.heights(0), [7.5, 3.0])
    np.testing.assert_allclose(flights.heights(4), [7.5, 5.0])
    np.testing.assert_allclose(flights.heights(99), [7.5, 8.0])
    np.testing.assert_allclose(flights.start()[1], [10.0, 1.0, 5.0, 0.0], atol=1e-12)
