"""The waveform that serves the plans of one dwell."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cogradar.services.allocator.track_update import TrackUpdate, roster_of, unchanged
from cogradar.shared.power.rules import Emission, Requests, power_rule
from cogradar.shared.power.search import search_directions, search_power
from cogradar.shared.protocol.messages import Plan, Waveform
from cogradar.shared.protocol.roster import Roster
from cogradar.shared.scenario.radar_config import RadarConfig, Strategy
from cogradar.shared.signal.array import angle_bin, bin_centres, spatial_frequency
from cogradar.shared.signal.waveform import beam_factor
from cogradar.shared.tracking.assignment import load_solver
from cogradar.shared.tracking.motion import predicted_mean

LEAST_WORTH = 0.5  # of a target, as which a track is served, however improbable it is: a look settles it
MIN_RANGE_KM = 1e-3  # a target on top of the array needs no power; keeps delta = 1/R^4 finite


def coasted(radar: RadarConfig, plan: Plan, k: int) -> Plan:
    """A plan of an earlier dwell for dwell k: its cells and range, moved as its estimate will have moved by then.

    Its chances are kept, and what a look is worth: an estimate says nothing of how the belief has spread since.
    """
    if plan.k == k:
        return plan
    if plan.status == "searching":
        return plan.model_copy(update={"k": k})
    n_bin, dwells = radar.array.n_bin, np.array([1, k + 1 - plan.k])
    states = np.array([predicted_mean(plan.in_plane[0], radar.motion.dt_s * n) for n in dwells])
    meant, arrived = angle_bin(spatial_frequency(states), n_bin).astype(np.int32)
    moved = np.clip(np.append(plan.bins, np.int32(plan.best_bin)) + (arrived - meant), 0, n_bin - 1).astype(np.int32)
    kept = np.sort(np.unique(moved[:-1], return_index=True)[1])  # of cells that meet at the edge the first
    range_km = float(np.hypot(states[1, 0], states[1, 2]))
    if plan.nus is not None and plan.gate is not None:
        from_nu, to_nu = spatial_frequency(states)
        nus = np.clip(plan.nus + (to_nu - from_nu), -0.5, 0.5)
        moved[:-1], kept = angle_bin(nus, n_bin), np.arange(nus.size)
        gate = plan.gate
        if gate.any():  # of the same width, at the array the nearest: (0, 0) would be all ranges
            gate = gate + max(range_km - plan.range_km, -float(gate[0]))
        plan = plan.model_copy(update={"nus": nus, "gate": gate})
    gain = plan.gain * (_floored(plan.range_km) / _floored(range_km)) ** 4
    cells = {"bins": moved[kept], "chances": plan.chances[kept], "best_bin": int(moved[-1])}
    return plan.model_copy(update={"k": k, "range_km": range_km, "gain": gain, **cells})


def waveform(radar: RadarConfig, strategy: Strategy, update: TrackUpdate) -> Waveform:
    """Waveform after a dwell, for the tracks that go on or begin, and for the search, if there is one."""
    array = radar.array
    served = [coasted(radar, plan, update.k) for plan in update.plans]
    if any(plan.status == "searching" for plan in served):
        unlit = np.full((len(served), 1), np.nan)
        return _message(radar, update, served, _nothing(array.n_tx, array.power, unlit, "acquisition"), None)
    requests = _requests(radar, served) if served else None
    searched, power, roster = np.empty(0), 0.0, None
    if radar.search is not None:
        if strategy is not Strategy.ORTHOGONAL:
            power = search_power(radar, radar.search, requests)
            searched = search_directions(radar, radar.search, update.next_search, power)
        roster = roster_of(radar, update, searched, power)
    if requests is None:
        isotropic = array.power if strategy is Strategy.ORTHOGONAL else 0.0
        sent = _nothing(array.n_tx, isotropic, np.empty((0, 1)), "optimal")
    else:
        left = radar.model_copy(update={"array": array.model_copy(update={"power": array.power - power})})
        sent = power_rule(strategy)(left if power else radar, requests)
    if searched.size:
        beams = beam_factor(searched, np.full(searched.size, power / searched.size), array.n_tx)
        sent = sent._replace(factor=np.hstack((sent.factor, beams)))
    else:
        sent = sent._replace(isotropic=sent.isotropic + power)
    return _message(radar, update, served, sent, roster)


def _nothing(n_tx: int, isotropic: float, nus: NDArray[np.float64], status: str) -> Emission:
    """No beam."""
    return Emission(isotropic, np.empty((n_tx, 0), np.complex128), nus, np.zeros(nus.shape), status)


def _message(
    radar: RadarConfig, update: TrackUpdate, served: Sequence[Plan], sent: Emission, roster: Roster | None
) -> Waveform:
    """The message of an emission."""
    is_lit = ~np.isnan(sent.nus)
    nus = np.where(is_lit, sent.nus, 0.0)
    beams = np.where(is_lit, angle_bin(nus, radar.array.n_bin), -1).astype(np.int32)
    steered: dict[str, Any] = {}
    if radar.receiver.cells == "steered":
        gates = [np.zeros(2) if plan.gate is None else plan.gate for plan in served]
        steered = {"nus": nus, "gates": np.array(gates).reshape(-1, 2), "roster": roster}
    return Waveform.model_validate(
        {
            "run": update.run,
            "k": update.k,
            "tracking": sent.status != "acquisition",
            "isotropic": sent.isotropic,
            "factor": sent.factor.astype(np.complex64),
            "beams": beams,
            "shares": sent.shares,
            "status": sent.status,
            "late": np.array([plan.k != update.k for plan in update.plans], dtype=np.int32),
        }
        | steered
    )


def _requests(radar: RadarConfig, plans: Sequence[Plan]) -> Requests:
    """What the plans of tracks ask for, as arrays."""
    n, centres = max(plan.bins.size for plan in plans), bin_centres(radar.array.n_bin)
    nus, chances = np.zeros((len(plans), n)), np.zeros((len(plans), n))
    for m, plan in enumerate(plans):
        nus[m, : plan.bins.size] = centres[plan.bins] if plan.nus is None else plan.nus
        chances[m, : plan.bins.size] = plan.chances * _worth(plan)
    ranges = np.maximum([plan.range_km for plan in plans], MIN_RANGE_KM)
    gains, worths = (np.array([getattr(plan, name) for plan in plans]) for name in ("gain", "worth"))
    reaches, astray = (np.array([getattr(plan, name) for plan in plans]) for name in ("reach", "astray"))
    return Requests(nus, chances, ranges, gains, worths, reaches, astray, plans[0].k)


def _worth(plan: Plan) -> float:
    """How much a look that would find the target of a plan is worth."""
    return 1.0 if plan.existence is None else max(plan.existence, LEAST_WORTH)


def _floored(range_km: float) -> float:
    return max(range_km, MIN_RANGE_KM)


def warm_up(radar: RadarConfig, strategy: Strategy) -> None:
    """Make a waveform that is not sent: the first call of a compiled kernel loads it, which may take a second."""
    bins = np.linspace(0, radar.array.n_bin - 1, radar.announced or 1).astype(np.int32)
    asked: dict[str, Any] = {"chances": np.ones(1), "gain": 1.0, "range_km": radar.acquisition.range_max_km}
    asked |= {"existence": 1.0, "confirmed": True, "in_doubt": False}  # as of a roster's tracks
    if radar.receiver.cells == "steered":
        asked |= {"nus": np.zeros(1), "gate": np.zeros(2)}
        load_solver()
    plans = [
        Plan(run="warm-up", k=0, t=0, target=m, status="tracking", bins=bin_, best_bin=int(bin_[0]), **asked)
        for m, bin_ in enumerate(bins[:, np.newaxis])
    ]
    waveform(radar, strategy, unchanged(plans, 0))
