"""Questions over HTTP: the rows that metrics has, in pages; and every fault as a problem document."""

import asyncio
import re
import sqlite3
import threading
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import pytest
from anyio.to_thread import current_default_thread_limiter

from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.metrics.processes import Gathered
from cogradar.services.web import run_answers
from cogradar.services.web.app import ROUTES, create
from cogradar.services.web.run_answers import SCORED
from cogradar.shared.protocol.events import Tick
from tests.services.web.conftest import DWELLS, FAST_S, ask

RUNS = "/api/v1/runs"


@pytest.mark.parametrize("metric", ["runs", *SCORED])
def test_rows_are_those_of_metrics(web: httpx.Client, core: MetricsCore, metric: str) -> None:
    asked = {} if metric in {"runs", "picture", "confirmation", "commands"} else {"target": "2", "dwells": "3:6"}
    asked = {"dwells": "3:6"} if metric == "antennas" else asked
    for run in ("whole", "all"):
        path = RUNS if metric == "runs" else f"{RUNS}/{run}/{metric}"
        found = web.get(path, params=asked)
        assert found.status_code == 200
        expected = answer(core.store, metric, asked if metric == "runs" else asked | {"run": run})
        total = {"total": len(expected)} if metric == "runs" else {}
        assert found.json() == {"rows": expected, "next": None} | total
        assert bool(expected) == (metric not in {"confirmation", "commands"})  # of an unknown number; none was given


def test_a_run_is_its_row(web: httpx.Client, core: MetricsCore) -> None:
    (row,) = answer(core.store, "runs", {"run": "begun"})
    assert web.get(f"{RUNS}/begun").json() == row
    assert row["status"] == "running"


def test_pages_of_runs_say_how_many_there_are(web: httpx.Client) -> None:
    total = web.get(RUNS).json()["total"]
    assert total == 6
    newest = web.get(RUNS, params={"limit": 1, "offset": total - 1}).json()
    assert ([row["run"] for row in newest["rows"]], newest["next"], newest["total"]) == (["begun"], None, total)
    assert web.get(RUNS, params={"run": "whole", "offset": 7}).json() == {"rows": [], "next": None, "total": 1}


def test_pages_follow_each_other_to_the_last_row(web: httpx.Client, core: MetricsCore) -> None:
    path: str | None = f"{RUNS}/whole/tracks?limit=5&target=1"
    found_rows: list[dict[str, Any]] = []
    while path is not None:
        found = web.get(path)
        link = re.fullmatch(r'<(.+)>; rel="next"', found.headers.get("link", ""))
        path = found.json()["next"]
        assert (link[1] if link else None) == path
        found_rows += found.json()["rows"]
    assert found_rows == answer(core.store, "tracks", {"run": "whole", "target": "1"})
    assert len(found_rows) == DWELLS


def test_answers_about_a_finished_run_are_conditional(web: httpx.Client) -> None:
    for path in (f"{RUNS}/whole", f"{RUNS}/whole/p_d", f"{RUNS}/whole/tracks?limit=3", f"{RUNS}/whole/beampattern"):
        tag = web.get(path).headers["etag"]
        assert web.get(path, headers={"If-None-Match": f'"x", W/{tag}'}).status_code == 304
        assert web.get(path, headers={"If-None-Match": '"x"'}).status_code == 200
    assert web.get(f"{RUNS}/whole/p_d?target=1").headers["etag"] != web.get(f"{RUNS}/whole/p_d").headers["etag"]
    for path in (f"{RUNS}/begun/p_d", f"{RUNS}/begun/beampattern", f"{RUNS}/all/p_d", RUNS):
        assert "etag" not in web.get(path).headers
    for path, status in (("whole", 200), ("nobody", 404), ("whole/p_d?target=3", 404), ("whole/beampattern", 200)):
        assert web.get(f"{RUNS}/{path}", headers={"If-None-Match": "*"}).status_code == status


def test_another_program_answers_under_another_tag(web: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    tag = web.get(f"{RUNS}/whole/p_d").headers["etag"]
    monkeypatch.setattr("cogradar.services.web.run_answers._ROOMS", ("services/metrics",))
    run_answers._answered_by.cache_clear()
    assert web.get(f"{RUNS}/whole/p_d", headers={"If-None-Match": tag}).headers["etag"] != tag
    monkeypatch.undo()
    run_answers._answered_by.cache_clear()
    assert web.get(f"{RUNS}/whole/p_d").headers["etag"] == tag


@pytest.mark.parametrize(
    ("path", "status", "words"),
    [
        ("/page/nothing.js", 404, "nothing.js"),
        ("/page/static.py", 404, "static.py"),
        ("/page/..%2Fstatic.py", 404, ""),
        ("/page/.js", 400, "name"),
        ("/page/index.html?v=1", 400, "v"),
        (f"{RUNS}/", 404, "no such address; /api/v1/runs has all runs, /api/v1/openapi.json describes every address"),
        ("/api/v1", 404, "/api/v1/openapi.json describes every address"),
        (f"{RUNS}/nobody", 404, "nobody"),
        (f"{RUNS}/nobody/p_d", 404, "no such run"),
        (f"{RUNS}/nobody/beampattern", 404, "nobody"),
        (f"{RUNS}/nobody/events", 404, "no such run"),
        (f"{RUNS}/whole/speed", 404, ""),
        (f"{RUNS}/whole/p_d?target=3", 404, "2 targets"),
        (f"{RUNS}/all", 400, "one run"),
        (f"{RUNS}/whole/p_d?dwells=5:3", 400, "the first must not be after the last"),
        (f"{RUNS}/blind/p_d", 404, "no truth"),
        (f"{RUNS}/whole/beampattern?dwell=9", 404, f"no dwell 9, there are 1 to {DWELLS}"),
        (f"{RUNS}/all/beampattern", 400, "of one run"),
        (f"{RUNS}/all/events", 400, "of one run"),
        (f"{RUNS}/-x/p_d", 400, "run = '-x': must be 1 to 64 letters, digits, '.', '_' and '-', the first a letter or"),
        (f"{RUNS}/whole/p_d?target=0", 400, "target"),
        (f"{RUNS}/whole/p_d?target=1.0", 400, "target = '1.0': must be an integer >= 1 and <= 4096"),
        (f"{RUNS}/whole/p_d?dwells=a", 400, "dwells = 'a': must be a:b, first and last dwell, either may be empty"),
        (f"{RUNS}/whole/p_d?strategy=best", 400, "'best': must be one of orthogonal, uniform, power-aware"),
        (f"{RUNS}/whole/p_d?colour=red", 400, "colour"),
        (f"{RUNS}/whole/p_d?run=other", 400, "run"),
        (f"{RUNS}/whole?target=1", 400, "target"),
        (f"{RUNS}/whole/picture?dwells=1:2", 400, "dwells"),
        (f"{RUNS}?target=1", 400, "target"),
        (f"{RUNS}?limit=1001", 400, "limit"),
        (f"{RUNS}?limit=1&limit=2", 400, "twice"),
        (f"{RUNS}/whole/events?last_event_id=x", 400, "last_event_id"),
        (f"{RUNS}?scenario={'x' * 3000}", 414, "2048"),
    ],
)
def test_faults_are_problem_documents(web: httpx.Client, path: str, status: int, words: str) -> None:
    found = web.get(path)
    document = found.json()
    assert (found.status_code, found.headers["content-type"]) == (status, "application/problem+json")
    assert (document["status"], document["type"]) == (status, "about:blank")
    assert words in document["detail"]
    assert "Traceback" not in found.text


def test_what_is_no_get_is_refused(web: httpx.Client) -> None:
    for method in ("POST", "PUT", "DELETE", "OPTIONS"):
        found = web.request(method, RUNS)
        assert (found.status_code, found.json()["status"]) == (405, 405)
        assert "GET" in found.headers["allow"]
    assert web.head(f"{RUNS}/whole/events").status_code == 200


def test_a_fault_of_ours_is_no_traceback(core: MetricsCore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cogradar.services.web.run_answers.answer", lambda *_: 1 // 0)
    found = ask(create(core, None, FAST_S), RUNS)
    assert (found.status_code, found.headers["content-type"]) == (500, "application/problem+json")
    assert "Zero" not in found.text


def test_only_this_machines_names_are_served(web: httpx.Client, core: MetricsCore) -> None:
    for host in ("localhost", "localhost:8080", "LOCALHOST:1", "127.0.0.1", "[::1]:8080"):
        assert web.get("/healthz", headers={"Host": host}).status_code == 200
    for host in ("evil.example", "localhost.evil.example:8080", "127.0.0.1.evil.example"):
        found = web.get("/healthz", headers={"Host": host, "Origin": f"http://{host}"})
        assert (found.status_code, found.json()["status"]) == (421, 421)
        assert not [name for name in found.headers if name.startswith("access-control")]
    assert ask(create(core, None, FAST_S), "/healthz", Host="radar.example").status_code == 200


def test_ready_is_who_has_a_journal_and_follows_it(journal: Path, tmp_path: Path) -> None:
    core = MetricsCore(str(tmp_path / "later.db"))
    app = create(core, None, FAST_S)
    assert ask(app, "/healthz").json() == {"status": "ok"}
    core.handle(Tick(time.monotonic()))
    assert "no journal" in ask(app, "/readyz").json()["detail"]
    assert (ask(app, "/metrics").status_code, ask(app, "/metrics").json()["detail"]) == (
        503,
        "not connected to a router",
    )
    (tmp_path / "later.db").write_bytes(journal.read_bytes())
    core.handle(Tick(time.monotonic() - 60.0))
    assert "router" in ask(app, "/readyz").json()["detail"]
    core.handle(Tick(time.monotonic()))
    assert ask(app, "/readyz").json() == {"status": "ok"}
    core.close()


def test_a_beampattern_is_highest_where_the_tracks_look(web: httpx.Client) -> None:
    found = web.get(f"{RUNS}/whole/beampattern", params={"dwell": 4}).json()
    assert found["t"] == 4
    assert len(found["nu"]) == len(found["angle_deg"]) == len(found["power_db"])
    assert found["angle_deg"][0] == pytest.approx(-90.0)
    top = max(found["power_db"])
    peak = found["nu"][found["power_db"].index(top)]
    strongest = max(found["beams"], key=lambda beam: beam["power_db"])
    assert peak == pytest.approx(strongest["nu"], abs=0.02)
    assert top == pytest.approx(strongest["power_db"], abs=0.5)
    assert [one["antenna"] for one in found["antennas"]] == list(range(1, 17))
    assert sum(one["power"] for one in found["antennas"]) == pytest.approx(1.0)
    assert all(0.0 <= one["papr_db"] < 12.1 for one in found["antennas"])
    assert web.get(f"{RUNS}/whole/beampattern").json()["t"] == DWELLS
    assert web.get(f"{RUNS}/blind/beampattern").status_code == 200


def test_metrics_are_text_for_prometheus(web: httpx.Client) -> None:
    found = web.get("/metrics")
    assert found.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"
    assert 'cogradar_runs{process="metrics-0",role="metrics",status="complete"}' in found.text


def test_many_scrapes_are_one_and_take_no_thread_from_answers(journal: Path) -> None:
    """All threads for answers are taken here."""
    scrapes, others_answered = list[float](), threading.Event()

    def gather() -> Gathered:
        scrapes.append(time.monotonic())
        others_answered.wait(10.0)  # a process that does not answer
        return Gathered({}, {("planner", "deaf")})

    async def get() -> list[httpx.Response]:
        current_default_thread_limiter().total_tokens = 1
        async with current_default_thread_limiter(), asyncio.timeout(20.0):
            transport = httpx.ASGITransport(app, raise_app_exceptions=False)
            async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
                five = [asyncio.ensure_future(client.get("/metrics")) for _ in range(5)]
                paths = ["/healthz", "/readyz", "/api/v1/openapi.json", "/nothing"]
                others = await asyncio.gather(*map(client.get, paths))
                others_answered.set()
                return [*await asyncio.gather(*five), *others, await client.get("/metrics")]

    of_journal = MetricsCore(str(journal))
    of_journal.gather = gather
    app = create(of_journal, None, FAST_S)
    found = asyncio.run(get())
    of_journal.close()
    assert [answered.status_code for answered in found] == [200] * 5 + [200, 503, 200, 404, 200]
    assert len(scrapes) == 2  # one for five, and one after it


def test_a_run_that_retention_has_dropped_has_no_beampattern(journal: Path, tmp_path: Path) -> None:
    path = tmp_path / "runs.db"
    path.write_bytes(journal.read_bytes())
    core = MetricsCore(str(path))
    app = create(core, None, FAST_S)
    assert ask(app, f"{RUNS}/whole/beampattern").status_code == 200
    with closing(sqlite3.connect(path)) as theirs:
        theirs.execute("DELETE FROM run WHERE run = 'whole'")
        theirs.commit()
    assert ask(app, f"{RUNS}/whole/beampattern?dwell=1").status_code == 404  # what was asked a moment ago is kept
    core.close()


def test_the_description_names_every_address(web: httpx.Client) -> None:
    paths = web.get("/api/v1/openapi.json").json()["paths"]
    assert set(paths) == {route.path for route in ROUTES}
