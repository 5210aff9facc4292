"""The whole radar as Gymnasium environments, in which an agent decides what is radiated.

    import gymnasium
    import cogradar.env

    environment = gymnasium.make("cogradar/Paper-v0")
    observation, info = environment.reset(seed=1)
    observation, reward, terminated, truncated, info = environment.step(environment.action_space.sample())

Front end, detector, beliefs and scores are the same as in `cogradar.run`; only the waveform is the agent's. An episode
is a run: it begins after the acquisition, where there is one, and is truncated after its last dwell. Needs Gymnasium:
pip install 'cogradar[gym]'.
"""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from cogradar.running import Player, play, run_start
from cogradar.running import load as load_scenario
from cogradar.services.analysis.arrays.dwell import Dwell
from cogradar.services.errors import BadInput
from cogradar.shared.protocol.messages import Plan, Waveform
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scoring.sets import assigned, distance_of, squared_distances
from cogradar.shared.signal.array import bin_centres
from cogradar.shared.signal.waveform import beam_factor

Observation = dict[str, NDArray[Any]]
Action = Mapping[str, NDArray[Any]]
SLOTS = 100  # tracks of an unknown number that an agent sees: those with the lowest numbers


def detections(dwell: Dwell) -> float:
    """Share of the targets that are there with a cell over its limit, 0 .. 1."""
    there = len(dwell.truth())
    return len(set(dwell.detections()["target"].tolist()) - {0}) / there if there else 0.0


def information(dwell: Dwell) -> float:
    """Minus the mean differential entropy of the tracks' positions, in nats; 0 without a track."""
    of_position = dwell.tracks()["covariance"][:, ::2, ::2]
    if not len(of_position):
        return 0.0
    return float(-np.mean(0.5 * np.linalg.slogdet(2.0 * math.pi * math.e * of_position)[1]))


def gospa(dwell: Dwell) -> float:
    """Minus GOSPA of confirmed tracks and targets, km: p = 2, alpha = 2, c = 5 km."""
    tracks, truth = dwell.tracks(), dwell.truth()
    tracks = tracks[tracks["confirmed"]]
    estimates = np.stack([tracks[name] for name in ("x_hat", "vx_hat", "y_hat", "vy_hat")], axis=-1)
    states = np.stack([truth[name] for name in ("x", "vx", "y", "vy")], axis=-1)
    squared = squared_distances(estimates, states)
    within = [float(squared[i, j]) for i, j in enumerate(assigned(squared)) if j >= 0]
    found = distance_of(len(tracks), len(truth), within)
    return -float(np.sqrt(found.localisation + found.missed + found.false))


REWARDS: dict[str, Callable[[Dwell], float]] = {
    "detections": detections,
    "information": information,
    "gospa": gospa,
}


class _Radar(gymnasium.Env[Observation, Action]):
    """What all environments have in common."""

    _quick: ClassVar[Mapping[str, Any]] = {}  # what is set unless somebody else sets it
    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 - as Gymnasium has it

    def __init__(
        self,
        scenario: str | Path | Scenario,
        settings: Mapping[str, Any],
        dwells: int | None,
        reward: str,
        render_mode: str | None,
    ) -> None:
        if reward not in REWARDS:
            raise BadInput(f"reward = {reward!r}: must be one of {', '.join(REWARDS)}")
        if render_mode not in {None, *self.metadata["render_modes"]}:
            raise BadInput(f"render_mode = {render_mode!r}: must be rgb_array or None")
        self.render_mode = render_mode
        if isinstance(scenario, Scenario) and settings:
            raise BadInput("settings: a Scenario has all its values: give cogradar.load the settings, or here the name")
        if not isinstance(settings, Mapping):
            raise BadInput(f"settings = {settings!r}: must be a dict")
        given = {**self._quick, **settings}
        self._scenario = scenario if isinstance(scenario, Scenario) else load_scenario(scenario, given)
        run_start(self._scenario, Strategy.UNIFORM, 0, dwells)  # each episode's, refused before the first
        self._dwells = dwells
        self._reward = REWARDS[reward]
        self._player: Player | None = None
        self._dwell: Dwell | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin another run; its seed is drawn from the environment's generator, which `seed` sets."""
        super().reset(seed=seed, options=options)
        self.close()
        of_run = int(self.np_random.integers(2**63))
        self._player = play(self._scenario, seed=of_run, dwells=self._dwells, strategy="uniform")
        self._dwell = next(dwell for dwell in self._player if self._begins(dwell))
        return self._observation(self.dwell), self._info(self.dwell)

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Radiate what the action says, and measure; the action is that for the dwell after the last observation."""
        if self._player is None:
            raise BadInput("step: reset the environment first")
        if not isinstance(action, Mapping):
            raise BadInput(f"action: {type(action).__name__}: must be a dict of arrays, as of the space")
        known = [*getattr(self.action_space, "spaces", ())]
        if unknown := [name for name in action if name not in known]:
            raise BadInput(f"action: {unknown[0]}: must be one of {', '.join(known)}")
        try:
            self._dwell = self._player.send(self._waveform(self.dwell, action))
        except StopIteration:
            raise BadInput("step: the episode is over: reset the environment first") from None
        is_last = self._dwell.t >= self._player.dwells
        reward = self._reward(self._dwell)
        return self._observation(self._dwell), reward, False, is_last, self._info(self._dwell)

    def render(self) -> Any:
        """The beliefs after the last dwell, an image (height, width, 3)."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        figure = Figure(figsize=(6.4, 4.8), dpi=100)
        canvas, axes = FigureCanvasAgg(figure), figure.add_subplot()
        truth, tracks = self.dwell.truth(), self.dwell.tracks()
        axes.plot(truth["y"], truth["x"], "+", tracks["y_hat"], tracks["x_hat"], "o", markerfacecolor="none")
        axes.set(xlabel="y, km", ylabel="x (boresight), km", title=f"dwell {self.dwell.t}")
        canvas.draw()
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()

    def close(self) -> None:
        """Give up the run."""
        if self._player is not None:
            self._player.close()
        self._player = self._dwell = None

    @property
    def dwell(self) -> Dwell:
        """The last dwell, with all its tables. Raises BadInput before the first one."""
        if self._dwell is None:
            raise BadInput("reset the environment first")
        return self._dwell

    def _begins(self, dwell: Dwell) -> bool:
        """Whether the agent decides from this dwell on."""
        raise NotImplementedError

    def _observation(self, dwell: Dwell) -> Observation:
        raise NotImplementedError

    def _waveform(self, dwell: Dwell, action: Action) -> Waveform | None:
        raise NotImplementedError

    def _info(self, dwell: Dwell) -> dict[str, Any]:
        """What no radar knows: the true states, (n, 4), and whose rows they are."""
        truth = dwell.truth()
        states = np.stack([truth[name] for name in ("x", "vx", "y", "vy")], axis=-1)
        return {"k": dwell.k, "t": dwell.t, "targets": np.asarray(truth["target"]), "states": states}


def _beliefs(plans: list[Plan], size: int) -> Observation:
    """What is known of each track, in the order of `plans`, zeros behind them."""
    shown: Observation = {
        "mean": np.zeros((size, 4)),
        "covariance": np.zeros((size, 4, 4)),
        "range_km": np.zeros(size),
        "gain": np.zeros(size),
        "detected": np.zeros(size, dtype=np.int8),
    }
    for i, plan in enumerate(plans[:size]):
        shown["mean"][i], shown["covariance"][i] = plan.estimate, plan.covariance
        shown["range_km"][i], shown["gain"][i], shown["detected"][i] = plan.range_km, plan.gain, plan.detected
    return shown


def _space_of_beliefs(size: int) -> dict[str, spaces.Space[Any]]:
    return {
        "mean": spaces.Box(-np.inf, np.inf, (size, 4), np.float64),
        "covariance": spaces.Box(-np.inf, np.inf, (size, 4, 4), np.float64),
        "range_km": spaces.Box(0.0, np.inf, (size,), np.float64),
        "gain": spaces.Box(0.0, np.inf, (size,), np.float64),
        "detected": spaces.MultiBinary(size),
    }


def _numbers(action: Action, name: str, size: int, most: float, *, whole: bool = False) -> NDArray[np.float64]:
    """What an action says, (size,). Raises BadInput for what is not in its space."""
    try:
        found = np.asarray(action[name], dtype=np.float64)
    except (KeyError, TypeError, ValueError):
        found = np.empty(0)
    if found.shape != (size,) or not ((found >= 0.0) & (found <= most) & ~(whole & (found != np.floor(found)))).all():
        raise BadInput(f"action: {name} must be {size} of 0 .. {most:g}{', whole numbers' if whole else ''}")
    return found


def _shares(weights: NDArray[np.float64], power: float) -> NDArray[np.float64]:
    """Power split in proportion to weights, evenly if all are 0."""
    total = float(weights.sum())
    return weights * (power / total) if total > 0.0 else np.full(weights.shape, power / max(weights.size, 1))


class PaperEnv(_Radar):
    """A known number M of targets, found already, and an angle grid of L bins: "cogradar/Paper-v0".

    Action      : "bins", (M,), the bin that each track is looked for in, and "weights", (M,), 0 .. 1, what the power is
                  split in proportion to; with actions="bins" it is split evenly
    Observation : Of the belief after the last dwell: "mean" (M, 4), [x, vx, y, vy] in km and km/s, and "covariance"
                  (M, 4, 4). Of the last dwell: "detected" (M,). Expected in the next dwell: "range_km" and "gain" (M,),
                  and "best_bin" (M,), the most probable one.
    Reward      : one of `REWARDS`
    """

    _quick: ClassVar[Mapping[str, Any]] = {"radar.planner.rule": "mode"}  # no search for what the agent does not ask

    def __init__(
        self,
        scenario: str | Path | Scenario = "paper",
        *,
        settings: Mapping[str, Any] | None = None,
        dwells: int | None = None,
        actions: str = "cells",
        reward: str = "detections",
        render_mode: str | None = None,
    ) -> None:
        super().__init__(scenario, settings or {}, dwells, reward, render_mode)
        radar = self._scenario.radar
        if radar.is_unknown or radar.receiver.cells != "bins":
            raise BadInput(f'{self._scenario.name}: needs a known number of targets, and cells = "bins"')
        if actions not in {"cells", "bins"}:
            raise BadInput(f"actions = {actions!r}: must be cells or bins")
        m, self._n_bin, self._is_weighted = radar.announced, radar.array.n_bin, actions == "cells"
        chosen: dict[str, spaces.Space[Any]] = {"bins": spaces.MultiDiscrete(np.full(m, self._n_bin))}
        if self._is_weighted:
            chosen["weights"] = spaces.Box(0.0, 1.0, (m,), np.float64)
        self.action_space = spaces.Dict(chosen)  # type: ignore[assignment] # a Dict of arrays is what Action says
        bins = {"best_bin": spaces.MultiDiscrete(np.full(m, self._n_bin))}
        self.observation_space = spaces.Dict(_space_of_beliefs(m) | bins)  # type: ignore[assignment] # likewise

    def _begins(self, dwell: Dwell) -> bool:
        return dwell.next is not None and dwell.next.tracking

    def _observation(self, dwell: Dwell) -> Observation:
        plans = sorted(dwell.plans, key=lambda plan: plan.target)
        return _beliefs(plans, len(plans)) | {"best_bin": np.array([plan.best_bin for plan in plans], dtype=np.int64)}

    def _waveform(self, dwell: Dwell, action: Action) -> Waveform | None:
        if (sent := dwell.next) is None:
            return None
        array, m = self._scenario.radar.array, sent.beams.shape[0]
        bins = _numbers(action, "bins", m, self._n_bin - 1, whole=True).astype(np.int32)
        weights = _numbers(action, "weights", m, 1.0) if self._is_weighted else np.ones(m)
        shares = _shares(weights, array.power)
        factor = beam_factor(bin_centres(self._n_bin)[bins], shares, array.n_tx)
        told = {
            "beams": bins[:, np.newaxis],
            "shares": shares[:, np.newaxis],
            "factor": factor.astype(sent.factor.dtype),
        }
        return sent.model_copy(update=told | {"isotropic": 0.0, "status": "fixed"})


class SkyEnv(_Radar):
    """An unknown number of targets, which come and go: "cogradar/Sky-v0".

    The radar looks for each track where its belief says; the agent splits the power over tracks and search.

    Action      : "weights", (SLOTS,), 0 .. 1, of the tracks, and "search", (1,), of all beams of the search together:
                  what the power is split in proportion to
    Observation : as of `PaperEnv`, (SLOTS, ...), in the order of the tracks' numbers; "existence" (SLOTS,) is their
                  probability of existence, 0 where there is no track. One that has just begun has no belief yet.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario = "traffic",
        *,
        settings: Mapping[str, Any] | None = None,
        dwells: int | None = None,
        reward: str = "gospa",
        render_mode: str | None = None,
    ) -> None:
        super().__init__(scenario, settings or {}, dwells, reward, render_mode)
        radar = self._scenario.radar
        if radar.search is None or radar.search.pattern == "isotropic":
            raise BadInput(f"{self._scenario.name}: needs an unknown number of targets, and a search with beams")
        share = spaces.Box(0.0, 1.0, (SLOTS,), np.float64)
        chosen: dict[str, spaces.Space[Any]] = {"weights": share, "search": spaces.Box(0.0, 1.0, (1,), np.float64)}
        self.action_space = spaces.Dict(chosen)  # type: ignore[assignment] # a Dict of arrays is what Action says
        shown = _space_of_beliefs(SLOTS) | {"existence": share}
        self.observation_space = spaces.Dict(shown)  # type: ignore[assignment] # likewise

    def _begins(self, dwell: Dwell) -> bool:
        return dwell.k == 0

    def _observation(self, dwell: Dwell) -> Observation:
        by_track = {plan.target: plan for plan in dwell.plans if plan.status == "tracking"}
        roster = dwell.next.roster if dwell.next is not None else None
        ids = [] if roster is None else roster.ids.tolist()
        plans = [by_track[one] for one in ids if one in by_track]
        existence = np.zeros(SLOTS)
        existence[: len(ids)] = 0.0 if roster is None else roster.expected[:SLOTS, -1]
        return _beliefs(plans, SLOTS) | {"existence": existence}

    def _waveform(self, dwell: Dwell, action: Action) -> Waveform | None:
        sent = dwell.next
        if sent is None or sent.roster is None or sent.nus is None:
            return None
        power, roster = self._scenario.radar.array.power, sent.roster
        weights = np.zeros(sent.beams.shape)
        given = _numbers(action, "weights", SLOTS, 1.0)[: sent.beams.shape[0]]
        searched = float(_numbers(action, "search", 1, 1.0)[0])
        lit = (sent.beams >= 0) & (np.cumsum(sent.beams >= 0, axis=1) == 1)  # the brightest cell of each track
        weights[: given.size] = lit[: given.size] * given[:, np.newaxis]
        search = searched if roster.searched.size else 0.0
        if weights.sum() + search <= 0.0:
            weights, search = lit.astype(np.float64), 1.0
        scale = power / (weights.sum() + search)
        shares, of_search = weights * scale, search * scale
        at = shares > 0.0
        beams = beam_factor(sent.nus[at], shares[at], self._scenario.radar.array.n_tx)
        each = np.full(roster.searched.size, of_search / max(roster.searched.size, 1))
        factor = np.hstack((beams, beam_factor(roster.searched, each, self._scenario.radar.array.n_tx)))
        told = {"shares": shares, "factor": factor.astype(sent.factor.dtype), "isotropic": 0.0, "status": "fixed"}
        return sent.model_copy(update=told | {"roster": roster.model_copy(update={"search_share": of_search})})


gymnasium.register("cogradar/Paper-v0", "cogradar.env:PaperEnv")
gymnasium.register("cogradar/Sky-v0", "cogradar.env:SkyEnv")
