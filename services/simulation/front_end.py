"""The simulated front end, watched; a dwell is a pure function, so that it can be cached."""

import hashlib
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np

from cogradar.services.emulator.front_end import FrontEndError, GroundTruth, ScanData, Transmission
from cogradar.services.emulator.kept_open import ATTEMPTS
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.services.simulation.schedule import LONG_DWELLS, RUN_SEEDS
from cogradar.shared.protocol.messages import EmulatorCheckpoint

Watch = Callable[[str, int, int, Transmission, bool], None]  # run, k, t, what is radiated, whether it is measured
_CLOCKS = 2 * (RUN_SEEDS + 1) * LONG_DWELLS  # of all worlds: two skies, and the second run has the next seed


class ReceiverFaults:
    """What is wrong with the receivers of all runs.

    In lockstep a dwell fails so often that its front end is opened again and the run goes on: nothing else may change.
    """

    def __init__(self) -> None:
        self.amounts: list[float] = []  # of the faults that last
        self._attempts = Counter[tuple[str, int]]()

    def measured(self, checkpoint: EmulatorCheckpoint, k: int, scan: ScanData) -> ScanData:
        """What comes of a dwell. Raises FrontEndError."""
        if not self.amounts:
            return scan
        self._attempts[checkpoint.run, k] += 1
        is_lockstep = checkpoint.rate_hz == 0.0
        if is_lockstep and self._attempts[checkpoint.run, k] >= ATTEMPTS:
            return scan
        if is_lockstep or self.amounts[-1] < 2.0:
            raise FrontEndError("the receiver is out")
        nonsense = replace(scan, statistic=scan.statistic * np.nan)
        return nonsense if self.amounts[-1] < 3.0 else ScanData.not_measured("no packet")


class WatchedFrontEnd:
    """A scan is a function of the run, the dwell, its clock and the waveform, whatever was transmitted before."""

    def __init__(self, checkpoint: EmulatorCheckpoint, watch: Watch, faults: ReceiverFaults) -> None:
        self._checkpoint, self._watch, self._faults = checkpoint, watch, faults
        self._world = _named(checkpoint)
        self._known: tuple[int, GroundTruth] | None = None  # the truth at a clock

    def transmit(self, k: int, t: int, waveform: Transmission) -> ScanData:
        """Transmit dwell k and measure."""
        scan, truth = simulated(self._world, k, t, waveform)
        self._known, is_measured = (t, truth), False
        try:
            measured = self._faults.measured(self._checkpoint, k, scan)
            is_measured = measured is scan
        finally:
            self._watch(self._checkpoint.run, k, t, waveform, is_measured)
        return measured

    def truth(self, t: int) -> GroundTruth:
        """The truth at clock t."""
        if self._known is None or self._known[0] != t:
            self._known = t, _opened(self._world, t).truth(t)
        return self._known[1]

    def close(self) -> None:
        """There is nothing to switch off."""


def simulated(world: bytes, k: int, t: int, waveform: Transmission) -> tuple[ScanData, GroundTruth]:
    """Scan and truth of a dwell in a world of this name."""
    front_end = _opened(world, t)
    return front_end.transmit(k, t, waveform), front_end.truth(t)


_WORLDS: dict[bytes, EmulatorCheckpoint] = {}  # by a digest of all that a scan depends on but dwell and waveform


def _named(checkpoint: EmulatorCheckpoint) -> bytes:
    parts = repr((checkpoint.world, checkpoint.radar, checkpoint.world_seed)).encode()
    name = hashlib.blake2b(parts, digest_size=16).digest()
    if name not in _WORLDS:
        scene = {"radar": checkpoint.radar, "seed": 0, "world": checkpoint.world, "world_seed": checkpoint.world_seed}
        settings = {"run": "r", "strategy": "orthogonal", "dwells": 1, "k": 0, "t": 0}
        _WORLDS[name] = EmulatorCheckpoint.model_validate(settings | scene)
    return name


@lru_cache(maxsize=_CLOCKS)
def _opened(world: bytes, t: int) -> SimulatedFrontEnd:
    """A world at clock t. It can be used for any dwell of this clock: a scan does not depend on those before."""
    return SimulatedFrontEnd.open(_WORLDS[world].model_copy(update={"t": t}))
