"""With nothing found, the log says each half minute how near the search came to it."""

import logging

import pytest

from cogradar.services.planner.core import TELL_S, PlannerCore
from cogradar.services.planner.ownership import owners
from cogradar.shared.protocol.events import Membership, Tick
from cogradar.shared.protocol.messages import Message, RunEnd, RunStart, Scan
from cogradar.shared.protocol.topics import Role
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from tests.lossy import lossy
from tests.services.loop import checkpoint, play, scans
from tests.skies import sky_start

WEAK = ("radar.echo.amplitude_db=65", "world.echo.amplitude_db=40", "radar.acquisition.max_scans=12")


def _weak() -> RunStart:
    """Echoes are 25 dB weaker than the radar is told."""
    return RunStart.of(load("smoke", WEAK), Strategy.POWER_AWARE, 1, 4).model_copy(update={"run": "r"})


def _told(said: list[Message], start: RunStart, names: tuple[str, ...], caplog: pytest.LogCaptureFixture) -> list[str]:
    """What planners of these names log in two minutes, in which all the scans come at first."""
    caplog.clear()
    with caplog.at_level(logging.INFO):
        for name in names:
            core = PlannerCore(name)
            core.handle(Membership(Role.PLANNER, names))
            list(core.handle(checkpoint(start)))
            for scan in scans(said):
                list(core.handle(scan))
            for second in range(121):
                list(core.handle(Tick(float(second))))
    return [record.getMessage() for record in caplog.records if "scans" in record.getMessage()]


def test_an_acquisition_of_too_weak_echoes_says_so(caplog: pytest.LogCaptureFixture) -> None:
    said, start = play(_weak(), lossy(outages=(3, 4))), _weak()
    (end,) = [message for message in said if isinstance(message, RunEnd)]
    assert end.status == "failed"
    best = max((scan for scan in scans(said) if scan.bins.size), key=lambda scan: float(scan.statistic.max()))
    nearest = f"largest statistic {best.statistic.max():.1f} at "
    assert nearest in end.reason
    assert "degrees, a detection takes " in end.reason
    assert end.reason.endswith("; nothing was measured in 2 dwells: no packet")
    names = ("a", "b")
    lines = _told(said, start, names, caplog)
    assert len(lines) == int(120.0 / TELL_S)  # of the planner alone that owns the first track
    assert owners("r", 2, names)[0] in names
    assert lines[0].startswith("r: 12 scans, in 2 of them nothing was measured: 0 of 2 targets confirmed; " + nearest)


def test_a_search_without_a_track_says_so(caplog: pytest.LogCaptureFixture) -> None:
    start = sky_start("world.echo.amplitude_db=20", dwells=12)
    said = play(start)
    assert not any(scan.roster is None or scan.roster.confirmed.any() for scan in scans(said))
    lines = _told(said, start, ("a",), caplog)
    assert len(lines) == int(120.0 / TELL_S)
    assert lines[0].startswith("r: 12 scans without a confirmed track; largest statistic ")


def test_who_tracks_says_nothing(caplog: pytest.LogCaptureFixture) -> None:
    for start in (sky_start(dwells=12), RunStart.of(load("smoke"), Strategy.POWER_AWARE, 1, 4)):
        named = start.model_copy(update={"run": "r"})
        said = play(named)
        assert isinstance(said[-1], Message)
        assert any(isinstance(message, Scan) for message in said)
        assert _told(said, named, ("a",), caplog) == []
