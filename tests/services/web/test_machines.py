"""The machine room: what a window of counts says, and who owns what when a planner is gone."""

import json
import math
import time
from bisect import bisect_left
from types import SimpleNamespace

import numpy as np
import pytest

from cogradar.services.metrics.core import MetricsCore
from cogradar.services.metrics.processes import Gathered, read
from cogradar.services.planner.ownership import owners
from cogradar.services.web.app import create
from cogradar.services.web.views.processes import Machines, quantile
from cogradar.shared.protocol.topics import Role
from cogradar.shared.wire.exposition import Exposition
from cogradar.shared.wire.meter import EDGES_S, Durations, Measures
from tests.services.web.conftest import FAST_S, ask


def test_a_quantile_is_within_its_bucket() -> None:
    seconds = np.random.default_rng(1).lognormal(-4.0, 1.0, 2000)
    edges = [*EDGES_S, math.inf]
    counts = np.bincount([bisect_left(EDGES_S, value) for value in seconds], minlength=len(edges))
    buckets = list(zip(edges, np.cumsum(counts).astype(float).tolist(), strict=True))
    for share in (0.01, 0.5, 0.99):
        exact, found = 1e3 * float(np.quantile(seconds, share)), quantile(buckets, share)
        assert found == pytest.approx(exact, rel=0.25)
    assert quantile([(0.1, 0.0), (math.inf, 0.0)], 0.5) is None
    assert quantile([(0.1, 0.0), (math.inf, 3.0)], 0.5) == pytest.approx(100.0)
    assert quantile([], 0.5) is None


class _Process:
    """Counts as a planner does."""

    def __init__(self) -> None:
        self.scans, self.handled = 0, Durations()

    def measures(self) -> Measures:
        return {
            "messages_received": {"scan": self.scans},
            "messages_sent": {"plan": self.scans},
            "handling_seconds": {"scan": self.handled},
        }

    def work(self, scans: int, seconds: float) -> None:
        self.scans += scans
        for _ in range(scans):
            self.handled.observe(seconds)


def test_rates_and_times_are_those_of_the_last_seconds(core: MetricsCore, monkeypatch: pytest.MonkeyPatch) -> None:
    planner, router = _Process(), _Process()
    alive = {(Role.PLANNER, "a"): planner, (Role.PLANNER, "b"): _Process(), (Role.ROUTER, "router"): router}
    now = [1000.0]
    monkeypatch.setattr(
        "cogradar.services.web.views.processes.time", SimpleNamespace(monotonic=lambda: now[0], time=lambda: now[0])
    )
    monkeypatch.setattr(
        core,
        "gather",
        lambda: Gathered({process: read(Exposition(one.measures).text()) for process, one in alive.items()}, set()),
    )
    machines = Machines(core)
    new = json.loads(Machines(core)._read())
    assert {row["name"] for row in new["processes"] if row["starting"]} == set(new["owners"]["begun"].values())
    planner.work(500, 2.0)
    first = json.loads(machines._read())
    assert (first["window_s"], first["processes"][1]["dwells_per_s"]) == (None, None)
    assert first["processes"][1]["handling_p50_ms"] == pytest.approx(2000.0, rel=0.5)
    for _ in range(20):
        now[0] += 1.0
        planner.work(10, 0.003)
        found = json.loads(machines._read())
    assert found["window_s"] == pytest.approx(10.0)
    (router_row, a, b) = found["processes"]
    assert (a["dwells_per_s"], a["handling_of"]) == (pytest.approx(10.0), "scan")
    assert 2.0 <= a["handling_p50_ms"] <= a["handling_p99_ms"] <= 5.0
    assert [row["starting"] for row in (router_row, a, b)] == [False, False, "b" in found["owners"]["begun"].values()]
    assert a["began_utc_s"] is not None
    assert found["utc_s"] == now[0]
    assert (b["dwells_per_s"], b["handling_p50_ms"], b["late"]) == (0.0, None, None)
    assert found["owners"] == {"begun": _numbered(owners("begun", 2, ["a", "b"]))}
    del alive[Role.PLANNER, "b"]
    kept = json.loads(machines._read())["owners"]
    now[0] += 4.0
    assert kept == found["owners"]  # a planner whose token is back within three seconds never left
    assert json.loads(machines._read())["owners"] == {"begun": _numbered(["a", "a"])}


def test_a_process_that_is_too_busy_to_answer_is_there_and_is_gone_once_its_token_is(
    core: MetricsCore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At a high load an answer may take longer than two seconds, and a token may be missed for a moment."""
    now = [1000.0]
    monkeypatch.setattr(
        "cogradar.services.web.views.processes.time", SimpleNamespace(monotonic=lambda: now[0], time=lambda: now[0])
    )
    answer = read(Exposition(_Process().measures).text())
    router, busy = (Role.ROUTER, "router"), (Role.ALLOCATOR, "busy")
    gathered = [Gathered({router: answer, busy: answer}, set())]
    monkeypatch.setattr(core, "gather", lambda: gathered[0])
    machines = Machines(core)

    def shown() -> dict[str, tuple[bool, bool, float | None]]:
        now[0] += 0.3
        rows = json.loads(machines._read())["processes"]
        return {row["name"]: (row["alive"], row["answers"], row["dwells_per_s"]) for row in rows}

    up = shown()
    assert (up["router"], up["busy"]) == ((True, True, None), (True, True, None))
    gathered[0] = Gathered({router: answer}, {busy})
    assert shown()["busy"] == (True, False, None)
    gathered[0] = Gathered({router: answer}, {(Role.ALLOCATOR, "")})  # neither an answer nor a token
    assert shown()["busy"] == (True, False, None)
    gathered[0] = Gathered({}, {(role, "") for role in Role})  # it was this process that heard nothing
    now[0] += 1.0
    assert shown()["busy"] == (True, False, None)
    gathered[0] = Gathered({router: answer}, {(Role.ALLOCATOR, "")})
    now[0] += 4.0
    gone = shown()
    assert "busy" not in gone
    assert gone[""] == (False, False, None)


def test_a_process_that_is_gone_for_long_is_gone_also_where_no_router_answers(
    core: MetricsCore, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [1000.0]
    monkeypatch.setattr(
        "cogradar.services.web.views.processes.time", SimpleNamespace(monotonic=lambda: now[0], time=lambda: now[0])
    )
    gathered = [Gathered({(Role.ALLOCATOR, "once"): read(Exposition(_Process().measures).text())}, set())]
    monkeypatch.setattr(core, "gather", lambda: gathered[0])
    machines = Machines(core)
    names = []
    for at_s in (0.0, 1.0, 30.0, 62.0):
        now[0] = 1000.0 + at_s
        names.append({row["name"] for row in json.loads(machines._read())["processes"]} - {""})
        gathered[0] = Gathered({}, {(Role.ALLOCATOR, "")})
    assert names == [{"once"}, {"once"}, {"once"}, set()]


def _numbered(names: list[str]) -> dict[str, str]:
    """By track."""
    return {str(track): name for track, name in enumerate(names, 1)}


def test_without_a_router_there_is_no_machine_room(core: MetricsCore, monkeypatch: pytest.MonkeyPatch) -> None:
    assert ask(create(core, None, FAST_S), "/api/v1/processes").status_code == 200
    monkeypatch.setattr(core, "gather", None)
    found = ask(create(core, None, FAST_S), "/api/v1/processes")
    assert (found.status_code, "router" in found.json()["detail"]) == (503, True)


def test_who_asks_within_a_second_shares_the_answer(core: MetricsCore, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = list[float]()

    def gather() -> Gathered:
        asked.append(time.monotonic())
        return Gathered({}, set())

    monkeypatch.setattr(core, "gather", gather)
    app = create(core, None, FAST_S)
    for _ in range(5):
        assert ask(app, "/api/v1/processes").json()["processes"] == []
    assert len(asked) == 1
