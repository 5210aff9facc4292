"""Who is asked for what it sent answers once: with nothing left to read, or when it is asked again meanwhile."""

import pytest

from cogradar.services.delivery.resend import ResendBuffer
from cogradar.shared.protocol.messages import Checkpoint, Plan
from tests.services.loop import checkpoint, smoke_start

START = smoke_start(dwells=8)


def _plans(k: int) -> list[Plan]:
    return [Plan(run="r", k=k, t=0, target=m, status="searching") for m in (0, 1)]


def _request(k: int) -> Checkpoint:
    return checkpoint(START, k, resend=True)


@pytest.fixture
def kept() -> ResendBuffer:
    """A buffer with two dwells."""
    buffer = ResendBuffer(0)
    for k in (3, 4):
        buffer.add(k, _plans(k))
    return buffer


def test_who_has_read_all_answers_at_once_and_only_once(kept: ResendBuffer) -> None:
    kept.acknowledge(_request(4))
    assert kept.again(drained=True) == _plans(4)
    assert kept.again(drained=True) == []
    assert not kept.is_asked


def test_who_is_behind_answers_when_asked_again(kept: ResendBuffer) -> None:
    kept.acknowledge(_request(3))
    assert kept.again(drained=False) == []
    kept.acknowledge(_request(3))
    assert kept.again(drained=False) == [*_plans(3), *_plans(4)]


def test_requests_that_waited_together_are_one(kept: ResendBuffer) -> None:
    """After a long computation: what it made was sent when it read them."""
    kept.acknowledge(_request(3))
    kept.acknowledge(_request(3))
    assert kept.again(drained=False) == []
    assert kept.again(drained=True) == [*_plans(3), *_plans(4)]


def test_a_request_for_another_dwell_is_a_first_one(kept: ResendBuffer) -> None:
    kept.acknowledge(_request(3))
    assert kept.again(drained=False) == []
    kept.acknowledge(_request(4))
    assert kept.again(drained=False) == []
    kept.acknowledge(_request(4))
    assert kept.again(drained=False) == _plans(4)


def test_what_is_acknowledged_meanwhile_is_not_said_again(kept: ResendBuffer) -> None:
    kept.acknowledge(_request(3))
    kept.acknowledge(checkpoint(START, 4))
    assert kept.again(drained=True) == []


def test_a_repeated_checkpoint_takes_no_request_back(kept: ResendBuffer) -> None:
    kept.acknowledge(_request(4))
    kept.acknowledge(checkpoint(START, 4))
    assert kept.again(drained=True) == _plans(4)
