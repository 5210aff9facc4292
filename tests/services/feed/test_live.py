"""A run on real processes, followed as an observer follows it."""

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import pytest

from cogradar.services.errors import BadInput, Interrupted, NoMetrics
from cogradar.services.feed import source
from cogradar.services.feed.picture import Picture, Wanted
from cogradar.services.feed.source import live
from cogradar.services.runs.cluster import play_on
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy

DWELLS, RATE_HZ, WITHIN_S = 40, 5.0, 120.0
SITE = ["site.latitude_deg=48.35", "site.longitude_deg=11.79", "site.boresight_deg=60"]


def _until(seconds: float) -> Callable[[], None]:
    deadline = time.monotonic() + seconds

    def check() -> None:
        assert time.monotonic() < deadline

    return check


def _played(endpoint: str, start: RunStart, ended: threading.Event | None = None) -> threading.Thread:
    def play() -> None:
        with suppress(Interrupted):
            stop = ended or threading.Event()
            play_on(endpoint, start, report=lambda _: None, notify=lambda _: None, stop=stop)

    thread = threading.Thread(target=play)
    thread.start()
    return thread


@pytest.mark.zenoh
@pytest.mark.slow
def test_a_run_that_begins_is_followed_to_its_end(endpoint: str) -> None:
    start = RunStart.of(load("smoke", SITE), Strategy.POWER_AWARE, 1, DWELLS, RATE_HZ)
    said, found, player = list[str](), list[Picture](), None
    for picture in live(endpoint, None, _until(WITHIN_S), said.append, Wanted()):
        player = player or _played(endpoint, start)  # once the feed listens
        if picture is not None:
            found.append(picture)
            if len(found) > 1 and found[-2].tracks and not picture.tracks:
                break
    assert player is not None
    player.join(WITHIN_S)
    assert (said[0], said[-1]) == ("no run goes on; waiting for one to begin", f"following {start.run}")
    assert {picture.run for picture in found} == {start.run}
    shown = [picture for picture in found if picture.tracks]
    assert len(shown) >= 0.8 * DWELLS
    assert [picture.t for picture in shown] == sorted(picture.t for picture in shown)
    assert shown[-1].t >= DWELLS - 5
    assert all(abs(picture.utc_s - time.time()) < WITHIN_S for picture in shown)
    with pytest.raises(BadInput, match="is over"):
        next(live(endpoint, start.run, _until(5.0), said.append, Wanted()))


@pytest.mark.zenoh
@pytest.mark.slow
def test_a_run_is_followed_on_though_its_messages_come_no_more(endpoint: str, monkeypatch: pytest.MonkeyPatch) -> None:
    connect, made, said = source._connected, list[source._Connection](), list[str]()

    def connected(*args: Any) -> source._Connection:
        made.append(connect(*args))
        return made[-1]

    monkeypatch.setattr(source, "_connected", connected)
    monkeypatch.setattr(source, "SILENT_S", 3.0)
    start = RunStart.of(load("smoke", SITE), Strategy.POWER_AWARE, 2, 20 * DWELLS, RATE_HZ)
    ended = threading.Event()
    player = _played(endpoint, start, ended)
    n_before = n_after = 0
    for picture in live(endpoint, None, _until(WITHIN_S), said.append, Wanted()):
        is_shown = picture is not None and picture.run == start.run and bool(picture.tracks)
        if len(made) == 1:
            n_before += is_shown
            while n_before == 3 and made[0].listener._subscribers:  # a router forgets what this process listens to
                made[0].listener._subscribers.pop().undeclare()
        else:
            n_after += is_shown
        if n_after == 5:
            break
    ended.set()
    player.join(WITHIN_S)
    assert said[-1] == f"nothing was heard of {start.run} for 3 s; connecting anew"


def test_without_services_it_says_so() -> None:
    with pytest.raises(NoMetrics, match="no metrics service"):
        next(live("tcp/127.0.0.1:9", None, _until(20.0), print, Wanted()))
