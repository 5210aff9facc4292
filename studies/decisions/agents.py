"""Agents and the radar's own rules in one environment: what each lets the radar detect, with intervals.

In `starved` there is too little power to light all aircraft well: how it is split could decide what is detected. An
agent's policy is linear: the logarithm of a track's weight is theta^T [log range, log sigma, not detected]. It is
trained by the cross-entropy method on seeds of its own.
"""

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cogradar
from cogradar.env import PaperEnv, detections, gospa
from cogradar.services.analysis.tables import Column, Table
from cogradar.services.errors import check_stop
from cogradar.shared.scoring.errors import bootstrap_interval

Observation = Mapping[str, NDArray[Any]]
Policy = Callable[[Observation], dict[str, NDArray[Any]]]
Tell = Callable[[str], None]

FEATURES = 3  # a factor that all weights have changes nothing
POPULATION, ELITE, GENERATIONS, EPISODES = 16, 4, 8, 2  # of the cross-entropy method
FIRST_TRAINING_SEED = 1_000_000  # beyond any seed of a comparison
RULES: dict[str, dict[str, Any]] = {  # of the radar itself
    "POMCP, max-min power": {"radar.planner.rule": "pomcp"},
    "most probable bin, max-min power": {"radar.planner.rule": "mode"},
    "joint looks, urgency": {"radar.allocation.objective": "urgency"},
}


def linear(theta: NDArray[np.float64]) -> Policy:
    """The policy with these parameters, (FEATURES,)."""

    def act(shown: Observation) -> dict[str, NDArray[Any]]:
        sigma = np.sqrt(np.maximum(np.trace(shown["covariance"][:, ::2, ::2], axis1=1, axis2=2), 1e-6))
        features = np.stack([np.log(np.maximum(shown["range_km"], 1e-3)), np.log(sigma), 1.0 - shown["detected"]])
        logarithms = theta @ features
        return {"bins": shown["best_bin"], "weights": np.exp(logarithms - logarithms.max())}

    return act


def played(scenario: str, act: Policy, dwells: int, seed: int) -> tuple[float, float, float]:
    """Mean detections a target and GOSPA (km) of the dwells of one episode, and its steps per second."""
    environment = PaperEnv(scenario, dwells=dwells)
    shown, _ = environment.reset(seed=seed)
    began, hits, distances = time.monotonic(), list[float](), list[float]()
    while len(hits) < dwells:
        shown, reward, *_ = environment.step(act(shown))
        hits.append(reward)
        distances.append(-gospa(environment.dwell))
    took = time.monotonic() - began
    environment.close()
    return float(np.mean(hits)), float(np.mean(distances)), dwells / took


def own(scenario: str, settings: Mapping[str, Any], dwells: int, seed: int) -> tuple[float, float, float]:
    """The same of the radar's own rules."""
    began, hits, distances = time.monotonic(), list[float](), list[float]()
    of_run = int(np.random.default_rng(seed).integers(2**63))  # the run that an environment begins with this seed
    with cogradar.play(scenario, set=settings, seed=of_run, dwells=dwells) as player:
        for dwell in player:
            if dwell.t:
                hits.append(detections(dwell))
                distances.append(-gospa(dwell))
    return float(np.mean(hits)), float(np.mean(distances)), dwells / (time.monotonic() - began)


def trained(scenario: str, dwells: int, tell: Tell, stop: threading.Event) -> NDArray[np.float64]:
    """Parameters of `linear` that the cross-entropy method finds."""
    rng, seeds = np.random.default_rng(1), count(FIRST_TRAINING_SEED)
    mean, spread = np.zeros(FEATURES), np.full(FEATURES, 2.0)
    for generation in range(GENERATIONS):
        ours = [next(seeds) for _ in range(EPISODES)]
        candidates = mean + spread * rng.standard_normal((POPULATION, FEATURES))
        values = np.zeros(POPULATION)
        for i, theta in enumerate(candidates):
            check_stop(stop)
            values[i] = np.mean([played(scenario, linear(theta), dwells, seed)[0] for seed in ours])
            tell(f"training: generation {generation + 1} of {GENERATIONS}, policy {i + 1} of {POPULATION}")
        best = candidates[np.argsort(values)[-ELITE:]]
        mean, spread = best.mean(axis=0), best.std(axis=0) + 0.1
    return mean


def policies(theta: NDArray[np.float64], n_bin: int) -> Iterator[tuple[str, Policy]]:
    """The agents that are compared."""
    rng = np.random.default_rng(2)

    def at_random(shown: Observation) -> dict[str, NDArray[Any]]:
        m = shown["range_km"].size
        return {"bins": rng.integers(n_bin, size=m), "weights": rng.random(m)}

    yield "random", at_random
    yield "most probable bin, equal power", linear(np.zeros(FEATURES))
    yield "most probable bin, power as range^4", linear(np.array([4.0, 0.0, 0.0]))
    yield f"trained: {theta[0]:+.1f} log range {theta[1]:+.1f} log sigma {theta[2]:+.1f} if not detected", linear(theta)


def table(scenario: str, seeds: int, dwells: int, tell: Tell, stop: threading.Event) -> Table:
    """All of them over the same seeds."""
    theta = trained(scenario, dwells, tell, stop)
    n_bin = cogradar.load(scenario).radar.array.n_bin
    plays: dict[str, Callable[[int], tuple[float, float, float]]] = {
        name: lambda seed, act=act: played(scenario, act, dwells, seed)  # type: ignore[misc]
        for name, act in policies(theta, n_bin)
    }
    for name, settings in RULES.items():
        plays[name] = lambda seed, settings=settings: own(scenario, settings, dwells, seed)  # type: ignore[misc]
    rows, rng = [], np.random.default_rng(3)
    for name, play in plays.items():
        found = []
        for seed in range(1, seeds + 1):
            check_stop(stop)
            found.append(play(seed))
            tell(f"{name}: run {seed} of {seeds}")
        hits, distances, rates = np.array(found).T
        row: dict[str, Any] = {"policy": name, "runs": seeds, "hits": hits.mean(), "gospa": distances.mean()}
        row["hits_low"], row["hits_high"] = bootstrap_interval(hits, rng)
        row["gospa_low"], row["gospa_high"] = bootstrap_interval(distances, rng)
        rows.append(row | {"rate": np.median(rates)})
    columns = [
        Column("policy", "{policy}", left=True),
        Column("runs", "{runs}"),
        Column("detected", "{hits:.3f} [{hits_low:.3f}, {hits_high:.3f}]"),
        Column("GOSPA km", "{gospa:.2f} [{gospa_low:.2f}, {gospa_high:.2f}]"),
        Column("dwells/s", "{rate:.0f}"),
    ]
    return Table(f"`{scenario}`, {dwells} dwells: share of the targets that a dwell detects", columns, rows)
