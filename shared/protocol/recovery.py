"""The messages by which a process gets back what it lost: snapshots of tracks, recalls, and their answers."""

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from cogradar.shared.protocol.fields import (
    LARGEST,
    MAX_HISTORY,
    MAX_SIDE,
    Epoch,
    Floats,
    Index,
    Indices,
    Particles,
    Payload,
    ProcessName,
    Product,
    Size,
    States,
    Unseen,
    are_divisors,
)
from cogradar.shared.protocol.messages import Message
from cogradar.shared.scenario.faults import printable

MAX_WHY = 400  # characters


class _Unable(Message):
    """A process cannot do its part of a run, and says so again after each checkpoint."""

    process: ProcessName
    reason: Annotated[str, Field(min_length=1, max_length=MAX_WHY)]
    ends: bool  # the same happens in any process, or no other one could do it: the run fails

    @classmethod
    def of(cls, run: str, process: str, error: object, *, ends: bool) -> Self:
        """With a text, such as an exception's."""
        return cls(run=run, process=process, reason=printable(str(error))[:MAX_WHY] or "?", ends=ends)


class NoPlans(_Unable):
    """planner -> recorder, planners: others take its tracks."""

    late: bool = False  # the reason names planners that brought no plans, and the sender does its part


class NoWaveforms(_Unable):
    """allocator -> recorder."""


class Snapshot(Message):
    """All that a track is after dwell k: planner -> recorder.

    Fields as in `cogradar.shared.tracking.model.TrackState`. All owners of a track send the same. Not part
    of the digest, and never resent: if one is lost, the next one or the whole history does as well.
    """

    target: Index
    k: Index
    belief: Particles  # (n, 4) particles, (3, 31) components of a mixture, or numbers of a filter of a user's own
    detected: bool
    depleted: bool
    sigma_hat: Size
    in_beam: bool
    level: Product
    power: Size
    echo: Product
    remembered: Particles  # (n, 4), or (0, 4): the particles themselves, or not kept
    hit_bin: Annotated[int, Field(ge=-1, le=MAX_SIDE)]
    hit_amplitude: Product
    measured: Floats  # (4,)
    looked: States  # (n_miss, n_bin); with steered cells as wide as what stands for the looks of a dwell
    log_evidence: float
    attempts: Index
    modes: Floats  # (3,) probabilities
    existence: Annotated[float, Field(ge=0, le=1)]
    confirmed: bool
    in_doubt: bool
    unseen: Unseen | None = None  # as in a plan

    @model_validator(mode="after")
    def _aligned(self) -> Self:
        if self.belief.size == 0 or self.remembered.shape not in {(self.belief.shape[0], 4), (0, 4)}:
            raise ValueError("belief must have numbers, remembered be (n, 4) or (0, 4)")
        if self.modes.shape != (3,):
            raise ValueError("modes must be (3,)")
        if self.measured.shape != (4,):
            raise ValueError("measured must be (4,)")
        if self.hit_bin >= 0 and self.sigma_hat == 0.0:
            raise ValueError("a detection needs a sigma_hat > 0")
        if not are_divisors(np.array([self.sigma_hat, self.power])):
            raise ValueError(f"sigma_hat and power must be 0 or at least {1 / LARGEST:g}")
        return self


class ScanRecall(Message):
    """A planner lacks the scans of a run from dwell k on: planner -> recorder.

    The answer is the snapshots of these tracks of dwell k or later, and the scans if a track has none.
    """

    k: Index
    targets: Indices  # tracks that wait for dwell k
    planner: ProcessName  # it asks, and is answered


class WaveformRecall(Message):
    """The emulator lacks the waveforms of a run from dwell k on: emulator -> recorder."""

    k: Index


class History(Message):
    """Journalled messages of one topic, in order of dwells: recorder -> the one process that lacks them.

    Planners and the emulator recall them. The allocator is given the plans of a dwell that lacks its waveform alone.
    """

    to: ProcessName  # a planner's name, "emulator" or "allocator"
    topic: Literal["scan", "plan", "waveform", "snapshot"]
    k: Index  # dwell of the first; in lockstep the others follow without a gap
    payloads: Annotated[list[Payload], Field(max_length=MAX_HISTORY)]  # each an encoded message, envelope and all
    epoch: Epoch = 0  # as of a checkpoint


class Handover(Message):
    """Tracks that change hands: planner -> planners.

    A worker goes on planning for tracks that another one now owns, and says so, until that one says that it has taken
    them. No dwell waits for a worker that has yet to rebuild them. If either is lost, both plan the same for a while.
    """

    planner: ProcessName  # the sender
    k: Index  # the newest dwell that it has planned for: the new owner must be as far
    targets: Indices
    taken: bool  # the sender has them; False: it plans for them, and another one owns them
