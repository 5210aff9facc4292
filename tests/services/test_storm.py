"""Sixty runs of thirty targets at once, on real processes: nobody is sent again what is only waiting to be read."""

import json
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from cogradar.services import kernels
from cogradar.services.metrics.processes import counts, read
from cogradar.services.runs import cluster, in_process
from cogradar.services.runs.launcher import Launcher, LocalProcesses
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.protocol.topics import Role
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.queries import ask, ask_expositions
from cogradar.shared.wire.session import open_session
from cogradar.shared.wire.zenoh_bus import ZenohBus
from studies.processes.many_targets import many_targets

pytestmark = [pytest.mark.zenoh, pytest.mark.nightly]

RUNS, TARGETS, DWELLS, SEEDS, PLANNERS = 60, 30, 20, 3, 2
WITHIN_S, ANSWER_S = 1800.0, 60.0
AGAIN_SHARE = 0.05  # of all messages; a dwell that takes longer than the recorder's patience costs a scan or two


def _starts() -> list[RunStart]:
    scenario = many_targets(TARGETS)
    return [RunStart.of(scenario, Strategy.POWER_AWARE, 1 + n % SEEDS, DWELLS) for n in range(RUNS)]


def test_sixty_runs_of_thirty_targets_make_no_storm(tmp_path: Path) -> None:
    starts, stop = _starts(), threading.Event()
    kernels.compile_all(lambda _: None)
    alone = [in_process.play(start).run["digest"] for start in starts[:SEEDS]]
    sent = Counter[str]()
    with (
        Launcher(LocalProcesses(PLANNERS, str(tmp_path / "store.db")), stop) as launcher,
        open_session([launcher.endpoint], ANSWER_S, launcher.check) as session,
    ):
        cluster.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
        operator = ZenohBus(session, Role.OPERATOR, "operator-storm", reads=False)
        operator.publish(*starts)
        deadline, rows = time.monotonic() + WITHIN_S, list[dict[str, Any]]()
        while sum(row["status"] == "complete" for row in rows) < RUNS:
            assert time.monotonic() < deadline, [(row["run"], row["status"], row["t"]) for row in rows]
            time.sleep(2.0)
            rows = json.loads(ask(session, "runs", {}, ANSWER_S, launcher.check))
        for _, text in ask_expositions(session, ANSWER_S, 1 << 20):
            for (name, _, _), value in counts(read(text)).items():
                sent[name] += int(value) if name.startswith("cogradar_messages") else 0
        operator.close()
    assert {row["run"]: row["digest"] for row in rows} == {
        start.run: alone[n % SEEDS] for n, start in enumerate(starts)
    }
    assert sent["cogradar_messages_dropped_total"] == 0, sent
    share = sent["cogradar_messages_redelivered_total"] / sent["cogradar_messages_sent_total"]
    assert share < AGAIN_SHARE, sent
