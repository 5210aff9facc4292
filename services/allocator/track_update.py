"""The tracks after a dwell: the tracks of the dwell before, without the ended ones, and births.

With an unknown number of targets it is a function of a scan and of the plans that follow it. A detection that no track
claims begins a tentative track, which is illuminated in the very next dwell. Of two tracks that follow one target the
younger ends.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.elementwise import hypot
from cogradar.shared.numerics.linear import eigh, product
from cogradar.shared.protocol.fields import FAR
from cogradar.shared.protocol.messages import Plan, Scan
from cogradar.shared.protocol.roster import BIRTH, EXPECTED, Roster, no_tracks
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.signal.array import angle_bin, apart, near_pairs, spatial_frequency
from cogradar.shared.signal.looks import NEIGHBOURS, n_range_cells
from cogradar.shared.signal.response import Response, response_of
from cogradar.shared.signal.scan import Detections
from cogradar.shared.tracking.assignment.shares import unclaimed
from cogradar.shared.tracking.existence import ENDED_BELOW, existence_of
from cogradar.shared.tracking.motion import CERTAINLY_STRAIGHT, modes_after, predicted_moments
from cogradar.shared.tracking.sensor import heard

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SIGMAS = 3.0  # standard deviations between what may be of one target
ONE_TARGET = {True: 3.0, False: 9.5}  # squared distance of two tracks of one target, both confirmed or not
_ROUNDING = 1e-15  # of an eigenvalue, relative to the largest one
_MIRRORED = np.array([1.0, 1.0, -1.0, -1.0])  # a state at the other end of the field
NEAR_KM = 1e-3  # a target is not nearer than this


class TrackUpdate(NamedTuple):
    """The tracks with which a run continues after a dwell."""

    run: str
    k: int
    plans: list[Plan]  # of the tracks, in the order of their ids; the last ones of those that begin
    born_k: list[int]
    births: Floats  # (b, BIRTH)
    next_id: int
    next_search: int = 0  # number of the next beam of the search
    dropped: tuple[int, ...] = ()  # orders by which tracks end


def unchanged(plans: Sequence[Plan], k: int) -> TrackUpdate:
    """Announced tracks after dwell k: they are all there, and none begins or ends."""
    return TrackUpdate(plans[0].run, k, list(plans), [0] * len(plans), np.empty((0, BIRTH)), len(plans))


def updated(
    radar: RadarConfig, scan: Scan, roster: Roster, plans: Sequence[Plan], *, begins: bool = True
) -> TrackUpdate:
    """Tracks after a scan: one without a plan ends, and an unexplained detection begins one.

    roster : of the scan's dwell
    plans  : newest ones of its tracks, in order
    begins : whether tracks may begin
    """
    array = radar.array
    response = response_of(radar.receiver.cells, array.n_bin, array.n_tx, array.n_rx, radar.receiver.range_cell_km)
    said = scan.roster or no_tracks()
    told = Detections.of(vars(scan) | {"ids": said.ids, "expected": said.expected}, array.n_bin, 0.0)
    alive = [plan for plan in plans if plan.status == "tracking"]
    is_new = np.array([_is_told(told, plan) for plan in alive], dtype=np.bool_)
    alive = _one_each(radar, response, alive, scan.k, is_new)
    # In real time a track may have begun, or have flown elsewhere, after the waveform of this scan was sent.
    known = set(said.ids.tolist()) if told.age == 0 else set[int]()
    strangers = [plan for plan in alive if plan.target not in known]
    untold = expected(radar, strangers, scan.k).tolist() if strangers else []
    found = unclaimed(response, told)
    found = found[[not _is_of_one(response, scan, row, untold) for row in found.tolist()]] if untold else found
    found = found[: radar.most_tracks - len(alive)] if begins else found[:0]
    began = dict(zip(roster.ids.tolist(), roster.born_k.tolist(), strict=True))
    births = np.array([_birth(scan, row) for row in found.tolist()]).reshape(-1, BIRTH)
    births = births[[_chance(radar, birth) > ENDED_BELOW for birth in births]]
    ids = range(roster.next_id, roster.next_id + len(births))
    new = [_first_plan(radar, scan, id_, birth) for id_, birth in zip(ids, births, strict=True)]
    born_k = [began[plan.target] for plan in alive] + [scan.k] * len(new)
    return TrackUpdate(scan.run, scan.k, [*alive, *new], born_k, births, ids.stop, roster.next_search)


def expected(radar: RadarConfig, plans: Sequence[Plan], k: int) -> Floats:
    """Where tracks are expected in dwell k: direction and range in km, each with its standard deviation; (M, 4)."""
    return _places(*moved(radar, plans, k))


def moved(radar: RadarConfig, plans: Sequence[Plan], k: int) -> tuple[Floats, Floats]:
    """Estimates of tracks and their covariances, as they will be, or were, in dwell k; (M, 4) and (M, 4, 4)."""
    dt = radar.motion.dt_s * (k - np.array([plan.k for plan in plans], np.float64))
    modes = np.array([CERTAINLY_STRAIGHT if plan.modes is None else plan.modes for plan in plans]).reshape(-1, 3)
    states = np.array([plan.in_plane[0] for plan in plans]).reshape(-1, 4)
    covariances = np.array([plan.in_plane[1] for plan in plans]).reshape(-1, 4, 4)
    modes = modes_after(modes, dt[:, np.newaxis])
    return predicted_moments(states, covariances, modes, dt, radar.motion.sigma_s_km_s2)


def roster_of(radar: RadarConfig, made: TrackUpdate, searched: Floats, share: float, next_search: int) -> Roster:
    """The roster of the next dwell, with the search's directions, its share of the power, and where it goes on."""
    places = expected(radar, made.plans, made.k + 1)
    return Roster(
        ids=np.array([plan.target for plan in made.plans], np.int32),
        next_id=made.next_id,
        confirmed=np.array([plan.confirmed for plan in made.plans], np.int32),
        born_k=np.array(made.born_k, np.int32),
        births=made.births,
        expected=np.array(
            [(*place, plan.existence) for place, plan in zip(places.tolist(), made.plans, strict=True)], np.float64
        ).reshape(-1, EXPECTED),
        searched=searched,
        next_search=next_search,
        search_share=share,
    )


def _places(states: Floats, covariances: Floats) -> Floats:
    """nu, its standard deviation, range in km and its standard deviation, to first order; (M, 4)."""
    x, y, places = states[:, 0], states[:, 2], covariances[:, ::2, ::2]
    range_km = np.maximum(hypot(x, y), NEAR_KM)
    by_nu = np.stack((-x * y, x * x), axis=1) / (2.0 * (range_km * range_km * range_km)[:, np.newaxis])
    by_range = np.stack((x, y), axis=1) / range_km[:, np.newaxis]
    nu_sigma, range_sigma = (
        np.sqrt(np.maximum(np.sum(by[:, :, np.newaxis] * places * by[:, np.newaxis], axis=(1, 2)), 0.0))
        for by in (by_nu, by_range)
    )
    return np.column_stack((spatial_frequency(states), nu_sigma, np.minimum(range_km, FAR), range_sigma))


def _is_told(scan: Detections, plan: Plan) -> bool:
    """Whether a scan tells something of a track: one of its looks was measured, or each look that was asked for. Looks
    of an older waveform tell something if they found it.
    """
    if scan.age > 0:
        return plan.k == scan.k and plan.detected
    track = plan.target
    if scan.unmeasured is None:
        return True
    at = scan.row_of(track)
    if scan.ids is None or at == scan.ids.size or scan.ids[at] != track:
        return False
    return bool(np.isin(scan.beam_nus[at][scan.beams[at] >= 0], scan.nus).any())


def _one_each(
    radar: RadarConfig, response: Response, plans: Sequence[Plan], k: int, is_told: NDArray[np.bool_]
) -> list[Plan]:
    """Without the younger of two tracks of one target, or the one that is not confirmed.

    is_told : (M,) of which the scan tells something. Beliefs of two others only grow broad, and would come to look like
              beliefs of one target.
    """
    if len(plans) < 2:
        return list(plans)
    moments = moved(radar, plans, k)
    places = _places(*moments)
    one, other = near_pairs(places[:, 0], places[:, 0], response.lobe)
    spread_km = SIGMAS * hypot(places[other, 3], places[one, 3])
    reach_km = 2.0 * response.range_cell_km if response.measures_range else spread_km
    near = (one < other) & (np.abs(places[one, 2] - places[other, 2]) < reach_km) & (is_told[one] | is_told[other])
    ended = set[int]()
    for i, j in zip(one[near].tolist(), other[near].tolist(), strict=True):
        bound = ONE_TARGET[bool(plans[i].confirmed and plans[j].confirmed)]
        states, covariances = (of_both[[i, j]] for of_both in moments)
        if abs(places[i, 0] - places[j, 0]) > 0.5:  # at both ends they have one echo: as if they were at one
            states[1], covariances[1] = states[1] * _MIRRORED, covariances[1] * np.outer(_MIRRORED, _MIRRORED)
        if {i, j} & ended or _distance(states, covariances) >= bound:
            continue
        ended.add(i if plans[j].confirmed and not plans[i].confirmed else j)
    return [plan for i, plan in enumerate(plans) if i not in ended]


def _distance(states: Floats, covariances: Floats) -> float:
    """Squared distance of two estimates, (2, 4), with their covariances, (2, 4, 4)."""
    error, spread = states[0] - states[1], covariances[0] + covariances[1]
    values, vectors = eigh(0.5 * (spread + spread.T))
    counts = values > _ROUNDING * values.max()
    return float(np.sum(product(error, vectors)[counts] ** 2 / values[counts]))


def _is_of_one(response: Response, scan: Scan, row: int, tracks: Sequence[Sequence[float]]) -> bool:
    """Whether a detection may be of one of the tracks that are expected there."""
    nu_hat, range_km = (float(np.asarray(column)[row]) for column in (scan.nu_hats, scan.ranges_km))
    return any(
        apart(nu_hat, nu) < SIGMAS * nu_sigma + NEIGHBOURS * response.lobe
        and abs(range_km - at_km) < SIGMAS * range_sigma + NEIGHBOURS * response.range_cell_km
        for nu, nu_sigma, at_km, range_sigma in tracks
    )


def _birth(scan: Scan, row: int) -> list[float]:
    """The detection of a row, as a roster has it."""
    columns = (scan.nus, scan.limits, scan.ranges_km, scan.nu_hats, scan.nu_sigmas)
    places = [float(np.asarray(column)[row]) for column in columns]
    return [*places, float(heard(scan.alpha_hat[row])), float(scan.sigma_hat[row]), float(scan.signature_power[row])]


def _chance(radar: RadarConfig, birth: Floats) -> float:
    """Probability that there is a target where a track begins."""
    _nu, limit, *_, amplitude, sigma_hat, _power = birth.tolist()
    n_cell = n_range_cells(*radar.acquisition.ranges_km, radar.receiver.range_cell_km)
    return existence_of(radar).at_birth(limit, amplitude / sigma_hat, n_cell)


def _first_plan(radar: RadarConfig, scan: Scan, id_: int, birth: Floats) -> Plan:
    """The plan of a track that begins with a detection: another look at where it was."""
    nu, _limit, range_km, nu_hat, nu_sigma, amplitude, sigma_hat, power = birth.tolist()
    nu = nu_hat if nu_sigma > 0.0 else nu
    array, width, v_max = radar.array, radar.receiver.range_cell_km, radar.acquisition.v_max_km_s
    gain = 2.0 * amplitude**2 * array.n_tx * array.n_rx / (sigma_hat**2 * power)
    gate = np.zeros(2)
    if width > 0.0:
        moved_km = v_max * radar.motion.dt_s * np.sqrt(2.0)
        low, high = max(range_km - 0.5 * width - moved_km, 0.0), range_km + 0.5 * width + moved_km
        gate = np.array([np.floor(low / width), np.ceil(high / width)]) * width
    else:
        range_km = _likely_range(radar, amplitude)
    chance = _chance(radar, birth)
    state = np.array([range_km * np.sqrt(max(1.0 - 4.0 * nu * nu, 0.0)), 0.0, range_km * 2.0 * nu, 0.0])
    spread = (width or range_km) ** 2 / 12.0 + (2.0 * range_km * (nu_sigma or 0.25 / array.n_rx)) ** 2
    return Plan(
        run=scan.run,
        k=scan.k,
        t=scan.t,
        target=id_,
        status="tracking",
        bins=np.array([angle_bin(nu, array.n_bin)], np.int32),
        chances=np.ones(1),
        best_bin=int(angle_bin(nu, array.n_bin)),
        worth=1.0,
        gain=gain,
        range_km=range_km,
        estimate=state,
        covariance=np.diag([spread, v_max**2 / 3.0] * 2),
        detected=True,
        nus=np.array([nu]),
        gate=gate,
        existence=chance,
        confirmed=existence_of(radar).is_confirmed(chance),
        in_doubt=False,
    )


def _likely_range(radar: RadarConfig, amplitude: float) -> float:
    """Range at which an echo has this amplitude, within those where targets may be."""
    at_1_km = 10.0 ** (radar.echo.amplitude_db / 20.0)
    low, high = radar.acquisition.ranges_km
    return float(np.clip(np.sqrt(at_1_km / max(amplitude, 1e-300)), low, high))
