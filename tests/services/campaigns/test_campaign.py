"""Campaigns: the same results whoever plays them, in whatever order, and however often they are interrupted."""

import multiprocessing
import os
import re
import signal
import threading
import tomllib
from collections.abc import Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from cogradar.services.campaigns import campaign as campaigns
from cogradar.services.campaigns.campaign import Campaign, Tally, open_store, parse_strategies, results_digest
from cogradar.services.campaigns.pool import LocalPool, play_one
from cogradar.services.errors import BadInput, Interrupted, RunFailed, StoreFailed
from cogradar.services.metrics.recording import snapshots, take
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.recorder.journal import Journal
from cogradar.services.runs import in_process
from cogradar.shared.protocol.build import LIBRARIES, build, sources
from cogradar.shared.protocol.messages import Waveform
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.codec import decode
from tests.scenarios import varied
from tests.services.loop import SMOKE

REPOSITORY = Path(__file__).resolve().parents[3]
STRATEGIES = (Strategy.UNIFORM, Strategy.POWER_AWARE)
SMALL = Campaign((SMOKE,), STRATEGIES, runs=3, first_seed=5, dwells=4)


@pytest.fixture(scope="module")
def reference() -> str:
    """Digest of SMALL's results, played in this process one run after the other, last run first."""
    store = in_memory()
    for place, start in reversed(list(enumerate(SMALL.starts(), 1))):
        played = in_memory()
        in_process.play(start, store=played)
        recording = take(played, start.run)
        assert recording is not None
        store.journal.add_recording(recording, place)
    return results_digest(store)


def _play(store: Store, workers: int = 2, campaign: Campaign = SMALL, **other: Any) -> Tally:
    return campaigns.play(campaign, store, LocalPool(workers), **({"stop": threading.Event()} | other))


def test_runs_have_opaque_ids_and_strategies_share_seeds() -> None:
    starts = SMALL.starts()
    assert [(start.strategy, start.seed) for start in starts] == [
        (strategy, seed) for seed in (5, 6, 7) for strategy in ("uniform", "power-aware")
    ]
    assert {start.dwells for start in starts} == {4}
    assert len({start.run for start in starts} | {start.run for start in SMALL.starts()}) == 2 * len(starts)


def test_snapshots_are_the_papers() -> None:
    assert snapshots(300) == (75, 200, 300)
    assert snapshots(1) == (1,)
    assert snapshots(4) == (1, 2, 4)


@pytest.mark.parametrize("text", ["", "best", "uniform,", "uniform,uniform", "uniform, power-aware"])
def test_bad_strategies_are_refused(text: str) -> None:
    with pytest.raises(BadInput, match=r"must be (one of orthogonal, uniform, power-aware|each once)"):
        parse_strategies(text)


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 3])
def test_results_do_not_depend_on_the_number_of_workers(workers: int, reference: str) -> None:
    store, seen = in_memory(), []
    tally = _play(store, workers, report=lambda now: seen.append(now.done))
    assert results_digest(store) == reference
    assert seen == [0, 1, 2, 3, 4, 5, 6]
    assert (tally.played, {name: len(cpu) for name, cpu in tally.cpu_s.items()}) == (
        6,
        {"uniform": 3, "power-aware": 3},
    )
    # In the order of the campaign, not of arrival.
    played = [(row["strategy"], row["seed"]) for row in store.read("SELECT strategy, seed FROM run ORDER BY place")]
    assert played == [(start.strategy, start.seed) for start in SMALL.starts()]


@pytest.mark.slow
def test_the_waveforms_kept_are_those_of_the_snapshots() -> None:
    """The beams radiated at dwell t are the bins that its scores say were asked for."""
    store = in_memory()
    _play(store, 1, Campaign((SMOKE,), (Strategy.POWER_AWARE,), runs=1, first_seed=5, dwells=12))
    rows = store.read("SELECT k, payload, acquisition_scans FROM message JOIN run USING (run) ORDER BY k")
    assert [row["k"] - row["acquisition_scans"] + 2 for row in rows] == [3, 8, 12]
    for row, t in zip(rows, (3, 8, 12), strict=True):
        waveform = decode(row["payload"])
        assert isinstance(waveform, Waveform)
        scores = store.read("SELECT bin, share FROM score WHERE t = ? ORDER BY track", [t])
        assert waveform.beams[:, 0].tolist() == [score["bin"] for score in scores]
        assert waveform.shares[:, 0].tolist() == [score["share"] for score in scores]


@pytest.mark.slow
def test_an_interrupted_campaign_goes_on_to_the_same_result(reference: str) -> None:
    store, stop = in_memory(), threading.Event()

    def report(now: Tally) -> None:
        if now.played == 2:
            stop.set()

    with pytest.raises(Interrupted, match="--resume"):
        _play(store, report=report, stop=stop)
    assert multiprocessing.active_children() == []
    (partial,) = store.read("SELECT COUNT(*) AS n FROM run")
    assert 2 <= partial["n"] < 6
    assert _play(store).played == 6 - partial["n"]
    assert results_digest(store) == reference


@pytest.mark.slow
def test_a_killed_worker_costs_nothing_but_time(reference: str) -> None:
    store = in_memory()
    sent: list[str] = []

    def report(now: Tally) -> None:
        if now.played == 1 and not sent:
            os.kill(next(child.pid for child in multiprocessing.active_children() if child.pid), signal.SIGKILL)

    _play(store, report=report, notify=sent.append)
    assert sent == ["a worker process died; its run is made again"]
    assert results_digest(store) == reference


def test_workers_that_keep_dying_end_the_campaign(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: Any) -> Iterator[Any]:
        raise BrokenProcessPool

    monkeypatch.setattr(campaigns, "_play_on", broken)
    with pytest.raises(RunFailed, match="died 4 times"):
        _play(in_memory())


@pytest.mark.slow
def test_a_full_disk_leaves_whole_runs_and_a_campaign_that_goes_on(tmp_path: Path, reference: str) -> None:
    """SQLite is told that the disk is full at a number of pages that holds some of the runs but not all."""
    path = str(tmp_path / "c.db")
    store = open_store(path, SMALL, resume=False)
    (page,) = store.read("PRAGMA page_count")
    store.read(f"PRAGMA max_page_count = {page['page_count'] + 2}")
    with pytest.raises(StoreFailed, match=r"c\.db: database or disk is full"):
        _play(store)
    store.close()
    with closing(open_store(path, SMALL, resume=True)) as again:
        counts = again.read("SELECT run, COUNT(t) AS n FROM run LEFT JOIN score USING (run) GROUP BY run")
        assert len(counts) < 6
        assert {row["n"] for row in counts} <= {2 * 4}
        _play(again)
        assert results_digest(again) == reference


def test_a_run_that_fails_is_a_result() -> None:
    """It would fail again: recorded with its reason, not played a second time."""
    deaf = varied(SMOKE, {"echo": {"amplitude_db": -100.0}}, acquisition={"max_scans": 3})
    store = in_memory()
    (start,) = Campaign((deaf,), (Strategy.UNIFORM,), runs=1, first_seed=1, dwells=4).starts()
    recording, _ = play_one(start, build())
    store.journal.add_recording(recording, 1)
    (run,) = store.read("SELECT status, reason FROM run")
    assert run["status"] == "failed"
    assert "within 3 scans" in run["reason"]
    assert campaigns.missing_runs([start], store) == []


def test_the_digest_sees_every_score(reference: str) -> None:
    store = in_memory()
    for place, start in enumerate(SMALL.starts(), 1):
        store.journal.add_recording(play_one(start, build())[0], place)
    assert results_digest(store) == reference
    nudged = "UPDATE main.score SET x_hat = x_hat * (1 + 3e-16) WHERE t = 2 AND target = 1"
    store.journal.write(nudged)
    assert results_digest(store) != reference


def test_a_run_is_refused_by_another_program() -> None:
    with pytest.raises(RunFailed, match=f"runs build {build()}, this system another, so"):
        play_one(SMALL.starts()[0], "another")


def test_several_scenarios_share_seeds_and_are_told_apart() -> None:
    """In a store that has one of them, the other's runs are missing."""
    louder = varied(SMOKE, {"echo": {"amplitude_db": 3.0}})
    store, asked = in_memory(), Campaign((SMOKE, louder), STRATEGIES[:1], runs=2, first_seed=5, dwells=2)
    starts = asked.starts()
    assert [start.seed for start in starts] == [5, 5, 6, 6]
    store.journal.add_recording(play_one(starts[1], build())[0], 2)
    assert [place for place, _ in campaigns.missing_runs(asked.starts(), store)] == [1, 3, 4]


def test_the_program_is_all_that_can_change_a_result() -> None:
    """What is not in its digest only shows, or carries bytes: a new dependency or room must be decided about."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    direct = {re.match(r"[\w-]+", line)[0] for line in project["dependencies"]}  # type: ignore[index] # all match
    assert direct - set(LIBRARIES) == {
        "cryptography",
        "eclipse-zenoh",
        "filelock",
        "geographiclib",
        "matplotlib",
        "plotly",
        "prometheus-client",
        "rich",
        "starlette",
        "typer",
        "uvicorn",
    }
    rooms = {file.relative_to(REPOSITORY).parts[1] for file in sources()}
    assert {path.parent.name for path in (REPOSITORY / "services").glob("*/*.py")} - rooms == {
        "analysis",
        "bench",
        "cli",
        "sweeps",
        "web",
    }


def test_a_store_with_something_else_is_refused(tmp_path: Path) -> None:
    path = str(tmp_path / "c.db")
    open_store(path, SMALL, resume=False).close()
    with pytest.raises(BadInput, match="0 of the 6 runs of this campaign; add --resume"):
        open_store(path, SMALL, resume=False)
    open_store(path, SMALL, resume=True).close()
    others = {
        "runs = 3 there, 4 asked for": Campaign((SMOKE,), STRATEGIES, runs=4, first_seed=5, dwells=4),
        "first_seed = 5 there, 1": Campaign((SMOKE,), STRATEGIES, runs=3, first_seed=1, dwells=4),
        "strategies = uniform,power-aware there": Campaign((SMOKE,), STRATEGIES[:1], runs=3, first_seed=5, dwells=4),
        "dwells = 4 there, 5": Campaign((SMOKE,), STRATEGIES, runs=3, first_seed=5, dwells=5),
        "its scenario, smoke": Campaign((SMOKE.model_copy(update={"title": "x"}),), STRATEGIES, 3, 5, 4),
    }
    for words, other in others.items():
        for resume in (False, True):
            with pytest.raises(BadInput, match=words):
                open_store(path, other, resume=resume)


def test_a_store_played_by_another_program_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = str(tmp_path / "c.db")
    open_store(path, SMALL, resume=False).close()
    monkeypatch.setattr(campaigns, "build", lambda: "another")
    with pytest.raises(BadInput, match="another version of the program"):
        open_store(path, SMALL, resume=True)


def test_a_store_of_single_runs_is_refused(tmp_path: Path) -> None:
    path = str(tmp_path / "c.db")
    store = Journal(path)
    store.add_recording(play_one(SMALL.starts()[0], build())[0], 1)
    store.close()
    with pytest.raises(BadInput, match="belong to no campaign"):
        open_store(path, SMALL, resume=True)
