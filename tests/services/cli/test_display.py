"""What the terminal shows: literally, within its width, and saying what its numbers mean."""

import io
import shlex
from dataclasses import replace
from typing import Any

import pytest
from rich.console import Console

from cogradar.services.campaigns.campaign import Tally
from cogradar.services.cli.display import (
    RunDisplay,
    campaign_caption,
    next_step,
    outcome,
    run_caption,
    run_digest,
    run_tables,
)
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.store import in_memory
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.runs.run import Progress, Result, result, window
from cogradar.shared.protocol.orders import PAUSED
from tests.services.loop import play, smoke_start
from tests.services.tables import assert_shown_whole, shown

TRICKY = "[red]/tmp/[/red] [bold]x[/] [link=y] :warning: [0]"


def _console(width: int = 100) -> Console:
    """With all that a user's terminal has: markup is on unless the display sees to it."""
    return Console(file=io.StringIO(), width=width, force_terminal=True, color_system=None, legacy_windows=False)


def _shown(console: Console) -> str:
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def _finished(dwells: int) -> Result:
    store = in_memory()
    core = RecorderCore(store.journal)
    start = smoke_start(dwells=dwells)
    for message in play(start):
        core.handle(message)
    done = result(lambda metric, parameters: answer(store, metric, parameters), start, began=0.0)
    assert done is not None
    return done


@pytest.fixture(scope="module")
def finished() -> Result:
    return _finished(60)


def _row(target: int, **values: Any) -> dict[str, Any]:
    return {"target": target, "n": 300, "p_d": 1.0, "position_rmse_km": 99.94, "velocity_rmse_km_s": 0.123} | values


def test_a_line_that_is_said_is_shown_as_it_is() -> None:
    console = _console()
    with RunDisplay(console, 10) as display:
        display.notify(TRICKY)
    assert TRICKY in _shown(console)


def test_what_a_run_waits_for_is_shown_as_it_is() -> None:
    console = _console()
    with RunDisplay(console, 10) as display:
        display.report(Progress(0, 10, 3, TRICKY, []))
    assert TRICKY in _shown(console)
    assert "acquiring, 4 scans" in _shown(console)


def test_what_a_run_waits_for_is_cut_between_words_and_says_so() -> None:
    console, waits = _console(80), f"a planner: plan of track {', '.join(map(str, range(1, 13)))} at dwell 3"
    with RunDisplay(console, 10) as display:
        display.report(Progress(0, 10, 3, waits, []))
    line = next(line for line in _shown(console).splitlines() if "a planner" in line)
    assert len(line.rstrip()) <= 80
    assert line.rstrip().endswith(", ...")


def test_of_an_unknown_number_of_tracks_the_live_line_says_how_many_are_confirmed() -> None:
    console = _console()
    with RunDisplay(console, 10) as display:
        display.report(Progress(4, 10, 3, "", [_row(1)], confirmed=7))
    assert "7 tracks" in _shown(console)


def test_the_live_line_has_both_errors_of_three_targets_in_110_characters() -> None:
    console = _console(110)
    with RunDisplay(console, 300) as display:
        for t in (298, 299, 300):
            display.report(Progress(t, 300, t, "", [_row(1), _row(2, p_d=0.94), _row(3)]))
    line = next(line for line in reversed(_shown(console).splitlines()) if "T1" in line)
    assert all(words in line for words in ("300/300", "T1 1.00 99.9km 123m/s", "T2 0.94", "T3 1.00 99.9km 123m/s"))


def test_a_live_line_that_is_too_short_for_all_targets_has_the_worst_and_says_how_many_are_left_out() -> None:
    console = _console(80)
    rows = [_row(m, p_d=0.5 if m == 11 else 1.0) for m in range(1, 13)]
    with RunDisplay(console, 300) as display:
        for t in (298, 299, 300):
            display.report(Progress(t, 300, t, "", rows))
    lines = _shown(console).splitlines()
    assert max(map(len, lines)) <= 80
    line = next(line for line in reversed(lines) if "T11" in line)
    assert all(words in line for words in ("300/300", "T11 0.50 99.9km 123m/s", "+11 more", "━", "/s"))


def test_there_is_a_table_per_target_with_its_acquisition_and_its_windows(finished: Result) -> None:
    scans = finished.run["acquisition_scans"]
    for m, (table, row) in enumerate(zip(run_tables(finished), finished.targets, strict=True), 1):
        assert_shown_whole([table])
        text = shown(table, 80)
        assert text.startswith(f"target {m}, acquired in {scans} scan")
        assert all(words in text for words in ("1-50", "51-60", "P_D", "RMSE km", "m/s", "in bin", "SNR dB"))
        line = next(line for line in text.splitlines() if "all 60" in line)
        assert line.split()[2:5] == [f"{row[key]:.3f}" for key in ("p_d", "p_d_low", "p_d_high")]
        assert line.split()[6:8] == [f"{row['position_rmse_km']:.3f}", f"{1000 * row['velocity_rmse_km_s']:.1f}"]


def test_a_run_of_one_window_has_one_row_per_target(finished: Result) -> None:
    short = _finished(50)
    assert [len(table.rows) for table in run_tables(short)] == [1, 1]
    assert [len(table.rows) for table in run_tables(finished)] == [3, 3]
    assert "windows" not in run_caption(short)
    assert "windows of 50 dwells" in run_caption(finished)


@pytest.mark.parametrize(("dwells", "width"), [(1, 50), (300, 50), (301, 100), (1200, 200), (100_000, 16_700)])
def test_a_long_run_has_no_more_than_six_windows(dwells: int, width: int) -> None:
    assert window(dwells) == width
    assert 0 < dwells <= 6 * width


def test_a_lost_target_is_marked_and_the_caption_says_what_that_means(finished: Result) -> None:
    lost = Result(finished.run, [row | {"lost": row["target"] == 2} for row in finished.targets], [], {}, 1.0)
    assert ["LOST" in table.title for table in run_tables(lost)] == [False, True]
    assert "LOST: the track" in run_caption(lost)
    assert "LOST" not in run_caption(finished)


@pytest.mark.parametrize("conflicts", [0, 2])
def test_messages_that_differed_are_a_warning(conflicts: int, finished: Result) -> None:
    found = replace(finished, run=finished.run | {"conflicts": conflicts})
    warned = f"WARNING: {conflicts} messages differed"
    for caption in (run_caption(found), campaign_caption(Tally(3, 3), conflicts, "0")):
        assert (warned in caption) == (conflicts > 0)


def test_the_caption_says_what_the_intervals_mean(finished: Result) -> None:
    caption = run_caption(finished)
    assert all(words in caption for words in ("Wilson", "one run", "independent", "campaign"))
    assert run_digest(finished) == f"digest {finished.run['digest']}"


def test_nothing_moves_in_a_pipe() -> None:
    console = Console(file=io.StringIO(), width=80)
    with RunDisplay(console, 10) as display:
        display.report(Progress(1, 10, 3, "", [_row(1)]))
        display.notify("a line")
    assert _shown(console) == "a line\n"


def test_in_a_pipe_a_long_run_says_now_and_then_how_far_it_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 0.0
    monkeypatch.setattr("time.monotonic", lambda: now_s)
    with RunDisplay(Console(file=io.StringIO(), width=80), 100) as display:
        for t in range(100):
            now_s = float(t)
            display.report(Progress(t, 100, t, "", [_row(1)]))
    assert capsys.readouterr().err.splitlines() == ["dwell 30 of 100", "dwell 60 of 100", "dwell 90 of 100"]


def test_stale_waveforms_are_told_of_while_they_happen_and_once() -> None:
    console = Console(file=io.StringIO(), width=80)
    with RunDisplay(console, 100) as display:
        for t, stale in ((10, 0.9), (30, 0.1), (40, 0.9), (50, 0.95)):
            display.report(Progress(t, 100, t, "", [_row(1, stale=stale)]))
    (line,) = _shown(console).splitlines()
    assert line == "90 % of the waveforms came too late so far: a lower --rate gives them more time"


def test_why_nothing_is_measured_is_told_while_it_happens_and_not_too_often(monkeypatch: pytest.MonkeyPatch) -> None:
    console, now_s = Console(file=io.StringIO(), width=80), 0.0
    monkeypatch.setattr("time.monotonic", lambda: now_s)
    with RunDisplay(console, 100) as display:
        for t, fault in ((0, ""), (1, "no answer"), (5, "it is hot"), (30, "no answer"), (35, ""), (40, "it is hot")):
            now_s = float(t)
            display.report(Progress(t, 100, t, "", [_row(1)], fault=fault))
    assert _shown(console).splitlines() == ["not measured: no answer", "not measured: it is hot"]


def test_a_fault_right_after_a_pause_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """The pause had the only line of ten seconds, and the fault was over by then."""
    console, said = _console(), list[str]()
    with RunDisplay(console, 100) as display:
        monkeypatch.setattr(display, "notify", said.append)
        for t, fault in enumerate((PAUSED, "", "PLL not locked", "it is hot")):
            display.report(Progress(t, 100, t, "", [_row(1)], fault=fault))
    assert said == [f"not measured: {PAUSED}", "not measured: PLL not locked"]


def test_a_run_that_was_slower_than_its_rate_says_so(finished: Result) -> None:
    in_time = replace(finished, run=finished.run | {"rate_hz": 10.0}, elapsed_s=6.2)
    assert "dwells a second were made" not in run_caption(in_time)
    slow = replace(in_time, elapsed_s=30.0)
    assert "dwells a second were made of 10: the front end, or this machine, is slower" in run_caption(slow)
    lost = replace(slow, picture=slow.picture | {"dwells": 41}, targets=[row | {"p_d": None} for row in slow.targets])
    assert "41 of 60 dwells stored" in run_caption(lost)
    assert outcome(lost).startswith("41 of 60 dwells were made")


def test_a_run_without_truth_says_so_instead_of_dashes(finished: Result) -> None:
    unknown = {"p_d": None, "p_d_low": None, "p_d_high": None, "in_bin": None, "outage": None, "lost": None}
    blind = Result(finished.run, [row | unknown for row in finished.targets], [], {}, 1.0)
    assert "this run has no truth to compare with: P_D and errors are unknown" in run_caption(blind)
    assert "Wilson" not in run_caption(blind)
    assert [column.heading for column in run_tables(blind)[0].columns] == ["dwells", "power"]


def test_what_to_type_next_can_be_pasted(finished: Result) -> None:
    result = replace(finished, run=finished.run | {"run": "smoke-1"})
    assert "--store FILE" in next_step("cogradar", result, None, None)
    head, *typed = shlex.split(next_step("./cogradar", result, "a b.db", None))
    assert (head, typed) == ("next:", ["./cogradar", "figures", "a b.db", "--out", "figures"])
    for other in ({"status": "stopped"}, {"t": result.run["t"] + 1}):  # figures need all dwells of a complete run
        asked = shlex.split(next_step("./cogradar", replace(result, run=result.run | other), "a b.db", None))
        assert asked[1:] == ["./cogradar", "query", "summary", "--run", "smoke-1", "--store", "a b.db"]
    blind = replace(result, picture={}, targets=[row | {"p_d": None} for row in result.targets])
    asked = shlex.split(next_step("./cogradar", blind, "a b.db", None))  # figures compare with the truth
    assert asked[1:] == ["./cogradar", "query", "tracks", "--run", "smoke-1", "--store", "a b.db"]
    many = replace(blind, run=blind.run | {"tracks": None})  # rows of `tracks` are of targets
    asked = shlex.split(next_step("./cogradar", many, "a b.db", None))
    assert asked[1:] == ["./cogradar", "export", "smoke-1", "--store", "a b.db", "--out", "tracks.csv"]
    assert next_step("cogradar", result, None, "tcp/a:1").endswith("query tracks --run smoke-1 --connect tcp/a:1")
    assert next_step("cogradar", result, None, "tcp/a:1", "http://a:80").endswith(
        "http://a:80/api/v1/runs/smoke-1/summary"
    )


def test_a_run_says_what_happened_first(finished: Result) -> None:
    first, second = finished.targets
    errors = sorted(row["position_rmse_km"] for row in finished.targets)
    assert outcome(finished).startswith("All 2 targets were tracked to the end. P_D ")
    assert f"position RMSE {errors[0]:.3f} to {errors[1]:.3f} km." in outcome(finished)
    lost = replace(finished, targets=[first, second | {"lost": True}])
    assert outcome(lost).startswith("1 of 2 targets was lost: 2. P_D ")
    alone = replace(finished, targets=[first])
    assert outcome(alone).startswith(f"The only target was tracked to the end. P_D {first['p_d']:.3f}, ")
    blind = replace(finished, picture={}, targets=[row | {"p_d": None} for row in finished.targets])
    assert outcome(blind) == f"{finished.run['t']} dwells were made."
