"""The alarms for Prometheus: each one rings when it should, says what is wrong, and is silent before."""

import subprocess
from pathlib import Path
from typing import NamedTuple

import pytest
import yaml

from tests.services.metrics.test_processes import REPOSITORY, tool

RULES = REPOSITORY / "deploy/prometheus/alerts.yml"


class Case(NamedTuple):
    """Series, each sampled every five seconds for five minutes; quiet up to `quiet_s`, and rings at `rings_s`."""

    series: dict[str, str]
    quiet_s: int
    rings_s: int
    says: str


LATE = "cogradar_plans_late_total"
PLANS = 'cogradar_messages_sent_total{role="planner",process="p",topic="plan"}'
SCANS = 'cogradar_messages_sent_total{role="emulator",process="e",topic="scan"}'
ASKED = "cogradar_looks_asked_total"


def _front_end(seconds: float) -> dict[str, str]:
    """Of ten dwells of 0.2 s every five seconds: all scans come after so long."""
    buckets = {edge: "0+10x60" if seconds <= edge else "0x60" for edge in (0.02, 0.1, 0.16, 0.2)}
    scans = {f'cogradar_scan_seconds_bucket{{le="{edge}"}}': values for edge, values in buckets.items()}
    scans['cogradar_scan_seconds_bucket{le="+Inf"}'] = "0+10x60"
    return scans | {"cogradar_dwell_seconds_sum": "0+2x60", "cogradar_dwell_seconds_count": "0+10x60"}


CASES = {
    "CogradarDown": Case({'up{job="cogradar"}': "1x6 0x54"}, 35, 90, "nothing is known of the radar"),
    "CogradarNoFrontEnd": Case({'cogradar_up{role="emulator"}': "1x6 0x54"}, 35, 90, "No front end"),
    "CogradarFrontEndFails": Case({"cogradar_front_ends_failing": "0x6 1x54"}, 40, 90, "Nothing is measured"),
    "CogradarNotMeasured": Case(
        {ASKED: "0+100x60", "cogradar_looks_not_measured_total": "0+4x12 48+20x48"}, 65, 200, "20% of the looks"
    ),
    "CogradarProcessDown": Case(
        {'cogradar_up{role="planner",process="planner-1"}': "1x6 0x54"}, 35, 90, "planner planner-1 does not answer"
    ),
    "CogradarStandsStill": Case({"cogradar_dwell_age_seconds": "1x6 12x54"}, 35, 60, "for 12s"),
    "CogradarJournalFull": Case({"cogradar_journal_full": "0x6 1x54"}, 30, 40, "its disk is full"),
    "CogradarCertificateEnds": Case(
        {'cogradar_certificate_days{role="planner",process="p"}': "31x6 29x54"}, 30, 40, "planner p ends in 29 days"
    ),
    "CogradarTrackLost": Case({"cogradar_tracks_lost": "0x6 2x54"}, 30, 60, "2 targets"),
    "CogradarTargetsMissed": Case({"cogradar_targets_missed": "1x6 0x3 3x51"}, 100, 120, "3 targets"),
    "CogradarTracksEnd": Case({"cogradar_tracks_ended_total": "0x12 0+1x48"}, 90, 240, "ended within five minutes"),
    "CogradarLatePlans": Case(
        {PLANS: "0+30x60", LATE: "0x12 0+3x48", **_front_end(0.02)}, 65, 200, "and the front end is fast"
    ),
    "CogradarSlowFrontEnd": Case(
        {PLANS: "0+30x60", LATE: "0x12 0+3x48", **_front_end(0.16)}, 65, 200, "as the front end takes 1"
    ),
    "CogradarStaleWaveforms": Case(
        {SCANS: "0+30x60", "cogradar_waveforms_stale_total": "0x12 0+3x48"}, 65, 200, "older waveform"
    ),
    "CogradarBlindCells": Case({"cogradar_blind_share": "0.01x6 0.2x54"}, 35, 60, "20% of the cells"),
}


def test_every_alarm_is_tried() -> None:
    (group,) = yaml.safe_load(RULES.read_text(encoding="utf-8"))["groups"]
    assert {rule["alert"] for rule in group["rules"]} == CASES.keys()


@pytest.mark.parametrize("name", CASES)
def test_it_rings_when_it_should(name: str, tmp_path: Path) -> None:
    case = CASES[name]
    assert _ringing(name, case, case.quiet_s, tmp_path) == ""
    assert case.says in _ringing(name, case, case.rings_s, tmp_path)


def test_plans_that_are_late_for_the_front_end_are_not_the_planners(tmp_path: Path) -> None:
    slow = CASES["CogradarSlowFrontEnd"]
    assert _ringing("CogradarLatePlans", slow, slow.rings_s, tmp_path) == ""


def _ringing(name: str, case: Case, at_s: int, folder: Path) -> str:
    """What promtool says against an alarm that should not ring at this time."""
    test = {
        "interval": "5s",
        "input_series": [{"series": series, "values": values} for series, values in case.series.items()],
        "alert_rule_test": [{"eval_time": f"{at_s}s", "alertname": name, "exp_alerts": []}],
    }
    file = folder / "test.yml"
    file.write_text(yaml.safe_dump({"rule_files": [str(RULES)], "evaluation_interval": "5s", "tests": [test]}))
    done = subprocess.run([tool("promtool"), "test", "rules", str(file)], capture_output=True, text=True, check=False)
    return "" if done.returncode == 0 else done.stdout + done.stderr
