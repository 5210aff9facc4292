"""What an observer hears through a router that asks for certificates."""

import time

from cogradar.shared.protocol.messages import Checkpoint, Message, Plan, Truth, Waveform
from cogradar.shared.protocol.topics import Role
from cogradar.shared.wire.zenoh_bus import Listener, ZenohBus
from tests.samples import sample
from tests.services.certs.conftest import Secured


def test_an_observer_hears_the_loop_and_not_the_truth(secured: Secured) -> None:
    with secured.session("observer") as session:
        listener = Listener(session, (Checkpoint, Plan, Waveform, Truth))
        buses = [
            ZenohBus(secured.session(role), role, f"{role}-feed", reads=False)
            for role in (Role.EMULATOR, Role.PLANNER, Role.ALLOCATOR, Role.RECORDER)
        ]
        said = (sample(Truth), sample(Plan), sample(Waveform), sample(Checkpoint))
        heard, deadline = list[Message](), time.monotonic() + 10.0
        while {type(message) for message in heard} < {Checkpoint, Plan, Waveform} and time.monotonic() < deadline:
            for bus, message in zip(buses, said, strict=True):
                bus.publish(message)
            heard += listener.receive(0.1)
        for bus in buses:
            bus.close()
        listener.close()
    assert {type(message) for message in heard} == {Checkpoint, Plan, Waveform}
    assert all(message in said for message in heard)
