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

PLAN = Plan("smoke", 1, 0, 1, 2)
POOL = LocalPool(1)


def _play(plan: Plan, file: Path, stop: threading.Event | None = None) -> list[str]:
    """Play what is missing; what was reported."""
    said: list[str] = []
    decision_runs.play(plan, file, POOL, tell=said.append, stop=stop or threading.Event())
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


def test_another_program_counts_if_this_one_comes_to_the_same(file: Path, whole: list[str]) -> None:
    n = len(whole)
    text = file.read_text(encoding="utf-8").replace(decision_runs.program(), "0" * 16)
    file.write_text("".join(text.splitlines(keepends=True)[:-1]), encoding="utf-8")
    said = _play(PLAN, file)
    assert said == [f"playing {decision_runs.REPLAYED} runs of other versions of the program again", f"{n} of {n} runs"]


@pytest.mark.parametrize("key", ["digest", "p_d", "lost"])
def test_another_program_does_not_count_if_it_came_to_something_else(key: str, file: Path, whole: list[str]) -> None:
    differing = {"digest": "f" * 64, "p_d": [0.1, 0.1], "lost": [1, 1]}
    lines = [json.loads(line) | {"program": "0" * 16, key: differing[key]} for line in whole]
    file.write_text("".join(f"{json.dumps(line)}\n" for line in lines), encoding="utf-8")
    before = file.read_bytes()
    with pytest.raises(BadInput, match=r"program 0+ played rule .*, seed 1 otherwise than this one \(.* there, .* now"):
        _play(PLAN, file)
    assert file.read_bytes() == before


def test_what_cannot_be_gone_on_with_is_refused_and_left_as_it_is(file: Path, whole: list[str]) -> None:
    def refused(plan: Plan, said: str) -> None:
        before = file.read_bytes()
        with pytest.raises(BadInput, match=said):
            _play(plan, file)
        assert file.read_bytes() == before

    refused(PLAN._replace(dwells=3), r"holds runs of smoke, 2 dwells, not of smoke, 3 dwells; name another file")
    with pytest.raises(BadInput, match="not of paper, 300 dwells"):
        decision_runs.of_plan(Plan("paper", 1, 0, 1, None), file)
    lock = JournalLock(str(file), "another")
    refused(PLAN, "in use by another")
    lock.release()
    for other, said in {
        whole[1].replace('"seed":1', '"seed":"one"'): r"d\.jsonl, line 2: seed: Input should be a valid integer",
        whole[1].replace('"digest"', '"digests"'): r"line 2: digests: Extra inputs are not permitted",
        json.dumps({key: value for key, value in json.loads(whole[1]).items() if key != "p_d"}): "neither what a run",
        json.dumps(json.loads(whole[1]) | {"rule": "guess"}): "none of the settings and rules",
        json.dumps(json.loads(whole[1]) | {"sigma_s": 1.0}): "none of the settings",
        "no JSON": "line 2: no result: Invalid JSON",
    }.items():
        file.write_text(f"{whole[0]}\n{other}\n{whole[2]}\n", encoding="utf-8")
        refused(PLAN, said)
    file.write_text("a file of somebody else, in one line", encoding="utf-8")
    refused(PLAN, "line 1: no result")
    file.write_bytes(b"SQLite format 3\0\xff\n and more")
    refused(PLAN, "can't decode")
    with pytest.raises(BadInput, match="directory"):
        decision_runs.read(file.parent)


def test_a_scenario_that_has_changed_is_refused(tmp_path: Path) -> None:
    scenario, file = tmp_path / "mine.toml", tmp_path / "d.jsonl"
    scenario.write_text('extends = "smoke"\n', encoding="utf-8")
    plan = Plan(str(scenario), 1, 0, 0, 2)
    result = decision_runs.play_one(plan, plan.asked()[0])
    file.write_text(result.model_dump_json(exclude_none=True) + "\n", encoding="utf-8")
    assert decision_runs.of_plan(plan, file) == [result]
    scenario.write_text('extends = "smoke"\n[radar.belief]\nn_particle = 700\n', encoding="utf-8")
    with pytest.raises(BadInput, match=r"mine\.toml has changed since these runs were played"):
        decision_runs.of_plan(plan, file)


def test_a_stop_leaves_what_was_played(file: Path, whole: list[str]) -> None:
    file.write_text(f"{whole[0]}\n", encoding="utf-8")
    stop = threading.Event()
    stop.set()
    with pytest.raises(Interrupted, match="the same command goes on"):
        _play(PLAN, file, stop)
    assert _lines(file) == whole[:1]


def test_a_run_that_failed_is_played_again_by_another_program_only(file: Path, whole: list[str]) -> None:
    failed = json.loads(whole[0])
    for key in ("digest", "p_d", "p_d_last", "lost", "decisions"):
        failed.pop(key, None)
    failed["failed"] = "no acquisition"
    file.write_text("\n".join([json.dumps(failed), *whole[1:], ""]), encoding="utf-8")
    assert _play(PLAN, file) == []
    file.write_text("\n".join([json.dumps(failed | {"program": "0" * 16}), *whole[1:], ""]), encoding="utf-8")
    assert _play(PLAN, file) == [f"{len(whole)} of {len(whole)} runs"]
    assert Result.model_validate_json(_lines(file)[-1]) == Result.model_validate_json(whole[0])


def test_a_plan_has_its_own_results_only(file: Path, whole: list[str]) -> None:
    later = json.dumps(json.loads(whole[1]) | {"seed": 2})
    file.write_text("\n".join([*whole, later, ""]), encoding="utf-8")
    assert len(decision_runs.read(file)) == len(whole) + 1
    assert len(decision_runs.of_plan(PLAN, file)) == len(whole)
