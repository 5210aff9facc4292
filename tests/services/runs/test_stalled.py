"""A run that stands still ends with what it waits for, and with the planners that are there to bring it."""

from typing import Any, cast

import pytest

from cogradar.services.errors import RunFailed
from cogradar.services.runs import cluster
from cogradar.shared.protocol.topics import Role
from cogradar.shared.wire.queries import Alive, NoAnswer
from tests.services.loop import smoke_start


def _nothing(*_: object) -> None:
    """Nobody stops it, reads it or is told."""


class _Bus:
    def __init__(self, n_planner: int) -> None:
        self._names = [f"p{i}" for i in range(n_planner)]

    def publish(self, *_: object) -> None:
        """Nobody hears it."""

    def alive(self) -> Alive:
        return Alive("", {Role.PLANNER: self._names} if self._names else {}, [])


@pytest.mark.parametrize(("n", "said"), [(0, "none"), (2, "p0, p1"), (200, "p0, p1, p2, p3, p4 and 195 more")])
def test_it_names_the_planners(n: int, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object) -> object:
        raise NoAnswer

    monkeypatch.setattr(cluster, "STALL_S", 0.0)
    monkeypatch.setattr(cluster, "_query", never)
    with pytest.raises(RunFailed, match=f"know the run; planners that are there: {said}$"):
        cluster._play("tcp/x:1", cast("Any", None), cast("Any", _Bus(n)), smoke_start(), _nothing, _nothing, _nothing)
