"""A front end without a way back, and what an emulator hears of a run."""

from typing import Any, cast

import numpy as np

from cogradar.services.emulator.front_end import FrontEnd, FrontEndError, ScanData, Transmission
from cogradar.shared.protocol.messages import EmulatorCheckpoint, Waveform
from cogradar.shared.protocol.recovery import History
from cogradar.shared.wire.codec import encode
from tests.services.loop import SMOKE, checkpoint, smoke_start

RADAR = SMOKE.radar


class Receiver:
    """A front end that cannot go back: what it measures depends on how often it transmitted."""

    def __init__(self) -> None:
        self.transmitted: list[tuple[int, int]] = []
        self.opened = self.closed = 0
        self.fails_at: int | None = None
        self.fails_for = 1000  # attempts
        self.is_broken = False
        self.returns: Any = None  # instead of a scan
        self.error: Exception = FrontEndError("the cable is out")
        self.ends_at: int | None = None
        self.wrong: dict[str, Any] = {}

    def open(self, _: EmulatorCheckpoint) -> FrontEnd:
        self.opened += 1
        return self

    def transmit(self, k: int, t: int, waveform: Transmission) -> ScanData | None:
        if self.is_broken:
            raise OSError("the cable is loose")
        if k == self.fails_at and self.fails_for > 0:
            self.fails_for -= 1
            raise self.error
        if k == self.ends_at:
            return None
        self.transmitted.append((k, t))
        if self.returns is not None:
            return cast(ScanData, self.returns)
        ones = np.ones(waveform.bins.size)
        columns: dict[str, Any] = {"bins": waveform.bins, "statistic": ones * len(self.transmitted), "alpha_hat": ones}
        return ScanData(**(columns | {"sigma_hat": ones, "signature_power": ones} | self.wrong))

    def close(self) -> None:
        self.closed += 1


def begin(k: int = 0, t: int = 0, **changed: Any) -> EmulatorCheckpoint:
    return checkpoint(smoke_start(), k, t).model_copy(update={"world": None} | changed)


def waveform_of(k: int, tracking: bool = True) -> Waveform:
    return Waveform(
        run="r",
        k=k,
        tracking=tracking,
        isotropic=1.0,
        factor=np.zeros((RADAR.array.n_tx, 0), dtype=np.complex64),
        beams=np.array(((3,), (12,)) if tracking else ((-1,), (-1,)), dtype=np.int32),
        shares=np.zeros((2, 1)),
        status="fixed",
        late=np.zeros(2, dtype=np.int32),
    )


def history(k: int) -> History:
    return History(run="r", to="emulator", topic="waveform", k=k, payloads=[encode(waveform_of(k))])
