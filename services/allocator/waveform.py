"""The waveform that serves the plans of one dwell."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cogradar.services.allocator.track_update import TrackUpdate, moved, roster_of, unchanged
from cogradar.shared.numerics.elementwise import hypot
from cogradar.shared.power.rules import Emission, Requests, power_rule
from cogradar.shared.power.search import search_directions, search_power
from cogradar.shared.power.wide import affordable, sure_powers
from cogradar.shared.protocol.messages import Plan, Waveform
from cogradar.shared.protocol.orders import (
    Order,
    SectorSearch,
    accuracies,
    is_paused,
    looks,
    of_tracks,
    power_share,
    priorities,
    searches,
    settings_of,
    under,
)
from cogradar.shared.protocol.roster import Roster
from cogradar.shared.scenario.radar_config import RadarConfig, Strategy
from cogradar.shared.signal.array import angle_bin, bin_centres, spatial_frequency
from cogradar.shared.signal.waveform import beam_factor
from cogradar.shared.tracking.assignment.solver import load_solver
from cogradar.shared.tracking.belief.across import AIM, echo_gain, needed_zeta
from cogradar.shared.tracking.motion import predicted_mean

LEAST_WORTH = 0.5  # of a target, as which a track is served, however improbable it is: a look settles it
LEAST_GAIN = 1e-12
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
    range_km = float(hypot(states[1, 0], states[1, 2]))
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


def waveform(radar: RadarConfig, strategy: Strategy, update: TrackUpdate, orders: Sequence[Order] = ()) -> Waveform:
    """Waveform after a dwell, for the tracks that go on or begin, and for the search, if there is one.

    orders : in force in the dwell that it is for (`cogradar.shared.protocol.orders.in_force`)
    """
    radar, strategy = under(radar, strategy, settings_of(orders))
    born_ks = dict(zip((plan.target for plan in update.plans), update.born_k, strict=True))
    orders = of_tracks(orders, born_ks if radar.is_unknown else None)
    radar = _with_power(radar, radar.array.power * power_share(orders))
    array = radar.array
    served = [coasted(radar, plan, update.k) for plan in update.plans]
    if any(plan.status == "searching" for plan in served):
        unlit = np.full((len(served), 1), np.nan)
        return _message(radar, update, served, _nothing(array.n_tx, array.power, unlit, "acquisition"), None, orders)
    lit = [plan for plan in (_outside_blanked(radar, plan, orders) for plan in served) if plan.bins.size]
    requests = _requests(radar, lit, priorities(orders), _fixed(radar, update, lit, orders)) if lit else None
    searched, powers, roster, power = np.empty(0), np.empty(0), None, 0.0
    if radar.search is not None:
        next_search = update.next_search
        if strategy is not Strategy.ORTHOGONAL:
            asked = looks(orders)
            of_looks = np.array([look.share * array.power for look in asked])
            left = _with_power(radar, array.power - float(of_looks.sum())) if asked else radar
            power = search_power(left, radar.search, requests)
            times = partial(searches, orders, margin=_margin(radar, orders))
            searched, next_search = search_directions(radar, radar.search, update.next_search, power, times)
            powers = np.full(searched.size, power / max(searched.size, 1))
            if asked:
                of_all = np.append(powers, of_looks)
                searched, place = np.unique(np.append(searched, [look.nu for look in asked]), return_inverse=True)
                powers = np.zeros(searched.size)
                np.add.at(powers, place, of_all)
                power += float(of_looks.sum())
        shown = 0.0 if is_paused(orders) else power
        roster = roster_of(radar, update, searched, shown, next_search)
    if requests is None:
        isotropic = array.power if strategy is Strategy.ORTHOGONAL else 0.0
        sent = _nothing(array.n_tx, isotropic, np.empty((0, 1)), "optimal")
    else:
        left = _with_power(radar, array.power - power) if power else radar
        if requests.fixed.any():
            requests = requests._replace(fixed=affordable(radar, requests, left.array.power))
        sent = power_rule(strategy)(left, requests)
    sent = _with_unlit(sent, [plan.target for plan in lit], served)
    if is_paused(orders):  # beams say what would be asked for, and is not measured; in an acquisition the radar knows
        silent = _nothing(array.n_tx, 0.0, sent.nus, sent.status)
        return _message(radar, update, served, silent, roster, orders)
    if searched.size:
        sent = sent._replace(factor=np.hstack((sent.factor, beam_factor(searched, powers, array.n_tx))))
    else:
        sent = sent._replace(isotropic=sent.isotropic + power)
    return _message(radar, update, served, sent, roster, orders)


def _with_power(radar: RadarConfig, power: float) -> RadarConfig:
    """A radar with another power to spend."""
    if power == radar.array.power:
        return radar
    return radar.model_copy(update={"array": radar.array.model_copy(update={"power": power})})


def _outside_blanked(radar: RadarConfig, plan: Plan, orders: Sequence[Order]) -> Plan:
    """A plan without its cells in blanked sectors; none may be left."""
    if plan.nus is None or not any(isinstance(order.action, SectorSearch) for order in orders):
        return plan
    margin = _margin(radar, orders)
    kept = np.flatnonzero(searches(orders, plan.nus, margin))
    near = np.arange(-plan.reach - 1, plan.reach + 2) / (radar.array.n_bin - 1)  # looks may be widened so far
    is_clear = bool(searches(orders, np.clip(plan.nus[:, np.newaxis] + near, -0.5, 0.5), margin).all())
    cells = {name: getattr(plan, name)[kept] for name in ("bins", "nus", "chances")}
    return plan.model_copy(update=cells | {"reach": plan.reach if is_clear else 0})


def _margin(radar: RadarConfig, orders: Sequence[Order]) -> float:
    """What stays free beside a blanked sector, in nu: half a beam's width, or nothing if no bin were left."""
    half_beam = 0.5 / radar.array.n_tx
    return half_beam if searches(orders, bin_centres(radar.array.n_bin), half_beam).any() else 0.0


def _with_unlit(sent: Emission, lit: Sequence[int], served: Sequence[Plan]) -> Emission:
    """An emission with a row for each of the tracks that are served, though it lights only some of them."""
    if len(lit) == len(served):
        return sent
    rows = np.flatnonzero(np.isin([plan.target for plan in served], lit))
    nus = np.full((len(served), sent.nus.shape[1]), np.nan)
    shares = np.zeros(nus.shape)
    nus[rows], shares[rows] = sent.nus, sent.shares
    return sent._replace(nus=nus, shares=shares)


def _nothing(n_tx: int, isotropic: float, nus: NDArray[np.float64], status: str) -> Emission:
    """No beam."""
    return Emission(isotropic, np.empty((n_tx, 0), np.complex128), nus, np.zeros(nus.shape), status)


def _message(
    radar: RadarConfig,
    update: TrackUpdate,
    served: Sequence[Plan],
    sent: Emission,
    roster: Roster | None,
    orders: Sequence[Order],
) -> Waveform:
    """The message of an emission."""
    obeyed = sorted({*update.dropped, *(order.n for order in orders)})
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
            "late": np.array([update.k - plan.k for plan in update.plans], dtype=np.int32),
            "orders": np.array(obeyed, np.int32) if obeyed else None,
            "settings": settings_of(orders),
        }
        | steered
    )


def _fixed(radar: RadarConfig, update: TrackUpdate, plans: Sequence[Plan], orders: Sequence[Order]) -> dict[int, float]:
    """Power that tracks need in the next dwell for the accuracy that is asked of them; `plans`: for that dwell.

    At least what finds the target for sure: a miss would cost more.
    """
    asked = accuracies(orders)
    known = {plan.target: plan for plan in update.plans if plan.target in asked}
    found = {}
    for plan in plans:
        if plan.target in known and plan.gate is not None:
            states, covariances = moved(radar, [known[plan.target]], update.k + 1)
            zeta = needed_zeta(radar.array.n_rx, (states[0], covariances[0]), AIM * asked[plan.target])
            needed = zeta / max(echo_gain(radar, plan.gain, plan.gate), LEAST_GAIN)
            found[plan.target] = max(needed, float(sure_powers(radar, np.array([plan.gain]))[0]))
    return found


def _requests(
    radar: RadarConfig, plans: Sequence[Plan], weights: Mapping[int, float], powers: Mapping[int, float]
) -> Requests:
    """What the plans of tracks ask for, as arrays; of some of them priorities and fixed powers."""
    n, centres = max(plan.bins.size for plan in plans), bin_centres(radar.array.n_bin)
    nus, chances = np.zeros((len(plans), n)), np.zeros((len(plans), n))
    for m, plan in enumerate(plans):
        nus[m, : plan.bins.size] = centres[plan.bins] if plan.nus is None else plan.nus
        chances[m, : plan.bins.size] = plan.chances * _worth(plan)
    ranges = np.maximum([plan.range_km for plan in plans], MIN_RANGE_KM)
    gains, worths = (np.array([getattr(plan, name) for plan in plans]) for name in ("gain", "worth"))
    reaches, astray = (np.array([getattr(plan, name) for plan in plans]) for name in ("reach", "astray"))
    wanted = np.array([weights.get(plan.target, 1.0) for plan in plans])
    fixed = np.array([powers.get(plan.target, 0.0) for plan in plans])
    return Requests(nus, chances, ranges, gains, worths, reaches, astray, plans[0].k, wanted, fixed)


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
