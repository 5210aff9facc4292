"""Tracks of an unknown number, as the page asks for them: they begin, are confirmed, and end."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cogradar.services.metrics.core import MetricsCore
from cogradar.services.metrics.processes import Gathered
from cogradar.services.planner.ownership import owner_of
from cogradar.services.web.app import create
from cogradar.services.web.views import course, particles, schemas
from cogradar.services.web.views.processes import Machines
from cogradar.services.web.views.radar import facts
from cogradar.services.web.views.tracks import track_of
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Message, Plan, RunStart, Truth
from cogradar.shared.protocol.topics import Role
from cogradar.shared.scenario.limits import MIXTURE_STATES
from cogradar.shared.signal.array import spatial_frequency
from tests.services.births import FAR, HERE, THERE, UNKNOWN, plan, roster, scan, start_of, waveform
from tests.services.loop import play
from tests.services.web.conftest import FAST_S, ask, record
from tests.services.web.unknown_run import DWELLS, LATE, late, sent

PLAYED = 10  # dwells


@pytest.fixture(scope="module")
def played() -> list[Message]:
    return play(start_of(PLAYED))


@pytest.fixture(scope="module")
def store(played: list[Message], tmp_path_factory: pytest.TempPathFactory) -> Iterator[MetricsCore]:
    """Runs: by-hand, blind (without truth, and late), played (by the cores), begun (not over)."""
    path: Path = tmp_path_factory.mktemp("unknown") / "runs.db"
    said, start = sent(), start_of(DWELLS)
    blind = start.model_copy(update={"scenario": start.scenario | {"world": None}})
    record(
        path,
        {
            "by-hand": said,
            "blind": [blind, *(late(message) for message in said if not isinstance(message, RunStart | Truth))],
            "played": played,
            "begun": [message for message in said if getattr(message, "k", 0) < 8],
        },
    )
    core = MetricsCore(str(path))
    core.handle(Tick(0.0))
    yield core
    core.close()


def _get(core: MetricsCore, path: str) -> dict[str, Any]:
    found = ask(create(core, None, FAST_S), f"/api/v1/runs/{path}")
    assert found.status_code == 200, found.text
    document: dict[str, Any] = found.json()
    return document


def _dwells(core: MetricsCore, run: str = "by-hand") -> dict[int, dict[str, Any]]:
    document = _get(core, f"{run}/dwells?dwells=1:")
    schemas.Dwells.model_validate_json(json.dumps(document))
    return {dwell["t"]: dwell for dwell in document["dwells"]}


def test_a_dwell_has_the_tracks_that_are_there(store: MetricsCore) -> None:
    dwells = _dwells(store)
    there = {t: [track["track"] for track in dwell["tracks"]] for t, dwell in dwells.items()}
    assert [there[t] for t in range(1, DWELLS + 1)] == [
        *([], [1], [1], [1, 2], [1, 2], [1]),
        *([1, 3], [1, 3], [1, 3], [1, 3], [1], [1]),
    ]
    first, third = dwells[8]["tracks"]
    assert (first["confirmed"], first["target"], first["error_km"], first["born_t"]) == (True, 1, 0.0, 1)
    assert (third["confirmed"], third["target"], third["existence"]) == (True, 2, 0.9)
    assert [third["x_hat"], third["y_hat"]] == [THERE[0], THERE[2]]
    assert third["modes"] == [0.8, 0.1, 0.1]
    assert (third["detected"], third["statistic"], third["threshold"]) == (True, 100.0, 30.0)
    assert (third["share"], len(third["cells"])) == (0.2, 1)
    nu = float(spatial_frequency(np.array(THERE)))
    assert third["beam_deg"] == pytest.approx(np.degrees(np.arcsin(2.0 * nu)))
    assert third["beams_deg"][0][0] < third["beam_deg"] < third["beams_deg"][0][1]


def test_a_tentative_track_is_told_and_not_counted(store: MetricsCore) -> None:
    dwells = _dwells(store)
    second = dwells[4]["tracks"][1]
    assert (second["confirmed"], second["target"], second["detected"], second["is_over"]) == (False, None, False, False)
    assert (dwells[4]["picture"]["tracks"], dwells[8]["picture"]["tracks"]) == (1, 2)
    last = dwells[5]["tracks"][1]
    assert (last["is_over"], last["x_hat"], last["covariance"]) == (True, None, None)


def test_a_dwell_tells_where_was_searched_and_how_all_fared(store: MetricsCore) -> None:
    dwell = _dwells(store)[8]
    assert (len(dwell["search"]["beams_deg"]), dwell["search"]["share"]) == (2, 0.1)
    assert dwell["search"]["beams_deg"][0][0] < -30.0 < dwell["search"]["beams_deg"][0][1]
    assert (dwell["picture"]["gospa_km"], dwell["picture"]["followed"]) == (0.0, 2)
    assert _dwells(store)[7]["picture"]["gospa_missed_km"] == pytest.approx(np.sqrt(12.5))  # not confirmed yet
    beams = _get(store, "by-hand/beampattern?dwell=8")
    schemas.Beampattern.model_validate_json(json.dumps(beams))
    assert [(beam["track"], beam["target"], beam["hit"]) for beam in beams["beams"]] == [(1, 1, True), (3, 2, True)]
    assert [beam["nu"] for beam in beams["search"]] == [-0.25, 0.25]
    first = _get(store, "by-hand/beampattern?dwell=1")
    assert first["power_db"] == pytest.approx(len(first["nu"]) * [10.0 * np.log10(UNKNOWN.radar.array.power)])


def test_without_truth_there_are_tracks_alone(store: MetricsCore) -> None:
    dwells, timeline = _dwells(store, "blind"), _get(store, "blind/timeline")
    assert [track["track"] for track in dwells[8]["tracks"]] == [1, 3]
    assert {(track["target"], track["error_km"]) for track in dwells[8]["tracks"]} == {(None, None)}
    assert (dwells[8]["targets"], dwells[8]["picture"]["gospa_km"]) == ([], None)
    assert (timeline["first"], set(timeline["missed"])) == (list(range(1, DWELLS + 1)), {None})


def test_without_truth_late_plans_are_of_the_waveform_that_was_radiated(store: MetricsCore) -> None:
    timeline, course = _get(store, "blind/timeline"), _get(store, "blind/course?track=1")
    is_late = {t: dwell["tracks"][0]["late"] for t, dwell in _dwells(store, "blind").items() if dwell["tracks"]}
    assert [t for t, is_one in is_late.items() if is_one] == list(LATE)
    assert [t for t, is_one in zip(course["t"], course["late"], strict=True) if is_one] == list(LATE)
    assert [t for t, n in zip(timeline["first"], timeline["late"], strict=True) if n] == list(LATE)
    assert [t for t, n in zip(timeline["first"], timeline["stale"], strict=True) if n] == [LATE[1]]


def test_the_course_of_a_track_ends_with_it(store: MetricsCore) -> None:
    found = _get(store, "by-hand/course?track=3")
    schemas.Course.model_validate_json(json.dumps(found))
    assert (found["t"], found["confirmed"]) == ([7, 8, 9, 10], [False, True, True, True])
    assert (found["follows"], found["error_km"]) == ([None, 2, 2, None], [None, 0.0, 0.0, None])
    assert {found[name] for name in ("target", *course.OF_TARGET)} == {None}
    assert _get(store, "by-hand/course?track=3&dwells=8:9")["t"] == [8, 9]
    app = create(store, None, FAST_S)
    assert "no track 4" in ask(app, "/api/v1/runs/by-hand/course?track=4").json()["detail"]


def test_the_timeline_has_the_targets_that_nobody_follows(store: MetricsCore) -> None:
    timeline = _get(store, "by-hand/timeline")
    schemas.Timeline.model_validate_json(json.dumps(timeline))
    assert timeline["missed"] == [1.0, 1.0, *(3 * [0.0]), 0.5, 0.5, 0.0, 0.0, 0.5, 0.0, 0.0]
    assert (timeline["swaps"], set(timeline["detected"])) == (DWELLS * [0], {None})


def test_each_track_that_is_there_has_an_owner(store: MetricsCore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store, "gather", lambda: Gathered({(Role.PLANNER, name): [] for name in "ab"}, set()))
    found = json.loads(Machines(store)._read())["owners"]
    assert found == {"begun": {str(track + 1): owner_of("begun", track, "ab") for track in (0, 2)}}


def test_a_track_that_its_waveform_does_not_have_is_not_called_late(store: MetricsCore) -> None:
    here, later = roster({0: HERE, 1: THERE}), roster({0: HERE, 2: FAR})
    two = vars(scan(3, here)) | {"roster": vars(here)}
    other = vars(waveform(2, later)) | {"roster": vars(later), "late": np.array([0, 1], np.int32)}
    found = track_of(facts(store.store, "by-hand"), two, other, 1, (None, None))
    assert (found["late"], found["share"]) == (False, 0.0)


def test_a_track_whose_looks_were_not_measured_was_not_missed(store: MetricsCore) -> None:
    """A pause, a lost packet: whether it would have been detected is not known."""
    here = roster({0: HERE, 1: THERE})
    seen, missed = vars(scan(3, here)) | {"roster": vars(here)}, (vars(plan(3, 1, THERE, detected=False)), None)
    known, lit = facts(store.store, "by-hand"), seen["beam_nus"][1, :1]
    assert track_of(known, seen, None, 1, missed)["detected"] is False
    assert track_of(known, seen | {"unmeasured": lit}, None, 1, missed)["detected"] is None
    assert track_of(known, seen | {"unmeasured": lit}, None, 0, missed)["detected"] is False


def test_a_track_whose_first_scans_are_missing_began_with_a_later_one(
    store: MetricsCore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In real time a waveform that is late is not radiated: the next one says the same of the birth."""
    born = roster({0: HERE}, born=[0])
    scans = [scan(1, roster({})), scan(2, born), scan(3, roster({0: HERE}))]
    monkeypatch.setattr(particles, "_messages", lambda _store, _run, a, b: (s for s in scans if a <= s.k <= b))
    known = facts(store.store, "by-hand")
    state = particles.Beliefs().of(store.store, known._replace(row=known.row | {"rate_hz": 1.0}), 0, 3)
    assert state is not None
    assert (state.target, state.k) == (0, 3)


def test_particles_of_a_track_are_those_of_its_planner(store: MetricsCore, played: list[Message]) -> None:
    plans = {m.target: m for m in played if isinstance(m, Plan) and m.t == PLAYED}
    assert plans
    for track, told in plans.items():
        cloud = _get(store, f"played/particles?track={track + 1}")
        assert len(cloud["x"]) == MIXTURE_STATES
        assert [np.mean(cloud["x"]), np.mean(cloud["y"])] == pytest.approx(told.estimate[[0, 2]].tolist(), abs=1e-3)
    refused = ask(create(store, None, FAST_S), f"/api/v1/runs/played/particles?track=99&dwell={PLAYED}")
    assert (refused.status_code, "no track 99" in refused.json()["detail"]) == (404, True)
