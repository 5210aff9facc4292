"""Emulator: the scene (targets move) and the signal (disturbance, echoes, the receiver's statistic).

This is what a hardware front end would replace: it obeys waveforms and reports scans. The truth leaves it on a topic
of its own that only metrics reads.

A world is a function of the seed and of the waveforms, so an emulator that comes back begins at the run's checkpoint
and says again what is not in the store yet.
"""

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from services.early import Early, decoded
from services.silence import Silence
from services.unstored import Unstored
from shared.array import angle_bin, bin_centres, spatial_frequency, steering_vector
from shared.detection import wald_test
from shared.disturbance import draw
from shared.echo import amplitude, snr_db
from shared.kinematics import propagate
from shared.messages import (
    Checkpoint,
    Event,
    History,
    Message,
    Refused,
    RunEnd,
    Scan,
    Tick,
    Truth,
    Waveform,
    WaveformRecall,
)
from shared.scenario import Scenario
from shared.seeds import Purpose, generator
from shared.waveform import transmit_signatures

POWER_TOLERANCE = 1e-5  # of the total power; waveforms are complex64 on the wire
HOLD_DWELLS = 200  # how far a run may be ahead of the store; publishers keep more than twice as much


@dataclass
class _World:
    """One run's scene: a function of the seed and of the waveforms received."""

    run: str
    scenario: Scenario
    seed: int
    dwells: int
    k: int  # next dwell to transmit
    t: int  # clock of dwell k-1
    unstored: Unstored
    states: NDArray[np.float64]  # (M, 4)
    period_s: float  # between dwells in real time; 0: in lockstep
    waveforms: dict[int, Waveform] = field(default_factory=dict)  # of dwell k-1 and later; in real time the newest
    due_s: float = 0.0  # when dwell k is to be transmitted, in real time
    over: bool = False


class EmulatorCore:
    """Waveform k in, truth and scan k+1 out, for any number of runs."""

    def __init__(self) -> None:
        self._worlds: dict[str, _World] = {}
        self._early = Early()
        self._silence = Silence()

    @property
    def wake_s(self) -> float:
        """When the next dwell of a run in real time is due."""
        return min((world.due_s for world in self._worlds.values() if _is_ticking(world)), default=math.inf)

    def handle(self, event: Event) -> Sequence[Message]:
        """Begin a run, let more dwells happen, or say again what nobody seems to have heard."""
        for run in self._silence.after(event):
            self._worlds.pop(run, None)
        match event:
            case Checkpoint(ended=True):
                self._worlds.pop(event.run, None)
                self._early.forget(event.run)
            case Checkpoint() if event.run in self._worlds:
                return _checkpoint(self._worlds[event.run], event)
            case Checkpoint():
                self._worlds[event.run] = _begin(event)
                said = [*_go_on(self._worlds[event.run]), *self._early.replay(event.run, self.handle)]
                return [*said, *_missing(self._worlds[event.run])]
            case Waveform() if event.run in self._worlds:
                return _take(self._worlds[event.run], event)
            case History(topic="waveform") if event.run in self._worlds:
                return [said for payload in event.payloads for said in self._recalled(event.run, payload)]
            case Waveform():
                self._early.keep(event)
            case Tick():
                said = [said for world in self._worlds.values() for said in _pulse(world, event.now_s)]
                self._silence.hear(said)  # in real time the radar goes on, though nobody else is left
                return said
            case _:
                pass
        return ()

    def _recalled(self, run: str, payload: bytes) -> Sequence[Message]:
        waveform = decoded(payload)
        return _take(self._worlds[run], waveform) if isinstance(waveform, Waveform) and waveform.run == run else ()


def _begin(checkpoint: Checkpoint) -> _World:
    """The world as it was after dwell k-1. The targets fly from t = 1 on, whatever was transmitted."""
    scenario = Scenario.model_validate(checkpoint.scenario)
    world = _World(
        checkpoint.run,
        scenario,
        checkpoint.seed,
        checkpoint.dwells,
        checkpoint.k,
        t=0,
        unstored=Unstored(checkpoint.k),
        states=scenario.initial_states(),
        period_s=1.0 / checkpoint.rate_hz if checkpoint.rate_hz else 0.0,
    )
    while world.t < checkpoint.t:
        _move(world)
    return world


def _take(world: _World, waveform: Waveform) -> Sequence[Message]:
    """Keep a waveform until its dwell comes; a repeated one changes nothing."""
    _check(world.scenario, waveform)
    if world.period_s:
        if waveform.k >= max(world.waveforms, default=0):
            world.waveforms = {waveform.k: waveform}
        return ()
    if world.k - 1 <= waveform.k < world.k + HOLD_DWELLS and not world.over:
        world.waveforms.setdefault(waveform.k, waveform)
    return _go_on(world)


def _checkpoint(world: _World, checkpoint: Checkpoint) -> Sequence[Message]:
    """Go on as far as the store allows; if it waits for something, say it again."""
    return [*world.unstored.checkpoint(checkpoint.k), *_go_on(world), *_missing(world)]


def _missing(world: _World) -> Sequence[Message]:
    """The question for the next waveform, if the store has it already and we do not."""
    any_will_do = bool(world.period_s and world.waveforms)
    lacks = not world.over and 0 < world.k <= world.unstored.k and not any_will_do
    return (WaveformRecall(run=world.run, k=world.k - 1),) if lacks else ()


def _go_on(world: _World) -> Sequence[Message]:
    """In lockstep: transmit as far as waveforms are there and the store keeps up."""
    said: list[Message] = []
    while not world.period_s and not world.over and world.k - world.unstored.k < HOLD_DWELLS:
        waveform = world.waveforms.pop(world.k - 1, None)
        if waveform is None and world.k > 0:
            break
        said += _next_dwell(world, waveform)
    return said


def _is_ticking(world: _World) -> bool:
    return world.period_s > 0.0 and not world.over


def _pulse(world: _World, now_s: float) -> Sequence[Message]:
    """In real time: transmit when it is due, with the newest waveform there is. Dwells that are overdue are not made up
    for: a transmitter that was late goes on at its rate.
    """
    if not _is_ticking(world) or now_s < world.due_s:
        return ()
    waveform = next(iter(world.waveforms.values()), None)
    on_time = now_s < world.due_s + world.period_s
    world.due_s = (world.due_s if on_time else now_s) + world.period_s
    if world.t > 0 and waveform is None:
        return ()  # back in mid-run: the allocator goes on saying waveforms, and the store's newest was asked for
    if waveform is not None and waveform.k > world.k:
        _skip(world, waveform.k + 1)
    return _next_dwell(world, waveform)


def _skip(world: _World, k: int) -> None:
    """In real time: the others went on to dwell k while this process was away. The targets flew all the while; the
    dwells in between never happened.
    """
    while world.k < k and world.t < world.dwells:
        world.k += 1
        if world.t > 0:
            _move(world)


def _next_dwell(world: _World, waveform: Waveform | None) -> Sequence[Message]:
    """Dwell k with this waveform, or, before there is any, with power in all directions; or the end of the run."""
    k, world.k = world.k, world.k + 1
    said: tuple[Message, ...]
    if world.t == world.dwells:
        said = _end(world, k, "complete")
    elif waveform is not None and waveform.tracking:
        _move(world)
        said = _transmit(world, k, waveform.k, waveform.isotropic, waveform.factor, waveform.beams)
    elif k >= world.scenario.acquisition.max_scans:
        said = _end(world, k, "failed", f"not every target was detected within {k} scans")
    else:
        searching = np.full(world.scenario.n_target, -1, dtype=np.int32)
        nothing = np.empty((world.scenario.array.n_tx, 0), dtype=np.complex64)
        isotropic, factor = (
            (world.scenario.array.power, nothing) if waveform is None else (waveform.isotropic, waveform.factor)
        )
        said = _transmit(world, k, -1 if waveform is None else waveform.k, isotropic, factor, searching)
    return world.unstored.add(k, said)


def _move(world: _World) -> None:
    """Let the targets fly for one dwell; the noise is keyed by (target, t), so strategies share trajectories."""
    world.t += 1
    motion = world.scenario.motion
    for m in range(world.scenario.n_target):
        rng = generator(world.seed, Purpose.MOTION, m, world.t)
        world.states[m] = propagate(world.states[m : m + 1], motion.dt_s, motion.sigma_s_km_s2, rng)[0]


def _end(world: _World, k: int, status: str, reason: str = "") -> tuple[Message, ...]:
    world.over = True
    end = {"run": world.run, "k": k - 1, "t": world.t, "status": status, "reason": reason}
    return (RunEnd.model_validate(end),)


def _transmit(
    world: _World,
    k: int,
    waveform_k: int,
    isotropic: float,
    factor: NDArray[np.complex64],
    beams: NDArray[np.int32],
) -> tuple[Message, ...]:
    """One transmit-receive cycle. Power in all directions lets every cell be tested; beams only their own."""
    array = world.scenario.array
    bins = np.arange(array.n_bin) if isotropic > 0 else np.unique(beams)
    target_bins = angle_bin(spatial_frequency(world.states), array.n_bin)
    range_km = np.hypot(world.states[:, 0], world.states[:, 2])
    echoes = _echoes(world, k, range_km, target_bins)
    nus = bin_centres(array.n_bin)[bins]
    signatures = transmit_signatures(isotropic, factor.astype(np.complex128), nus)
    cells = [
        wald_test(
            draw(
                world.scenario.disturbance.model,
                array.n_tx * array.n_rx,
                generator(world.seed, Purpose.DISTURBANCE, int(bin_), k),
            ),
            signature,
            steering_vector(nu, array.n_rx),
            echoes.get(int(bin_), 0j),
        )
        for bin_, nu, signature in zip(bins, nus, signatures, strict=True)
    ]
    truth = Truth(
        run=world.run,
        k=k,
        t=world.t,
        states=world.states.copy(),
        bins=target_bins.astype(np.int32),
        snr_db=snr_db(range_km, world.scenario.echo.amplitude_db),
        waveform_k=waveform_k,
    )
    scan = Scan(
        run=world.run,
        k=k,
        t=world.t,
        bins=bins.astype(np.int32),
        statistic=np.array([cell.statistic for cell in cells]),
        alpha_hat=np.array([cell.alpha_hat for cell in cells], dtype=np.complex64),
        sigma_hat=np.array([cell.sigma_hat for cell in cells]),
        signature_power=np.array([cell.signature_power for cell in cells]),
        beams=beams,
    )
    return truth, scan


def _echoes(world: _World, k: int, range_km: NDArray[np.float64], target_bins: NDArray[np.int64]) -> dict[int, complex]:
    """Echo amplitude alpha of each occupied bin: known magnitude, phase redrawn every dwell."""
    echoes: dict[int, complex] = {}
    magnitudes = amplitude(range_km, world.scenario.echo.amplitude_db)
    for m, (bin_, magnitude) in enumerate(zip(target_bins, magnitudes, strict=True)):
        phase = generator(world.seed, Purpose.PHASE, m, k).uniform(0.0, 2.0 * np.pi)
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
