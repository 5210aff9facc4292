"""Emulator: transmits what it is told and reports scans of a scene that it simulates (`shared.world.scene`).

This is what a hardware front end would replace. The truth leaves it on a topic of its own that only metrics reads.

A world is a function of the seed and of the waveforms, so an emulator that comes back begins at the run's checkpoint
and says again what is not in the store yet.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from services.delivery.inactivity import Inactivity
from services.delivery.pending import Pending, decoded
from services.delivery.resend import ResendBuffer
from shared.protocol.messages import (
    EmulatorCheckpoint,
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
from shared.scenario.radar_config import RadarConfig
from shared.scenario.world_config import WorldConfig
from shared.world.scene import Scene

POWER_TOLERANCE = 1e-5  # of the total power; waveforms are complex64 on the wire
HOLD_DWELLS = 200  # how far a run may be ahead of the store; all processes keep more than twice as much to redeliver


@dataclass
class _World:
    """One run: a function of the seed and of the waveforms received."""

    run: str
    radar: RadarConfig
    scene: Scene  # as it was in dwell k-1
    dwells: int
    k: int  # next dwell to transmit
    resend: ResendBuffer
    period_s: float  # between dwells in real time; 0: in lockstep
    waveforms: dict[int, Waveform] = field(default_factory=dict)  # of dwell k-1 and later; in real time the newest
    due_s: float = -math.inf  # when dwell k is to be transmitted, in real time; the first at once
    over: bool = False
    likely: Sequence[int] = ()  # cells that dwell k will probably look at: those of dwell k-1, if they are few
    prepared: int = 0  # newest dwell that was prepared


class EmulatorCore:
    """Waveform k in, truth and scan k+1 out, for any number of runs."""

    def __init__(self) -> None:
        self._worlds: dict[str, _World] = {}
        self._pending = Pending()
        self._inactivity = Inactivity()

    @property
    def wake_s(self) -> float | None:
        """When the next dwell of a run in real time is due."""
        return min((world.due_s for world in self._worlds.values() if _is_ticking(world)), default=None)

    def handle(self, event: Event) -> Sequence[Message]:
        """Begin a run, let more dwells happen, or say again what nobody seems to have heard."""
        for run in self._inactivity.after(event):
            self._worlds.pop(run, None)
        match event:
            case EmulatorCheckpoint(ended=True):
                self._worlds.pop(event.run, None)
                self._pending.forget(event.run)
            case EmulatorCheckpoint() if self._goes_on_at(event):
                return _checkpoint(self._worlds[event.run], event)
            case EmulatorCheckpoint():  # a new run, or one that is rewound
                self._worlds[event.run] = _begin(event)
                said = [*_go_on(self._worlds[event.run]), *self._pending.replay(event.run, self.handle)]
                return [*said, *_missing(self._worlds[event.run])]
            case Waveform() if event.run in self._worlds:
                return _take(self._worlds[event.run], event)
            case History(topic="waveform") if event.run in self._worlds:
                return [said for payload in event.payloads for said in self._recalled(event.run, payload)]
            case Waveform():
                self._pending.add(event)
            case Tick():
                said = [said for world in self._worlds.values() for said in _pulse(world, event.now_s)]
                self._inactivity.note(said)  # in real time the radar goes on, though nobody else is left
                return said
            case _:
                pass
        return ()

    def prepare(self) -> bool:
        """Let the targets fly and draw the noise of a dwell whose waveform is still to come."""
        for world in self._worlds.values():
            if world.scene.t > 0 and world.prepared < world.k and not world.over:
                world.scene.prepare(world.k, world.likely)
                world.prepared = world.k
                return True
        return False

    def _goes_on_at(self, checkpoint: EmulatorCheckpoint) -> bool:
        world = self._worlds.get(checkpoint.run)
        return world is not None and not world.resend.is_rewound_by(checkpoint)

    def _recalled(self, run: str, payload: bytes) -> Sequence[Message]:
        waveform = decoded(payload)
        return _take(self._worlds[run], waveform) if isinstance(waveform, Waveform) and waveform.run == run else ()


def _begin(checkpoint: EmulatorCheckpoint) -> _World:
    """The world as it was after dwell k-1."""
    radar, world = RadarConfig.model_validate(checkpoint.radar), WorldConfig.model_validate(checkpoint.world)
    return _World(
        checkpoint.run,
        radar,
        Scene(world, radar, checkpoint.world_seed, checkpoint.t),
        checkpoint.dwells,
        checkpoint.k,
        ResendBuffer(checkpoint.k),
        period_s=1.0 / checkpoint.rate_hz if checkpoint.rate_hz else 0.0,
    )


def _take(world: _World, waveform: Waveform) -> Sequence[Message]:
    """Keep a waveform until its dwell comes; a repeated one changes nothing."""
    _check(world.radar, waveform)
    if world.period_s:
        if waveform.k >= max(world.waveforms, default=0):
            world.waveforms = {waveform.k: waveform}
        return ()
    if world.k - 1 <= waveform.k < world.k + HOLD_DWELLS and not world.over:
        world.waveforms.setdefault(waveform.k, waveform)
    return _go_on(world)


def _checkpoint(world: _World, checkpoint: EmulatorCheckpoint) -> Sequence[Message]:
    """Go on as far as the store allows; if it waits for something, say it again."""
    return [*world.resend.acknowledge(checkpoint), *_go_on(world), *_missing(world)]


def _missing(world: _World) -> Sequence[Message]:
    """The question for the next waveform, if the store has it already and we do not."""
    any_will_do = bool(world.period_s and world.waveforms)
    lacks = not world.over and 0 < world.k <= world.resend.k and not any_will_do
    return (WaveformRecall(run=world.run, k=world.k - 1),) if lacks else ()


def _go_on(world: _World) -> Sequence[Message]:
    """In lockstep: transmit as far as waveforms are there and the store keeps up."""
    said: list[Message] = []
    while not world.period_s and not world.over and world.k - world.resend.k < HOLD_DWELLS:
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
    if world.scene.t > 0 and waveform is None:
        return ()  # back in mid-run: the allocator goes on saying waveforms, and the store's newest was asked for
    if waveform is not None and waveform.k > world.k:
        _skip(world, waveform.k + 1)
    return _next_dwell(world, waveform)


def _skip(world: _World, k: int) -> None:
    """In real time: the others went on to dwell k while this process was away. The targets flew all the while; the
    dwells in between never happened.
    """
    while world.k < k and world.scene.t < world.dwells:
        world.k += 1
        if world.scene.t > 0:
            world.scene.move()


def _next_dwell(world: _World, waveform: Waveform | None) -> Sequence[Message]:
    """Dwell k with this waveform, or, before there is any, with power in all directions; or the end of the run."""
    k, world.k = world.k, world.k + 1
    said: tuple[Message, ...]
    if world.scene.t == world.dwells:
        said = _end(world, k, "complete")
    elif waveform is not None and waveform.tracking:
        world.scene.move()
        said = _transmit(world, k, waveform.k, waveform.isotropic, waveform.factor, waveform.beams)
    elif k >= world.radar.acquisition.max_scans:
        said = _end(world, k, "failed", f"not every target was detected within {k} scans")
    else:
        searching = np.full(world.radar.tracks, -1, dtype=np.int32)
        nothing = np.empty((world.radar.array.n_tx, 0), dtype=np.complex64)
        isotropic, factor = (
            (world.radar.array.power, nothing) if waveform is None else (waveform.isotropic, waveform.factor)
        )
        said = _transmit(world, k, -1 if waveform is None else waveform.k, isotropic, factor, searching)
    return world.resend.add(k, said)


def _end(world: _World, k: int, status: str, reason: str = "") -> tuple[Message, ...]:
    world.over = True
    end = {"run": world.run, "k": k - 1, "t": world.scene.t, "status": status, "reason": reason}
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
    scene = world.scene
    bins = np.arange(world.radar.array.n_bin) if isotropic > 0 else np.unique(beams)
    cells = scene.observe(k, isotropic, factor.astype(np.complex128), bins)
    world.likely = bins.tolist() if isotropic == 0.0 else []
    scan = Scan(
        run=world.run,
        k=k,
        t=scene.t,
        bins=bins.astype(np.int32),
        statistic=np.array([cell.statistic for cell in cells]),
        alpha_hat=np.array([cell.alpha_hat for cell in cells], dtype=np.complex64),
        sigma_hat=np.array([cell.sigma_hat for cell in cells]),
        signature_power=np.array([cell.signature_power for cell in cells]),
        beams=beams,
    )
    truth = Truth(
        run=world.run,
        k=k,
        t=scene.t,
        states=scene.states,
        bins=scene.target_bins.astype(np.int32),
        snr_db=scene.snr_db,
        waveform_k=waveform_k,
    )
    return scan, truth  # in this order: the loop waits for the scan


def _check(radar: RadarConfig, waveform: Waveform) -> None:
    """Refuse what the transmitter cannot send."""
    array, power = (
        radar.array,
        waveform.isotropic + float(np.sum(np.abs(waveform.factor.astype(np.complex128)) ** 2)),
    )
    if waveform.factor.shape[0] != array.n_tx:
        raise Refused(f"waveform for {waveform.factor.shape[0]} antennas, the array has {array.n_tx}")
    if waveform.beams.size != radar.tracks or (waveform.beams >= array.n_bin).any():
        raise Refused(f"beams {waveform.beams.tolist()}, expected {radar.tracks} of bins 0 .. {array.n_bin - 1}")
    if power > array.power * (1.0 + POWER_TOLERANCE):
        raise Refused(f"power {power:g}, at most {array.power:g} is allowed")
    if not waveform.tracking and waveform.isotropic == 0.0:
        raise Refused("an acquisition waveform must light up every cell")
