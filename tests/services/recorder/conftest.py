"""A run that a recorder hears of, and what it acknowledges of it."""

from collections.abc import Iterable

import pytest

from cogradar.services.recorder.core import RecorderCore
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Checkpoint, EmulatorCheckpoint, Message
from tests.services.loop import play, smoke_start

Acknowledged = tuple[int, int, bool]  # dwell, scan, whether the run has ended


@pytest.fixture(scope="module")
def sent() -> list[Message]:
    return play(smoke_start(dwells=20))


def acknowledged(core: RecorderCore, messages: Iterable[Message | Tick]) -> list[Acknowledged]:
    answers = [answer for message in messages for answer in core.handle(message)]
    return [(a.k, a.t, a.ended) for a in answers if isinstance(a, Checkpoint) and not isinstance(a, EmulatorCheckpoint)]
