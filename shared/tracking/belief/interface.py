"""What all but the filter itself needs of a belief: planning, existence of a target, what a plan says of it."""

from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.tracking.motion import covariance_of_state, expected_states, mean_state

if TYPE_CHECKING:
    from cogradar.shared.tracking.model import TrackerModel

Floats = NDArray[np.float64]


class Belief(Protocol):
    """p(s) of the target of one track, s = [x, vx, y, vy] in km and km/s."""

    @property
    def rows(self) -> Floats:
        """The belief as numbers, one row for each of its parts: what a snapshot carries."""

    def sample(self) -> Floats:
        """Equally probable states that stand for it, (n, 4)."""

    def moments(self) -> tuple[Floats, Floats]:
        """Mean, (4,), and covariance, (4, 4)."""

    def expected(self, model: "TrackerModel", modes: Floats) -> Floats:
        """Equally probable states one dwell later, without noise but with turns, (n, 4).

        modes : (3,) probabilities of the track's modes of motion now
        """


class Particles(NamedTuple):
    """An unweighted particle filter's belief: its particles are its sample."""

    states: Floats  # (n, 4)

    @property
    def rows(self) -> Floats:
        """All particles."""
        return self.states

    def sample(self) -> Floats:
        """All particles."""
        return self.states

    def moments(self) -> tuple[Floats, Floats]:
        """Of the particles."""
        mean = mean_state(self.states)
        return mean, covariance_of_state(self.states, mean)

    def expected(self, model: "TrackerModel", modes: Floats) -> Floats:
        """Each particle in a mode that it is dealt."""
        return expected_states(self.states, model.of_modes(modes).motion)
