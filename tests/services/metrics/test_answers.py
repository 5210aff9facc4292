"""Answers to questions: what they are of, and what is said where there is none."""

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from cogradar.services.errors import BadInput
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.database import Database
from cogradar.services.runs.run import PICTURE, result
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Message, Plan, RunStart, Scan, Truth, Waveform
from cogradar.shared.protocol.recovery import NoPlans
from cogradar.shared.scenario.limits import NO_END
from cogradar.shared.scenario.radar_config import Strategy
from tests.services.loop import checkpoints, play, scans, smoke_start

DWELLS = 8


@pytest.fixture(scope="module")
def sent() -> list[Message]:
    return play(smoke_start(dwells=DWELLS))


def _recorded(*runs: list[Message]) -> Store:
    store = in_memory()
    for i, messages in enumerate(runs):
        core = RecorderCore(store.journal, resume=i > 0)
        for message in messages:
            core.handle(message)
    return store


def _called(sent: list[Message], run: str) -> list[Message]:
    return [message.model_copy(update={"run": run}) for message in sent]


def _blind(sent: list[Message], run: str) -> list[Message]:
    """The same run without truth."""
    start = smoke_start(dwells=DWELLS)
    start = start.model_copy(update={"scenario": start.scenario | {"world": None}})
    return _called([start, *(m for m in sent if not isinstance(m, RunStart | Truth))], run)


def test_runs_says_how_each_run_is(sent: list[Message]) -> None:
    (run,) = answer(_recorded(sent), "runs", {})
    acquisition_scans = sum(scan.t == 0 for scan in scans(sent))
    assert (run["run"], run["strategy"], run["seed"], run["dwells"], run["t"]) == (
        "r",
        "power-aware",
        1,
        DWELLS,
        DWELLS,
    )
    assert (run["status"], run["acquisition_scans"], run["waiting_for"]) == ("complete", acquisition_scans, "")
    assert run["k"] == scans(sent)[-1].k


def test_a_run_without_an_end_has_no_number_of_dwells_and_is_asked_about_those_it_has(sent: list[Message]) -> None:
    messages = [message for message in sent if isinstance(message, Scan | Plan | Truth | Waveform)]
    store = in_memory()
    core = RecorderCore(store.journal)
    for event in (smoke_start(dwells=NO_END), *messages, *3 * [Tick(0.0)]):
        core.handle(event)
    (run,) = answer(store, "runs", {})
    assert (run["dwells"], run["t"], run["status"]) == (None, DWELLS, "running")
    assert {row["n"] for row in answer(store, "summary", {})} == {DWELLS}
    with pytest.raises(BadInput, match=f"dwells 1 to {DWELLS}"):
        answer(store, "tracks", {"dwells": f"1:{DWELLS + 1}"})


@pytest.mark.parametrize(
    ("last", "words"),
    [(RunStart, "the emulator's first scan"), (Scan, "plan of track 1, 2 at dwell 0"), (Plan, "waveform of dwell 0")],
)
def test_a_run_in_progress_says_what_it_waits_for(sent: list[Message], last: type[Message], words: str) -> None:
    kinds = {RunStart: 1, Scan: 4, Plan: 6}  # start; checkpoint, truth and scan; two plans
    assert words in answer(_recorded(sent[: kinds[last]]), "runs", {})[0]["waiting_for"]


def test_a_run_in_progress_says_why_nothing_was_measured(sent: list[Message]) -> None:
    said = [one.model_copy(update={"fault": "no packet"}) if isinstance(one, Scan) else one for one in sent[:4]]
    (run,) = answer(_recorded(said), "runs", {})
    assert run["fault"] == "no packet"
    assert run["waiting_for"].endswith("plan of track 1, 2 at dwell 0; not measured: no packet")


def test_a_run_in_progress_names_the_planners_that_brought_no_plans(sent: list[Message]) -> None:
    """Two planners say the same of the others, which stands there once."""
    said = "n-1, n-2 and 4 more: no plans; others take their tracks"
    late = [NoPlans(run="r", process=name, reason=said, ends=False, late=True) for name in ("a", "b")]
    (run,) = answer(_recorded([*sent[:4], *late]), "runs", {})
    assert run["waiting_for"] == f"a planner: plan of track 1, 2 at dwell 0; {said}"


def test_a_run_whose_recorder_is_frozen_waits_for_the_recorder(
    sent: list[Message], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The journal alone looks as if the next scan did not come."""
    journal, now_s = Journal(str(tmp_path / "r.db")), time.monotonic()
    recorder = RecorderCore(journal)
    core = MetricsCore(str(tmp_path / "r.db"))
    monkeypatch.setattr(time, "monotonic", lambda: now_s)
    for message in sent[:20]:
        for said in recorder.handle(message):
            core.handle(said)

    def waits() -> str:
        (run,) = json.loads(core.answer("runs", {}))
        return str(run["waiting_for"])

    now_s += 19.0
    assert waits().startswith("the emulator")
    now_s += 3.0
    assert waits() == "the recorder, which has said nothing for 22 s"
    core.handle(checkpoints(smoke_start(dwells=DWELLS), k=5, t=4)[0])
    assert waits().startswith("the emulator")
    now_s += 22.0
    for message in sent[20:40]:  # what it says is lost, and what it writes is not
        recorder.handle(message)
    for _ in range(8):
        recorder.handle(Tick(0.0))
    assert "the recorder" not in waits()
    now_s += 22.0
    assert waits().startswith("the recorder")
    core.close()
    journal.close()


def test_a_run_in_progress_whose_scan_is_damaged_hides_no_other(sent: list[Message]) -> None:
    store = _recorded(sent[:4])
    store.journal.write("UPDATE message SET payload = x'00ff' WHERE topic = 'scan'")
    (run,) = answer(store, "runs", {})
    assert run["waiting_for"].startswith("scan of dwell 0: cannot be read: ")
    assert run["fault"] is None


@pytest.mark.parametrize("n_run", [2, 200])
def test_rows_of_many_runs_are_verified_with_as_many_questions_as_of_few(
    n_run: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, asked = in_memory(), list[str]()
    for i in range(n_run):
        store.journal.add_run(smoke_start(run=f"r{i}"))
    store.journal.give_up_unfinished()
    read = Database.read

    def counted(self: Database, query: str, parameters: Sequence[Any] = ()) -> list[dict[str, Any]]:
        asked.append(query)
        return read(self, query, parameters)

    monkeypatch.setattr(Database, "read", counted)
    assert len(answer(store, "runs", {})) == min(n_run, 200)
    store.check_rows([row["run"] for row in store.read("SELECT run FROM run")])
    assert len(asked) == 3  # the runs, their rows, and all names once more


def test_p_d_and_rmse_agree_with_the_rows(sent: list[Message]) -> None:
    store, asked = _recorded(sent), {"target": "2", "dwells": "3:6"}
    rows = list(answer(store, "tracks", asked))
    (p_d,) = answer(store, "p_d", asked)
    assert (p_d["first_dwell"], p_d["last_dwell"], p_d["n"]) == (3, 6, 4)
    assert p_d["p_d"] == sum(row["detected"] for row in rows) / 4
    assert p_d["p_d_low"] <= p_d["p_d"] <= p_d["p_d_high"]
    (rmse,) = answer(store, "rmse", asked)
    squares = [(row["x"] - row["x_hat"]) ** 2 + (row["y"] - row["y_hat"]) ** 2 for row in rows]
    assert rmse["position_rmse_km"] == pytest.approx((sum(squares) / 4) ** 0.5, rel=1e-12)


@pytest.mark.parametrize("metric", ["p_d", "rmse", "tracks", "summary"])
def test_without_a_run_the_newest_is_meant_and_all_are_pooled_on_request_only(metric: str, sent: list[Message]) -> None:
    other = play(smoke_start(Strategy.UNIFORM, seed=2, dwells=DWELLS))
    store = _recorded(sent, _called(other, "newer"))
    assert answer(store, metric, {}) == answer(store, metric, {"run": "newer"})
    of_first = answer(store, metric, {"strategy": "power-aware"})
    assert of_first == answer(store, metric, {"run": "r"})
    pooled = answer(store, metric, {"run": "all"})
    assert sorted(map(str, pooled)) == sorted(map(str, [*answer(store, metric, {}), *of_first]))
    assert len(answer(store, "runs", {})) == 2


@pytest.mark.parametrize("metric", ["p_d", "rmse", "tracks", "summary"])
def test_of_equal_runs_the_newest_complete_one_counts(metric: str, sent: list[Message]) -> None:
    """A run that was cancelled, or goes on, does not replace one that is complete."""
    begun = _called(sent[: len(sent) // 2], "begun")
    store = _recorded(sent, _called(sent, "again"), begun)
    assert len(answer(store, "runs", {})) == 3
    assert answer(store, metric, {"run": "all"}) == answer(store, metric, {"run": "again"})
    assert answer(_recorded(begun), metric, {"run": "all"}) == answer(store, metric, {"run": "begun"})


def test_experiments_are_never_pooled(sent: list[Message]) -> None:
    longer = play(smoke_start(dwells=DWELLS + 2, seed=2))
    store = _recorded(sent, _called(longer, "longer"))
    rows = answer(store, "p_d", {"run": "all"})
    assert [(row["scenario"], row["target"], row["runs"], row["n"]) for row in rows] == [
        ("smoke", target, 1, n) for n in (DWELLS, DWELLS + 2) for target in (1, 2)
    ]
    assert answer(store, "p_d", {"run": "all", "seed": "2"}) == rows[2:]


@pytest.mark.parametrize("metric", ["runs", "p_d", "rmse", "tracks", "summary"])
def test_pages_together_are_the_whole(metric: str, sent: list[Message]) -> None:
    other = play(smoke_start(Strategy.UNIFORM, seed=2, dwells=DWELLS))
    store = _recorded(sent, _called(other, "newer"))
    asked = {} if metric == "runs" else {"run": "all"}
    whole, size = answer(store, metric, asked), 3
    pages = [
        answer(store, metric, asked | {"limit": str(size), "offset": str(offset)})
        for offset in range(0, len(whole) + size, size)
    ]
    assert [row for page in pages for row in page] == whole
    assert all(len(page) == size for page in pages[: len(whole) // size])
    assert answer(store, metric, asked | {"offset": "1"}) == whole[1:]


def test_runs_are_chosen_by_scenario_strategy_and_seed(sent: list[Message]) -> None:
    store = _recorded(sent, _called(play(smoke_start(Strategy.UNIFORM, seed=2, dwells=DWELLS)), "newer"))
    for asked in ({"seed": "1"}, {"strategy": "power-aware"}, {"scenario": "smoke", "seed": "1"}):
        assert answer(store, "p_d", asked) == answer(store, "p_d", {"run": "r"})
        assert [row["run"] for row in answer(store, "runs", asked)] == ["r"]
    assert answer(store, "runs", {"seed": "7"}) == []


def test_of_no_run_there_is_nothing_to_say() -> None:
    for metric in ("runs", "p_d", "rmse", "tracks", "summary"):
        assert (
            answer(in_memory(), metric, {})
            == answer(in_memory(), metric, {"run": "all"} if metric != "runs" else {})
            == []
        )


def test_without_truth_what_needs_it_is_unknown(sent: list[Message]) -> None:
    store = _recorded(sent, _blind(sent, "blind"))
    for metric in ("p_d", "rmse"):
        with pytest.raises(BadInput, match=f"run = 'blind': has no truth to compare with, so {metric} is unknown"):
            answer(store, metric, {})
        assert answer(store, metric, {"run": "all"}) == answer(store, metric, {"run": "r"})
    rows = answer(store, "summary", {})
    assert len(rows) == 2
    for row in rows:
        unknown = {"p_d", "p_d_low", "p_d_high", "hit_rate", "in_bin", "outage", "outage_longest", "snr_db", "lost"}
        unknown |= {"position_rmse_km", "velocity_rmse_km_s", "born_t", "gone_t", "visible_t", "confirmed_t"}
        assert {name for name, value in row.items() if value is None} == unknown
        assert (row["n"], row["share"] > 0) == (DWELLS, True)
    tracks = answer(store, "tracks", {})
    assert len(tracks) == 2 * DWELLS
    assert {row["x"] for row in tracks} == {None}
    assert all(row["x_hat"] is not None and row["detected"] in {0, 1} for row in tracks)


@pytest.mark.parametrize("document", ["[]", "{bad"])
def test_a_run_that_cannot_be_read_is_named_with_the_reason(sent: list[Message], document: str) -> None:
    store = _recorded(sent)
    store.journal.write("UPDATE run SET document = ?, status = 'quarantined', reason = 'why'", document)
    with pytest.raises(BadInput, match="run = 'r': cannot be read: "):
        answer(store, "p_d", {})
    (run,) = answer(store, "runs", {})
    assert (run["status"], run["reason"], run["length_s"]) == ("quarantined", "why", 8.0)


@pytest.mark.parametrize(
    ("metric", "parameters", "words"),
    [
        ("speed", {}, "metric = 'speed'"),
        ("p_d", {"target": "0"}, "target = '0'"),
        ("p_d", {"target": "x; DROP TABLE run"}, "target"),
        ("p_d", {"strategy": "best"}, "orthogonal, uniform, power-aware"),
        ("p_d", {"dwells": "5"}, "a:b"),
        ("p_d", {"colour": "red"}, "colour"),
        ("p_d", {"run": "nobody"}, "run = 'nobody': no such run"),
        ("p_d", {"run": "nobody", "target": "0"}, "target = '0'"),
        ("runs", {"target": "1"}, "takes no target"),
        ("runs", {"dwells": "1:2"}, "no dwells"),
        ("p_d", {"seed": "-1"}, "seed = '-1': must be a number from 0"),
        ("p_d", {"limit": "0"}, "limit = '0': must be a number from 1"),
        ("p_d", {"offset": "x"}, "offset = 'x': must be a number from 0"),
        ("p_d", {"scenario": "paper", "seed": "7"}, "no run with scenario = paper, seed = 7"),
    ],
)
def test_bad_questions_are_answered_with_what_is_allowed(metric: str, parameters: dict[str, str], words: str) -> None:
    with pytest.raises(BadInput, match=words):
        answer(in_memory(), metric, parameters)


@pytest.mark.parametrize("run", [{}, {"run": "all"}])
@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"target": "3"}, "target = 3: .* 2 targets"),
        ({"dwells": f"1:{DWELLS + 1}"}, f"dwells = {DWELLS + 1}: .* dwells 1 to {DWELLS}"),
        ({"dwells": "20:"}, f"dwells = 20: .* dwells 1 to {DWELLS}"),
        ({"dwells": "0:2"}, f"dwells = 0: .* dwells 1 to {DWELLS}"),
    ],
)
def test_targets_and_dwells_that_there_are_not_are_bad_questions(
    asked: dict[str, str], words: str, run: dict[str, str], sent: list[Message]
) -> None:
    store = _recorded(sent)
    for metric in ("p_d", "rmse", "tracks", "summary"):
        with pytest.raises(BadInput, match=words):
            answer(store, metric, run | asked)


def test_a_run_or_scenario_of_a_similar_name_is_named(sent: list[Message]) -> None:
    store = _recorded(_called(sent, "smoke-0123456789ab"))
    for parameters, guess in (
        ({"run": "smoke-0123456789ac"}, " (did you mean smoke-0123456789ab?)"),
        ({"scenario": "smkoe", "strategy": "power-aware"}, " (did you mean smoke?)"),
        ({"run": "nobody"}, ""),
        ({"scenario": "smoke", "strategy": "uniform"}, ""),
    ):
        with pytest.raises(BadInput, match=r"no such run|no run with") as caught:
            answer(store, "p_d", parameters)
        assert str(caught.value).endswith(guess)
        assert ("did you mean" in str(caught.value)) == bool(guess)


def test_what_is_for_our_own_programs_is_not_offered(sent: list[Message]) -> None:
    with pytest.raises(BadInput) as caught:
        answer(_recorded(sent), "speed", {})
    assert str(caught.value) == (
        "metric = 'speed': must be one of runs, tracks, p_d, rmse, consistency, confirmation, summary, picture,"
        " antennas, commands"
    )


def test_a_result_has_a_row_per_window_and_target() -> None:
    start = smoke_start(Strategy.UNIFORM, dwells=60)
    store = _recorded(play(start))
    done = result(lambda metric, parameters: answer(store, metric, parameters), start, began=0.0)
    assert done is not None
    assert [[row["n"] for row in window] for window in done.windows] == [[50, 50], [10, 10]]
    assert sum(w[0]["detections"] for w in done.windows) == done.targets[0]["detections"]
    keys = {"run", "scenario", "strategy", "seed", "dwells", "acquisition_scans", "digest", "elapsed_s", "targets"}
    assert set(done.as_json()) == keys | {"false_tracks", *PICTURE, "unmeasured_fault"}
