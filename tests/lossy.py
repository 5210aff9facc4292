"""A simulated front end whose receiver loses looks, has outages and fails."""

from collections.abc import Callable, Collection
from dataclasses import fields, replace

import numpy as np

from cogradar.services.emulator.front_end import FrontEnd, FrontEndError, GroundTruth, ScanData, Transmission
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.shared.protocol.messages import EmulatorCheckpoint

_OTHERS = {"beams", "beam_nus", "gates", "roster", "settings", "unmeasured", "lost_km", "fault", "waveform_k", "utc_s"}
_OTHERS |= {"front_end"}
COLUMNS = {field.name for field in fields(ScanData)} - _OTHERS


class LossyFrontEnd:
    """Loses each look with a probability, all looks of some dwells, and raises once in others."""

    def __init__(self, checkpoint: EmulatorCheckpoint, loss: float, outages: Collection[int], raises: set[int]) -> None:
        self._simulated = SimulatedFrontEnd.open(checkpoint)
        self._loss, self._outages, self._raises = loss, outages, raises

    def transmit(self, k: int, t: int, waveform: Transmission) -> ScanData:
        if k in self._raises:
            self._raises.remove(k)
            raise FrontEndError("the cable is out")
        scan = self._simulated.transmit(k, t, waveform)
        if k in self._outages:
            return ScanData.not_measured("no packet")
        assert scan.nus is not None
        looks = np.unique(scan.nus)
        kept = looks[np.random.default_rng((7, k)).random(looks.size) >= self._loss]
        rows = np.isin(scan.nus, kept)
        return replace(scan, **{name: getattr(scan, name)[rows] for name in COLUMNS})

    def truth(self, t: int) -> GroundTruth:
        return self._simulated.truth(t)

    def close(self) -> None:
        self._simulated.close()


def lossy(
    loss: float = 0.0, outages: Collection[int] = (), raises: Collection[int] = ()
) -> Callable[[EmulatorCheckpoint], FrontEnd]:
    """What opens it for a run; each dwell in `raises` fails once."""
    left = set(raises)
    return lambda checkpoint: LossyFrontEnd(checkpoint, loss, outages, left)
