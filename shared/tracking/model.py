"""What is the same in every dwell of a run, and what a track is after one of them."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from shared.scenario.limits import LOOKS_ROW
from shared.scenario.radar_config import AcquisitionSection, BeliefSection, RadarConfig, Strategy
from shared.signal.radar_equation import amplitude, amplitude_at_1_km
from shared.signal.receiver import threshold
from shared.tracking.motion import Motion
from shared.tracking.sensor import Sensor
from shared.tracking.steered.looks import Aperture

NONE = np.empty((0, 4))  # no particles


@dataclass(frozen=True)
class TrackerModel:
    """All constants of the tracker: sensor, motion, belief, initiation."""

    sensor: Sensor
    motion: Motion
    belief: BeliefSection
    acquisition: AcquisitionSection
    n_track: int
    tests_every_cell: bool  # each dwell tests the whole grid for every track: the orthogonal strategy
    n_virtual: int  # n_tx n_rx, channels that an echo is integrated over
    gate_bins: int  # how far from where a track expects its target a detection may be
    seed: int  # of the radar's random numbers
    p_fa: float  # of a look, whatever the number of its range cells
    wide_looks: bool = False  # looks may find a target that has turned away
    aperture: Aperture | None = None  # what steered cells are read by; None: cells are bins

    @property
    def width_of_looked(self) -> int:
        """Numbers by which a track remembers the cells of a dwell."""
        return self.sensor.n_bin if self.aperture is None else LOOKS_ROW

    @classmethod
    def of(cls, radar: RadarConfig, strategy: Strategy, seed: int) -> Self:
        """Model of the tracks of a run."""
        return cls(
            Sensor(
                radar.array.n_bin,
                radar.echo.amplitude_db,
                threshold(radar.detector.p_fa),
                radar.belief.amplitude == "exact",
                radar.assumes.rcs,
            ),
            Motion(radar.motion.dt_s, radar.motion.sigma_s_km_s2),
            radar.belief,
            radar.acquisition,
            radar.tracks,
            strategy is Strategy.ORTHOGONAL,
            radar.array.n_tx * radar.array.n_rx,
            radar.planner.widen_bins,
            seed,
            radar.detector.p_fa,
            radar.planner.wide_looks,
            Aperture(radar.array.n_tx, radar.array.n_rx, radar.receiver.range_cell_km)
            if radar.receiver.cells == "steered"
            else None,
        )

    def of_echo(self, echo: float) -> Self:
        """The model of a track that knows this of its target's echoes."""
        return self if self.sensor.law.tells_range else replace(self, sensor=self.sensor._replace(echo=echo))

    @property
    def least_echo(self) -> float:
        """|alpha|^2 at the end of the prior of range, of the RCS that is assumed: where nothing else is known."""
        at_1_km = amplitude_at_1_km(self.sensor.amplitude_db)
        return float(amplitude(at_1_km, np.array(self.acquisition.range_max_km**2))) ** 2


@dataclass(frozen=True, eq=False)
class TrackState:
    """All that a track is after dwell k. The last seven are what it remembers to begin again from (`recovery`)."""

    target: int  # track number, 0 .. M-1
    k: int
    particles: NDArray[np.float64]  # (n, 4) km, km/s
    detected: bool  # dwell k had a detection of this track
    depleted: bool  # the observation of dwell k had to be explained by a recovery
    sigma_hat: float  # of the last detection
    in_beam: bool  # the last detection was in a beam: not the acquisition's, nor the orthogonal strategy's
    level: float  # S = sigma_hat^2 ||v||^2 of the last detection: the disturbance level, whatever the waveform
    power: float  # ||v||^2 of the last look
    echo: float  # mean |alpha|^2, learned from its looks; 0 if something is assumed of the RCS
    remembered: NDArray[np.float64]  # (n, 4) belief right after the last detection; (0, 4): `particles` itself
    hit_bin: int  # of the last detection; -1: too long ago to say where the target is now
    hit_amplitude: float  # its |alpha_hat| / sigma_hat
    measured: NDArray[np.float64]  # (4,) its direction looked at, direction, sigma and range measured; 0: not steered
    looked: NDArray[np.float64]  # (n_miss, n_bin) sigma of the cells looked at in each dwell since, 0 elsewhere; or the
    # looks themselves, if they were steered, (n_miss, LOOKS_ROW) of `steered.looks.row_of`
    log_evidence: float  # log prod P(miss | belief) since the detection, or since the track began again
    attempts: int  # times it began again since the detection
