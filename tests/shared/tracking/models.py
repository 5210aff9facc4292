"""Tracker models that the tests begin with."""

import tomllib
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.scenario.files import SCENARIO_DIR, load, parse
from cogradar.shared.scenario.radar_config import RadarConfig, Strategy
from cogradar.shared.signal.array import angle_bin, bin_centres
from cogradar.shared.signal.response import FAR_KM, BinResponse
from cogradar.shared.tracking.belief.likelihood import Looks
from cogradar.shared.tracking.model import TrackerModel
from cogradar.shared.tracking.sensor import STEP
from tests.shared.tracking.scans import SEED


def paper_model(*, is_exact: bool | None = None, **belief: Any) -> TrackerModel:
    """Of the paper's radar with some settings of the belief changed; amplitudes read otherwise than by its filter."""
    radar = load("paper").radar
    radar = radar.model_copy(update={"belief": radar.belief.model_copy(update=belief)})
    model = TrackerModel.of(radar, Strategy.POWER_AWARE, seed=5)
    return model if is_exact is None else replace(model, sensor=model.sensor._replace(is_exact=is_exact))


def in_level(level: int) -> float:
    """An amplitude in the middle of a level."""
    return (level + 0.5) * STEP


def smoke_radar(fidelity: str, **belief: Any) -> RadarConfig:
    """The small scenario's radar with all that a fidelity stands for, some settings of the belief changed."""
    document = tomllib.loads((SCENARIO_DIR / "smoke.toml").read_text(encoding="utf-8"))
    document["radar"] |= {"fidelity": fidelity, "belief": document["radar"]["belief"] | belief}
    return parse(document, source="smoke").radar


def smoke_model(fidelity: str, strategy: Strategy = Strategy.UNIFORM, **belief: Any) -> TrackerModel:
    """Of that radar."""
    return TrackerModel.of(smoke_radar(fidelity, **belief), strategy, SEED)


THRESHOLD = -2.0 * float(np.log(1e-4))  # of the paper's radar


def in_bins(hit_bin: int, amplitude: float, sigma: NDArray[np.float64], limit: float = THRESHOLD) -> Looks:
    """What a track is told of bins: its detection, -1 for none; sigma (n_bin,), 0 in those that were not looked at."""
    bins, n_bin = np.flatnonzero(sigma), sigma.size
    hit = int(np.searchsorted(bins, hit_bin)) if hit_bin >= 0 else -1
    nus = bin_centres(n_bin)[bins]
    return Looks(BinResponse(n_bin), hit, float(amplitude), 0.0, 0.0, 0.0, nus, sigma[bins], limit, 0.0, FAR_KM)


def sigma_of_bins(looks: Looks) -> NDArray[np.float64]:
    """Standard deviation of alpha_hat in each bin, (n_bin,); 0 in those that were not looked at."""
    sigma = np.zeros(looks.response.n_bin)
    sigma[angle_bin(looks.nus, sigma.size)] = looks.sigma
    return sigma
