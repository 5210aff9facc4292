"""All tracks and targets together: from stored messages to what is asked, and Stone Soup's figures of the same run."""

import json
from collections import defaultdict
from typing import Any

import numpy as np
import pytest

from cogradar.services.analysis.report import report
from cogradar.services.analysis.report_tables import tables
from cogradar.services.cli.display import run_caption
from cogradar.services.errors import BadInput
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.experiments import experiments
from cogradar.services.metrics.recording import take
from cogradar.services.metrics.scoring.scorer import Scorer
from cogradar.services.metrics.selection import Selection
from cogradar.services.metrics.store import Store, in_memory
from cogradar.services.runs.in_process import play
from cogradar.services.runs.run import PICTURE, Result
from cogradar.shared.protocol.messages import Plan, RunStart, Scan, Truth, Waveform
from cogradar.shared.protocol.topics import BY_MESSAGE
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.codec import decode, encode, fields
from tests.oracles import stone_soup
from tests.services.loop import play as messages_of
from tests.services.loop import smoke_start

Sent = Plan | Scan | Truth | Waveform
DWELLS = 30


@pytest.fixture(scope="module")
def played() -> tuple[Store, Result]:
    """The published filter: now and then an estimate is more than 5 km off.

    Never in the dwells before and after one alone: Stone Soup can follow no target for a single dwell.
    """
    store = in_memory()
    start = RunStart.of(load("smoke", ["radar.fidelity=paper"]), Strategy.UNIFORM, 7, DWELLS)
    return store, play(start, store=store)


def _stored(store: Store) -> tuple[stone_soup.States, stone_soup.States]:
    """Estimates and truths of the messages, by id and dwell t."""
    tracks, truths = defaultdict[int, dict[int, Any]](dict), defaultdict[int, dict[int, Any]](dict)
    for row in store.read("SELECT payload FROM message WHERE topic IN ('plan', 'truth')"):
        match decode(row["payload"]):
            case Plan(t=t, target=track, estimate=estimate) if t > 0:
                tracks[track][t] = estimate
            case Truth(t=t, states=states) if t > 0:
                for target, state in enumerate(states):
                    truths[target][t] = state
            case _:
                pass
    return tracks, truths


def test_a_stored_run_has_the_figures_that_stone_soup_has(played: tuple[Store, Result]) -> None:
    store, result = played
    theirs = stone_soup.metrics(*_stored(store))
    rows = answer(store, "pictures", {})
    for name in ("localisation", "missed", "false", "ospa"):
        assert [row[f"{name}_km2"] for row in rows] == pytest.approx(getattr(theirs, name), abs=1e-6)
    for name in ("completeness", "ambiguity", "spuriousness"):
        assert result.picture[name] == pytest.approx(getattr(theirs, name), abs=1e-6)
    assert 0.5 < theirs.completeness < 1.0
    assert result.picture["gospa_km"] ** 2 * DWELLS == pytest.approx(
        sum(theirs.localisation) + sum(theirs.missed) + sum(theirs.false), abs=1e-6
    )


def test_the_row_of_a_run_is_that_of_its_json(played: tuple[Store, Result]) -> None:
    store, result = played
    (row,) = answer(store, "picture", {})
    assert row == result.picture
    assert {name: result.as_json()[name] for name in PICTURE} == {name: row[name] for name in PICTURE}
    assert (row["tracks"], row["swaps"], row["false_tracks"], row["dwells"]) == (2, 0, 0, DWELLS)
    assert row["breaks"] > 0
    assert row["gospa_km"] ** 2 == pytest.approx(
        sum(row[f"gospa_{part}_km"] ** 2 for part in ("localisation", "missed", "false"))
    )


@pytest.mark.parametrize("parameters", [{"target": "1"}, {"dwells": "1:9"}])
def test_it_is_about_whole_runs(parameters: dict[str, str], played: tuple[Store, Result]) -> None:
    with pytest.raises(BadInput, match="`picture` is about whole runs: it takes no target and no dwells"):
        answer(played[0], "picture", parameters)


def test_a_campaign_s_store_keeps_it(played: tuple[Store, Result]) -> None:
    store, result = played
    recording = take(store, result.run["run"])
    assert recording is not None
    kept = in_memory()
    kept.journal.add_recording(recording, 1)
    assert answer(kept, "picture", {}) == answer(store, "picture", {})
    assert answer(kept, "pictures", {"offset": "4", "limit": "3"}) == answer(store, "pictures", {})[4:7]


@pytest.fixture(scope="module", params=["lags", "rows"])
def jammed(request: pytest.FixtureRequest) -> tuple[Store, Result]:
    """Beside a jammer the published estimate of the noise is negative in some cells."""
    store = in_memory()
    settings = [
        "world.signal=array",
        f"radar.receiver.noise={request.param}",
        "world.jammers=[{bearing_deg = -70.0, jnr_db = 10.0}]",
    ]
    return store, play(RunStart.of(load("smoke", settings), Strategy.UNIFORM, 1, 20), store=store)


def test_blind_cells_of_a_run_are_counted_and_shown_if_there_are_any(jammed: tuple[Store, Result]) -> None:
    store, result = jammed
    rows = store.read("SELECT payload FROM message WHERE topic = 'scan' ORDER BY k")
    scans = [scan for row in rows if (scan := decode(row["payload"])) and isinstance(scan, Scan) and scan.t > 0]
    blind = [int((scan.sigma_hat == 0.0).sum()) for scan in scans]
    (experiment,), found = experiments(store, Selection.of({})), result.as_json()
    made = report(store, experiment)
    assert result.picture["dwells"] == len(scans)
    assert found["blind_cells"] == sum(blind)
    assert found["blind_dwells"] == sum(n > 0 for n in blind)
    assert found["blind_share"] == sum(blind) / sum(scan.sigma_hat.size for scan in scans)
    is_blind = json.loads(experiment.document)["radar"]["receiver"]["noise"] == "lags"
    assert (found["blind_cells"] > 0) == is_blind
    assert (f"blind cells: {sum(blind)} in " in run_caption(result)) == is_blind
    assert [row["blind_share"] for row in made["picture"]] == [found["blind_share"]]
    assert any(table.title == "Cells whose noise had no estimate" for table in tables(made)) == is_blind


def _pictures(start: RunStart, sent: list[Sent], gone_from: int = 10**6) -> list[dict[str, Any]]:
    """Rows of the table of a run in which the first target is absent from a dwell t on."""
    scorer, found = Scorer(start), []
    for k in sorted({message.k for message in sent}):
        dwell = [(BY_MESSAGE[type(m)].name, fields(encode(m))) for m in sent if m.k == k]
        for topic, content in dwell:
            if topic == "truth" and content["t"] >= gone_from:
                content["bins"], content["states"] = content["bins"].copy(), content["states"].copy()
                content["bins"][0], content["states"][0] = -1, np.nan
        if (scored := scorer.score(k, dwell)) is not None:
            found.append(scored.picture)
    return found


def test_a_track_of_a_target_that_has_gone_is_spurious_and_its_end_no_break() -> None:
    start = smoke_start(dwells=6)
    rows = _pictures(start, [message for message in messages_of(start) if isinstance(message, Sent)], gone_from=4)
    assert [row["t"] for row in rows] == [1, 2, 3, 4, 5, 6]
    assert [(row["targets"], row["tracks"]) for row in rows] == [(2, 2)] * 3 + [(1, 2)] * 3
    assert [row["followed"] for row in rows] == [2, 2, 2, 1, 1, 1]
    assert [row["assigned"] for row in rows] == [row["followed"] for row in rows]
    assert {row["breaks"] for row in rows} == {0}
    assert [row["missed_km2"] for row in rows] == [0.0] * 6
    assert [row["false_km2"] for row in rows] == [0.0] * 3 + [12.5] * 3


def test_without_truth_only_the_tracks_are_counted() -> None:
    start = smoke_start(dwells=4)
    blind = start.model_copy(update={"scenario": start.scenario | {"world": None}})
    rows = _pictures(blind, [message for message in messages_of(start) if isinstance(message, Plan | Scan)])
    assert [(row["tracks"], row["began"]) for row in rows] == [(2, 2), (2, 0), (2, 0), (2, 0)]
    known = {"run", "k", "t", "tracks", "began", "tested", "blind", "unmeasured", "waveform_k", "late"}
    assert {value for row in rows for name, value in row.items() if name not in known} == {None}
