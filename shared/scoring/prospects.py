"""What can be said of a scenario before it is played: how well each target can be seen, and what makes no sense.

Closed forms at the start of the run, from what the world will do; nothing is drawn.
"""

from collections.abc import Sequence
from itertools import repeat
from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.power.rules import Requests, power_rule
from cogradar.shared.power.search import search_directions
from cogradar.shared.power.wide import ASTRAY, sure_powers
from cogradar.shared.scenario.limits import (
    CONTAINER_BYTES,
    NO_END,
    PROCESS_BYTES,
    UNLIMITED,
    beliefs_bytes,
    dwell_s,
    n_state,
    said_dwells,
    tree_bytes,
)
from cogradar.shared.scenario.plugins.names import is_own, short
from cogradar.shared.scenario.radar_config import RadarConfig, SearchSection
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scenario.tables import FIDELITY, POWER_RULES, REACQUIRE_BELOW
from cogradar.shared.scenario.world_config import TargetSection
from cogradar.shared.scoring.finite_size import finite_size
from cogradar.shared.signal.array import bin_centres, in_plane, spatial_frequency, steering_vector
from cogradar.shared.signal.looks import directions_everywhere, n_range_cells, range_cells
from cogradar.shared.signal.monopulse import off_axis_loss
from cogradar.shared.signal.radar_equation import snr_db
from cogradar.shared.signal.receiver import detection_probability, noncentrality, threshold
from cogradar.shared.signal.waveform import beampattern, transmit_signatures
from cogradar.shared.tracking.acquisition import expected_scans
from cogradar.shared.tracking.existence import alert_p_fa
from cogradar.shared.world.disturbance import power_spectrum

# Single looks, 3 targets at 20, 40 and 80 km, dwells of 1 to 12 s, 6 runs each. Share of lost tracks: 0.02 where a
# belief grows by less than two cells in a dwell, 0.3 from two to four cells, 0.6 beyond. Joint looks without wide ones,
# at 20 km and for each of their three cells: none up to 2.5 cells, then 0.4.
GROWTH = 2.0  # cells by which a belief may grow in a dwell, for each cell that is looked at
OWN_CELLS = 3  # of a track, with joint looks
FEWEST_DWELLS = 5.0  # in which the fastest target crosses the field of view
NEAR_ENOUGH_KM = 0.1  # an error of position from a height that is not assumed
ROUNDED = 0.95  # keeps a limit that is shown with two digits below the limit
GHOST_DB = 25.0  # over the limit; two-way sidelobes are 26 dB down
UNSEEN = 0.1  # a target with a lower P_D is hardly ever seen
LONG_S = 3600.0
_LEAST_P_D = 1e-9
_BEGINS = 64  # dwells in which a target may come, of all


class Prospect(NamedTuple):
    """One target at t = 0, or at its birth."""

    target: int  # counted from 1
    range_km: float
    angle_deg: float  # from the array's normal, as the array measures it
    snr_db: float  # of one virtual channel and the mean RCS, over the disturbance's mean level
    disturbance_db: float  # what the disturbance has towards this target, relative to its mean level
    array_snr_db: float  # of all of them, with all power on this target: plus 10 log10(P n_tx n_rx)
    p_d: dict[str, float]  # of each strategy, if every track asks for its target's bin; of an unknown number, of a look
    scans: float  # until an acquisition has found it
    seconds: float | None = None  # until the search of an unknown number sees it, expected


def prospects(scenario: Scenario) -> list[Prospect]:
    """What the radar can expect of each target when it begins. Raises ValueError without a [world].

    As if all of them were there at that time. Range cells: as if all of them were tested; a track that asks for few of
    them has a lower threshold.
    """
    world, radar = scenario.simulated, scenario.radar
    array, states = radar.array, world.measured_states()
    ranges = np.hypot(states[:, 0], states[:, 2])
    nus, width = spatial_frequency(states), radar.receiver.range_cell_km
    everywhere = directions_everywhere(array.n_bin, width)  # where cells are while power goes everywhere
    nearest = everywhere[np.abs(everywhere - nus[:, np.newaxis]).argmin(axis=1)]
    nus = nus if radar.receiver.cells == "steered" else nearest
    matched = (off_axis_loss(nus - nearest, array.n_tx) * off_axis_loss(nus - nearest, array.n_rx)) ** 2
    snrs = snr_db(ranges, world.echo.amplitude_db) + np.array([target.rcs_db for target in world.targets])
    laws = [target.rcs or world.rcs for target in world.targets]
    spectrum = power_spectrum(world.disturbance.model, nus)
    p_d: dict[str, NDArray[np.float64]] = {}
    cells = range_cells(*radar.acquisition.ranges_km, width) if width > 0.0 else [0]
    limit = threshold(radar.detector.p_fa, len(cells) * everywhere.size // array.n_bin)
    gains = 2.0 * 10.0 ** (snrs / 10.0) * array.n_tx * array.n_rx / spectrum
    requests = Requests.of_single(nus, np.maximum(ranges, 1e-3), gains)
    for name in POWER_RULES if radar.search is None else ():
        sent = power_rule(name)(radar, requests)
        signature_power = beampattern(sent.isotropic, sent.factor, nus) * array.n_rx
        signature_power *= matched if sent.isotropic > 0.0 else 1.0
        signatures = transmit_signatures(sent.isotropic, sent.factor, nus)
        p_d[name] = np.array(
            [
                finite_size(
                    world.disturbance.model,
                    nu,
                    np.kron(u, steering_vector(nu, array.n_rx)),
                    radar.receiver.noise,
                    array.n_rx,
                ).detection_probability(10.0 ** (snr / 10.0), power, limit, law)
                for nu, u, snr, power, law in zip(nus.tolist(), signatures, snrs, signature_power, laws, strict=True)
            ]
        )
    found = _of_search(scenario, radar.search, snrs, spectrum) if radar.search is not None else None
    if found is not None:
        p_d["search"] = found[0]
    gain = 10.0 * np.log10(array.power * array.n_tx * array.n_rx)
    everywhere_power = array.power * array.n_rx * matched  # ||v||^2 of the acquisition
    amplitudes = np.sqrt(0.5 * noncentrality(10.0 ** (snrs / 10.0), everywhere_power, spectrum))
    return [
        Prospect(
            m + 1,
            float(ranges[m]),
            float(np.degrees(np.arctan2(states[m, 2], states[m, 0]))),
            float(snrs[m]),
            float(10.0 * np.log10(spectrum[m])),
            float(snrs[m] + gain),
            {name: float(p[m]) for name, p in p_d.items()},
            expected_scans(radar, float(amplitudes[m])),
            None if found is None else float(found[1][m]),
        )
        for m in range(len(states))
    ]


def _of_search(
    scenario: Scenario, search: SearchSection, snrs: NDArray[np.float64], spectrum: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """P_D of the search's looks at each target with all power, and expected seconds until one sees it; (M,) each.

    The beams of two sweeps are gone through, since every second one goes between the directions of the first, and the
    target may come in any of these dwells. P_D holds for many receive channels.
    """
    radar, world, array = scenario.radar, scenario.simulated, scenario.radar.array
    nus, laws = spatial_frequency(world.measured_states()), [target.rcs or world.rcs for target in world.targets]
    n_cell = n_range_cells(*radar.acquisition.ranges_km, radar.receiver.range_cell_km)
    missed, near = list[NDArray[np.float64]](), list[NDArray[np.bool_]]()
    beam = 0
    while not missed or beam % (2 * array.n_bin):
        found, beam = search_directions(radar, search, beam, array.power)
        gain = array.n_tx / found.size if found.size else 1.0  # of a beam with its share of the power
        looks = found if found.size else bin_centres(array.n_bin)
        apart = np.abs(nus[:, np.newaxis] - looks).min(axis=1)
        loss = (off_axis_loss(apart, array.n_tx) * off_axis_loss(apart, array.n_rx)) ** 2
        zeta = noncentrality(10.0 ** (snrs / 10.0), array.power * array.n_rx * gain * loss, spectrum)
        limit = threshold(alert_p_fa(looks.size), n_cell)
        p_d = [float(detection_probability(*pair)) for pair in zip(zeta, repeat(limit), laws, strict=False)]
        missed.append(np.minimum(1.0 - np.array(p_d), 1.0 - _LEAST_P_D))
        near.append(apart <= (0.5 + 1e-9) / (array.n_bin - 1))
    chances, at = np.array(missed), np.array(near)
    seen = 1.0 - (chances * at).sum(axis=0) / np.maximum(at.sum(axis=0), 1)
    n_dwell = len(chances)
    begins = np.unique(np.linspace(0, n_dwell, min(n_dwell, _BEGINS), endpoint=False).astype(int))
    # In a period all looks miss with probability q, after i dwells with q_i: sum_i q_i / (1 - q) dwells, q_0 = 1.
    dwells = [
        np.vstack((np.ones(len(nus)), np.cumprod(np.roll(chances, -begin, axis=0), axis=0)[:-1])).sum(axis=0)
        for begin in begins.tolist()
    ]
    return seen, radar.motion.dt_s * np.mean(dwells, axis=0) / (1.0 - np.prod(chances, axis=0))


def warnings(scenario: Scenario, expected: Sequence[Prospect]) -> list[str]:
    """What is legal but makes no sense, a line each; `expected` are the prospects of its targets."""
    found = [*_of_sizes(scenario), *_of_field_of_view(scenario.radar), *_of_filter(scenario.radar)]
    if scenario.world is None:
        return found
    radar, starting = scenario.radar, scenario.starting
    for prospect, target in zip(expected, scenario.world.targets, strict=True):
        texts = _of_target(scenario, prospect, target)
        if prospect.target - 1 in starting:
            texts += _of_acquisition(scenario, prospect)
        found += [f"target {prospect.target} {text}" for text in texts]
    found += _of_receiver(scenario) + _of_recording(scenario)
    assumed, real = radar.echo.amplitude_db, scenario.world.echo.amplitude_db
    if abs(assumed - real) > 6.0:
        found.append(
            f"radar.echo.amplitude_db = {assumed:g} but world.echo.amplitude_db = {real:g}: the radar takes echoes for"
            f" echoes of targets {10.0 ** ((assumed - real) / 40.0):.2g} times as far away"
        )
    if scenario.world.rcs != "constant" and radar.assumes.rcs == "known":
        found.append(
            f'world.rcs = "{scenario.world.rcs}" but radar.assumes.rcs = "known": the radar takes what fluctuates for'
            " changes of range"
        )
    return found


def _of_receiver(scenario: Scenario) -> list[str]:
    """What is slow: data sets with noise from many directions in all range cells, each of them searched for echoes."""
    world, receiver = scenario.simulated, scenario.radar.receiver
    many = [("world.clutter", world.clutter), ("world.disturbance.recording", world.disturbance.recording)]
    given = [name for name, section in many if section is not None]
    if not given or receiver.separation != "joint":
        return []
    return [
        f'radar.receiver.separation = "joint" with {" and ".join(given)}: a dwell may take seconds, as what comes from'
        ' many directions is searched for echoes; set separation = "none", and noise = "range-cells" for its noise'
    ]


def _of_recording(scenario: Scenario) -> list[str]:
    """What a recorded disturbance does not say of itself."""
    radar, section = scenario.radar, scenario.simulated.disturbance.recording
    if section is None:
        return []
    recording, key = section.read(*scenario.data_set_shape), f"world.disturbance.recording.file = {section.file}"
    found = ["world.disturbance.model = recorded: P_D is that in white noise of the same mean power"]
    n_cell = n_range_cells(*radar.acquisition.ranges_km, radar.receiver.range_cell_km)
    has, needs = recording.dwells(n_cell), scenario.most_dwells
    if has < needs:
        found.append(
            f"{key}: has data for {has} dwells with {n_cell} range cells each, a run"
            f" of up to {needs} dwells has them {needs / has:.3g} times"
        )
    if recording.left_over:
        found.append(f"{key}: its last {recording.left_over} samples are not used")
    return found


def _of_target(scenario: Scenario, prospect: Prospect, target: TargetSection) -> list[str]:
    found, radar, state = list[str](), scenario.radar, target.begin
    prior, end_s = radar.acquisition, scenario.dwells * radar.motion.dt_s
    if target.first_s > end_s:
        found.append(f"begins after {target.first_s:g} s, and the run ends after {end_s:g} s")
    if not prior.range_min_km <= prospect.range_km <= prior.range_max_km:
        found.append(
            f"starts at {prospect.range_km:.4g} km, beyond the prior: radar.acquisition.range_min_km .. range_max_km ="
            f" {prior.range_min_km:g} .. {prior.range_max_km:g}"
        )
    if max(abs(state[1]), abs(state[3])) > prior.v_max_km_s:
        fastest = max(abs(state[1]), abs(state[3]))
        found.append(
            f"flies at {fastest:g} km/s along an axis, beyond the prior: radar.acquisition.v_max_km_s ="
            f" {prior.v_max_km_s:g}"
        )
    found += _of_dwell_time(radar, prospect)
    is_straight = not (target.turns or target.trajectory or target.born_s or target.gone_s or target.stays)
    if is_straight and state[0] + state[1] * radar.motion.dt_s * scenario.dwells < 0.0:
        dwell = int(-state[0] / (state[1] * radar.motion.dt_s)) + 1
        found.append(f"passes x = 0 at dwell {dwell} of {said_dwells(scenario.dwells)} and leaves the field of view")
    assumed, height_km = radar.assumes.height_max_km, target.begin_height_km
    beyond_km = float(np.hypot(state[0], height_km)) - abs(state[0])
    if height_km > assumed and beyond_km > NEAR_ENOUGH_KM:
        found.append(
            f"is {height_km:g} km high, but radar.assumes.height_max_km = {assumed:g}: an array of one line measures it"
            f" {beyond_km:.2g} km further away; set radar.assumes.height_max_km to the highest that targets are"
        )
    measured = in_plane(state, height_km)
    nu, resolved = float(spatial_frequency(measured)), 1.0 / radar.array.n_tx
    if scenario.simulated.signal == "array" and abs(nu) > 0.5 - resolved:
        found.append(
            f"starts at nu = {nu:.4f}, within 1/n_tx = {resolved:.4g} of end-fire: the array hears it at both ends, and"
            f" its track may begin at the wrong one; abs(nu) <= {0.5 - resolved:.4g} is unambiguous"
        )
    if scenario.simulated.signal == "array" and radar.receiver.separation == "none":
        found += _of_sidelobes(radar, prospect)
    name, best = max(prospect.p_d.items(), key=lambda item: item[1])
    there_s = min(target.last_s, end_s) - target.first_s
    if prospect.seconds is not None and prospect.seconds > max(there_s, 0.0):
        found.append(
            f"is probably never seen: the search with all power takes some {prospect.seconds:.2g} s to see it (P_D of a"
            f" look {best:.2g}), and it is there for {max(there_s, 0.0):.4g} s"
        )
    elif prospect.seconds is None and best < UNSEEN:
        found.append(f"cannot be detected: P_D {best:.2g} at the start with the best strategy ({name})")
    return found


def _of_sidelobes(radar: RadarConfig, prospect: Prospect) -> list[str]:
    """Whether an echo is detected in looks that point elsewhere, while power goes in all directions."""
    zeta_db = prospect.array_snr_db - prospect.disturbance_db + 10.0 * float(np.log10(2.0 / radar.array.n_tx))
    over_db = zeta_db - 10.0 * float(np.log10(threshold(radar.detector.p_fa)))
    if over_db <= GHOST_DB:
        return []
    return [
        f"has an echo {over_db:.0f} dB over the limit: more than {GHOST_DB:g} dB are detected through sidelobes, too,"
        ' and may begin false tracks; set radar.receiver.separation = "joint"'
    ]


def _of_dwell_time(radar: RadarConfig, prospect: Prospect) -> list[str]:
    """Whether the belief of a new track grows faster in a dwell than looks follow.

    All velocities up to v_max are possible, so that after a dwell the target is within h = v_max dt + sigma_s dt^2 of
    its place. The second term is two standard deviations of what its acceleration does. At range R a cell is 2 R /
    ((n_bin - 1) cos theta) wide.
    """
    motion, v_max, array = radar.motion, radar.acquisition.v_max_km_s, radar.array
    looks, cell_km = _cells_looked_at(radar, prospect), 2.0 * prospect.range_km / (array.n_bin - 1)
    cell_km /= max(float(np.cos(np.radians(prospect.angle_deg))), 1e-3)
    half_km = v_max * motion.dt_s + motion.sigma_s_km_s2 * motion.dt_s**2
    grown = min(2.0 * half_km / cell_km, float(array.n_bin))
    if grown <= GROWTH * looks:
        return []
    reach_km = 0.5 * GROWTH * looks * cell_km
    longest_s = 2.0 * reach_km / (v_max + float(np.sqrt(v_max**2 + 4.0 * motion.sigma_s_km_s2 * reach_km)))
    cure = f"motion.dt_s = {ROUNDED * longest_s:.2g} or less"
    if radar.planner.looks == "single":
        cure += ', or fidelity = "best" (joint looks light more cells)'
    elif not radar.planner.wide_looks:
        cure += ", or planner.wide_looks = true"
    return [
        f"may be {half_km:.3g} km away after a dwell of motion.dt_s = {motion.dt_s:g} s (acquisition.v_max_km_s ="
        f" {v_max:g}): {grown:.2g} cells at {prospect.range_km:.3g} km, and {looks:.2g}"
        f" {'is' if looks == 1.0 else 'are'} lit, so that the track may be lost; set {cure}"
    ]


def _cells_looked_at(radar: RadarConfig, prospect: Prospect) -> float:
    """Cells that a track can have lit in a dwell: joint looks as far as power suffices, wide looks with half of it."""
    if radar.planner.looks == "single":
        return 1.0
    gain = 2.0 * 10.0 ** (0.1 * (prospect.array_snr_db - prospect.disturbance_db)) / radar.array.power
    affordable = radar.array.power / max(radar.announced, 1) / float(sure_powers(radar, np.array([gain]))[0])
    own = max(1.0, min(affordable, OWN_CELLS))
    return max(own, min(ASTRAY * affordable, radar.array.n_bin)) if radar.planner.wide_looks else own


def _of_field_of_view(radar: RadarConfig) -> list[str]:
    prior, dt_s = radar.acquisition, radar.motion.dt_s
    dwells = prior.range_max_km / (prior.v_max_km_s * dt_s)
    if dwells >= FEWEST_DWELLS:
        return []
    return [
        f"radar.motion.dt_s = {dt_s:g}: a target with acquisition.v_max_km_s = {prior.v_max_km_s:g} crosses"
        f" acquisition.range_max_km = {prior.range_max_km:g} in {dwells:.2g} dwells, too few to follow it; set"
        f" motion.dt_s = {ROUNDED * dt_s * dwells / FEWEST_DWELLS:.2g} or less"
    ]


def _of_acquisition(scenario: Scenario, prospect: Prospect) -> list[str]:
    most = scenario.radar.acquisition.max_scans
    if scenario.radar.search is not None or prospect.scans <= most:
        return []
    scans = f"some {prospect.scans:.2g}" if prospect.scans < inf else "more than any number of"
    return [
        f"is probably not acquired, so that no track begins: it takes {scans} scans (P_D"
        f" {prospect.p_d['orthogonal']:.2g} with the orthogonal waveform), radar.acquisition.max_scans = {most}"
    ]


def _of_filter(radar: RadarConfig) -> list[str]:
    """Keys of particles that were set although the belief has none; those that every scenario sets are none."""
    if radar.belief.filter != "gaussian" and not is_own(radar.belief.filter):
        return []
    preset = FIDELITY[radar.fidelity]["belief"]
    if radar.fidelity == "paper" and radar.planner.looks == "joint":
        preset = preset | {"reacquire_below": REACQUIRE_BELOW}
    name = short(radar.belief.filter)
    return [
        f'radar.belief.{key} = {value:g} has no effect with radar.belief.filter = "{name}": leave it out'
        for key in ("kernel_bandwidth", "reacquire_below")
        if (value := getattr(radar.belief, key)) != preset[key]
    ]


def _of_sizes(scenario: Scenario) -> list[str]:
    radar, found = scenario.radar, list[str]()
    tree = tree_bytes(radar.planner.n_sim, radar.array.n_bin)
    beliefs = beliefs_bytes(n_state(radar.belief), radar.announced)
    if PROCESS_BYTES + tree + beliefs > CONTAINER_BYTES:
        found.append(
            f"a planner of all tracks needs up to {(PROCESS_BYTES + tree + beliefs) / 2**20:.0f} MiB (search tree"
            f" {tree / 2**20:.0f}, beliefs {beliefs / 2**20:.0f}); a container of"
            f" docker-compose.yml has {CONTAINER_BYTES / 2**20:.0f}"
        )
    if scenario.dwells == NO_END and scenario.world is not None and scenario.world.repeat_s is None:
        found.append(
            f"dwells = {UNLIMITED}: all targets fly once, and nothing comes after them; set world.repeat_s to the time"
            " after which they come again"
        )
    run_s = dwell_s(radar) * scenario.dwells
    if run_s > LONG_S and scenario.dwells < NO_END:
        found.append(f"a run of {scenario.dwells} dwells may take {run_s / 3600.0:.1f} hours with one planner")
    return found
