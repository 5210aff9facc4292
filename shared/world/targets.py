"""The true targets: how they move, when they are there, and how strong their echoes are.

States are [x, vx, y, vy] in km and km/s, on the ground; each target has a height besides. Random numbers are keyed by
target and dwell, so that all strategies of a seed see the same trajectories and the same phases.
"""

from collections.abc import Sequence
from math import cos, hypot, radians, sin
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.constants import G_KM_S2
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.scenario.world_config import TargetSection, WorldConfig
from cogradar.shared.signal.radar_equation import amplitude

if TYPE_CHECKING:
    from scipy.interpolate import Akima1DInterpolator

# By `world.rcs`: what an echo's power is multiplied by is Gamma(shape, 1/shape), of mean 1. (Swerling 1954)
_SHAPES = {"swerling1": 1.0, "swerling3": 2.0}  # many scatterers alike; one among many small ones

_STEADY = (0.0, 0.0)  # noise of a target that has none


class Flights:
    """Where the targets of a world are, clock by clock; M of them, whether they are there or not."""

    def __init__(self, world: WorldConfig, dt_s: float, seed: int) -> None:
        """dt_s : dwell, s."""
        self._targets, self._dt, self._seed = world.targets, dt_s, seed
        self._sigmas = [
            world.motion.sigma_s_km_s2 if target.sigma_s_km_s2 is None else target.sigma_s_km_s2
            for target in world.targets
        ]
        self._courses = [_course(target) for target in world.targets]
        self._first_s = np.array([target.first_s for target in world.targets])
        self._last_s = np.array([target.last_s for target in world.targets])
        self._heights_km = np.array([target.height_km for target in world.targets])
        self._climbing = [m for m, course in enumerate(self._courses) if course is not None and course.c.shape[-1] > 2]
        self._period = None if world.repeat_s is None else max(round(world.repeat_s / dt_s), 1)

    def begun(self, t: int) -> int:
        """The newest clock, up to t, at which all targets were where they begin."""
        return 0 if self._period is None else t - t % self._period

    def start(self) -> NDArray[np.float64]:
        """States with which all begin, (M, 4); of a target that comes later, those at which it will begin."""
        return np.array(
            [
                target.state if course is None else _along(course, 0.0)
                for target, course in zip(self._targets, self._courses, strict=True)
            ],
            dtype=np.float64,
        )

    def moved(self, states: NDArray[np.float64], t: int) -> NDArray[np.float64]:
        """States at clock t from those at t - 1; (M, 4) -> (M, 4)."""
        since = t - self.begun(t)
        if since == 0:
            return self.start()
        out, before = np.empty_like(states), states.tolist()
        for m, (target, course) in enumerate(zip(self._targets, self._courses, strict=True)):
            if course is not None:
                out[m] = _along(course, since * self._dt)
            else:
                out[m] = _flown(before[m], target, self._dt, since, self._noise(m, t))
        return out

    def _noise(self, m: int, t: int) -> Sequence[float]:
        """Acceleration of target m in the dwell before clock t, km/s^2, (2,)."""
        sigma = self._sigmas[m]
        if sigma == 0.0:
            return _STEADY
        drawn: list[float] = (sigma * generator(self._seed, Purpose.MOTION, m, t).standard_normal(2)).tolist()
        return drawn

    def heights(self, t: int) -> NDArray[np.float64]:
        """Heights at clock t, km, (M,)."""
        time = (t - self.begun(t)) * self._dt
        found = self._heights_km.copy()
        for m in self._climbing:
            course = self._courses[m]
            found[m] = 0.0 if course is None else max(_at(course, time)[2], 0.0)
        return found

    def present(self, states: NDArray[np.float64], t: int) -> NDArray[np.bool_]:
        """Which targets are there at clock t: between birth and death, and in the field of view, x >= 0; (M,)."""
        time = (t - self.begun(t)) * self._dt
        return np.asarray((self._first_s <= time) & (time <= self._last_s) & (states[:, 0] >= 0.0))


def _course(target: TargetSection) -> "Akima1DInterpolator | None":
    """Its trajectory, smooth through all rows; None: it has none.

    Between two rows it depends on the nearest rows alone (modified Akima interpolation). A cubic spline through all
    would swing out where rows are close together and others, after a gap, far apart.
    """
    if target.trajectory is None:
        return None
    from scipy.interpolate import Akima1DInterpolator  # half a second, which most worlds need not spend

    rows = np.array(target.trajectory, dtype=np.float64)
    return Akima1DInterpolator(rows[:, 0], rows[:, 1:], method="makima")


def _along(course: "Akima1DInterpolator", time: float) -> NDArray[np.float64]:
    """State on a trajectory, (4,); before the first row and after the last the state of this row."""
    state = np.empty(4)
    state[0::2], state[1::2] = _at(course, time)[:2], _at(course, time, 1)[:2]
    return state


def _at(course: "Akima1DInterpolator", time: float, derivative: int = 0) -> NDArray[np.float64]:
    """Position on a trajectory, (2,) or with its height (3,), or its derivative."""
    return np.asarray(course(min(max(time, float(course.x[0])), float(course.x[-1])), derivative))


def _flown(
    before: Sequence[float], target: TargetSection, dt: float, t: int, noise: Sequence[float]
) -> Sequence[float]:
    """State of a target that flies by itself at clock t since its flight began, (4,) -> (4,); still until its birth.

        s' = A s + G w,  A_b = [[1, dt], [0, 1]] and G_b = [dt^2/2, dt] per axis,  w the noise, N(0, sigma_s^2 I_2)

    A turn through the angle a in a dwell moves the target along the chord of its arc, whose velocity is that of the
    middle of the turn times sin(a/2) / (a/2). The process noise is added as without a turn. In numbers, and not in
    arrays of two: a sky has hundreds of targets.
    """
    begin = (t - 1) * dt
    if target.born_s > begin:
        begin, dt = target.born_s, t * dt - target.born_s
    if dt <= 0.0:
        return before
    angle, faster = _manoeuvred(target, before, begin, begin + dt)
    shortened, mean = 1.0 if angle == 0.0 else float(np.sinc(0.5 * angle / np.pi)), 0.5 * (1.0 + faster)
    after = list[float]()
    turned = zip(_rotated(before[1::2], 0.5 * angle), _rotated(before[1::2], angle), strict=True)
    for place, (middle, end), w in zip(before[0::2], turned, noise, strict=True):
        chord = middle * shortened * mean
        velocity = chord + dt * w
        if angle != 0.0 or faster != 1.0:
            velocity += end * faster - chord
        after += [place + dt * chord + 0.5 * dt * dt * w, velocity]
    if target.stays:
        after[0] = max(after[0], 0.0)
    return after


def undisturbed_path(target: TargetSection, dt: float, n: int) -> NDArray[np.float64]:
    """States at clocks 0 to n - 1 of a target that is there from the start, flies by itself, and may leave, (n, 4).

    Without process noise; bit for bit as `Flights` moves it. Straight flight is summed up at once. Raises ValueError
    for a target that is born later, has a trajectory, or stays in view.
    """
    if target.trajectory is not None or target.born_s > 0.0 or target.stays:
        raise ValueError("the target must be there from the start, without a trajectory, and may leave")
    begins = dt * np.arange(-1, n - 1)  # of the dwell before each clock
    turning = np.zeros(n, dtype=bool)
    for turn in target.turns:
        turning |= (turn.from_s < begins + dt) & (turn.to_s > begins)
    states, t = np.empty((n, 4)), 1
    states[0] = target.state
    while t < n:
        if turning[t]:
            states[t] = _flown(states[t - 1].tolist(), target, dt, t, _STEADY)
            t += 1
        else:
            end = t + int(np.argmax(turning[t:])) if turning[t:].any() else n
            velocity = states[t - 1, 1::2]
            steps = np.broadcast_to(dt * velocity, (end - t, 2))
            states[t:end, 0::2] = np.cumsum(np.concatenate([states[t - 1 : t, 0::2], steps]), axis=0)[1:]
            states[t:end, 1::2] = velocity
            t = end
    return states


def _manoeuvred(target: TargetSection, state: Sequence[float], begin: float, end: float) -> tuple[float, float]:
    """Angle in rad by which a target turns between these times, and the factor by which it becomes faster.

    With g the angle is acceleration / speed times its time. A speed is reached evenly by the end of its turn.
    """
    angle, faster, speed = 0.0, 1.0, hypot(state[1], state[3])
    for turn in target.turns:
        low, high = max(turn.from_s, begin), min(turn.to_s, end)
        if high <= low or speed == 0.0:
            continue
        if turn.g is not None:
            angle += (high - low) * turn.g * G_KM_S2 / speed
        elif turn.rate_deg_s is not None:
            angle += (high - low) * radians(turn.rate_deg_s)
        if turn.speed_km_s is not None:
            now = faster * speed
            faster *= 1.0 + (turn.speed_km_s / now - 1.0) * (high - low) / (turn.to_s - low)
    return angle, faster


def _rotated(velocity: Sequence[float], angle: float) -> tuple[float, float]:
    """A velocity, (2,), turned through an angle in rad, from +x towards +y; exactly itself if that is 0."""
    c, s = cos(angle), sin(angle)
    return c * velocity[0] - s * velocity[1], s * velocity[0] + c * velocity[1]


def echo_amplitudes(
    states: NDArray[np.float64],
    at_1_km: NDArray[np.float64] | float,
    laws: Sequence[str],
    seed: int,
    k: int,
    numbers: Sequence[int] | None = None,
) -> NDArray[np.complex128]:
    """Complex echo amplitude alpha of each target in dwell k, (M, 4) -> (M,).

    states  : where the array measures them (`array.in_plane`)
    numbers : of these targets in the world; None: they are all

    |alpha|^2 by the radar equation, with |alpha| = at_1_km, one or (M,), at 1 km, times a factor by a law of
    `world.rcs`, one of each target; the phase is uniform. Both are drawn anew in each dwell.
    """
    numbers = range(states.shape[0]) if numbers is None else numbers
    turns = [generator(seed, Purpose.PHASE, m, k).random() for m in numbers]
    magnitudes = amplitude(at_1_km, states[:, 0] ** 2 + states[:, 2] ** 2)
    for i, (m, law) in enumerate(zip(numbers, laws, strict=True)):
        if law in _SHAPES:
            shape = _SHAPES[law]
            magnitudes[i] *= np.sqrt(generator(seed, Purpose.RCS, m, k).standard_gamma(shape) / shape)
    return np.asarray(magnitudes * np.exp(2j * np.pi * np.array(turns)), dtype=np.complex128)
