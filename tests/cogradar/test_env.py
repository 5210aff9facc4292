"""Environments: Gymnasium's own check, equal seeds give equal episodes, and the waveform is what the action says."""

import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from numpy.typing import NDArray

import cogradar
import cogradar.env
from tests.skies import small_sky

Episode = list[tuple[dict[str, NDArray[Any]], float]]


def _made(name: str, **how: Any) -> Any:
    scenario = small_sky() if name.startswith("cogradar/Sky") else "smoke"
    return gymnasium.make(name, **{"scenario": scenario, "dwells": 8} | how).unwrapped


@pytest.mark.parametrize(
    ("name", "how"),
    [
        ("cogradar/Paper-v0", {"render_mode": "rgb_array"}),
        ("cogradar/Paper-v0", {"actions": "bins", "reward": "information"}),
        ("cogradar/Sky-v0", {}),
    ],
)
def test_gymnasium_finds_nothing_wrong(name: str, how: dict[str, Any]) -> None:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*A Box observation space (min|max)imum value is")  # beliefs have no bound
        check_env(_made(name, **how))


def _episode(environment: Any, seed: int) -> Episode:
    observation, _ = environment.reset(seed=seed)
    environment.action_space.seed(seed)
    found, is_over = [(observation, 0.0)], False
    while not is_over:
        observation, reward, is_done, is_over, info = environment.step(environment.action_space.sample())
        assert not is_done
        found.append((observation, reward))
    assert info["t"] == 8
    environment.close()
    return found


@pytest.mark.parametrize("name", ["cogradar/Paper-v0", "cogradar/Sky-v0"])
def test_equal_seeds_give_equal_episodes(name: str) -> None:
    one, same, other = (_episode(_made(name), seed) for seed in (5, 5, 6))
    assert len(one) == len(same)
    for (shown, reward), (again, repeated) in zip(one, same, strict=True):
        assert reward == repeated
        assert all(np.array_equal(shown[key], again[key]) for key in shown)
    assert not np.array_equal(one[-1][0]["mean"], other[-1][0]["mean"])


def test_the_waveform_is_what_the_action_says() -> None:
    environment = _made("cogradar/Paper-v0")
    observation, info = environment.reset(seed=1)
    assert observation["mean"].shape == (2, 4)
    for _ in range(4):
        bins = (observation["best_bin"] + np.array([0, 3])) % 16
        observation, *_ = environment.step({"bins": bins, "weights": np.array([0.25, 0.75])})
    dwell = environment.dwell
    looks, sent = dwell.detections(all_looks=True), dwell.waveforms()
    assert sorted(looks["nu"].tolist()) == pytest.approx(sorted((bins / 15.0 - 0.5).tolist()))
    assert dwell.tracks()["share"].tolist() == pytest.approx([0.25, 0.75])
    assert np.sum(np.abs(sent["factor"]) ** 2) == pytest.approx(1.0)
    assert info["states"].shape == (2, 4)
    environment.close()


def test_power_goes_where_the_agent_puts_it() -> None:
    environment = _made("cogradar/Sky-v0", dwells=12)
    observation, _ = environment.reset(seed=4)
    for _ in range(11):
        first = np.zeros(cogradar.env.SLOTS)
        first[0] = 1.0
        observation, *_ = environment.step({"weights": first, "search": np.array([1.0])})
    tracks = environment.dwell.tracks()
    assert np.count_nonzero(observation["existence"]) >= 2
    assert tracks["share"][0] == pytest.approx(0.5)
    assert not tracks["share"][1:].any()
    environment.close()


def test_what_is_not_steered_is_the_radars_own_run() -> None:
    own = cogradar.run("smoke", seed=2, dwells=6)
    with cogradar.play("smoke", seed=2, dwells=6) as player:
        dwell = next(player)
        while dwell.t < player.dwells:
            dwell = player.send(None)
        list(player)
        assert player.result.digest == own.digest


def test_a_better_policy_is_rewarded() -> None:
    environment = _made("cogradar/Paper-v0", dwells=20)
    totals = []
    for is_random in (False, True):
        observation, _ = environment.reset(seed=7)
        environment.action_space.seed(7)
        totals.append(0.0)
        for _ in range(20):
            likely = {"bins": observation["best_bin"], "weights": np.ones(2)}
            action = environment.action_space.sample() if is_random else likely
            observation, reward, *_ = environment.step(action)
            totals[-1] += reward
    assert totals[0] > totals[1] + 5.0


@pytest.mark.parametrize(
    ("name", "how", "words"),
    [
        ("cogradar/Paper-v0", {"reward": "fame"}, "must be one of detections, information, gospa"),
        ("cogradar/Paper-v0", {"actions": "words"}, "must be cells or bins"),
        ("cogradar/Paper-v0", {"dwells": 0}, "dwells = 0: must be an integer >= 1"),
        ("cogradar/Sky-v0", {"dwells": 2.5}, "dwells = 2.5: must be a whole number"),
        ("cogradar/Paper-v0", {"scenario": "traffic"}, "needs a known number of targets"),
        ("cogradar/Sky-v0", {"scenario": "paper"}, "needs an unknown number of targets"),
        ("cogradar/Sky-v0", {"scenario": "nowhere"}, "no such scenario"),
    ],
)
def test_what_cannot_be_played_is_bad_input(name: str, how: dict[str, Any], words: str) -> None:
    with pytest.raises(cogradar.BadInput, match=words):
        _made(name, **how)


def test_an_action_outside_the_grid_is_bad_input() -> None:
    environment = _made("cogradar/Paper-v0")
    with pytest.raises(cogradar.BadInput, match="reset"):
        environment.step(environment.action_space.sample())
    environment.reset(seed=1)
    for bins in ([3, 16], [3, -1], [3], [3.5, 4.0], [float("nan"), 3.0], ["a", "b"], [3, 2**32]):
        with pytest.raises(cogradar.BadInput, match=r"bins must be 2 of 0 \.\. 15, whole numbers"):
            environment.step({"bins": np.array(bins)})
    for weights in ([0.5, float("nan")], [-0.5, 1.0], [0.5, 1.5], [1.0], [1.0, float("inf")]):
        with pytest.raises(cogradar.BadInput, match=r"weights must be 2 of 0 \.\. 1$"):
            environment.step({"bins": np.array([3, 4]), "weights": np.array(weights)})
    for _ in range(8):
        *_, is_over, _ = environment.step({"bins": np.array([3, 4]), "weights": np.array([0.0, 1.0])})
    assert is_over
    with pytest.raises(cogradar.BadInput, match="the episode is over: reset"):
        environment.step({"bins": np.array([3, 4]), "weights": np.ones(2)})
    environment.close()


def test_an_action_has_what_its_space_has_and_nothing_else() -> None:
    """Without weights the power was split evenly, as if an agent had meant it."""
    bins = {"bins": np.array([3, 4])}
    for how, action, words in (
        ({}, bins, "weights must be 2 of"),
        ({"actions": "bins"}, bins | {"weights": np.ones(2)}, "action: weights: must be one of bins"),
    ):
        environment = _made("cogradar/Paper-v0", **how)
        environment.reset(seed=1)
        with pytest.raises(cogradar.BadInput, match=words):
            environment.step(action)
        environment.close()


def test_a_sky_takes_any_split_of_its_space_and_no_other() -> None:
    environment = _made("cogradar/Sky-v0")
    environment.reset(seed=4)
    for search, weight in ((0.0, 1.0), (1.0, 0.0), (0.0, 0.0), (1.0, 1.0)):
        shown, *_ = environment.step({"weights": np.full(100, weight), "search": np.array([search])})
        assert all(np.isfinite(values).all() for values in shown.values())
    for action, words in (
        ({"weights": np.full(100, np.nan), "search": np.ones(1)}, "weights must be 100 of"),
        ({"weights": np.ones(3), "search": np.ones(1)}, "weights must be 100 of"),
        ({"weights": np.ones(100), "search": -np.ones(1)}, "search must be 1 of"),
        ({"weights": np.ones(100)}, "search must be 1 of"),
    ):
        with pytest.raises(cogradar.BadInput, match=words):
            environment.step(action)
    environment.close()
    with pytest.raises(cogradar.BadInput, match="a Scenario has all its values"):
        _made("cogradar/Sky-v0", settings={"radar.array.n_tx": 12})
