"""A run on real processes that a fusion node commands."""

import socket
import threading
import time
from contextlib import ExitStack, closing

import pytest

from cogradar.services.errors import Interrupted
from cogradar.services.feed.feed import FORMATS, Options, Tally, feed
from cogradar.services.feed.picture import Wanted
from cogradar.services.feed.sapient.tasking import ACCEPTED, COMPLETED, REJECTED, Commander
from cogradar.services.feed.source import live
from cogradar.services.metrics.client import ask_service
from cogradar.services.runs import cluster as distributed
from cogradar.services.runs.cancel import cancel_on
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.radar_config import Strategy
from tests.services.feed.fusion import STOP, WITHIN_S, Fusion
from tests.services.feed.made import SITE
from tests.services.feed.test_sapient import FUSION
from tests.skies import small_sky

RATE_HZ = 10.0


@pytest.mark.zenoh
@pytest.mark.slow
def test_a_fusion_node_pauses_looks_and_is_refused(endpoint: str) -> None:
    start = RunStart.of(
        small_sky("radar.search.beams=4", "radar.motion.dt_s=0.1"), Strategy.POWER_AWARE, 1, 100_000, RATE_HZ
    )
    distributed.start_on(endpoint, start, notify=lambda _: None, stop=threading.Event())
    stop = threading.Event()

    def check() -> None:
        if stop.is_set():
            raise Interrupted("")

    def told(port: int, commander: Commander) -> None:
        kind, said = FORMATS["sapient"], list[str]()
        form = kind.make(Options(command=commander, notify=said.append))
        way = kind.way(f"tcp://127.0.0.1:{port}", form, said.append)
        with closing(way), pytest.raises(Interrupted):
            feed(live(endpoint, start.run, check, said.append, Wanted(site=SITE)), form, way, 10.0, Tally())

    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        closing(Commander(endpoint)) as commander,
        ExitStack() as opened,
    ):
        server.settimeout(WITHIN_S)
        feeding = threading.Thread(target=told, args=(server.getsockname()[1], commander))
        feeding.start()
        try:
            fusion = opened.enter_context(closing(Fusion(server)))
            fusion.send()
            fusion.until("status_report", mode="search and track")
            fusion.task(1, command={"mode_change": "pause"})
            assert "pause from dwell" in fusion.until("task_ack", task_status=ACCEPTED).reason[0]
            fusion.until("status_report", mode="pause")
            fusion.task(1, STOP)
            assert "resume from dwell" in fusion.until("task_ack", task_status=COMPLETED).reason[0]
            fusion.until("status_report", mode="search and track")
            area = {"range_bearing": {"azimuth": SITE.boresight_deg, "coordinate_system": 1, "datum": 1}}
            fusion.task(2, command={"look_at": area}, task_end_time={"seconds": round(time.time()) + 8})
            assert "look 0 " in fusion.until("task_ack", task_status=ACCEPTED).reason[0]
            fusion.task(3, command={"request": "drop 5000"})
            assert "there is no track 5000" in fusion.until("task_ack", task_status=REJECTED).reason[0]
            assert "look 0 " in fusion.until("task_ack", task_status=COMPLETED).reason[0]
        finally:
            stop.set()
            feeding.join(WITHIN_S)
    rows = ask_service(endpoint, "commands", {"run": start.run})
    assert [row["action"].split()[0] for row in rows] == ["pause", "resume", "look", "drop"]
    assert all(row["by"].endswith(f" for SAPIENT {FUSION}") for row in rows)
    cancel_on(endpoint, start.run)
