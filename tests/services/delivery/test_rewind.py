"""A run that is to be forgotten: nothing of it is left, also not what came before its first checkpoint."""

from collections.abc import Callable

import pytest

from cogradar.services.allocator.core import AllocatorCore
from cogradar.services.emulator.core import EmulatorCore
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.services.planner.core import PlannerCore
from cogradar.shared.protocol.events import Rewind
from cogradar.shared.protocol.messages import Message, Plan, Scan, Waveform
from cogradar.shared.wire.runner import Core
from tests.services.loop import checkpoint, play, smoke_start

START = smoke_start()
CORES: dict[type[Message], Callable[[], Core]] = {  # by what each waits for
    Plan: AllocatorCore,
    Scan: lambda: PlannerCore("p"),
    Waveform: lambda: EmulatorCore(SimulatedFrontEnd.open),
}


def _said(core: Core, *events: Message | Rewind) -> list[object]:
    return [answer for event in [*events, checkpoint(START)] for answer in core.handle(event)]


@pytest.mark.parametrize("kind", list(CORES), ids=lambda kind: kind.__name__)
def test_a_rewound_run_begins_as_one_of_which_nothing_was_heard(kind: type[Message]) -> None:
    early = [message for message in play(START) if isinstance(message, kind) and vars(message)["k"] == 0]
    fresh, heard, rewound = (_said(CORES[kind](), *events) for events in ((), early, [*early, Rewind(START.run)]))
    assert len(heard) > len(fresh)
    assert rewound == fresh
