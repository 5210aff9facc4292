"""The results of a comparison in their file: it goes on with what is there, and refuses what does not belong to it."""

import json
import threading
from pathlib import Path

import pytest

from services.campaigns.pool import LocalPool
from services.errors import BadInput, Interrupted
from services.recorder.lock import JournalLock
from services.sweeps import decision_runs
from services.sweeps.decisions import SNRS_DB, Plan, Result
from shared.protocol.build import build

PLAN = Plan("smoke", 1, 0, 1, 2)
POOL = LocalPool(1)


def _play(plan: Plan, file: Path, stop: threading.Event | None = None) -> list[str]:
    """Play what is missing; what was reported."""
    said: list[str] = []
    decision_runs.play(plan, file, POOL, report=said.append, stop=stop or threading.Event())
    return said


def _lines(file: Path) -> list[str]:
    return file.read_text(encoding="utf-8").splitlines()


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The lines of a comparison that was played whole."""
    file = tmp_path_factory.mktemp("whole") / "d.jsonl"
    said = _play(PLAN, file)
    assert said[-1] == f"{len(said)} of {len(said)} runs"
    assert {result.asked for result in decision_runs.read(file)} == set(PLAN.asked())
    assert {result.snr_db for result in decision_runs.read(file)} == {SNRS_DB[0]}
    return _lines(file)


@pytest.fixture
def file(tmp_path: Path, whole: list[str]) -> Path:
    path = tmp_path / "d.jsonl"
    path.write_text("".join(f"{line}\n" for line in whole), encoding="utf-8")
    return path


def test_it_goes_on_after_a_kill_in_the_middle_of_a_line(file: Path, whole: list[str]) -> None:
    text = file.read_text(encoding="utf-8")
    file.write_text(text[:-20], encoding="utf-8")
    assert [result.asked for result in decision_runs.read(file)] == [
        Result.model_validate_json(line).asked for line in whole[:-1]
    ]
    assert _play(PLAN, file) == [f"{len(whole)} of {len(whole)} runs"]
    assert sorted(_lines(file)) == sorted(whole)
    assert _play(PLAN, file) == []


def test_more_decisions_are_looked_into_later(file: Path, whole: list[str]) -> None:
    bare = [json.loads(line) for line in whole]
    for line in bare:
        line.pop("decisions", None)
    file.write_text("".join(f"{json.dumps(line)}\n" for line in bare), encoding="utf-8")
    assert _play(PLAN._replace(belief_runs=0), file) == []
    assert len(_play(PLAN, file)) == sum("decisions" in line for line in whole) > 0
    expected = {result.asked: result for result in map(Result.model_validate_json, whole)}
    assert {result.asked: result for result in decision_runs.read(file)} == expected


def test_another_program_counts_if_this_one_comes_to_its_digests(file: Path, whole: list[str]) -> None:
    n = len(whole)
    text = file.read_text(encoding="utf-8").replace(build(), "0" * 16)
    file.write_text("".join(text.splitlines(keepends=True)[:-1]), encoding="utf-8")
    said = _play(PLAN, file)
    assert said == [f"playing {decision_runs.REPLAYED} runs of other versions of the program again", f"{n} of {n} runs"]
    digest = json.loads(whole[2])["digest"]
    file.write_text(text.replace(digest, "f" * 64), encoding="utf-8")
    with pytest.raises(BadInput, match=rf"program 0+ played rule .* otherwise than this one .*{digest} now"):
        _play(PLAN, file)


def test_what_cannot_be_gone_on_with_is_refused(file: Path, whole: list[str]) -> None:
    with pytest.raises(BadInput, match=r"holds runs of smoke, 2 dwells, not of smoke, 3 dwells; name another file"):
        _play(PLAN._replace(dwells=3), file)
    lock = JournalLock(str(file), "another")
    with pytest.raises(BadInput, match="in use by another"):
        _play(PLAN, file)
    lock.release()
    file.write_text("\n".join([whole[0], whole[1].replace('"seed":1', '"seed":"one"'), ""]), encoding="utf-8")
    with pytest.raises(BadInput, match=r"d\.jsonl, line 2: seed: Input should be a valid integer"):
        decision_runs.read(file)
    file.write_text("no JSON\n", encoding="utf-8")
    with pytest.raises(BadInput, match=r"line 1: no result: Invalid JSON"):
        decision_runs.read(file)
    with pytest.raises(BadInput, match="directory"):
        decision_runs.read(file.parent)


def test_a_stop_leaves_what_was_played(file: Path, whole: list[str]) -> None:
    file.write_text(f"{whole[0]}\n", encoding="utf-8")
    stop = threading.Event()
    stop.set()
    with pytest.raises(Interrupted, match="the same command goes on"):
        _play(PLAN, file, stop)
    assert _lines(file) == whole[:1]


def test_a_run_that_fails_is_a_result(file: Path, whole: list[str]) -> None:
    failed = json.loads(whole[0])
    for key in ("digest", "p_d", "p_d_last", "lost", "decisions"):
        failed.pop(key, None)
    file.write_text("\n".join([json.dumps(failed | {"failed": "no acquisition"}), *whole[1:], ""]), encoding="utf-8")
    assert _play(PLAN, file) == []
