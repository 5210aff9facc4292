"""The emulator's echoes: known magnitude, a phase of its own in each dwell."""

import numpy as np

from cogradar.services.emulator.core import EmulatorCore
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.protocol.messages import RunStart, Scan, Truth, Waveform
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.world_config import WorldEchoSection
from tests.services.loop import SMOKE, checkpoint

N_DWELL = 40
LOUD_DB = 140.0  # the disturbance then moves an estimated phase by 1e-3 rad at most


def test_the_phase_of_an_echo_is_drawn_anew_each_dwell() -> None:
    """Targets stand still while they are acquired, so that nothing but the phase changes from scan to scan."""
    world = SMOKE.simulated.model_copy(update={"echo": WorldEchoSection(amplitude_db=LOUD_DB)})
    scenario = SMOKE.model_copy(update={"world": world})
    core = EmulatorCore(SimulatedFrontEnd.open)
    scan, truth = core.handle(checkpoint(RunStart.of(scenario, Strategy.ORTHOGONAL, seed=3, dwells=1)))
    assert isinstance(truth, Truth)
    bins = truth.bins
    for k in range(N_DWELL):
        assert isinstance(scan, Scan)
        drawn = [generator(3, Purpose.PHASE, m, k).uniform(0.0, 2.0 * np.pi) for m in range(2)]
        turned = scan.alpha_hat[bins] * np.exp(-1j * np.array(drawn))
        assert np.all(np.abs(np.angle(turned)) < 1e-2)
        scan, _ = core.handle(_acquiring(scan.run, k))


def _acquiring(run: str, k: int) -> Waveform:
    """The acquisition goes on."""
    return Waveform(
        run=run,
        k=k,
        tracking=False,
        isotropic=SMOKE.radar.array.power,
        factor=np.zeros((SMOKE.radar.array.n_tx, 0), dtype=np.complex64),
        beams=np.full((2, 1), -1, dtype=np.int32),
        shares=np.zeros((2, 1)),
        status="acquisition",
        late=np.zeros(SMOKE.radar.announced, np.int32),
    )
