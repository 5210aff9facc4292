"""What is the same in every dwell of a run, and what a track is after one of them."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.scenario.radar_config import AcquisitionSection, BeliefSection, RadarConfig, Strategy
from cogradar.shared.signal.radar_equation import amplitude, amplitude_at_1_km
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.signal.response import Response, response_of
from cogradar.shared.tracking.belief.interface import Belief
from cogradar.shared.tracking.existence import Existence, existence_of
from cogradar.shared.tracking.motion import CERTAINLY_STRAIGHT, HARD, TURN, Motion, modes_after, modes_at_first
from cogradar.shared.tracking.sensor import Sensor

NONE = np.empty((0, 4))  # no particles


@dataclass(frozen=True)
class TrackerModel:
    """All constants of the tracker: sensor, motion, belief, initiation."""

    sensor: Sensor
    response: Response  # of a look
    motion: Motion
    belief: BeliefSection
    acquisition: AcquisitionSection
    n_track: int
    tests_every_cell: bool  # each dwell tests the whole grid for every track: the orthogonal strategy
    n_virtual: int  # n_tx n_rx, channels that an echo is integrated over
    gate_bins: int  # how far from where a track expects its target a detection may be
    seed: int  # of the radar's random numbers
    p_fa: float  # of a look, whatever the number of its range cells
    wide_looks: bool  # looks may find a target that has turned away
    is_mixture: bool  # of motions; else a target flies straight whatever it did before
    sigma_straight: float  # standard deviation of the acceleration in straight flight, km/s^2
    existence: Existence
    radar: RadarConfig  # of all this, for filters of a user's own

    @property
    def hears_others(self) -> bool:
        """Whether a track meets echoes of others in bins of its own choice, and amplitudes tell them apart."""
        chooses_cells = self.wide_looks and not self.tests_every_cell
        return self.response.is_box and chooses_cells and self.sensor.law.tells_range

    @classmethod
    def of(cls, radar: RadarConfig, strategy: Strategy, seed: int) -> Self:
        """Model of the tracks of a run."""
        return cls(
            Sensor(
                radar.array.n_bin,
                radar.echo.amplitude_db,
                threshold(radar.detector.p_fa),
                radar.belief.filter not in {"published", "gaussian"},
                radar.assumes.rcs,
            ),
            response_of(
                radar.receiver.cells,
                radar.array.n_bin,
                radar.array.n_tx,
                radar.array.n_rx,
                radar.receiver.range_cell_km,
            ),
            Motion(radar.motion.dt_s, radar.motion.sigma_s_km_s2),
            radar.belief,
            radar.acquisition,
            radar.announced,
            strategy is Strategy.ORTHOGONAL,
            radar.array.n_tx * radar.array.n_rx,
            radar.planner.widen_bins,
            seed,
            radar.detector.p_fa,
            radar.planner.wide_looks,
            radar.motion.modes == "mixture",
            radar.motion.sigma_straight_km_s2 if radar.motion.modes == "mixture" else radar.motion.sigma_s_km_s2,
            existence_of(radar),
            radar,
        )._of(modes_at_first())

    def of_echo(self, echo: float) -> Self:
        """The model of a track that knows this of its target's echoes."""
        return self if echo == self.sensor.echo else replace(self, sensor=self.sensor._replace(echo=echo))

    def of_modes(self, modes: NDArray[np.float64]) -> Self:
        """The model of the next dwell of a track whose target moved in these modes, (3,)."""
        return self._of(modes_after(modes, self.motion.dt))

    def _of(self, modes: NDArray[np.float64]) -> Self:
        if not self.is_mixture:
            return self
        return replace(self, motion=self.motion._replace(turning=float(modes[TURN]), hard=float(modes[HARD])))

    @property
    def modes(self) -> NDArray[np.float64]:
        """Probabilities of the modes of the next dwell before its observation, (3,)."""
        turning, hard = self.motion.turning, self.motion.hard
        return np.array([1.0 - turning - hard, turning, hard])

    @property
    def least_echo(self) -> float:
        """|alpha|^2 at the end of the prior of range, of the RCS that is assumed: where nothing else is known."""
        return _least_echo(self.sensor.amplitude_db, self.acquisition.range_max_km)


@lru_cache(maxsize=16)
def _least_echo(amplitude_db: float, range_max_km: float) -> float:
    return float(amplitude(amplitude_at_1_km(amplitude_db), np.array(range_max_km**2))) ** 2


class TrackState(NamedTuple):
    """All that a track is after dwell k. From `remembered` on what it begins again from (`recovery`)."""

    target: int  # track number, 0 .. M-1
    k: int
    belief: Belief  # where the target is
    detected: bool  # dwell k had a detection of this track
    depleted: bool  # the observation of dwell k had to be explained by a recovery
    sigma_hat: float  # of the last detection
    in_beam: bool  # the last detection was in a beam: not the acquisition's, nor the orthogonal strategy's
    level: float  # S = sigma_hat^2 ||v||^2 of the last detection: the disturbance level, whatever the waveform
    power: float  # ||v||^2 of the last look
    echo: float  # mean |alpha|^2, learned from its looks; 0 if something is assumed of the RCS
    remembered: NDArray[np.float64]  # (n, 4) belief right after the last detection; (0, 4): the belief itself
    hit_bin: int  # of the last detection; -1: too long ago to say where the target is now
    hit_amplitude: float  # its |alpha_hat| / sigma_hat
    measured: NDArray[np.float64]  # (4,) of its look the direction; direction, sigma and range measured, 0: unknown
    looked: NDArray[np.float64]  # (n_miss, width) looks of each dwell since, by `Response.row_of`
    log_evidence: float  # log prod P(miss | belief) since the detection, or since the track began again
    attempts: int  # times it began again since the detection
    # (3,) probabilities of `motion.MODES` in dwell k
    modes: NDArray[np.float64] = CERTAINLY_STRAIGHT
    # Of a track whose target was not announced (`existence`).
    existence: float = 1.0  # probability that there is a target
    confirmed: bool = True
    in_doubt: bool = False  # dwell k does not say which detection is this track's and which another's

    @property
    def n_missed(self) -> int:
        """Dwells since the last detection, as far as they are remembered."""
        return int(self.looked.shape[0])
