"""A run without an end that is stopped goes on from its store."""

import json
import threading
from pathlib import Path

import pytest

from cogradar.services.errors import BadInput, Interrupted
from studies.soak import endless


def test_a_run_that_was_stopped_goes_on_from_its_store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(endless, "SAMPLE_DWELLS", 40)
    store, stop = str(tmp_path / "week.db"), threading.Event()
    with pytest.raises(Interrupted, match="keeps what was played"):
        endless.play(10.0, 1, lambda _: stop.set(), stop, store=store)
    kept = Path(f"{store}.samples.jsonl")
    kept.write_text(kept.read_text() + '{"dwells": ')  # of a sample whose writing a power cut ended
    whole = endless.play(10.0, 1, lambda _: None, threading.Event(), dwells=150, store=store).samples
    assert [json.loads(line)["dwells"] for line in kept.read_text().splitlines()] == [one.dwells for one in whole]
    assert [sample.start for sample in whole] == [0] + [1] * (len(whole) - 1)
    assert 0 < whole[0].dwells < whole[1].dwells < whole[2].dwells
    assert whole[-2].dwells < 150 <= whole[-1].dwells == whole[-1].kept
    assert whole[-1].next_track > whole[0].next_track


def test_a_store_of_something_else_is_refused(tmp_path: Path) -> None:
    store = tmp_path / "week.db"
    store.write_text("")
    with pytest.raises(BadInput, match=r"no week\.db\.samples\.jsonl beside it"):
        endless.play(1.0, 1, lambda _: None, threading.Event(), store=str(store))
    (tmp_path / "week.db.samples.jsonl").write_text('{"dwells": 3}\n')
    with pytest.raises(BadInput, match="no samples of this study"):
        endless.play(1.0, 1, lambda _: None, threading.Event(), store=str(store))


def test_memory_that_grows_within_a_start_is_seen_though_it_begins_anew_with_each() -> None:
    samples = [
        endless.Sample(500 * n, start, 200.0 + 10.0 * n, 50.0, 3.0, 9.0, 500, 1)
        for start, most in ((0, 30), (1, 20), (2, 10))
        for n in range(most)
    ]
    assert endless.Endless(1.0, samples).faults == ["memory: 345.0 MiB, then 445.0"]
