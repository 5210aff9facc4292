"""The angle bin of one position, and the distance of two directions, for kernels.

Apart from `cogradar.shared.signal.array`, which has the same for many states. Checks of scenarios and messages need the
grid, but not the compiler, whose import takes a quarter of a second.
"""

import numpy as np

from cogradar.shared.numerics.elementwise import hypot
from cogradar.shared.numerics.jit import inlined, kernel


@kernel
def bin_of(x: float, y: float, n_bin: int) -> int:
    """Angle bin of position (x, y) in km: `angle_bin(spatial_frequency(...))` for one state inside a kernel."""
    r = np.sqrt(x * x + y * y)
    if r == 0.0:
        return (n_bin - 1) // 2
    return int(np.floor((0.5 * y / r + 0.5) * (n_bin - 1) + 0.5))


@inlined
def from_line(x: float, z: float) -> float:
    """Distance from the array's line of a position at height z: `array.in_plane` for one, inside a kernel."""
    return float(hypot(x, z))


@inlined
def apart(nu: float, other: float) -> float:
    """Distance of two spatial frequencies on a circle: `array.apart` for one pair."""
    d = abs(nu - other)
    return min(d, 1.0 - d)
