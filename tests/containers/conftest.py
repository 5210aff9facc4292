"""What the container tests share: the image, and the services up with three planners."""

import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, NamedTuple

import pytest

from tests.containers.engine import cli, compose, engine_answers, left_over, wait_for

PLANNERS = 3


class FirstUp(NamedTuple):
    """What the first `docker compose up` came to."""

    answer_s: float  # until `query p_d --target 2` had something to tell,
    answer: list[dict[str, Any]]


@pytest.fixture(scope="session")
def image(request: pytest.FixtureRequest) -> Iterator[None]:
    """The image of this state of the sources; nothing is left of its containers afterwards."""
    if not engine_answers():
        pytest.fail("no Docker engine with Compose answers")  # who does not ask for these tests does not get them
    compose("build", "--quiet", "router")
    try:
        yield
    finally:
        if request.session.testsfailed:
            sys.stderr.write(compose("logs", "--no-color", "--timestamps", "--tail", "40"))
        compose("down", "--volumes", "--remove-orphans", "--timeout", "5")
    assert not left_over()


@pytest.fixture(scope="session")
def services(request: pytest.FixtureRequest) -> FirstUp:
    """All services healthy, three planners among them, the operator idle."""
    request.getfixturevalue("image")
    return _first_up()


def _first_up() -> FirstUp:
    """Bring everything up as a new user does, ask until there is an answer, then let the operator idle."""
    began = time.monotonic()
    scaled = ("up", "--detach", "--no-build", "--scale", f"planner={PLANNERS}")
    compose(*scaled, COGRADAR_SCENARIO="paper")
    answer = wait_for("an answer", _answer)
    answer_s = time.monotonic() - began
    compose(*scaled, "--wait", COGRADAR_SCENARIO="")
    return FirstUp(answer_s, answer)


def _answer() -> list[dict[str, Any]]:
    """What a new user's question is answered; nothing while metrics is not up or no target is tracked yet."""
    with suppress(AssertionError):
        answer: list[dict[str, Any]] = cli("query", "p_d", "--target", "2")
        return answer
    return []
