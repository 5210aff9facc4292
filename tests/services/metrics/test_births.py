"""Scores of tracks that begin and end: which follows which target is found in each dwell, as in the air picture."""

from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from cogradar.services.analysis.report import report
from cogradar.services.cli.display import run_caption, run_tables
from cogradar.services.errors import BadInput
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.experiments import experiments
from cogradar.services.metrics.selection import Selection
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.runs.run import Result, progress, result
from cogradar.services.web.schemas import ConfirmationRow, RunRow, SummaryRow
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Message, Plan, RunStart, Truth
from cogradar.shared.scoring.figures import LONG_VISIBLE
from tests.services.births import FAR, HERE, THERE, States, end, plan, roster, scan, start_of, truth, waveform
from tests.services.loop import smoke_start

# By dwell t: tracks and their states, those of them that are confirmed, targets and their states, and who is detected.
# Track 1 follows target 1 in dwells 3 and 4, then flies elsewhere and ends in 6; track 3 follows it from 7 on. Track 2,
# on target 2 while that is there, in dwells 2 to 6, is never confirmed.
Dwell = tuple[States, Sequence[int], States, Sequence[Sequence[float]]]
DWELLS: Sequence[Dwell] = (
    ({}, (), {0: HERE}, [HERE]),
    ({0: HERE}, (), {0: HERE, 1: THERE}, [HERE]),
    ({0: HERE, 1: THERE}, (0,), {0: HERE, 1: THERE}, [HERE, THERE]),
    ({0: HERE, 1: THERE}, (0,), {0: HERE, 1: THERE}, [HERE]),
    ({0: FAR, 1: THERE}, (0,), {0: HERE, 1: THERE}, []),
    ({0: FAR, 1: THERE, 2: HERE}, (0,), {0: HERE, 1: THERE}, [HERE]),
    ({2: HERE}, (2,), {0: HERE}, [HERE]),
    ({2: HERE}, (2,), {0: HERE}, []),
)
N = len(DWELLS)


def _messages() -> list[Message]:
    sent: list[Message] = []
    for k, (tracks, confirmed, targets, over) in enumerate(DWELLS):
        later = DWELLS[min(k + 1, N - 1)][0]
        of_scan = roster(tracks, confirmed=[m for m in DWELLS[k - 1][1] if m in tracks] if k else ())
        sent += [scan(k, of_scan, over), truth(k, targets)]
        for m, state in tracks.items():
            ended = m not in later
            sent.append(plan(k, m, state, status="ended" if ended else "tracking", confirmed=m in confirmed))
        sent.append(waveform(k, roster(later, confirmed=[m for m in confirmed if m in later])))
    return sent


def _stored(sent: Sequence[Message], start: RunStart, ticks: int = 2) -> Store:
    store = in_memory()
    core = RecorderCore(store.journal)
    for message in [start, *sent]:
        core.handle(message)
    for _ in range(ticks):
        core.handle(Tick(0.0))
    return store


@pytest.fixture(scope="module")
def store() -> Store:
    return _stored([*_messages(), end(N)], start_of(N))


@pytest.fixture(scope="module")
def done(store: Store) -> Result:
    found = result(lambda metric, asked: answer(store, metric, asked), start_of(N), began=0.0)
    assert found is not None
    return found


def _column(store: Store, target: int, name: str) -> list[Any]:
    return [row[name] for row in answer(store, "tracks", {"target": str(target)})]


def test_the_track_of_a_target_is_the_one_that_follows_it_in_the_dwell(store: Store) -> None:
    assert _column(store, 1, "track") == [None, None, 1, 1, None, None, 3, 3]
    assert _column(store, 2, "track") == N * [None]
    rows = answer(store, "tracks", {"target": "1"})
    for row in rows:
        has_track = row["track"] is not None
        assert all((row[name] is not None) == has_track for name in ("x_hat", "bin", "best_bin"))
        assert (len(row["cells"]), row["share"]) == ((1, pytest.approx(0.2)) if has_track else (0, 0.0))
    pictures = answer(store, "pictures", {})
    assert [row["tracks"] for row in pictures] == [0, 0, 1, 1, 1, 0, 1, 1]
    assert [row["began"] for row in pictures] == [0, 0, 1, 0, 0, 0, 1, 0]
    assert sum(row["followed"] for row in pictures) == 4


def test_detected_is_whoever_asked_for_it(store: Store) -> None:
    """The first one by the search, before there is any track."""
    assert _column(store, 1, "detected") == [1, 1, 1, 1, 0, 1, 1, 0]
    assert _column(store, 2, "detected") == [None, 0, 1, 0, 0, 0, None, None]
    assert _column(store, 1, "hit") == [0, 0, 1, 1, 0, 0, 1, 1]


def test_outages_begin_when_a_target_was_followed(store: Store) -> None:
    assert _column(store, 1, "outage") == [None, None, 0, 0, 1, 2, 0, 0]
    assert _column(store, 2, "outage") == N * [None]


def test_p_d_and_errors_are_of_the_dwells_since_the_target_was_followed_first(store: Store, done: Result) -> None:
    first, second = done.targets
    assert [row[name] for row in (first, second) for name in ("born_t", "gone_t", "confirmed_t")] == [
        *(1, None, 3),
        *(2, 7, None),
    ]
    assert (first["n"], first["detections"], first["p_d"]) == (6, 4, pytest.approx(4 / 6))
    assert (first["in_bin"], first["hit_rate"]) == (pytest.approx(4 / 6), pytest.approx(4 / 6))
    assert (first["outage"], first["outage_longest"], first["lost"], first["tracked"]) == (2, 2, False, True)
    assert first["position_rmse_km"] == 0.0
    assert (second["n"], second["p_d"], second["lost"], second["tracked"]) == (0, None, None, False)
    assert not first["false_track"]
    assert not second["false_track"]
    (p_d, none), (rmse, unknown) = (answer(store, metric, {}) for metric in ("p_d", "rmse"))
    assert (p_d["n"], p_d["p_d"], none["n"], none["p_d"]) == (6, first["p_d"], 0, None)
    assert (rmse["n"], rmse["position_rmse_km"], unknown["position_rmse_km"]) == (6, 0.0, None)


def test_time_from_visible_to_confirmed(store: Store) -> None:
    """Target 1 is visible in all dwells and confirmed in the third; target 2, in dwells 2 to 6, never is."""
    assert _column(store, 1, "visible") == N * [1]
    assert _column(store, 2, "visible") == [None, 1, 1, 1, 1, 1, None, None]
    assert [row["visible_t"] for row in answer(store, "summary", {})] == [1, 2]
    (row,) = answer(store, "confirmation", {})
    expected = {"scenario": "smoke", "strategy": "power-aware", "runs": 1}
    expected |= {"targets": 2, "confirmed": 1, "confirmation_median_s": 2.0, "confirmation_95_s": 2.0}
    assert row == expected | {"long_visible": 0, "never_found": 0}
    ConfirmationRow.model_validate(row)
    with pytest.raises(BadInput, match="`confirmation` is about whole runs"):
        answer(store, "confirmation", {"dwells": "1:4"})


def test_a_target_without_a_track_was_never_found_after_twenty_dwells() -> None:
    store = _stored(_unseen(LONG_VISIBLE), start_of(LONG_VISIBLE))
    (row,) = answer(store, "confirmation", {})
    assert [row[name] for name in ("targets", "confirmed", "confirmation_median_s", "long_visible", "never_found")] == [
        *(1, 0, None, 1, 1),
    ]
    (one,) = experiments(store, Selection(run="all"))
    (of_report,) = report(store, one)["confirmation"]
    assert (of_report["never_found"], of_report["share"], of_report["share_high"]) == (1, 1.0, 1.0)
    assert 0.2 < of_report["share_low"] < 0.21
    store = _stored(_unseen(LONG_VISIBLE - 1), start_of(LONG_VISIBLE - 1))
    assert answer(store, "confirmation", {})[0]["never_found"] == 0


def _unseen(dwells: int) -> list[Message]:
    """A target that the radar never sees."""
    nothing = roster({})
    sent = [m for k in range(dwells) for m in (scan(k, nothing), truth(k, {0: HERE}), waveform(k, nothing))]
    return [*sent, end(dwells)]


def test_of_a_known_number_the_acquisition_says_how_long_it_took() -> None:
    store = in_memory()
    store.journal.add_run(smoke_start())
    assert answer(store, "confirmation", {"run": "all"}) == []


def test_pages_have_the_rows_that_are_not_scored_too(store: Store) -> None:
    rows = answer(store, "tracks", {})
    assert len(rows) == 2 * N
    pages = [answer(store, "tracks", {"offset": str(i), "limit": "3"}) for i in range(0, 2 * N, 3)]
    assert [row for page in pages for row in page] == rows


@pytest.mark.parametrize("dwells", ["1:2", "3:5", "5:8"])
def test_any_dwells_can_be_asked_about(dwells: str, store: Store) -> None:
    first, last = map(int, dwells.split(":"))
    row, _ = answer(store, "summary", {"dwells": dwells})
    assert row["n"] == len(range(max(first, 3), last + 1))
    assert (row["born_t"], row["gone_t"], row["confirmed_t"]) == (1, None, 3)  # of the whole run


def test_the_json_of_a_run_says_when_each_target_was_there_and_found(done: Result) -> None:
    found = done.as_json()
    names = ("target", "born_t", "gone_t", "confirmed_t", "in_bin", "outage_longest", "lost")
    assert [[row[name] for name in names] for row in found["targets"]] == [
        [1, 1, None, 3, pytest.approx(4 / 6), 2, False],
        [2, 2, 7, None, None, None, None],
    ]
    assert (found["tracks"], found["swaps"], found["acquisition_scans"]) == (2, 0, 0)
    assert found["false_tracks"] == 2  # neither followed its target in three dwells in a row
    assert found["false_tracks_per_hour"] == pytest.approx(2 * 3600.0 / N)


def test_the_terminal_says_what_was_never_followed(done: Result) -> None:
    assert [table.title for table in run_tables(done)] == [
        "target 1, followed from dwell 3, out of its bin for 2 dwells, at most 2 in a row"
    ]
    assert run_caption(done).endswith("\nnever followed: target 2")


def test_rows_fit_their_description(store: Store) -> None:
    for row in answer(store, "runs", {}):
        assert (RunRow.model_validate(row).tracks, row["targets"]) == (None, 2)
    for row in answer(store, "summary", {}):
        SummaryRow.model_validate(row)


WAITING: Mapping[str, tuple[int, str]] = {
    "plans": (-3, "a planner: plan of track 1, 2 at dwell 3"),
    "a plan": (-2, "a planner: plan of track 2 at dwell 3"),
    "the waveform": (-1, "the allocator: waveform of dwell 3"),
}


@pytest.mark.parametrize(("until", "words"), WAITING.values(), ids=WAITING.keys())
def test_a_run_that_goes_on_says_how_many_tracks_are_confirmed(until: int, words: str) -> None:
    store = _stored([m for m in _messages() if getattr(m, "k", 0) <= 3][:until], start_of(N))
    now = progress(lambda metric, asked: answer(store, metric, asked), start_of(N))
    assert now is not None
    assert (now.confirmed, now.waiting_for) == (1, words)


def test_a_track_whose_plan_is_late_has_flown_on() -> None:
    late = [m for m in _messages() if not (isinstance(m, Plan) and m.k == 3)]
    store = _stored([*late, end(N)], start_of(N, rate_hz=10.0), ticks=20)
    assert _column(store, 1, "track") == [None, None, 1, 1, None, None, 3, 3]
    assert _column(store, 1, "x_hat")[3] == pytest.approx(HERE[0] + HERE[1])  # a second later


def test_without_truth_only_the_confirmed_tracks_are_counted() -> None:
    blind = start_of(N)
    blind = blind.model_copy(update={"scenario": blind.scenario | {"world": None}})
    store = _stored([*(m for m in _messages() if not isinstance(m, Truth)), end(N)], blind)
    assert answer(store, "tracks", {}) == []
    (row,) = answer(store, "picture", {})
    assert (row["tracks"], row["false_tracks"]) == (2, None)
    found = result(lambda metric, asked: answer(store, metric, asked), blind, began=0.0)
    assert found is not None
    assert (found.targets, found.false_tracks) == ([], None)
    assert "no truth" in run_caption(found)
