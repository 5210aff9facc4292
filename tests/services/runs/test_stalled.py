"""A run that stands still ends with what it waits for, and with the planners that are there to bring it."""

from types import SimpleNamespace
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


def test_a_run_that_went_on_is_left_alone_while_metrics_is_away(monkeypatch: pytest.MonkeyPatch) -> None:
    """A command that watched a run cancelled it when metrics was away for a minute."""
    row = {"status": "running", "waiting_for": "", "confirmed": None, "reason": "", "fault": None, "t": 1}
    answers: list[list[dict[str, Any]]] = [[row | {"k": 1}], [], *([[]] * 12), [row | {"k": 2}], [row | {"k": 2}]]
    told, asked = list[str](), iter(answers)

    def query(_: object, __: object, metric: str, ___: object) -> list[dict[str, Any]]:
        if metric == "runs" and (rows := next(asked)):
            return rows
        raise NoAnswer

    clock = iter(range(0, 10_000, 2))
    monkeypatch.setattr(cluster, "_query", query)
    monkeypatch.setattr(cluster, "time", SimpleNamespace(monotonic=lambda: float(next(clock)), sleep=_nothing))
    with pytest.raises(StopIteration):
        cluster._play(
            "tcp/x:1", cast("Any", None), cast("Any", _Bus(1)), smoke_start(), _nothing, _nothing, told.append
        )
    assert [text for text in told if "metrics" in text] == [
        "metrics does not answer: how far the run is will be seen once it does"
    ]
