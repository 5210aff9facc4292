"""What is measured with: beliefs, echoes and requests for power, of any number of targets."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.jit import kernel
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.power.rules import Requests
from cogradar.shared.signal.array import angle_bin, bin_centres, spatial_frequency, steering_vector
from cogradar.shared.signal.radar_equation import amplitude
from cogradar.shared.signal.response import FAR_KM, LobeResponse
from cogradar.shared.signal.scan import Detections
from cogradar.shared.tracking.belief.likelihood import Looks
from cogradar.shared.tracking.sensor import Sensor
from cogradar.shared.world.disturbance import draw
from cogradar.shared.world.scene import add_echo

Floats = NDArray[np.float64]

SEED = 1
# The belief that all work on: target 2 near its start, R = 60.47 km; mean and standard deviation.
CENTRE, SPREAD = np.array([60.0, 0.2, 7.5, 0.1]), np.array([0.5, 0.1, 0.5, 0.1])  # km, km/s
SIGMA_HAT = 3333.0**-0.5  # its echo with a third of the power: ||v||^2 = 10^4 / 3
LOBE = LobeResponse(100, 100, 100, np.inf)
RANGE_LOBE = LobeResponse(100, 100, 100, 0.15)


def particles(n: int) -> Floats:
    """Particles of target 2, (n, 4)."""
    rng = generator(SEED, Purpose.INITIATION, 0, 0)
    return np.asarray(CENTRE + SPREAD * rng.standard_normal((n, 4)))


def crowd(n: int) -> Detections:
    """A scan of n tracks as they are found: many compete, directly or through others, for what was detected."""
    rng = generator(SEED, Purpose.INITIATION, 0, 1)
    nus, ranges_km = rng.uniform(-0.43, 0.43, n), rng.uniform(40.0, 80.0, n)
    sigmas = np.full(n, 2e-3), np.full(n, 0.4)
    order = np.argsort(nus)
    columns: dict[str, Any] = {"statistic": 200.0, "limits": 18.4, "sigma_hat": 0.1, "signature_power": 100.0}
    columns = {name: np.full(n, value) for name, value in columns.items()}
    return Detections(
        k=1,
        bins=angle_bin(nus[order], 100).astype(np.int32),
        alpha_hat=np.ones(n, np.complex64),
        nus=nus[order],
        nu_hats=nus[order] + 5e-4 * rng.standard_normal(n),
        nu_sigmas=np.full(n, 5e-4),
        ranges_km=ranges_km[order] + 0.1,
        beams=angle_bin(nus, 100).astype(np.int32)[:, np.newaxis],
        beam_nus=nus[:, np.newaxis],
        gates=ranges_km[:, np.newaxis] + np.array([-2.0, 2.0]),
        ids=np.arange(n, dtype=np.int32),
        expected=np.column_stack((nus, sigmas[0], ranges_km, sigmas[1], np.full(n, 0.9))),
        **columns,
    )


def expected_amplitude(sensor: Sensor) -> float:
    """r of a detection with the amplitude that the middle of the belief has."""
    return float(amplitude(sensor.amplitude / SIGMA_HAT, CENTRE[0] ** 2 + CENTRE[2] ** 2))


def looks(sensor: Sensor, *, is_hit: bool) -> Looks:
    """A look at the middle of the belief and one a cell beside it: the first has the detection, or both have none."""
    nu, sigma = float(spatial_frequency(CENTRE)), np.full(2, SIGMA_HAT)
    found = (0, expected_amplitude(sensor), nu + 5e-4, 1e-3) if is_hit else (-1, 0.0, 0.0, 0.0)
    return Looks(LOBE, *found, 0.0, np.array([nu, nu + 0.01]), sigma, sensor.threshold, 0.0, FAR_KM)


def echo(nu: float, alpha: complex, i: int) -> NDArray[np.complex128]:
    """What a cell receives of a target in a direction under the i-th disturbance, orthogonal waveform; (10^4,)."""
    y = draw("ar6-t", 100 * 100, generator(SEED, Purpose.DISTURBANCE, 56, i))
    add_echo(y, alpha, steering_vector(nu, 100) / 10.0, steering_vector(nu, 100))
    return y


def allocation_problem(n_target: int, i: int) -> tuple[Floats, Floats]:
    """Spatial frequencies and weights 1/R^4 of the i-th problem: distinct bins of 100, ranges of 10 to 100 km."""
    rng = generator(SEED, Purpose.INITIATION, n_target, i)
    nus = bin_centres(100)[np.sort(rng.choice(100, n_target, replace=False))]
    return nus, rng.uniform(10.0, 100.0, n_target) ** -4.0


def joint_problem(n_target: int, i: int) -> tuple[Floats, Floats]:
    """Chances and gains of the i-th problem: three cells for each target, ranges of 40 to 100 km, no cell too dear."""
    rng = generator(SEED, Purpose.INITIATION, n_target, i)
    chances = rng.dirichlet((4.0, 1.0, 0.5), n_target)
    gains = 2e10 * n_target / 3.0 * rng.uniform(40.0, 100.0, n_target) ** -4.0
    return chances.ravel(), np.repeat(gains, 3)


def requests(n_target: int, i: int, surplus: float = 1.0) -> Requests:
    """What tracks ask for in the i-th problem: cells and gains as in `joint_problem`, one track in ten astray.

    surplus : of power, over `joint_problem`
    """
    nus, _ = allocation_problem(n_target, i)
    chances, gains = (column.reshape(n_target, 3) for column in joint_problem(n_target, i))
    rng = generator(SEED, Purpose.SEARCH, n_target, i)
    cells = np.clip(nus[:, np.newaxis] + np.array([0.0, 1.0, -1.0]) / 99.0, -0.5, 0.5)
    worths, reaches, astray = rng.random(n_target), rng.integers(1, 10, n_target), rng.random(n_target) < 0.1
    far = np.full(n_target, 60.0)
    return Requests(cells, chances, far, surplus * gains[:, 0], worths, reaches, astray, k=i)


@kernel
def reference_loop(n: int) -> float:
    """What a core does in a search, without one: n steps of integer mixing, a logarithm, a root, a table look-up."""
    table = np.zeros(1 << 12)
    state, total = 88172645463325252, 0.0
    for _ in range(n):
        state ^= (state << 13) & 0x7FFFFFFFFFFFFFFF
        state ^= state >> 7
        state ^= (state << 17) & 0x7FFFFFFFFFFFFFFF
        slot = state & 4095
        table[slot] += np.sqrt(np.log(2.0 + (state & 1023)))
        total += table[slot]
    return total
