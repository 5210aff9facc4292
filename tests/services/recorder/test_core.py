import json
from pathlib import Path

import pytest

from services.errors import BadInput
from services.metrics.answers import answer
from services.recorder.core import RecorderCore
from services.recorder.journal import Journal
from services.runs.run import result
from shared.protocol.messages import Checkpoint, Message, Plan, RunEnd, RunStart, Scan, Tick, Truth
from shared.scenario.radar_config import Strategy
from shared.signal.receiver import threshold
from tests.samples import digest
from tests.services.loop import SMOKE, plans, play, scans, smoke_start, waveforms


@pytest.fixture(scope="module")
def said() -> list[Message]:
    return play(smoke_start(dwells=8))


def _heard(messages: list[Message]) -> tuple[RecorderCore, Journal]:
    store = Journal(":memory:")
    core = RecorderCore(store)
    for message in messages:
        assert all(isinstance(answer, Checkpoint) for answer in core.handle(message))
    return core, store


def test_a_run_is_recorded_from_start_to_end(said: list[Message]) -> None:
    _, store = _heard(said)
    (run,) = answer(store, "runs", {})
    acquisition_scans = sum(scan.t == 0 for scan in scans(said))
    assert (run["run"], run["strategy"], run["seed"], run["dwells"], run["t"]) == ("r", "power-aware", 1, 8, 8)
    assert (run["status"], run["acquisition_scans"], run["waiting_for"]) == ("complete", acquisition_scans, "")
    kept = store.read("SELECT topic, COUNT(*) AS n FROM message GROUP BY topic")
    n = len(scans(said))
    assert {row["topic"]: row["n"] for row in kept} == {"scan": n, "truth": n, "waveform": n, "plan": 2 * n}


def test_the_digest_covers_scans_plans_and_waveforms_in_order(said: list[Message]) -> None:
    """Independently: per dwell plans by track, the scan, the waveform (topics in alphabetical order)."""
    _, store = _heard(said)
    ordered: list[Message] = []
    for scan, waveform in zip(scans(said), waveforms(said), strict=True):
        ordered += {plan.target: plan for plan in plans(said) if plan.k == scan.k}.values()
        ordered += [scan, waveform]
    assert answer(store, "runs", {})[0]["digest"] == digest(ordered)


def test_order_of_arrival_and_repetition_do_not_matter(said: list[Message]) -> None:
    _, one = _heard(said)
    _, other = _heard([*said[::-1], *said])
    for metric in ("runs", "tracks", "summary"):
        assert answer(one, metric, {}) == answer(other, metric, {})


def test_scores_follow_from_truth_scan_and_plan(said: list[Message]) -> None:
    """P_D counts the true bin's cell, tested and over the threshold; errors are those of the belief mean."""
    _, store = _heard(said)
    truths = {message.t: message for message in said if isinstance(message, Truth) and message.t > 0}
    by_t = {scan.t: scan for scan in scans(said) if scan.t > 0}
    estimates = {(plan.t, plan.target): plan.estimate for plan in plans(said) if plan.status == "tracking"}
    rows = answer(store, "tracks", {})
    assert len(rows) == 8 * 2
    for row in rows:
        truth, scan, m = truths[row["t"]], by_t[row["t"]], row["target"] - 1
        where = [i for i, bin_ in enumerate(scan.bins) if bin_ == truth.bins[m]]
        over = any(scan.statistic[i] >= threshold(SMOKE.radar.detector.p_fa) for i in where)
        assert row["detected"] == over
        assert row["x"] == truth.states[m, 0]
        track = (
            [0, 1] if SMOKE.simulated.targets[0].state[2] < SMOKE.simulated.targets[1].state[2] else [1, 0]
        )  # tracks go by bin
        assert row["y_hat"] == estimates[row["t"], track[m]][2]
        assert row["bin"] == scan.beams[track[m]]


def test_a_failed_run_says_why() -> None:
    core, store = _heard([smoke_start()])
    core.handle(RunEnd(run="r", k=0, t=0, status="failed", reason="no target"))
    (run,) = answer(store, "runs", {})
    assert (run["status"], run["reason"]) == ("failed", "no target")


@pytest.mark.parametrize(
    ("silent", "words"),
    [(RunStart, "the emulator's first scan"), (Scan, "plan of track 1, 2 at dwell 0"), (Plan, "waveform of dwell 0")],
)
def test_a_run_in_progress_says_what_it_waits_for(said: list[Message], silent: type[Message], words: str) -> None:
    kinds = {RunStart: 1, Scan: 4, Plan: 6}  # start; checkpoint, truth and scan; two plans
    _, store = _heard(said[: kinds[silent]])
    assert words in answer(store, "runs", {})[0]["waiting_for"]


def _checkpoints(core: RecorderCore, messages: list[Message]) -> list[tuple[int, int, bool]]:
    said = [answer for message in messages for answer in core.handle(message)]
    return [(answer.k, answer.t, answer.ended) for answer in said if isinstance(answer, Checkpoint)]


def test_checkpoints_say_how_far_the_store_is() -> None:
    """At the start, every 16 complete dwells, and at the end; the clock is that of the last dwell stored."""
    said = play(smoke_start(dwells=20))
    n, clock = len(scans(said)), {scan.k: scan.t for scan in scans(said)}
    assert 16 < n < 32
    assert _checkpoints(RecorderCore(Journal(":memory:")), said) == [(0, 0, False), (16, clock[15], False), (n, 20, True)]


def test_a_silence_is_broken_by_the_checkpoint(said: list[Message]) -> None:
    core = RecorderCore(Journal(":memory:"))
    _checkpoints(core, said[: said.index(waveforms(said)[1]) + 1])
    answers = {tick: core.handle(Tick(0.25 * tick)) for tick in range(1, 50)}
    assert [tick for tick, answer in answers.items() if answer] == [2, 4, 8, 16, 32, 48]
    assert _checkpoints(core, [said[-2]]) == []
    assert all(a.k == 2 for answer in answers.values() for a in answer if isinstance(a, Checkpoint))


@pytest.mark.parametrize("cut", [1, 7, 40, 76, 95])
def test_a_metrics_that_comes_back_goes_on_where_the_store_is(said: list[Message], cut: int) -> None:
    """Cut anywhere: in the acquisition, in its last dwell, in a dwell half scored."""
    store, whole = Journal(":memory:"), _heard(said)[1]
    first = RecorderCore(store)
    for message in said[:cut]:
        first.handle(message)
    second = RecorderCore(store, resume=True)
    for message in said[max(cut - 20, 1) :]:  # what publishers still keep
        second.handle(message)
    for metric in ("runs", "tracks", "summary"):
        assert answer(store, metric, {}) == answer(whole, metric, {})


def test_a_run_that_nobody_resumes_is_marked_as_interrupted() -> None:
    store = Journal(":memory:")
    RecorderCore(store).handle(smoke_start())
    RecorderCore(store)
    (run,) = answer(store, "runs", {})
    assert (run["status"], run["reason"]) == ("failed", "interrupted")


def test_an_end_that_is_said_again_is_acknowledged_again(said: list[Message]) -> None:
    core, _ = _heard(said)
    (end,) = core.handle(said[-1])
    assert isinstance(said[-1], RunEnd)
    assert isinstance(end, Checkpoint)
    assert end.ended


def test_a_store_survives_its_process(said: list[Message], tmp_path: object) -> None:
    path = f"{tmp_path}/runs.db"
    core = RecorderCore(Journal(path))
    for message in said:
        core.handle(message)
    assert answer(Journal(path, read_only=True), "p_d", {"target": "2"}) == answer(Journal(path), "p_d", {"target": "2"})


def test_a_file_that_is_no_store_is_refused(tmp_path: object) -> None:
    path = f"{tmp_path}/x.db"
    Path(path).write_text("this is not a database, but longer than its header would have to be to look like one" * 20)
    with pytest.raises(BadInput, match=r"x\.db"):
        Journal(path)


def test_p_d_and_rmse_agree_with_the_rows(said: list[Message]) -> None:
    core, store = _heard(said)
    rows = list(answer(store, "tracks", {"target": "2", "dwells": "3:6"}))
    (p_d,) = json.loads(core.answer("p_d", {"target": "2", "dwells": "3:6"}))
    assert (p_d["first_dwell"], p_d["last_dwell"], p_d["n"]) == (3, 6, 4)
    assert p_d["p_d"] == sum(row["detected"] for row in rows) / 4
    assert p_d["p_d_low"] <= p_d["p_d"] <= p_d["p_d_high"]
    (rmse,) = answer(store, "rmse", {"target": "2", "dwells": "3:6"})
    squares = [(row["x"] - row["x_hat"]) ** 2 + (row["y"] - row["y_hat"]) ** 2 for row in rows]
    assert rmse["position_rmse_km"] == pytest.approx((sum(squares) / 4) ** 0.5, rel=1e-12)


@pytest.mark.parametrize(
    ("metric", "parameters", "words"),
    [
        ("speed", {}, "metric = 'speed'"),
        ("p_d", {"target": "0"}, "target = '0'"),
        ("p_d", {"target": "x; DROP TABLE run"}, "target"),
        ("p_d", {"strategy": "best"}, "orthogonal, uniform, power-aware"),
        ("p_d", {"dwells": "5"}, "a:b"),
        ("p_d", {"colour": "red"}, "colour"),
        ("runs", {"target": "1"}, "target"),
    ],
)
def test_bad_questions_are_answered_with_what_is_allowed(metric: str, parameters: dict[str, str], words: str) -> None:
    with pytest.raises(BadInput, match=words):
        answer(Journal(":memory:"), metric, parameters)


def test_a_result_has_a_row_per_window_and_target() -> None:
    start = smoke_start(Strategy.UNIFORM, dwells=60)
    _, store = _heard(play(start))
    done = result(lambda metric, parameters: answer(store, metric, parameters), start, began=0.0)
    assert done is not None
    assert [[row["n"] for row in window] for window in done.windows] == [[50, 50], [10, 10]]
    assert sum(w[0]["detections"] for w in done.windows) == done.targets[0]["detections"]
    keys = {"run", "scenario", "strategy", "seed", "dwells", "acquisition_scans", "digest", "elapsed_s", "targets"}
    assert set(done.as_json()) == keys
