"""The radar's decisions by another library, where it is installed."""

import sys
import threading
from collections.abc import Iterator

import numpy as np
import pytest

from cogradar.services.errors import BadInput, MissingLibrary
from cogradar.shared.planning.exact import Values, values_of
from cogradar.shared.planning.radar_pomdp import legal_actions
from studies.peers import peers
from tests.oracles.exact import belief

GAMMA = 0.8  # of `paper`


def test_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "studies.peers.pomdp_py_adapter", raising=False)
    monkeypatch.setitem(sys.modules, "pomdp_py", None)
    with pytest.raises(MissingLibrary, match=r"this study needs pomdp-py .*: pip install pomdp-py"):
        peers.solvers()


def cases(*_: object) -> Iterator[peers.Case]:
    """Beliefs over some bins each, with echoes of middling strength."""
    for seed in range(3):
        problem = belief(seed + 1, 100, 60.0, 2.0, 4.0)
        actions = legal_actions(problem.particles, problem.n_bin, problem.motion.dt, 2)
        yield peers.Case(problem, actions, values_of(problem, GAMMA))


def test_the_search_tends_to_the_exact_value(monkeypatch: pytest.MonkeyPatch) -> None:
    """And loses less with more simulations; the most probable bin has no value and takes no time."""
    monkeypatch.setattr(peers, "solvers", lambda: {"cogradar": peers.own})
    monkeypatch.setattr(peers, "open_cases", cases)
    told: list[str] = []
    mode, few, many = peers.play("paper", 1, 3, [60, 100_000], told.append, threading.Event()).rows
    assert told[-1] == "cogradar, 100000 simulations: 3 of 3 decisions"
    assert (mode["name"], mode["error"], mode["ms"]) == ("most probable bin", None, None)
    assert many["loss"] <= few["loss"] + 1e-9
    assert abs(many["error"]) < 20.0 < abs(few["error"])
    assert few["ms"] < many["ms"]


def test_runs_without_open_decisions_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peers, "solvers", dict)
    monkeypatch.setattr(peers, "open_cases", lambda *_: iter(()))
    with pytest.raises(BadInput, match="nothing to compare"):
        peers.play("paper", 1, 5, [50], lambda _: None, threading.Event())


def test_the_loss_is_that_of_the_exact_values() -> None:
    values = Values(10, np.array([0.5, 0.7, 0.6]), np.array([0.2, 0.3, 0.5]), np.zeros(3), 0.1)
    case = peers.Case(None, np.array([10, 11, 12]), values)  # type: ignore[arg-type]
    row = peers._row("one", 100, [case, case], [(11, 0.8, 0.002), (40, 0.2, 0.004)])
    assert (row["best"], row["ms"], row["us"]) == pytest.approx((50.0, 3.0, 30.0))
    assert (row["loss"], row["error"]) == pytest.approx((300.0, 100.0))


def test_pomdp_py_searches_the_same_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    """With as many simulations it expects about the same."""
    pytest.importorskip("pomdp_py")
    monkeypatch.setattr(peers, "open_cases", cases)
    _, own, other = peers.play("paper", 1, 3, [3000], lambda _: None, threading.Event()).rows
    assert (own["name"], other["name"]) == ("cogradar", "pomdp-py")
    assert own["error"] == pytest.approx(other["error"], abs=30.0)
    assert other["loss"] < 30.0
