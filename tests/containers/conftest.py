"""What the container tests share: the image, and the services up with three planners."""

import sys
from collections.abc import Iterator

import pytest

from tests.containers.engine import compose, engine_answers, left_over

PLANNERS = 3


@pytest.fixture(scope="session")
def image() -> None:
    """The image of this state of the sources."""
    if not engine_answers():
        pytest.fail("no Docker engine with Compose answers")  # who does not ask for these tests does not get them
    compose("build", "--quiet", "router", timeout_s=1200)


@pytest.fixture(scope="session")
def services(request: pytest.FixtureRequest) -> Iterator[None]:
    """All services healthy, three planners among them; nothing is left of them afterwards."""
    request.getfixturevalue("image")
    try:
        compose("up", "--detach", "--no-build", "--wait", "--scale", f"planner={PLANNERS}", timeout_s=300)
        yield
    finally:
        if request.session.testsfailed:
            sys.stderr.write(compose("logs", "--no-color", "--timestamps", "--tail", "40"))
        compose("down", "--volumes", "--remove-orphans", "--timeout", "5")
    assert not left_over()
