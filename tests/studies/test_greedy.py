"""Where the bound says that the most probable bin is the best one, it is; and it says so often, but not always."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cogradar.shared.planning.exact import values_of
from cogradar.shared.planning.radar_pomdp import RadarPomdp, problem_of
from cogradar.shared.tracking.motion import Motion
from cogradar.shared.tracking.sensor import Sensor
from studies.decisions.greedy import enough, is_greedy_optimal, worth_of_telling
from tests.oracles.exact import beliefs

SENSOR = Sensor(100, 60.0, -2.0 * np.log(1e-4))


@settings(max_examples=200, deadline=None)
@given(beliefs, st.floats(0.0, 0.95))
def test_no_bin_beats_the_most_probable_one_where_the_bound_says_so(belief: RadarPomdp, gamma: float) -> None:
    values = values_of(belief, gamma)
    best = int(np.argmax(values.share))
    if is_greedy_optimal(values.share, values.detected, gamma):
        assert values.q[best] >= values.q.max() - 1e-6
    if values.share[best] > enough(gamma) + 1e-12:  # where both are equal, rounding decides
        assert is_greedy_optimal(values.share, values.detected, gamma)


def test_the_bound_is_not_vacuous() -> None:
    """Two bins, a little more of the belief in one where nothing would be detected: the other one is better."""
    far, near = [160.0, 0.0, 2.0, 0.0], [40.0, 0.0, 10.0, 0.0]
    for n_far, is_best in ((52, False), (80, True)):
        particles = np.array(n_far * [far] + (100 - n_far) * [near])
        values = values_of(problem_of(particles, 0.05, SENSOR, Motion(1.0, 0.004)), 0.8)
        assert values.share.argmax() != values.share.size - 1
        assert is_greedy_optimal(values.share, values.detected, 0.8) is is_best
        assert bool(values.q.argmax() == values.share.argmax()) is is_best


def value(weights: Sequence[float], detects: Sequence[float], gamma: float, looks: int) -> float:
    """Best sum of rewards of so many looks for a target that stands still, by trying every plan."""
    return max((q_value(a, weights, detects, gamma, looks) for a in range(len(weights))), default=0.0) if looks else 0.0


def q_value(a: int, weights: Sequence[float], detects: Sequence[float], gamma: float, looks: int) -> float:
    missed = [w * (1.0 - detects[a]) if b == a else w for b, w in enumerate(weights)]
    known = weights[a] * detects[a] * sum(gamma**i for i in range(looks - 1))
    return weights[a] + gamma * (known + value(missed, detects, gamma, looks - 1))


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.tuples(st.floats(0.01, 1.0), st.floats(0.0, 1.0)), min_size=2, max_size=3),
    st.floats(0.1, 0.9),
    st.integers(1, 5),
)
def test_the_bound_holds_for_any_number_of_looks(bins: list[tuple[float, float]], gamma: float, looks: int) -> None:
    """At the least the one for any horizon does, for all of them."""
    total = sum(weight for weight, _ in bins)
    share, detects = [weight / total for weight, _ in bins], [chance for _, chance in bins]
    detected = [p * d for p, d in zip(share, detects, strict=True)]
    values = [q_value(a, share, detects, gamma, looks) for a in range(len(bins))]
    for depth in (looks, math.inf):
        if is_greedy_optimal(share, detected, gamma, depth):
            assert values[int(np.argmax(share))] >= max(values) - 1e-9


def test_the_limits_in_closed_form() -> None:
    assert worth_of_telling(0.8, 1) == 0.0
    assert worth_of_telling(0.8, 2) == pytest.approx(0.8)
    assert worth_of_telling(0.8, math.inf) == pytest.approx(4.0)
    assert enough(0.8) == pytest.approx(1.8 / 2.8)
    assert enough(0.8, math.inf) == pytest.approx(1.0 / 1.2)
