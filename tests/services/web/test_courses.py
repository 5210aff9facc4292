"""Courses of targets and of whole runs: what is thinned or summed is what the rows say."""

import asyncio
import random
import tracemalloc
from collections.abc import Iterator
from typing import Any

import httpx
import numpy as np
import pytest
from anyio.to_thread import current_default_thread_limiter

from cogradar.services.metrics import queries
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.metrics.store import in_memory
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.tables import Recording
from cogradar.services.runs import in_process
from cogradar.services.web.app import THREADS, create
from cogradar.services.web.views import course, timeline
from cogradar.services.web.views.radar import facts
from cogradar.shared.protocol.messages import RunStart, Scan
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scoring.bounds import range_bound, range_information
from cogradar.shared.scoring.errors import wilson_interval
from cogradar.shared.signal.array import bin_centres
from cogradar.shared.world.disturbance import power_spectrum
from tests.services.loop import scans
from tests.services.scored import pictures as pictured
from tests.services.scored import scores as scored
from tests.services.web.conftest import DWELLS, FAST_S, LATE, ask
from tests.services.web.test_views import get

T, GAP, SCANS = 1234, 700, 9  # dwells, of which one is missing, as in real time


@pytest.fixture(scope="module")
def made_up(tmp_path_factory: pytest.TempPathFactory) -> Iterator[MetricsCore]:
    """A store with a finished run that nobody played: its scores are drawn."""
    path, paper, rng = tmp_path_factory.mktemp("long") / "runs.db", load("paper"), random.Random(1)  # noqa: S311 - a test's own numbers
    journal, start = Journal(str(path)), RunStart.of(paper, Strategy.UNIFORM, 1, T)
    journal.add_run(start.model_copy(update={"run": "long"}))
    journal.acknowledge("long", T + SCANS, T, 0)
    (row,) = journal.read("SELECT * FROM run")
    bins = {m: 20 * m for m in range(1, paper.radar.announced + 1)}
    outages = {
        (m, t): max(t % 30 - 9, 0) if m == 1 else max(t % (9 * m) - 5 * m, 0) for m in bins for t in range(1, T + 1)
    }
    scores = [
        (
            *("long", t + SCANS - 1, t, m, m, bins[m], rng.choices([bins[m], bins[m] + 1], [3, 2 + m])[0]),
            *(rng.random() < 0.8, rng.gauss(-14.0, 2.0)),
            *(30.0 + 10 * m, 0.0, 5.0, 0.0, 0.0, rng.gauss(30.0 + 10 * m, 0.1), 0.0, rng.gauss(5.0, 0.1), 0.0),
            *(rng.random(), 100.0, rng.random() < 0.1, t % 7 == 0),
            *(True, bins[m], outages[m, t], *(5 * [None]), "[[20,0.5]]"),
        )
        for t in range(1, T + 1)
        for m in bins
        if t != GAP
    ]
    pictures = [
        ("long", t + SCANS - 1, t, None, 3, *(13 * [None]), 0, None, 3, 0, 0, t + SCANS - 2, 0)
        for t in range(1, T + 1)
        if t != GAP
    ]
    journal.write("DELETE FROM run")
    complete = row | {"status": "complete", "digest": "0"}
    journal.add_recording(Recording(complete, scored(scores), pictured(pictures), []), 1)
    journal.close()
    core = MetricsCore(str(path))
    yield core
    core.close()


def rows_of(core: MetricsCore, target: int) -> list[dict[str, Any]]:
    return answer(core.store, "tracks", {"run": "long", "target": str(target)})


def asked(core: MetricsCore, path: str) -> dict[str, Any]:
    found = ask(create(core, None, FAST_S), f"/api/v1/runs/long/{path}")
    assert found.status_code == 200, found.text
    document: dict[str, Any] = found.json()
    return document


def test_a_course_is_that_of_the_rows_thinned(made_up: MetricsCore) -> None:
    found, rows = asked(made_up, "course?target=2"), rows_of(made_up, 2)
    assert found["every"] == 3
    assert (found["t"][-1], len(found["t"]) <= course.MAX_POINTS) == (T, True)
    by_t = {row["t"]: row for row in rows}
    assert found["t"] == [t for t in range(T % 3, T + 1, 3) if t in by_t]
    for name in ("share", "snr_db"):
        assert found[name] == [by_t[t][name] for t in found["t"]]
    for name in ("detected", "late", "stale"):
        assert found[name] == [bool(by_t[t][name]) for t in found["t"]]
    at = [by_t[t] for t in found["t"]]
    assert found["error_km"] == pytest.approx([np.hypot(r["x"] - r["x_hat"], r["y"] - r["y_hat"]) for r in at])
    assert set(found["statistic"]) == {None}  # its scans are not stored


def test_detections_are_counted_over_all_dwells_so_far(made_up: MetricsCore) -> None:
    rows = rows_of(made_up, 3)
    for dwells in ("", "&dwells=650:720", "&dwells=:40"):
        found = asked(made_up, f"course?target=3{dwells}")
        for i, t in enumerate(found["t"]):
            so_far = [row["detected"] for row in rows if row["t"] <= t]
            ends = wilson_interval(sum(so_far), len(so_far))
            assert found["p_d"][i] == pytest.approx(sum(so_far) / len(so_far))
            assert (found["p_d_low"][i], found["p_d_high"][i]) == pytest.approx(ends)
    assert GAP not in asked(made_up, "course?target=3&dwells=650:720")["t"]


def test_the_floor_is_the_bound_of_this_run(made_up: MetricsCore) -> None:
    paper, found = load("paper"), asked(made_up, "course?target=1&dwells=1:400")
    rows = {row["t"]: row for row in rows_of(made_up, 1)}
    spectrum = power_spectrum(paper.simulated.disturbance.model, bin_centres(paper.radar.array.n_bin))[20]
    u = [np.sqrt(10.0 ** (rows[t]["snr_db"] / 10.0) / spectrum * 100.0) for t in range(1, 401)]
    range_km, array, motion = np.hypot(40.0, 5.0), paper.radar.array, paper.radar.motion
    isotropic = np.sqrt(10.0 ** (rows[1]["snr_db"] / 10.0) / spectrum * array.n_rx * array.power)
    initial = SCANS * float(range_information(range_km, isotropic))
    of_prior, wider = (
        range_bound(
            range_information(range_km, u),
            initial,
            width * paper.radar.acquisition.v_max_km_s / np.sqrt(3.0),
            motion.dt_s,
            paper.simulated.motion.sigma_s_km_s2,
        ).position_km
        for width in (1.0, 10.0)
    )
    first = int(np.argmax(of_prior > course.SETTLED * wider))
    assert found["t"] == list(range(1, 401))
    assert found["floor_km"][:first] == [None] * first
    assert found["floor_km"][first:] == pytest.approx(of_prior[first:].tolist(), rel=1e-4)
    assert 0 < first < 100


def test_a_course_grows_with_its_run_and_begins_anew_with_another_journal(made_up: MetricsCore) -> None:
    app = create(made_up, None, FAST_S)
    pieces = [ask(app, f"/api/v1/runs/long/course?target=1&dwells=1:{last}").json() for last in (5, 90, 400)]
    for piece in pieces[:2]:
        assert piece["floor_km"] == pieces[2]["floor_km"][: len(piece["t"])]
        assert piece["p_d"] == pieces[2]["p_d"][: len(piece["t"])]
    courses: course.Courses = app.state.courses
    known = facts(made_up.store, "long")
    other = MetricsCore(made_up._path)
    before = courses.of(made_up.store, known, 1, 10)
    assert courses.of(made_up.store, known, 1, 20) is before
    early = known._replace(row=known.row | {"acknowledged_t": 5})  # of who asked before the others, and came later
    assert courses.of(made_up.store, early, 1, 5) is before
    assert courses.of(other.store, known, 1, 10) is not before
    other.close()
    made_up.store.forgotten["long"] += 1  # as when its journal was restored from an older state
    assert courses.of(made_up.store, known, 1, 10) is not before


def test_courses_under_way_hold_no_other_answer_up(made_up: MetricsCore) -> None:
    app = create(made_up, None, FAST_S)
    courses: course.Courses = app.state.courses
    held = [courses.of(made_up.store, facts(made_up.store, "long"), m, 10) for m in (1, 2)]

    async def get() -> tuple[list[httpx.Response], list[bool], list[httpx.Response]]:
        current_default_thread_limiter().total_tokens = THREADS
        transport = httpx.ASGITransport(app, raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost/api/v1/runs/long") as client:
            paths = [f"/course?target={m}&dwells=1:{last}" for last in range(300, 300 + THREADS) for m in (1, 2)]
            courses = [asyncio.ensure_future(client.get(path)) for path in paths]
            try:
                await asyncio.sleep(0.2)
                async with asyncio.timeout(20.0):
                    others = [await client.get(path) for path in ("/radar", "/timeline", "/dwells", "/summary", "/p_d")]
                are_over = [answer.done() for answer in courses]
            finally:
                for one in held:
                    one.lock.release()
            return others, are_over, await asyncio.gather(*courses)

    for one in held:
        one.lock.acquire()
    others, are_over, answered = asyncio.run(get())
    assert not any(are_over)
    assert {answer.status_code for answer in others + answered} == {200}


def test_what_is_kept_of_courses_is_bounded(made_up: MetricsCore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(course, "KEPT_DWELLS", 250)
    courses, known = course.Courses(), facts(made_up.store, "long")
    first = courses.of(made_up.store, known, 1, 100)
    courses.of(made_up.store, known, 2, 100)
    assert courses.of(made_up.store, known, 1, 50) is first
    courses.of(made_up.store, known, 3, 100)
    assert courses.of(made_up.store, known, 1, 50) is first
    courses.of(made_up.store, known, 2, 200)
    assert courses.of(made_up.store, known, 1, 50) is not first


def test_the_statistic_is_that_of_the_targets_cell(web: httpx.Client, sent: list[Any]) -> None:
    by_t: dict[int, Scan] = {scan.t: scan for scan in scans(sent)}
    dwells = {dwell["t"]: dwell for dwell in get(web, "whole/dwells", dwells=":")["dwells"]}
    for target in (1, 2):
        found = get(web, "whole/course", target=target)
        assert found["t"] == list(range(1, DWELLS + 1))
        assert found["statistic"] == [dwells[t]["targets"][target - 1]["statistic"] for t in found["t"]]
        assert found["threshold"] == [dwells[t]["threshold"] for t in found["t"]]
    assert {value for dwell in by_t.values() for value in dwell.statistic.tolist()} >= set(found["statistic"]) - {None}


def test_a_course_without_truth_has_what_is_known(web: httpx.Client) -> None:
    found = get(web, "blind/course", target=1)
    for name in ("p_d", "p_d_low", "error_km", "floor_km", "snr_db"):
        assert set(found[name]) == {None}
    assert [t for t, is_stale in zip(found["t"], found["stale"], strict=True) if is_stale] == [LATE]
    assert None not in found["statistic"]
    assert get(web, "whole/course", target=1, dwells="9:")["t"] == []
    assert {found[name] for name in course.OF_TRACK} == {None}
    for asked_for in ("", "?dwells=1:2", "?target=1&track=1", "?track=1"):  # it was told of its targets
        assert web.get(f"/api/v1/runs/whole/course{asked_for}").status_code == 404
    assert web.get("/api/v1/runs/whole/course?target=3").status_code == 404


@pytest.mark.parametrize("most", [timeline.MAX_ROWS, 0])
def test_buckets_add_up_to_the_run(made_up: MetricsCore, monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    monkeypatch.setattr(timeline, "MAX_ROWS", most)
    found = asked(made_up, "timeline")
    assert found["width"] == (3 if most else 32)
    assert len(found["first"]) <= timeline.MAX_BUCKETS
    assert (found["first"][0], found["last"][-1]) == (1, T)
    by_target = {m: {row["t"]: row for row in rows_of(made_up, m)} for m in (1, 2, 3)}
    for i, (first, last) in enumerate(zip(found["first"], found["last"], strict=True)):
        rows = {m: [of[t] for t in range(first, last + 1) if t in of] for m, of in by_target.items()}
        every = [row for of in rows.values() for row in of]
        assert found["detected"][i] == pytest.approx(np.mean([row["detected"] for row in every]))
        assert found["late"][i] == sum(row["late"] for row in every)
        assert found["stale"][i] == sum(row["stale"] for row in rows[1])
        errors = [
            np.sqrt(np.mean([(r["x"] - r["x_hat"]) ** 2 + (r["y"] - r["y_hat"]) ** 2 for r in of]))
            for of in rows.values()
        ]
        assert found["error_km"][i] == pytest.approx(max(errors))
        is_by_last = bool(most) or last == T
        if is_by_last:
            rows = {m: [of[t] for t in range(1, last + 1) if t in of] for m, of in by_target.items()}
        if is_by_last:
            is_lost = [of[-1]["outage"] >= min(20, last) for of in rows.values()]
        else:
            is_lost = [2 * sum(row["outage"] > 0 for row in of) > len(of) for of in rows.values()]
        assert found["lost"][i] == sum(is_lost)
    assert max(found["lost"]) > 0


def test_a_target_is_lost_in_a_dwell_as_in_the_summary_up_to_it(made_up: MetricsCore) -> None:
    by_target = {m: {row["t"]: row["outage"] for row in rows_of(made_up, m)} for m in (1, 2, 3)}
    every = asked(made_up, "dwells?dwells=1:60")["dwells"] + asked(made_up, "dwells?dwells=690:730")["dwells"]
    assert [dwell["t"] for dwell in every] == [*range(1, 61), *(t for t in range(690, 731) if t != GAP)]
    seen = set()
    for dwell in every:
        is_lost = [target["lost"] for target in dwell["targets"]]
        assert is_lost == [of[dwell["t"]] >= min(20, dwell["t"]) for of in by_target.values()]
        seen |= set(is_lost)
    assert seen == {True, False}
    for t in (5, 700 + 19, T):
        (dwell,) = asked(made_up, f"dwells?dwells={t}:{t}")["dwells"]
        summary = answer(made_up.store, "summary", {"run": "long", "dwells": f":{t}"})
        assert [target["lost"] for target in dwell["targets"]] == [row["lost"] for row in summary]


def test_a_timeline_without_truth_or_dwells(web: httpx.Client) -> None:
    found = get(web, "blind/timeline")
    assert (found["t"], set(found["lost"]), set(found["error_km"])) == (DWELLS, {None}, {None})
    assert found["first"] == found["last"] == list(range(1, DWELLS + 1))


def test_an_answer_over_many_dwells_holds_the_messages_of_a_few() -> None:
    core = MetricsCore(":memory:")
    core.store = in_memory()
    start = RunStart.of(load("traffic"), Strategy.POWER_AWARE, 1, 4 * queries.PIECE)
    in_process.play(start, store=core.store)
    waveforms = queries.messages(core.store, start.run, "waveform", range(start.dwells))
    of_all = sum(one["factor"].nbytes for one in waveforms.values())
    app, run = create(core, None, FAST_S), f"/api/v1/runs/{start.run}"
    for path in ("course?track=1", "antennas"):
        ask(app, f"{run}/{path}{'&' if '?' in path else '?'}dwells=1:2")  # imports
        tracemalloc.start()
        found = ask(app, f"{run}/{path}")
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert (found.status_code, peak < of_all) == (200, True), path
