"""The bus over a real router: what it declares, and what readers that come late get."""

import time

import pytest

from shared.protocol.messages import Message, RunStart
from shared.protocol.topics import Role
from shared.wire.keys import LEFT_ALONE
from shared.wire.session import open_session
from shared.wire.zenoh_bus import ZenohBus
from tests.samples import sample

pytestmark = pytest.mark.zenoh


def _bus(endpoint: str, role: Role, name: str) -> ZenohBus:
    return ZenohBus(open_session([endpoint], 10.0, lambda: None), role, name)


def _heard(bus: ZenohBus, n: int) -> list[Message]:
    heard: list[Message] = []
    deadline = time.monotonic() + 10.0
    while len(heard) < n and time.monotonic() < deadline:
        event = bus.receive(0.1)
        if isinstance(event, Message):
            heard.append(event)
    return heard


def test_many_runs_one_after_the_other_declare_no_more_keys(router: str) -> None:
    """The transport never frees a key; and yet every message arrives, and a reader that is late gets the last ones."""
    starts = [sample(RunStart, run=f"r{i}") for i in range(10 * LEFT_ALONE)]
    operator, reader = _bus(router, Role.OPERATOR, "o"), _bus(router, Role.METRICS, "m")
    late: ZenohBus | None = None
    try:
        for start in starts:
            operator.publish(start)
            operator.forget(start.run)
        assert _heard(reader, len(starts)) == starts
        assert len(operator._publishers) == LEFT_ALONE + 1
        late = _bus(router, Role.METRICS, "late")
        # The last start of each lane, and no run that was over long ago: metrics would begin it once more.
        assert set(_heard(late, LEFT_ALONE + 1)) == set(starts[-LEFT_ALONE - 1 :])
        assert late.receive(0.5) is None
        assert late.inbox.bad.total() == 0
    finally:
        for bus in (operator, reader, late):
            if bus is not None:
                bus.close()


def test_runs_at_the_same_time_have_keys_of_their_own(router: str) -> None:
    operator = _bus(router, Role.OPERATOR, "o")
    try:
        for i in range(6):
            operator.publish(sample(RunStart, run=f"r{i}"))
        assert sorted(operator._publishers) == [f"cogradar/lane/{i}/start" for i in range(6)]
    finally:
        operator.close()
