"""Which bin a track asks for: the settings of the planner reach the search, which draws from a key of its own."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from services.planner import decision
from services.planner.decision import decide
from shared.numerics.seeds import Purpose, generator
from shared.planning.radar_pomdp import plan
from shared.scenario.radar_config import FIDELITY, RadarConfig, Strategy
from shared.tracking.model import TrackerModel, TrackState
from shared.tracking.track import observe, start
from tests.shared.tracking.models import smoke_model, smoke_radar
from tests.shared.tracking.scans import ACQUISITION, BIN, HIT, LAST, MISS, SEED, TARGET


def started(model: TrackerModel) -> TrackState:
    return start(model, TARGET, BIN, ACQUISITION)


class Planned:
    """Stands for the search: what it was asked with, and how many numbers it drew."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.sigma: list[float] = []
        self.states: list[Any] = []
        monkeypatch.setattr(decision, "plan", self)

    def __call__(
        self, particles: NDArray[np.float64], sigma: float, radar: RadarConfig, rng: Any, has_time: None
    ) -> Any:
        self.sigma.append(sigma)
        result = plan(particles, sigma, radar, rng, has_time)
        self.states.append(rng.bit_generator.state["state"]["state"].tolist())
        return result


@pytest.mark.parametrize(("fidelity", "sigma"), [("paper", 0.09), ("robust", 0.09 * np.sqrt(128.0 / 4.0))])
def test_the_search_expects_the_noise_that_the_fidelity_remembers(
    fidelity: str, sigma: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    planned, model = Planned(monkeypatch), smoke_model(fidelity)
    state = observe(model, observe(model, started(model), HIT), MISS)
    decide(smoke_radar(fidelity), model, state)
    assert planned.sigma == [pytest.approx(sigma, rel=1e-12)]


def test_the_rollout_of_the_fidelity_reaches_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Random rollouts draw numbers, their mean draws none: the two leave the generator in different states."""
    planned, robust = Planned(monkeypatch), smoke_radar("robust")
    assert {name: settings["planner"]["rollout"] for name, settings in FIDELITY.items()} == {
        "paper": "random",
        "robust": "mean",
    }
    literal = robust.model_copy(update={"planner": smoke_radar("paper").planner})
    model = smoke_model("robust")
    for radar in (robust, literal, robust):
        decide(radar, model, started(model))
    assert planned.states[0] == planned.states[2] != planned.states[1]


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
    monkeypatch.setattr(decision, "plan", lambda *_: pytest.fail("searched"))
    model = smoke_model("robust", Strategy.ORTHOGONAL)
    made = decide(smoke_radar("robust"), model, started(model))
    assert (made.bin, made.n_sim) == (BIN, 0)
    assert made.range_km == pytest.approx(np.hypot(made.estimate[0], made.estimate[2]), abs=1.0)
