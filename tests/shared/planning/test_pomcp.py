"""The search against exact solutions of small problems, and against its plain version."""

from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from cogradar.shared.planning.pomcp import (
    FREE,
    OBSERVATION_BITS,
    ROOT,
    UNEXPANDED,
    SearchResult,
    SearchSettings,
    _find,
    best_action,
    new_tree,
    search,
    search_while,
    simulate,
)
from cogradar.shared.planning.problem import implement, mean_rollout, random_action, sample_state, step
from cogradar.shared.scenario.limits import tree_bytes
from tests.oracles.pomcp import (
    LISTEN,
    OPEN_LEFT,
    OPEN_RIGHT,
    Finite,
    action_values,
    after,
    bandit,
    chain,
    draw,
    finite,
    return_variance,
    search_tree,
    tiger,
    tracking,
    value,
)
from tests.plain import plain

SETTINGS = SearchSettings(n_sim=400_000, depth=3, rollout_depth=0, rollout_mean=False, gamma=0.9, ucb_c=1.0)
SMALL = SETTINGS._replace(n_sim=400)
ENDING = tracking()._replace(ends=np.array([False, False, True]))
THREE = np.arange(3)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(seed))


def assert_solves(problem: Finite, settings: SearchSettings, loss: float) -> None:
    """The best action is chosen; its value is the exact one, -loss and within 5 standard deviations; none is above.

    Q(ha) is a mean over all visits, and UCB visits a worse action below about (c/gap)^2 log N times: `loss` allows for
    those, c^2 log N / gap per edge, a few thousand over the tree, divided by n_sim.
    """
    leaf = mean_rollout(problem, settings.rollout_depth, settings.gamma)
    exact = action_values(problem, problem.belief, settings.depth, settings.gamma, leaf)
    result = search(problem, np.arange(exact.size), settings, rng())
    best = int(np.argmax(exact))
    deviation = 5.0 * np.sqrt(return_variance(problem, best, settings.depth, settings.gamma) / result.visits[best])
    assert result.action == best
    assert exact[best] - deviation - loss <= result.value[best] <= exact[best] + deviation
    # Any other action: a mean of N returns that span at most `spread` deviates by spread / (2 sqrt N) (Popoviciu).
    spread = np.ptp(problem.reward) * settings.depth
    assert np.all(result.value <= exact + 5.0 * 0.5 * spread / np.sqrt(result.visits))


@pytest.mark.parametrize("depth", [1, 2, 3])
@pytest.mark.parametrize("belief", [(0.5, 0.3, 0.2), (0.05, 0.15, 0.8)])
def test_tracking_toy_is_solved(belief: tuple[float, float, float], depth: int) -> None:
    assert_solves(tracking(belief), SETTINGS._replace(depth=depth), loss=0.02 * (depth - 1))


def test_tracking_toy_with_rollout_means_is_solved() -> None:
    assert_solves(tracking(), SETTINGS._replace(depth=2, rollout_depth=6, rollout_mean=True), loss=0.02)


def test_episodes_that_end_are_solved() -> None:
    assert_solves(ENDING._replace(belief=np.array([0.8, 0.15, 0.05])), SETTINGS, loss=0.04)


def test_identical_observations_leave_the_best_plan_without_feedback() -> None:
    blind = tracking()._replace(observation=np.ones((3, 3, 1)))
    assert_solves(blind, SETTINGS, loss=0.04)
    result = search(blind, THREE, SMALL._replace(n_sim=5000, ucb_c=50.0), rng())  # tries everything everywhere
    assert result.n_node == 1 + 3 + 3**2 + 3**3


def test_oracle_knows_tigers_value() -> None:
    # Opening a door at random loses 45, a growl tells 0.85, two alike 0.85^2 / (0.85^2 + 0.15^2) = 0.9698.
    assert action_values(tiger(), tiger().belief, 1, 0.95) == pytest.approx([-1.0, -45.0, -45.0])
    growled = after(tiger(), after(tiger(), tiger().belief, LISTEN, 0), LISTEN, 0)
    assert growled / growled.sum() == pytest.approx([0.7225 / 0.745, 0.0225 / 0.745])
    # Listen twice; open if both growls agree (0.745), else listen in vain.
    opened = (10.0 * 0.7225 - 100.0 * 0.0225) - 0.255
    assert value(tiger(), tiger().belief, 3, 0.95) == pytest.approx(-1.0 - 0.95 + 0.95**2 * opened)


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_tiger_is_solved_and_listened_to_first(depth: int) -> None:
    settings = SETTINGS._replace(depth=depth, gamma=0.95, ucb_c=60.0)
    assert search(tiger(), THREE, settings, rng()).action == LISTEN
    if depth == 3:  # below, every course of the best policy costs the same: no interval
        assert_solves(tiger(), settings, loss=0.2)


@pytest.mark.parametrize(("growl", "door"), [(0, OPEN_RIGHT), (1, OPEN_LEFT)])
def test_tiger_growls_twice_and_the_other_door_is_opened(growl: int, door: int) -> None:
    belief = tiger().belief
    settings = SETTINGS._replace(n_sim=20_000, depth=1, gamma=0.95, ucb_c=110.0)
    for opened in (LISTEN, door):
        belief = after(tiger(), belief, LISTEN, growl)
        belief /= belief.sum()
        assert search(tiger(belief[0]), THREE, settings, rng()).action == opened


@given(best=st.integers(0, 6), seed=st.integers(0, 2**32 - 1))
def test_best_arm_is_found_wherever_it_stands(best: int, seed: int) -> None:
    p_win = np.full(7, 0.3)
    p_win[best] = 0.8
    result = search(bandit(p_win), np.arange(7), SMALL._replace(n_sim=3000, depth=1, ucb_c=1.0), rng(seed))
    assert result.action == best == np.argmax(result.visits)
    # Upper 1e-9 quantiles of the binomial: the interval of 7 arms x 100 examples fails once in 10^6 runs.
    wins = np.rint(result.value * result.visits)
    low, high = stats.binom.ppf(1e-9, result.visits, p_win), stats.binom.ppf(1 - 1e-9, result.visits, p_win)
    assert np.all((low <= wins) & (wins <= high))


def test_untried_actions_are_not_favoured_by_position() -> None:
    # Of 8 arms that all fail, 3 are tried: each in 3/8 of the runs, and each is the first tried in 1/8.
    problem, n_run = bandit(np.zeros(8)), 4000
    for n_sim in (1, 3):
        settings = SMALL._replace(n_sim=n_sim, depth=1)
        tried = np.array([search(problem, np.arange(8), settings, rng(seed)).visits for seed in range(n_run)])
        p = n_sim / 8
        assert set(tried.sum(axis=1)) == {n_sim}
        assert np.all(np.abs(tried.sum(axis=0) - n_run * p) <= 5.0 * np.sqrt(n_run * p * (1.0 - p)))


def test_untried_actions_are_not_favoured_by_position_below_the_root() -> None:
    # The first step is worth nothing, the second 4^action. Four simulations try the root's actions; the fifth goes
    # through action 0, first among equals, and takes one there: its return is 0.5 * 4^action and its mean half.
    onwards = np.array([[[0.0, 1.0], [0.0, 1.0]]] * 4)
    reward = np.array([[0.0, 1.0], [0.0, 4.0], [0.0, 16.0], [0.0, 64.0]])[:, :, None]
    problem = finite((1.0, 0.0), onwards, np.ones((4, 1, 1)), reward)
    settings, n_run = SMALL._replace(n_sim=5, depth=2, rollout_mean=True, gamma=0.5), 4000
    values = [search(problem, np.arange(4), settings, rng(seed)).value[0] for seed in range(n_run)]
    counts = np.array([values.count(0.25 * 4.0**action) for action in range(4)])
    assert counts.sum() == n_run
    assert np.all(np.abs(counts - n_run / 4) <= 5.0 * np.sqrt(n_run * 0.25 * 0.75))


@pytest.mark.parametrize("rollout_depth", [0, 1, 5])
@pytest.mark.parametrize("depth", [1, 2, 3])
@pytest.mark.parametrize("n_sim", [1, 2, 50])
def test_every_return_spans_tree_and_rollout(depth: int, rollout_depth: int, n_sim: int) -> None:
    # Sums of small integers times powers of 1/2: exact, as are means of equal numbers.
    expected = sum((d + 1) * 0.5**d for d in range(depth + rollout_depth))
    settings = SMALL._replace(n_sim=n_sim, depth=depth, rollout_depth=rollout_depth, gamma=0.5)
    result = search(chain(12), np.arange(2), settings, rng())
    assert np.all(result.value[result.visits > 0] == expected)
    assert result.max_depth <= min(n_sim, depth)
    assert search(chain(12), np.zeros(1, dtype=np.int64), settings, rng()).max_depth == min(n_sim, depth)


def test_mean_rollout_values_the_levels_that_are_left() -> None:
    # One action, worth nothing in the tree and 1 per level below: simulation i of 4 leaves the tree after min(i, 3)
    # steps, and 6 - min(i, 3) levels are left.
    problem = finite((1.0,), np.ones((1, 1, 1)), np.ones((1, 1, 1)), np.zeros((1, 1, 1)), level_mean=1.0)
    settings = SMALL._replace(n_sim=4, depth=3, rollout_depth=3, rollout_mean=True, gamma=0.5)
    tails = [sum(0.5**d for d in range(steps, 6)) for steps in (1, 2, 3, 3)]
    assert search(problem, np.zeros(1, dtype=np.int64), settings, rng()).value[0] == pytest.approx(np.mean(tails))


@pytest.mark.parametrize("action", THREE)
def test_one_action_is_taken(action: int) -> None:
    result = search(tracking(), np.array([action]), SMALL, rng())
    assert (result.action, result.visits.tolist()) == (action, [400])


def test_actions_keep_their_names() -> None:
    exact = action_values(tracking(), tracking().belief, 1, 0.9)
    result = search(tracking(), np.array([2, 1]), SMALL._replace(n_sim=20_000, depth=1), rng())
    assert result.action == 1
    assert result.value.shape == result.visits.shape == (2,)
    assert abs(result.value[1] - exact[1]) <= 5.0 * 0.5 / np.sqrt(result.visits[1])  # a reward of 0 or 1


def test_terminal_root_is_worth_nothing() -> None:
    # All mass in an absorbing state whose every step ends the episode.
    over = finite((1.0,), np.ones((3, 1, 1)), np.ones((3, 1, 1)), np.zeros((3, 1, 1)), ends=True, level_mean=1.0)
    for rollout_mean in (False, True):
        result = search(over, THREE, SMALL._replace(rollout_depth=9, rollout_mean=rollout_mean), rng())
        assert result.value.tolist() == [0.0, 0.0, 0.0]
        assert (result.visits.sum(), result.n_node, result.max_depth) == (400, 1, 1)


def test_rewards_on_ending_count_and_nothing_after() -> None:
    once = bandit(np.array([0.0, 1.0]))._replace(ends=np.ones(2, dtype=np.bool_))
    result = search(once, np.arange(2), SMALL._replace(rollout_depth=9), rng())
    assert (result.value.tolist(), result.n_node, result.max_depth) == ([0.0, 1.0], 1, 1)


SAME = [
    (tracking(), SMALL),
    (tracking(), SMALL._replace(rollout_depth=4)),
    (tracking(), SMALL._replace(rollout_depth=4, rollout_mean=True)),
    (tracking(), SMALL._replace(depth=1)),
    (ENDING, SMALL._replace(depth=6, rollout_depth=2)),
    (tiger(), SMALL._replace(ucb_c=50.0, depth=5)),
    (bandit(np.linspace(0.1, 0.9, 40)), SMALL._replace(n_sim=25, depth=2)),
    (bandit(np.linspace(0.1, 0.9, 40)), SMALL._replace(n_sim=4000, depth=1)),
    (tracking(), SMALL._replace(n_sim=4000, ucb_c=0.3)),
]


@pytest.mark.parametrize(("problem", "settings"), SAME)
def test_kernel_and_plain_version_and_object_tree_are_equal(problem: Finite, settings: SearchSettings) -> None:
    actions = np.arange(problem.transition.shape[0])
    result = search(problem, actions, settings, rng(7))
    assert_equal(plain_search(problem, actions, settings, rng(7)), result)
    tree = search_tree(problem, actions, settings, rng(7))
    assert tree.visits == result.visits.tolist()
    assert tree.value == result.value.tolist()
    assert len(tree.all()) == result.n_node


def plain_search(problem: Any, actions: Any, settings: SearchSettings, rng: np.random.Generator) -> SearchResult:
    tree = new_tree(settings.n_sim, actions.size, rng)
    plain(simulate)(tree, problem, actions, settings, settings.n_sim, rng)
    return best_action(tree, actions)


def assert_equal(one: Any, other: Any) -> None:
    for a, b in zip(one, other, strict=True):
        assert np.array_equal(a, b)


@pytest.mark.parametrize(("problem", "settings"), SAME)
def test_visit_counts_add_up(problem: Finite, settings: SearchSettings) -> None:
    actions, source = np.arange(problem.transition.shape[0]), rng()
    tree = new_tree(settings.n_sim, actions.size, source)
    simulate(tree, problem, actions, settings, settings.n_sim, source)
    n_node, n_block, _ = tree.size
    assert tree.n_descent[ROOT] == settings.n_sim
    with_block = np.flatnonzero(tree.block[:n_node] != UNEXPANDED)
    assert sorted(tree.block[with_block]) == list(range(n_block))
    assert np.array_equal(tree.visits[tree.block[with_block]].sum(axis=1), tree.n_descent[with_block])
    assert np.array_equal(np.flatnonzero(tree.n_descent[:n_node]), with_block)
    # Each node but the root was made by one visit of its edge, which did not descend into it.
    used = tree.slot_key != FREE
    assert sorted(tree.slot_node[used]) == list(range(1, n_node))
    below = np.zeros(tree.visits.size, dtype=np.int64)
    np.add.at(below, tree.slot_key[used] >> OBSERVATION_BITS, 1 + tree.n_descent[tree.slot_node[used]])
    assert np.all(below[: n_block * actions.size] <= tree.visits[:n_block].ravel())
    assert not below[n_block * actions.size :].any()


def test_result_is_a_function_of_the_generator() -> None:
    assert_equal(search(tracking(), THREE, SMALL, rng(3)), search(tracking(), THREE, SMALL, rng(3)))
    first, second = (search(tracking(), THREE, SMALL, rng(seed)) for seed in (3, 4))
    assert not np.array_equal(first.value, second.value)


@pytest.mark.parametrize(("n_edge", "n_observation"), [(12_000, 1), (3000, 4), (120, 100)])
def test_hash_spreads_edges_and_observations_alike(n_edge: int, n_observation: int) -> None:
    # 12 000 balls thrown into 32 768 slots fill 32768 (1 - exp(-12000/32768)) = 10 049 of them; collisions here cost
    # half of the search's time once.
    empty = np.full(32_768, FREE, dtype=np.int64)
    edge, observation = np.divmod(np.arange(12_000), n_observation)
    assert edge.max() == n_edge - 1
    slots = {_find(empty, key) for key in (edge << OBSERVATION_BITS) | observation}
    assert len(slots) >= 9500


def test_hash_table_keeps_keys_that_collide_apart() -> None:
    # Half full: 32 of 64 slots. Of 32 keys thrown at random all fall into different ones with probability 8e-5.
    slot_key = np.full(64, FREE, dtype=np.int64)
    keys = rng().choice(2**40, 32, replace=False)
    slots = []
    for key in keys:
        slots.append(_find(slot_key, key))
        assert slot_key[slots[-1]] == FREE
        slot_key[slots[-1]] = key
    assert [_find(slot_key, key) for key in keys] == slots


@pytest.mark.parametrize(
    ("value", "visits", "best"),
    [
        ([0.1, 0.9, 0.5], [80, 5, 15], 1),  # the largest mean, not the most visited
        ([0.5, 0.5, 0.5], [20, 50, 30], 1),  # among equals the most visited
        ([0.5, 0.5, 0.5], [20, 40, 40], 1),  # then the first
        ([0.0, -3.0, -2.0], [0, 60, 40], 2),  # what was never tried has no mean
    ],
)
def test_decision_is_the_largest_mean(value: list[float], visits: list[int], best: int) -> None:
    tree = new_tree(100, 3, rng())
    tree.value[0], tree.visits[0] = value, visits
    result = best_action(tree, np.array([7, 8, 9]))
    assert (result.action, result.value.tolist(), result.visits.tolist()) == (7 + best, value, visits)


class Unknown(NamedTuple):
    nothing: int


def test_problem_without_functions_is_refused() -> None:
    problem = Unknown(0)
    for call in (
        lambda: sample_state(problem, rng()),
        lambda: step(problem, 0, 0, rng()),
        lambda: random_action(problem, rng()),
        lambda: mean_rollout(problem, 1, 0.9),
    ):
        with pytest.raises(NotImplementedError):
            call()


def test_functions_of_another_module_are_refused() -> None:
    """A change of theirs would not compile the search anew."""
    with pytest.raises(ValueError, match=r"draw of tests\.oracles\.pomcp for a problem of"):
        implement(Unknown, draw)


def test_a_search_with_time_enough_is_the_search_without_a_clock() -> None:
    """Slice by slice the same simulations; cut short, it has made the first ones and decides from them."""
    problem, settings = tiger(), SETTINGS._replace(n_sim=2_100)
    whole = search(problem, THREE, settings, rng(3))
    sliced = search_while(problem, THREE, settings, rng(3), lambda: True)
    assert sliced.action == whole.action
    np.testing.assert_array_equal(sliced.value, whole.value)
    np.testing.assert_array_equal(sliced.visits, whole.visits)
    cut = search_while(problem, THREE, settings, rng(3), lambda: False)
    assert cut.visits.sum() == 250
    first = search(problem, THREE, settings._replace(n_sim=250), rng(3))
    np.testing.assert_array_equal(cut.visits, first.visits)


@pytest.mark.parametrize("n_sim", [1, 7, 8, 12_000, 65_535])
@pytest.mark.parametrize("n_action", [1, 100])
def test_a_tree_allocates_what_scenarios_are_checked_against(n_sim: int, n_action: int) -> None:
    """And `simulate` a root of every visit count. Memory is reserved as a whole, before the first simulation."""
    reserved = sum(array.nbytes for array in new_tree(n_sim, n_action, rng()))
    assert reserved + 8 * (n_sim + 1) == tree_bytes(n_sim, n_action)
