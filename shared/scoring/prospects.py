"""What can be said of a scenario before it is played: how well each target can be seen, and what makes no sense.

Closed forms at the start of the run, from what the world will do; nothing is drawn.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.power.rules import Requests, power_rule
from cogradar.shared.scenario.limits import CONTAINER_BYTES, PROCESS_BYTES, beliefs_bytes, dwell_s, tree_bytes
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scenario.tables import POWER_RULES
from cogradar.shared.scenario.world_config import TargetSection
from cogradar.shared.scoring.finite_size import finite_size
from cogradar.shared.signal.array import spatial_frequency, steering_vector
from cogradar.shared.signal.looks import directions_everywhere, range_cells
from cogradar.shared.signal.monopulse import off_axis_loss
from cogradar.shared.signal.radar_equation import snr_db
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.signal.waveform import beampattern, transmit_signatures
from cogradar.shared.world.disturbance import power_spectrum

UNSEEN = 0.1  # a target with a lower P_D is hardly ever seen
LONG_S = 3600.0


class Prospect(NamedTuple):
    """One target at t = 0, or at its birth."""

    target: int  # counted from 1
    range_km: float
    angle_deg: float  # from the array's normal
    snr_db: float  # of one virtual channel and the mean RCS, over the disturbance's mean level
    disturbance_db: float  # what the disturbance has towards this target, relative to its mean level
    array_snr_db: float  # of all of them, with all power on this target: plus 10 log10(P n_tx n_rx)
    p_d: dict[str, float]  # of each strategy, if every track asks for its target's bin


def prospects(scenario: Scenario) -> list[Prospect]:
    """What the radar can expect of each target when it begins. Raises ValueError without a [world].

    As if all of them were there at that time. Range cells: as if all of them were tested; a track that asks for few of
    them has a lower threshold.
    """
    world, radar = scenario.simulated, scenario.radar
    array, states = radar.array, world.initial_states()
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
    for name in POWER_RULES:
        sent = power_rule(name)(radar, requests)
        signature_power = beampattern(sent.isotropic, sent.factor, nus) * array.n_rx
        signature_power *= matched if sent.isotropic > 0.0 else 1.0
        signatures = transmit_signatures(sent.isotropic, sent.factor, nus)
        p_d[name] = np.array(
            [
                finite_size(
                    world.disturbance.model, nu, np.kron(u, steering_vector(nu, array.n_rx))
                ).detection_probability(10.0 ** (snr / 10.0), power, limit, law)
                for nu, u, snr, power, law in zip(nus.tolist(), signatures, snrs, signature_power, laws, strict=True)
            ]
        )
    gain = 10.0 * np.log10(array.power * array.n_tx * array.n_rx)
    return [
        Prospect(
            m + 1,
            float(ranges[m]),
            float(np.degrees(np.arctan2(states[m, 2], states[m, 0]))),
            float(snrs[m]),
            float(10.0 * np.log10(spectrum[m])),
            float(snrs[m] + gain),
            {name: float(p[m]) for name, p in p_d.items()},
        )
        for m in range(len(states))
    ]


def warnings(scenario: Scenario, expected: Sequence[Prospect]) -> list[str]:
    """What is legal but makes no sense, a line each; `expected` are the prospects of its targets."""
    found = _of_sizes(scenario)
    if scenario.world is None:
        return found
    radar, starting = scenario.radar, scenario.starting
    for prospect, target in zip(expected, scenario.world.targets, strict=True):
        texts = _of_target(scenario, prospect, target)
        if prospect.target - 1 in starting:
            texts += _of_acquisition(scenario, prospect)
        found += [f"target {prospect.target} {text}" for text in texts]
    assumed, real = radar.echo.amplitude_db, scenario.world.echo.amplitude_db
    if abs(assumed - real) > 6.0:
        found.append(
            f"radar.echo.amplitude_db = {assumed:g} but world.echo.amplitude_db = {real:g}: the radar takes echoes for"
            f" those of targets {10.0 ** ((assumed - real) / 40.0):.2g} times as far away"
        )
    if scenario.world.rcs != "constant" and radar.assumes.rcs == "known":
        found.append(
            f'world.rcs = "{scenario.world.rcs}" but radar.assumes.rcs = "known": the radar takes what fluctuates for'
            " changes of range"
        )
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
    is_straight = not (target.turns or target.trajectory or target.born_s or target.gone_s or target.stays)
    if is_straight and state[0] + state[1] * radar.motion.dt_s * scenario.dwells < 0.0:
        dwell = int(-state[0] / (state[1] * radar.motion.dt_s)) + 1
        found.append(f"passes x = 0 at dwell {dwell} of {scenario.dwells} and leaves the field of view")
    name, best = max(prospect.p_d.items(), key=lambda item: item[1])
    if best < UNSEEN:
        found.append(f"cannot be detected: P_D {best:.2g} at the start with the best strategy ({name})")
    return found


def _of_acquisition(scenario: Scenario, prospect: Prospect) -> list[str]:
    found, radar = list[str](), scenario.radar
    prior = radar.acquisition
    scans = prior.confirmations / max(prospect.p_d["orthogonal"], radar.detector.p_fa)
    if scans > prior.max_scans:
        found.append(
            f"is probably not acquired, so that no track begins: it takes some {scans:.2g} scans at P_D"
            f" {prospect.p_d['orthogonal']:.2g} with the orthogonal waveform, radar.acquisition.max_scans ="
            f" {prior.max_scans}"
        )
    return found


def _of_sizes(scenario: Scenario) -> list[str]:
    radar, found = scenario.radar, list[str]()
    tree = tree_bytes(radar.planner.n_sim, radar.array.n_bin)
    beliefs = beliefs_bytes(radar.belief.n_particle, radar.announced)
    if PROCESS_BYTES + tree + beliefs > CONTAINER_BYTES:
        found.append(
            f"a planner of all tracks needs up to {(PROCESS_BYTES + tree + beliefs) / 2**20:.0f} MiB (search tree"
            f" {tree / 2**20:.0f}, beliefs {beliefs / 2**20:.0f}); a container of"
            f" docker-compose.yml has {CONTAINER_BYTES / 2**20:.0f}"
        )
    run_s = dwell_s(radar) * scenario.dwells
    if run_s > LONG_S:
        found.append(f"a run of {scenario.dwells} dwells may take {run_s / 3600.0:.1f} hours with one planner")
    return found
