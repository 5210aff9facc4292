"""Campaigns over services behind a router come to the results of local ones, bit for bit."""

import json
import threading
from pathlib import Path

import pytest

from services.campaigns import campaign as local
from services.campaigns import connected
from services.campaigns.campaign import Campaign, Tally, open_store, results_digest
from services.errors import BadInput, Interrupted, RunFailed
from services.metrics import recording as recordings
from services.metrics.answers import answer
from services.metrics.store import Store
from shared.scenario.radar_config import Strategy
from shared.wire.session import free_port, run_router
from tests.services.loop import SMOKE

ASKED = Campaign(SMOKE, (Strategy.POWER_AWARE, Strategy.ORTHOGONAL), runs=3, first_seed=1, dwells=8)


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """The campaign as this machine plays it."""
    store = open_store(str(tmp_path_factory.mktemp("local") / "local.db"), ASKED, resume=False)
    local.play(ASKED, store, 2, stop=threading.Event())
    return store


def _play(endpoint: str, path: Path, asked: Campaign = ASKED, *, resume: bool = False, at_once: int = 3) -> Store:
    store = open_store(str(path), asked, resume=resume)
    connected.play(asked, store, endpoint, at_once, stop=threading.Event())
    return store


def test_a_recording_comes_back_from_json_bit_for_bit(played: Store) -> None:
    for row in played.read("SELECT run FROM run"):
        recording = recordings.take(played, row["run"])
        assert recording is not None
        assert len(recording.messages) == len(recordings.snapshots(ASKED.dwells))
        (document,) = answer(played, "recording", {"run": row["run"]})
        assert recordings.unpack(json.loads(json.dumps(document))) == recording


@pytest.mark.parametrize("parameters", [{}, {"run": "r", "target": "1"}])
def test_a_recording_is_asked_for_by_the_name_of_its_run(parameters: dict[str, str], played: Store) -> None:
    with pytest.raises(BadInput, match="takes run, and nothing else"):
        answer(played, "recording", parameters)


def test_a_run_that_is_not_there_has_no_recording(played: Store) -> None:
    with pytest.raises(BadInput, match="run = 'nobody': no such run"):
        answer(played, "recording", {"run": "nobody"})


@pytest.mark.zenoh
def test_the_results_are_those_of_a_local_campaign(endpoint: str, played: Store, tmp_path: Path) -> None:
    """Twice over the same services."""
    for name in ("a.db", "b.db"):
        assert results_digest(_play(endpoint, tmp_path / name)) == results_digest(played)


@pytest.mark.zenoh
def test_an_interrupted_campaign_goes_on_with_the_runs_that_are_missing(
    endpoint: str, played: Store, tmp_path: Path
) -> None:
    stop, seen = threading.Event(), list[int]()

    def report(tally: Tally) -> None:
        seen.append(tally.done)
        if tally.played == 2:
            stop.set()

    store = open_store(str(tmp_path / "c.db"), ASKED, resume=False)
    with pytest.raises(Interrupted, match="--resume"):
        connected.play(ASKED, store, endpoint, 1, report=report, stop=stop)
    assert seen == [0, 1, 2]
    assert results_digest(_play(endpoint, tmp_path / "c.db", resume=True)) == results_digest(played)


@pytest.mark.zenoh
def test_a_run_that_fails_is_stored_and_reported(endpoint: str, tmp_path: Path) -> None:
    deaf = SMOKE.model_copy(
        update={
            "echo": SMOKE.radar.echo.model_copy(update={"amplitude_db": -100.0}),
            "acquisition": SMOKE.radar.acquisition.model_copy(update={"max_scans": 3}),
        }
    )
    asked = Campaign(deaf, (Strategy.UNIFORM,), runs=1, first_seed=1, dwells=4)
    store, said = open_store(str(tmp_path / "d.db"), asked, resume=False), list[str]()
    connected.play(asked, store, endpoint, None, notify=said.append, stop=threading.Event())
    assert said == ["smoke-uniform-1 failed: not every target was detected within 3 scans"]
    (row,) = store.read("SELECT status FROM run")
    assert row["status"] == "failed"


@pytest.mark.zenoh
def test_without_a_router_it_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connected, "CONNECT_WITHIN_S", 0.5)
    with pytest.raises(ConnectionError, match="no Zenoh router at tcp"):
        _play(f"tcp/127.0.0.1:{free_port()}", tmp_path / "e.db")


@pytest.mark.zenoh
def test_a_role_that_is_missing_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connected, "ALIVE_WITHIN_S", 0.5)
    stop, port = threading.Event(), free_port()
    router = threading.Thread(target=run_router, args=(f"tcp/127.0.0.1:{port}", stop))
    router.start()
    try:
        with pytest.raises(RunFailed, match=r"not alive within .* s: metrics, emulator, planner, allocator"):
            _play(f"tcp/127.0.0.1:{port}", tmp_path / "f.db")
    finally:
        stop.set()
        router.join()
