"""The simulated front end: echoes of a scene that is computed (`cogradar.shared.world.scene`), and its truth.

A scan is a function of the configuration, the seed and the waveform. So dwell k transmitted again, at any time and in
any process, gives the same scan.
"""

from contextlib import suppress
from typing import Self

import numpy as np

from cogradar.services.emulator.front_end import FrontEndError, GroundTruth, ScanData, Transmission
from cogradar.shared.protocol.messages import ABSENT, EmulatorCheckpoint
from cogradar.shared.scenario.plugins.kinds import SIGNAL
from cogradar.shared.scenario.plugins.names import PluginError
from cogradar.shared.scenario.plugins.resolver import load_for, resolve
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.scenario.world_config import WorldConfig
from cogradar.shared.signal.recording import RecordingError
from cogradar.shared.world.scene import Place, Scene


class SimulatedFrontEnd:
    """Targets that fly, and a receiver of their echoes."""

    def __init__(self, scene: Scene, k: int) -> None:
        """`scene` is as it was in dwell k-1."""
        self._scene = scene
        self._k = k  # next dwell
        self._likely: list[Place] = []  # where it will probably look: as in the last dwell, if those are few
        self._is_prepared = False

    @classmethod
    def open(cls, checkpoint: EmulatorCheckpoint) -> Self:
        """The world of a run at its checkpoint."""
        if checkpoint.world is None:
            raise FrontEndError("the scenario has no [world] to simulate, and this emulator has no other front end")
        world, radar = WorldConfig.model_validate(checkpoint.world), RadarConfig.model_validate(checkpoint.radar)
        try:
            load_for("emulator", checkpoint.radar, checkpoint.strategy, checkpoint.world)
            scene: Scene = resolve(SIGNAL, world.signal)(world, radar, checkpoint.world_seed, checkpoint.t)
        except PluginError as error:
            raise FrontEndError(f"world.disturbance.model: {error}") from None
        except RecordingError as error:  # on another machine, or changed since the run began
            raise FrontEndError(f"world.disturbance.recording: {error}") from None
        return cls(scene, checkpoint.k)

    def transmit(self, k: int, t: int, waveform: Transmission) -> ScanData:
        """Let the targets fly until t, and measure. They stand still during acquisition."""
        self._fly(t)
        try:
            measured = self._scene.observe(k, waveform.isotropic, waveform.factor, waveform.looks)
        except PluginError as error:
            raise FrontEndError(f"world.disturbance.model: {error}") from None
        self._k, self._is_prepared = k + 1, False
        self._likely = self._scene.drawn if waveform.isotropic == 0.0 else []
        return ScanData.of_looks(measured)

    def truth(self, t: int) -> GroundTruth:
        """The truth at clock t, of the last dwell, also if it was not transmitted."""
        self._fly(t)
        scene = self._scene
        present = scene.present
        return GroundTruth(
            np.where(present[:, np.newaxis], scene.states, 0.0),
            np.where(present, scene.target_bins, ABSENT).astype(np.int32),
            np.where(present, scene.snr_db, 0.0),
            np.where(present, scene.heights_km, 0.0),
        )

    def _fly(self, t: int) -> None:
        while self._scene.t < t:
            self._scene.move()
            self._is_prepared = False

    def prepare(self) -> bool:
        """Let the targets fly and draw the noise of the next dwell, once; results do not depend on it."""
        if self._scene.t == 0 or self._is_prepared:
            return False
        self._is_prepared = True
        with suppress(PluginError):  # what it draws next fails again, and is said then
            self._scene.prepare(self._k, self._likely)
        return True

    def close(self) -> None:
        """There is nothing to switch off."""
