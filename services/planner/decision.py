"""Which cells a track asks for next: belief and search composed."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.elementwise import hypot
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.planning.cells import (
    apart_km,
    bin_chances,
    information_gain,
    is_astray,
    look_gain,
    most_probable_cells,
    reach,
)
from cogradar.shared.planning.radar_pomdp import RadarPomdp, problem_of
from cogradar.shared.planning.rules import chosen_bin
from cogradar.shared.planning.steering import direction_in, directions, expected_at, gate
from cogradar.shared.protocol.fields import FAR, LARGEST, MAX_CELLS
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.signal.array import angle_bin, on_ground
from cogradar.shared.signal.looks import range_cells
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.tracking import track
from cogradar.shared.tracking.association import expected_sigma
from cogradar.shared.tracking.model import TrackerModel, TrackState
from cogradar.shared.tracking.motion import predicted_mean


@dataclass(frozen=True)
class Decision:
    """What a track asks for after a dwell."""

    bins: NDArray[np.int32]  # (c,) angle bins to illuminate next
    chances: NDArray[np.float64]  # (c,) probability that the target will be there
    best_bin: int  # the most probable one
    worth: float  # of a look (`cogradar.shared.planning.cells.information_gain`)
    gain: float  # of a look (`cogradar.shared.planning.cells.look_gain`)
    range_km: float  # expected range at the next dwell
    reach: int  # cells to either side of `bins` in which it may be, too
    astray: bool  # its misses are improbable
    estimate: NDArray[np.float64]  # (4,) belief mean now
    covariance: NDArray[np.float64]  # (4, 4) of the belief now
    n_sim: int  # simulations behind the choice
    plane_estimate: NDArray[np.float64] | None = None  # in the plane of the array, if heights are assumed
    plane_covariance: NDArray[np.float64] | None = None
    nus: NDArray[np.float64] | None = None  # (c,) directions of the cells, if they are steered
    gate: NDArray[np.float64] | None = None  # (2,) ranges to be tested, km; (0, 0): all


def decide(
    radar: RadarConfig, model: TrackerModel, state: TrackState, has_time: Callable[[], bool] | None = None
) -> Decision:
    """Choose the bin to look at next: by the radar's rule, or the most probable one if every cell is tested anyway.

    With joint looks there is no rule: the most probable cells are told, of which the allocator chooses.

    has_time : false as soon as the search must end (real time); without it, it makes all its simulations
    """
    mean, covariance = state.belief.moments()
    estimate = _within(mean, FAR)  # a belief that has flown away must not end its planner
    predicted = predicted_mean(estimate, model.motion.dt)
    chances = bin_chances(model, state)
    best_bin, range_km = int(np.argmax(chances)), min(float(hypot(predicted[0], predicted[2])), FAR)
    most = 1 if model.tests_every_cell or not state.confirmed else MAX_CELLS
    if most == 1 or radar.planner.looks == "joint":
        cells, n_sim = most_probable_cells(chances, most), 0
    else:
        rng = generator(model.seed, Purpose.SEARCH, state.target, state.k)
        choice = chosen_bin(problem_after(model, state), radar, rng, has_time)
        cells, n_sim, most = np.array([choice.bin]), choice.n_sim, 0
    is_wide = model.wide_looks and not model.tests_every_cell and state.confirmed
    astray, gain = is_wide and is_astray(state), min(look_gain(model, state, range_km), LARGEST)
    asked: dict[str, Any] = {"bins": cells.astype(np.int32), "chances": chances[cells], "gain": gain}
    if not model.response.is_box:
        asked = _steered(model, state, cells, most, gain, apart_km(model, state) if astray else 0.0)
    asked |= _estimates(estimate, _within(covariance, FAR**2), radar.assumes.height_max_km)
    return Decision(
        **asked,
        best_bin=best_bin,
        worth=information_gain(model, state, cells),
        range_km=range_km,
        reach=reach(model, state, range_km) if is_wide else 0,
        astray=astray,
        n_sim=n_sim,
    )


def _estimates(
    estimate: NDArray[np.float64], covariance: NDArray[np.float64], height_max_km: float
) -> dict[str, NDArray[np.float64]]:
    """Estimates as fields of a `Decision`: on the ground, and if heights are assumed in the plane of the array, too."""
    if height_max_km == 0.0:
        return {"estimate": estimate, "covariance": covariance}
    ground, spread = on_ground(estimate, covariance, height_max_km)
    plane = {"plane_estimate": estimate, "plane_covariance": covariance}
    return {"estimate": _within(ground, FAR), "covariance": _within(spread, FAR**2)} | plane


def _steered(
    model: TrackerModel, state: TrackState, cells: NDArray[np.int64], most: int, gain: float, beside_km: float
) -> dict[str, Any]:
    """What a track asks for in directions, as fields of a `Decision`.

    cells     : bins that were chosen
    most      : directions of the belief's that are asked for; 0: one, in the bin that was chosen
    gain      : of a look on axis whose statistic is compared with the threshold of one cell
    beside_km : how far to either side of where its range is expected the target may be
    """
    nus, ranges_km = expected_at(model, state)
    found = directions(model.response, nus, most) if most else direction_in(model.response, nus, int(cells[0]))
    tested = gate(model, ranges_km, beside_km)
    return {
        "bins": angle_bin(found.nus, model.sensor.n_bin).astype(np.int32),
        "chances": found.chances,
        "gain": gain * found.loss * _of_limit(model, tested),
        "nus": found.nus,
        "gate": tested,
    }


def _within(values: NDArray[np.float64], bound: float) -> NDArray[np.float64]:
    """Values cut to -bound .. bound; three times as fast as `np.clip`."""
    return np.minimum(np.maximum(values, -bound), bound)


def _of_limit(model: TrackerModel, tested: NDArray[np.float64]) -> float:
    """What a look with so many range cells gains, over one whose statistic is compared with the threshold of a cell."""
    low_km, high_km = tested.tolist() if tested.any() else model.acquisition.ranges_km
    n_cell = len(range_cells(low_km, high_km, model.response.range_cell_km))
    return model.sensor.threshold / threshold(model.p_fa, n_cell)


def problem_after(model: TrackerModel, state: TrackState) -> RadarPomdp:
    """What a track has to decide after a dwell."""
    sigma_hat = float(expected_sigma(model, state, state.power))
    return problem_of(state.belief.sample(), sigma_hat, model.of_echo(state.echo).sensor, model.motion)


def warm_up(radar: RadarConfig, model: TrackerModel) -> None:
    """Load every kernel that a run may need: track nothing, and decide on it with time for a little and with none."""
    state = track.warm_up(model)
    one = radar.planner.model_copy(update={"n_sim": 1})
    decide(radar.model_copy(update={"planner": one}), model, state, lambda: True)
    decide(radar, model, state, lambda: False)
