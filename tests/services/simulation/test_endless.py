"""A run without an end in simulated time: cut behind itself, and resumed after a restart of everything."""

import pytest

from cogradar.services.planner import owned_track
from cogradar.services.recorder import kept_span
from cogradar.services.recorder.journal import Retention
from cogradar.services.simulation.cluster import Cluster
from cogradar.services.simulation.disk import Disk
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.limits import NO_END
from cogradar.shared.scenario.radar_config import Strategy

NAMES = ("recorder-0", "emulator-0", "allocator-0", "planner-0", "planner-1")
UNKNOWN = ("radar.fidelity=best-range", 'radar.tracks="unknown"', "radar.search.beams=2", "world.repeat_s=50")
DWELLS, RESTARTS = 220, (80, 160)
Messages = dict[tuple[int, str, int], bytes]


def _played(keep: Retention, restarts: tuple[int, ...]) -> tuple[int, Messages]:
    """Play until so many dwells are acknowledged, and kill all processes on the way; the oldest dwell, and messages."""
    disk = Disk(generator(1, Purpose.FAULT, -1, 2))
    cluster, left = Cluster(1, disk, keep=keep), list(restarts)
    for name in NAMES:
        cluster.start(name)
    start = RunStart.of(load("smoke", UNKNOWN), Strategy.POWER_AWARE, 1, NO_END)
    cluster.ask([start.model_copy(update={"run": "endless"})])
    k = 0
    while k < DWELLS and cluster.step(600.0):
        rows = disk.journal.read("SELECT acknowledged_k AS k, kept_k FROM run")
        k, kept_k = (rows[0]["k"], rows[0]["kept_k"]) if rows else (0, 0)
        if left and k >= left[0]:
            del left[0]
            for name in NAMES:
                cluster.kill(name)
            for name in NAMES:
                cluster.start(name)
    assert not left
    kept = disk.journal.rows("SELECT k, topic, item, payload FROM message WHERE k < ?", [DWELLS])
    found = {(row[0], row[1], row[2]): bytes(row[3]) for row in kept}
    disk.close()
    return kept_k, found


def test_cut_behind_itself_and_restarted_it_is_the_run_that_it_is_if_kept_whole(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(kept_span, "ALWAYS_DWELLS", 32)
    monkeypatch.setattr(owned_track, "SNAPSHOT_DWELLS", 16)
    _, whole = _played(Retention(), ())
    kept_k, cut = _played(Retention(bytes_of_run=1), RESTARTS)
    assert 100 < kept_k <= DWELLS
    assert cut == {key: payload for key, payload in whole.items() if key[0] >= kept_k}
