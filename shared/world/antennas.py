"""What the antennas of the world really are: gains and phases that the radar does not know, and dead elements."""

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.numerics.elementwise import power, times
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.scenario.radar_config import ArraySection
from cogradar.shared.scenario.world_config import WorldArraySection
from cogradar.shared.signal.waveform import Elements


def elements(section: WorldArraySection, array: ArraySection, seed: int) -> Elements | None:
    """Complex gains of the antennas of a seed; None if they are as the radar assumes.

    e_i = 10^((g_i + sigma_g z_i) / 20) exp(j (phi_i + sigma_phi z'_i)),   z, z' standard normal; 0 of a dead element

    g_i, phi_i: its row of `tx_errors` or `rx_errors`
    """
    given = section.tx_errors, section.rx_errors
    if not (section.gain_sigma_db or section.phase_sigma_deg or section.dead_tx or section.dead_rx or any(given)):
        return None
    sides = (array.n_tx, section.dead_tx), (array.n_rx, section.dead_rx)
    return Elements(
        *(times(_gains(section, n, dead, seed, i), _measured(given[i])) for i, (n, dead) in enumerate(sides))
    )


def _measured(errors: list[list[float]]) -> NDArray[np.complex128]:
    """Gains of rows [gain_db, phase_deg], (n,); of no rows 1, (1,)."""
    gain_db, phase_deg = np.array(errors or [[0.0, 0.0]]).T
    return np.asarray(power(10.0, gain_db / 20.0) * np.exp(1j * np.radians(phase_deg)))


def _gains(section: WorldArraySection, n: int, dead: list[int], seed: int, side: int) -> NDArray[np.complex128]:
    z = generator(seed, Purpose.ELEMENTS, side, 0).standard_normal((2, n))
    phases = np.radians(section.phase_sigma_deg) * z[1]
    gains: NDArray[np.complex128] = power(10.0, section.gain_sigma_db * z[0] / 20.0) * np.exp(1j * phases)
    gains[np.array(dead, dtype=np.int64) - 1] = 0.0
    return gains
