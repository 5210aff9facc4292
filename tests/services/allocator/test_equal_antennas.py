"""What the allocator sends with equal antennas, whatever tracks ask for."""

import numpy as np
import pytest

import cogradar
from cogradar.shared.scenario.radar_config import Strategy

SMALL = ("radar.allocation.antennas=equal", "radar.belief.n_particle=200", "radar.planner.n_sim=100")


@pytest.mark.parametrize(
    "settings",
    [(), ("radar.fidelity=best",), ("radar.fidelity=best", "radar.tracks=unknown")],
    ids=["max-min", "joint looks", "unknown number"],
)
@pytest.mark.parametrize("strategy", list(Strategy))
def test_every_dwell_has_the_same_power_in_each_antenna(settings: tuple[str, ...], strategy: Strategy) -> None:
    scenario = cogradar.load("smoke", [*SMALL, *settings])
    result = cogradar.run(scenario, strategy=strategy, dwells=4)
    array = scenario.radar.array
    stored = ~np.isnan(result.isotropic)  # what was sent before the first waveform is not
    assert stored.sum() >= 3
    np.testing.assert_allclose(result.antenna_powers[stored], array.power / array.n_tx, rtol=1e-6)
    assert (result.papr_db[stored] >= -1e-6).all()


def test_with_the_published_limit_antennas_differ() -> None:
    result = cogradar.run(cogradar.load("smoke", SMALL[1:]), dwells=4)
    assert result.antenna_powers.max() > 1.01 * result.antenna_powers.min()
