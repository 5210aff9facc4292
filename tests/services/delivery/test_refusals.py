"""Valid messages that make no sense in their run: each core refuses them and goes on as if they had not come."""

from collections.abc import Callable

import numpy as np
import pytest

from cogradar.services.allocator.core import AllocatorCore
from cogradar.services.emulator.core import EmulatorCore
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.services.planner.core import PlannerCore
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.journal import Journal
from cogradar.shared.protocol.messages import Message, Plan, Refused, Scan, Truth, Waveform
from cogradar.shared.protocol.topics import Role
from cogradar.shared.wire.bus import LocalNetwork
from cogradar.shared.wire.runner import Core, step
from tests.samples import asked
from tests.services.loop import SMOKE, smoke_begin, smoke_start


def _waveform(**changes: object) -> Waveform:
    fields: dict[str, object] = {
        "run": "r",
        "k": 0,
        "tracking": True,
        "isotropic": 0.0,
        "factor": np.full((SMOKE.radar.array.n_tx, 1), 0.25, dtype=np.complex64),
        "beams": np.array([[3], [9]], dtype=np.int32),
        "shares": np.array([[0.5], [0.5]]),
        "status": "optimal",
        "late": np.zeros(2, dtype=np.int32),
    }
    return Waveform.model_validate(fields | changes)


def _scan(bins: list[int], beams: list[int], t: int = 1) -> Scan:
    column = np.ones(len(bins))
    return Scan(
        run="r",
        k=0,
        t=t,
        bins=np.array(bins, dtype=np.int32),
        statistic=column,
        alpha_hat=column.astype(np.complex64),
        sigma_hat=column,
        signature_power=column,
        beams=np.array(beams, dtype=np.int32)[:, np.newaxis],
    )


def _plan(target: int, bin_: int) -> Plan:
    return Plan(run="r", k=0, t=1, target=target, status="tracking", **asked(bin_), range_km=50.0)


DARK = np.array([[-1], [-1]], dtype=np.int32)
EMULATOR, ALLOCATOR = (lambda: EmulatorCore(SimulatedFrontEnd.open)), AllocatorCore
BAD: list[tuple[Callable[[], Core], Message]] = [
    (EMULATOR, _waveform(factor=np.zeros((5, 1), dtype=np.complex64))),
    (EMULATOR, _waveform(beams=np.array([[3]], np.int32), shares=np.array([[1.0]]), late=np.zeros(1, np.int32))),
    (EMULATOR, _waveform(beams=np.array([[3], [16]], dtype=np.int32))),
    (EMULATOR, _waveform(factor=np.ones((SMOKE.radar.array.n_tx, 1), dtype=np.complex64))),  # 16 times the power
    (EMULATOR, _waveform(tracking=False, beams=DARK, shares=np.zeros((2, 1)))),  # lights up no cell
    (ALLOCATOR, _plan(2, 3)),
    (ALLOCATOR, _plan(0, 16)),
    (lambda: PlannerCore("p"), _scan([3], [3])),
    (lambda: PlannerCore("p"), _scan([3, 16], [3, 16])),
    (lambda: PlannerCore("p"), _scan([3, 4], [-1, -1])),
    (lambda: PlannerCore("p"), _scan([3, 4], [-1, -1], t=0)),
    (lambda: RecorderCore(Journal(":memory:")), _plan(2, 3)),
    (lambda: RecorderCore(Journal(":memory:")), _scan([3], [3])),
    (
        lambda: RecorderCore(Journal(":memory:")),
        Truth(
            run="r",
            k=0,
            t=0,
            states=np.ones((1, 4)),
            heights_km=np.zeros(1),
            bins=np.array([3], dtype=np.int32),
            snr_db=np.ones(1),
            waveform_k=-1,
        ),
    ),
]


def test_the_recorder_refuses_a_message_that_differs_from_the_first() -> None:
    """Two owners of a track say the same; if they do not, the first counts and the difference is reported."""
    core = RecorderCore(Journal(":memory:"))
    core.handle(smoke_start())
    core.handle(_plan(0, 3))
    assert core.handle(_plan(0, 3)) == ()
    with pytest.raises(Refused, match="plan of dwell 0 differs"):
        core.handle(_plan(0, 4))


@pytest.mark.parametrize(("make", "message"), BAD)
def test_a_core_refuses_and_goes_on(make: Callable[[], Core], message: Message) -> None:
    core = make()
    core.handle(smoke_start() if isinstance(core, RecorderCore) else smoke_begin())
    with pytest.raises(Refused):
        core.handle(message)


def test_the_runner_drops_and_counts_what_a_core_refuses(caplog: pytest.LogCaptureFixture) -> None:
    network = LocalNetwork()
    bus, other = network.endpoint(Role.ALLOCATOR, "a"), network.endpoint(Role.PLANNER, "p")
    core = AllocatorCore()
    core.handle(smoke_begin())
    for _ in range(3):
        other.publish(_plan(0, 16))
        assert step(core, bus, 0.0)
    assert bus.inbox.bad == {"cogradar/10/local/run/r/plan/0-15": 3}
    assert [record.levelname for record in caplog.records] == ["WARNING"]
