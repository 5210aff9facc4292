"""Emulator: the scene (targets move) and the signal (disturbance, echoes, the receiver's statistic).

This is what a hardware front end would replace: it obeys waveforms and reports scans. The truth leaves it on a topic
of its own that only metrics reads.
"""

import cmath
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.array import angle_bin, bin_centres, spatial_frequency, steering_vector
from shared.detection import wald_test
from shared.disturbance import draw
from shared.echo import amplitude, snr_db
from shared.kinematics import propagate
from shared.messages import Event, Message, Refused, RunEnd, RunStart, Scan, Truth, Waveform
from shared.scenario import Scenario
from shared.seeds import Purpose, generator
from shared.waveform import transmit_signatures

POWER_TOLERANCE = 1e-5  # of the total power; waveforms are complex64 on the wire
MAX_ENDED = 10_000  # names kept of runs that ended, whose start may be heard again


@dataclass
class _World:
    """One run's scene: a function of the seed and of the waveforms received."""

    run: str
    scenario: Scenario
    seed: int
    dwells: int
    k: int
    t: int
    states: NDArray[np.float64]  # (M, 4)


class EmulatorCore:
    """Waveform k in, truth and scan k+1 out, for any number of runs."""

    def __init__(self) -> None:
        self._worlds: dict[str, _World] = {}
        self._ended: deque[str] = deque(maxlen=MAX_ENDED)

    def handle(self, event: Event) -> Sequence[Message]:
        """Begin a run, or let one more dwell happen."""
        match event:
            case RunStart() if event.run not in self._worlds and event.run not in self._ended:
                return self._begin(event)
            case Waveform() if event.run in self._worlds and event.k == self._worlds[event.run].k:
                _check(self._worlds[event.run].scenario, event)
                return self._next_dwell(self._worlds[event.run], event)
            case _:
                return ()  # a repeated waveform, or one for a run that ended

    def _begin(self, start: RunStart) -> Sequence[Message]:
        scenario = Scenario.model_validate(start.scenario)
        world = _World(start.run, scenario, start.seed, start.dwells, k=0, t=0, states=scenario.initial_states())
        self._worlds[start.run] = world
        searching = np.full(scenario.n_target, -1, dtype=np.int32)
        nothing = np.empty((scenario.array.n_tx, 0), dtype=np.complex64)
        return self._transmit(world, scenario.array.power, nothing, searching)

    def _next_dwell(self, world: _World, waveform: Waveform) -> Sequence[Message]:
        if world.t == world.dwells:
            return self._end(world, "complete")
        world.k += 1
        if waveform.tracking:
            world.t += 1
            self._move(world)
        elif world.k >= world.scenario.acquisition.max_scans:
            return self._end(world, "failed", f"not every target was detected within {world.k} scans")
        return self._transmit(world, waveform.isotropic, waveform.factor, waveform.beams)

    def _move(self, world: _World) -> None:
        """Let the targets fly for one dwell; the noise is keyed by (target, t), so strategies share trajectories."""
        motion = world.scenario.motion
        for m in range(world.scenario.n_target):
            rng = generator(world.seed, Purpose.MOTION, m, world.t)
            world.states[m] = propagate(world.states[m : m + 1], motion.dt_s, motion.sigma_s_km_s2, rng)[0]

    def _end(self, world: _World, status: str, reason: str = "") -> Sequence[Message]:
        del self._worlds[world.run]
        self._ended.append(world.run)
        return (
            RunEnd.model_validate({"run": world.run, "k": world.k, "t": world.t, "status": status, "reason": reason}),
        )

    def _transmit(
        self, world: _World, isotropic: float, factor: NDArray[np.complex64], beams: NDArray[np.int32]
    ) -> Sequence[Message]:
        """One transmit-receive cycle. Power in all directions lets every cell be tested; beams only their own."""
        array = world.scenario.array
        bins = np.arange(array.n_bin) if isotropic > 0 else np.unique(beams)
        target_bins = angle_bin(spatial_frequency(world.states), array.n_bin)
        range_km = np.hypot(world.states[:, 0], world.states[:, 2])
        echoes = self._echoes(world, range_km, target_bins)
        nus = bin_centres(array.n_bin)[bins]
        signatures = transmit_signatures(isotropic, factor.astype(np.complex128), nus)
        cells = [
            wald_test(
                draw(
                    world.scenario.disturbance.model,
                    array.n_tx * array.n_rx,
                    generator(world.seed, Purpose.DISTURBANCE, int(bin_), world.k),
                ),
                signature,
                steering_vector(nu, array.n_rx),
                echoes.get(int(bin_), 0j),
            )
            for bin_, nu, signature in zip(bins, nus, signatures, strict=True)
        ]
        truth = Truth(
            run=world.run,
            k=world.k,
            t=world.t,
            states=world.states.copy(),
            bins=target_bins.astype(np.int32),
            snr_db=snr_db(range_km, world.scenario.echo.amplitude_db),
        )
        scan = Scan(
            run=world.run,
            k=world.k,
            t=world.t,
            bins=bins.astype(np.int32),
            statistic=np.array([cell.statistic for cell in cells]),
            alpha_hat=np.array([cell.alpha_hat for cell in cells], dtype=np.complex64),
            sigma_hat=np.array([cell.sigma_hat for cell in cells]),
            signature_power=np.array([cell.signature_power for cell in cells]),
            beams=beams,
        )
        return truth, scan

    @staticmethod
    def _echoes(world: _World, range_km: NDArray[np.float64], target_bins: NDArray[np.int64]) -> dict[int, complex]:
        """Echo amplitude alpha of each occupied bin: known magnitude, phase redrawn every dwell."""
        echoes: dict[int, complex] = {}
        magnitudes = amplitude(range_km, world.scenario.echo.amplitude_db)
        for m, (bin_, magnitude) in enumerate(zip(target_bins, magnitudes, strict=True)):
            phase = generator(world.seed, Purpose.PHASE, m, world.k).uniform(0.0, 2.0 * np.pi)
            echoes[int(bin_)] = echoes.get(int(bin_), 0j) + cmath.rect(magnitude, phase)
        return echoes


def _check(scenario: Scenario, waveform: Waveform) -> None:
    """Refuse what the transmitter cannot send."""
    array, power = (
        scenario.array,
        waveform.isotropic + float(np.sum(np.abs(waveform.factor.astype(np.complex128)) ** 2)),
    )
    if waveform.factor.shape[0] != array.n_tx:
        raise Refused(f"waveform for {waveform.factor.shape[0]} antennas, the array has {array.n_tx}")
    if waveform.beams.size != scenario.n_target or (waveform.beams >= array.n_bin).any():
        raise Refused(f"beams {waveform.beams.tolist()}, expected {scenario.n_target} of bins 0 .. {array.n_bin - 1}")
    if power > array.power * (1.0 + POWER_TOLERANCE):
        raise Refused(f"power {power:g}, at most {array.power:g} is allowed")
    if not waveform.tracking and waveform.isotropic == 0.0:
        raise Refused("an acquisition waveform must light up every cell")
