"""The simulated front end, watched; a dwell is a pure function, so that it can be cached."""

from collections.abc import Callable

from cogradar.services.emulator.front_end import GroundTruth, ScanData, Transmission
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.shared.protocol.messages import EmulatorCheckpoint

Watch = Callable[[str, int, int, Transmission], None]  # run, k, t, what is radiated


class WatchedFrontEnd:
    """A scan is a function of the run, the dwell, its clock and the waveform, whatever was transmitted before."""

    def __init__(self, checkpoint: EmulatorCheckpoint, watch: Watch) -> None:
        self._checkpoint, self._watch = checkpoint, watch
        self._truth: GroundTruth | None = None

    def transmit(self, k: int, t: int, waveform: Transmission) -> ScanData:
        """Transmit dwell k and measure."""
        self._watch(self._checkpoint.run, k, t, waveform)
        start = self._checkpoint
        scan, self._truth = simulated(start.world, start.radar, start.world_seed, k, t, waveform)
        return scan

    def truth(self) -> GroundTruth:
        """The truth of the dwell that was transmitted last."""
        if self._truth is None:
            raise ValueError("nothing was transmitted")
        return self._truth

    def close(self) -> None:
        """There is nothing to switch off."""


def simulated(
    world: dict[str, object] | None, radar: dict[str, object], seed: int, k: int, t: int, waveform: Transmission
) -> tuple[ScanData, GroundTruth]:
    """Scan and truth of a dwell."""
    scene = {"radar": radar, "seed": 0, "world": world, "world_seed": seed}
    settings = {"run": "r", "strategy": "orthogonal", "dwells": 1}
    front_end = SimulatedFrontEnd.open(EmulatorCheckpoint.model_validate(settings | scene | {"k": k, "t": t}))
    return front_end.transmit(k, t, waveform), front_end.truth()
