"""A detection that says that its target has turned: where a belief may be that knows a wrong velocity.

Nearly constant velocity is the motion model. A target that turns leaves it by the speed of a few dwells' acceleration,
and as long as looks are wide it is detected all the same: beside its belief, or in range beside it. Until the belief
follows it is wrong about the velocity, and the position follows from that.
"""

import numpy as np
from numpy.typing import NDArray

from shared.tracking.model import TrackerModel

IMPROBABLE = 0.05  # of a detection under the belief: only then is another velocity thought of
FAR_LIKELIER = 10.0  # ... and believed if it explains the detection by so much better: aircraft seldom turn hard


def doubted(model: TrackerModel, predicted: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Particles, (n, 4), every second of which has flown the last dwell at a velocity drawn anew, as at acquisition."""
    v_max, particles = model.acquisition.v_max_km_s, predicted.copy()
    turned = particles[::2]
    velocities = rng.uniform(-v_max, v_max, (turned.shape[0], 2))
    turned[:, 0::2] += model.motion.dt * (velocities - turned[:, 1::2])
    turned[:, 1::2] = velocities
    np.maximum(turned[:, 0], 0.0, out=turned[:, 0])
    return particles
