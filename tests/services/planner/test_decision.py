"""Which bin a track asks for: the settings of the planner reach the search, which draws from a key of its own."""

from typing import Any

import numpy as np
import pytest

from cogradar.services.planner import decision
from cogradar.services.planner.decision import decide
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.planning.radar_pomdp import RadarPomdp
from cogradar.shared.planning.rules import Choice, chosen_bin
from cogradar.shared.scenario.radar_config import RadarConfig, Strategy
from cogradar.shared.tracking.model import TrackerModel, TrackState
from cogradar.shared.tracking.track import observe, start
from tests.shared.tracking.models import smoke_model, smoke_radar
from tests.shared.tracking.scans import ACQUISITION, BIN, HIT, LAST, MISS, SEED, TARGET


def started(model: TrackerModel) -> TrackState:
    return start(model, TARGET, BIN, ACQUISITION)


class Searched:
    """Stands for the search: what it was asked with, and how many numbers it drew."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.gains: list[float] = []
        self.states: list[Any] = []
        monkeypatch.setattr(decision, "chosen_bin", self)

    def __call__(self, problem: RadarPomdp, radar: RadarConfig, rng: Any, has_time: None) -> Choice:
        self.gains.append(problem.gain)
        choice = chosen_bin(problem, radar, rng, has_time)
        self.states.append(rng.bit_generator.state["state"]["state"].tolist())
        return choice


@pytest.mark.parametrize(("fidelity", "sigma"), [("paper", 0.09), ("robust", 0.09 * np.sqrt(128.0 / 4.0))])
def test_the_search_expects_the_noise_that_the_fidelity_remembers(
    fidelity: str, sigma: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    searched, model = Searched(monkeypatch), smoke_model(fidelity)
    state = observe(model, observe(model, started(model), HIT), MISS)
    decide(smoke_radar(fidelity), model, state)
    assert searched.gains == [pytest.approx(10.0 ** (70.0 / 20.0) / sigma, rel=1e-12)]


def test_the_rollout_of_the_fidelity_reaches_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Random rollouts draw numbers, their mean draws none: the two leave the generator in different states."""
    searched, robust, literal = Searched(monkeypatch), smoke_radar("robust"), smoke_radar("paper")
    assert (robust.belief.filter, literal.belief.filter) == ("likelihood", "published")
    model = smoke_model("robust")
    for radar in (robust, literal, robust):
        decide(radar, model, started(model))
    assert searched.states[0] == searched.states[2] != searched.states[1]


def test_the_search_draws_from_a_key_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    keys: list[tuple[int, Purpose, int, int]] = []

    def keyed(*key: Any) -> np.random.Generator:
        keys.append(key)
        return generator(*key)

    monkeypatch.setattr(decision, "generator", keyed)
    model = smoke_model("robust")
    state = started(model)
    decide(smoke_radar("robust"), model, state)
    decide(smoke_radar("robust"), model, observe(model, state, HIT))
    assert keys == [(SEED, Purpose.SEARCH, TARGET, k) for k in (LAST, HIT.k)]


def test_the_orthogonal_strategy_searches_nothing_and_asks_where_the_belief_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decision, "chosen_bin", lambda *_: pytest.fail("searched"))
    model = smoke_model("robust", Strategy.ORTHOGONAL)
    made = decide(smoke_radar("robust"), model, started(model))
    assert (made.bins.tolist(), made.best_bin, made.n_sim) == ([BIN], BIN, 0)
    assert made.range_km == pytest.approx(np.hypot(made.estimate[0], made.estimate[2]), abs=1.0)
