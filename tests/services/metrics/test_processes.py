"""All processes on one page: right numbers, valid for promtool, read by a real Prometheus, documented, drawn."""

import json
import re
import shutil
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml
from prometheus_client.core import Metric
from prometheus_client.parser import text_string_to_metric_families

from cogradar.services import kernels
from cogradar.services.metrics.client import ask_service
from cogradar.services.metrics.processes import gather
from cogradar.services.metrics.processes import page as page_of
from cogradar.services.planner.ownership import owners
from cogradar.services.runs import cluster
from cogradar.services.runs.launcher import Launcher, LocalProcesses
from cogradar.shared.protocol.build import build
from cogradar.shared.protocol.messages import RunCancel, RunStart, Scan
from cogradar.shared.protocol.topics import ALIVE, BY_MESSAGE, PROTOCOL, Role
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.exposition import METRICS
from cogradar.shared.wire.session import free_port, open_session
from cogradar.shared.wire.zenoh_bus import ZenohBus
from tests.samples import sample

pytestmark = pytest.mark.zenoh

REPOSITORY = Path(__file__).resolve().parents[3]
DWELLS, RATE_HZ = 20, 10.0
INTERVAL = "1m"
SECURED = {"certificate_days"}  # of processes that show certificates; these show none


def tool(name: str) -> str:
    if (path := shutil.which(name)) is None:
        pytest.skip(f"{name} is not installed (Debian package prometheus)")
    return path


@pytest.fixture(scope="module")
def services(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Launcher]:
    """Services by which two runs were played, a question answered, a message dropped."""
    kernels.compile_all(lambda _: None)
    store, stop = str(tmp_path_factory.mktemp("services") / "runs.db"), threading.Event()
    with Launcher(LocalProcesses(2, store, http="127.0.0.1:0"), stop) as launcher:
        cluster.wait_until_up(launcher.endpoint, launcher.names, launcher.check)
        for rate_hz in (0.0, RATE_HZ):
            start = RunStart.of(load("smoke"), Strategy.UNIFORM, 1, DWELLS, rate_hz)
            cluster.play_on(launcher.endpoint, start, report=lambda _: None, notify=lambda _: None, stop=stop)
        ask_service(launcher.endpoint, "runs", {})
        with open_session([launcher.endpoint], 10.0, lambda: None) as session:
            session.put(BY_MESSAGE[Scan].key_of(sample(Scan), build()), b"noise")
        yield launcher


@pytest.fixture(scope="module")
def address(services: Launcher) -> str:
    """Where metrics serves."""
    assert services.url is not None
    return services.url.removeprefix("http://").rstrip("/")


@pytest.fixture(scope="module")
def page(address: str) -> str:
    answer = httpx.get(f"http://{address}/metrics")
    assert (answer.status_code, answer.headers["content-type"]) == (200, "text/plain; version=0.0.4; charset=utf-8")
    return answer.text


@pytest.fixture(scope="module")
def families(page: str) -> dict[str, Metric]:
    return {family.name: family for family in text_string_to_metric_families(page)}


def total(family: Metric, suffix: str, **labels: str) -> float:
    found = [s for s in family.samples if s.name.endswith(suffix) and labels.items() <= s.labels.items()]
    assert found
    return sum(sample.value for sample in found)


def test_the_numbers_are_those_of_the_runs(families: dict[str, Metric]) -> None:
    scans = total(families["cogradar_messages_sent"], "_total", role=Role.EMULATOR, topic="scan")
    dwells = total(families["cogradar_dwells"], "_total")
    assert dwells >= 2 * DWELLS
    assert scans - total(families["cogradar_messages_redelivered"], "_total", topic="scan") == dwells
    assert total(families["cogradar_dwell_seconds"], "_count") == dwells - 2  # each run's first follows none
    assert total(families["cogradar_messages_dropped"], "_total", role=Role.RECORDER, topic="scan") == 1
    assert total(families["cogradar_runs"], "cogradar_runs", status="complete") == 2
    in_time = total(families["cogradar_deadline_margin_seconds"], "_count")
    assert in_time + total(families["cogradar_waveforms_stale"], "_total") == DWELLS
    assert total(families["cogradar_query_seconds"], "_count", status="answered") >= 1
    assert total(families["cogradar_tracks_owned"], "cogradar_tracks_owned") == 0  # both runs are over
    for role in (Role.PLANNER, Role.ALLOCATOR, Role.RECORDER):
        assert total(families["cogradar_handling_seconds"], "_sum", role=role) > 0.0


def test_every_process_is_there_with_its_own_numbers(families: dict[str, Metric]) -> None:
    up = {(s.labels["role"], s.labels["process"]): s.value for s in families["cogradar_up"].samples}
    names = [f"{role}-0" for role in ("emulator", "planner", "allocator", "recorder", "metrics")]
    assert up == {(name.partition("-")[0], name): 1.0 for name in [*names, "planner-1"]} | {("router", "router"): 1.0}
    cpu = families["process_cpu_seconds"].samples
    assert {(s.labels["role"], s.labels["process"]) for s in cpu} == up.keys()
    labels = {name for family in families.values() for sample in family.samples for name in sample.labels}
    assert labels <= {"role", "process", "topic", "status", "le", "version", "implementation"}


def test_the_machine_room_has_the_same_numbers(address: str, families: dict[str, Metric]) -> None:
    found = httpx.get(f"http://{address}/api/v1/processes").json()
    rows = {row["name"]: row for row in found["processes"]}
    assert rows.keys() == {s.labels["process"] for s in families["cogradar_up"].samples}
    assert all(row["alive"] and row["rss_bytes"] > 1e6 for row in rows.values())
    for name in ("recorder-0", "planner-0", "planner-1", "allocator-0", "emulator-0"):
        assert 0.0 < rows[name]["handling_p50_ms"] <= rows[name]["handling_p99_ms"]
    dwell = families["cogradar_dwell_seconds"]
    mean_ms = 1e3 * total(dwell, "_sum") / total(dwell, "_count")
    assert 0.1 * mean_ms < rows["emulator-0"]["dwell_p50_ms"] <= rows["emulator-0"]["dwell_p99_ms"]
    assert 0.0 < rows["emulator-0"]["margin_p99_ms"] <= rows["emulator-0"]["margin_p50_ms"] < 1e3 / RATE_HZ
    assert rows["emulator-0"]["stale"] == total(families["cogradar_waveforms_stale"], "_total")
    assert sum(row["dropped"] or 0.0 for row in rows.values()) == total(families["cogradar_messages_dropped"], "_total")
    assert found["owners"] == {}  # both runs are over


def test_the_machine_room_shows_a_run_that_goes_on_and_who_owns_its_tracks(services: Launcher, address: str) -> None:
    start = RunStart.of(load("smoke"), Strategy.UNIFORM, 1, 100_000, RATE_HZ)
    with closing(
        ZenohBus(open_session([services.endpoint], 10.0, lambda: None), Role.OPERATOR, "op", reads=False)
    ) as bus:
        bus.publish(start)
        deadline, rates, found = time.monotonic() + 60.0, list[float](), dict[str, Any]()
        while len(rates) < 5 or min(rates) < 0.5 * RATE_HZ:
            assert time.monotonic() < deadline, rates
            time.sleep(1.1)
            found = httpx.get(f"http://{address}/api/v1/processes").json()
            rates = [row["dwells_per_s"] for row in found["processes"] if row["dwells_per_s"] is not None]
        bus.publish(RunCancel(run=start.run))
    assert max(rates) < 2.0 * RATE_HZ
    assert list(found["owners"][start.run].values()) == owners(start.run, 2, ["planner-0", "planner-1"])
    assert found["window_s"] > 1.0


def test_who_is_alive_and_silent_is_not_up(router: str) -> None:
    session = open_session([router], 10.0, lambda: None)
    with session:
        token = session.liveliness().declare_token(
            ALIVE.format(protocol=PROTOCOL, build=build(), role=Role.PLANNER, name="deaf")
        )
        deadline, router_is_up = time.monotonic() + 10.0, 'cogradar_up{process="router",role="router"} 1.0'
        while router_is_up not in (lines := page_of(gather(session, 1.0)).decode().splitlines()):
            assert time.monotonic() < deadline  # it begins to answer a moment after it lets others connect
        token.undeclare()
    assert 'cogradar_up{process="deaf",role="planner"} 0.0' in lines
    assert 'cogradar_up{process="",role="allocator"} 0.0' in lines


def test_promtool_finds_nothing_to_say(page: str) -> None:
    command = [tool("promtool"), "check", "metrics"]
    checked = subprocess.run(command, input=page, capture_output=True, text=True, check=False)
    assert (checked.returncode, checked.stderr) == (0, "")
    configuration = REPOSITORY / "deploy/prometheus/prometheus.yml"
    subprocess.run([tool("promtool"), "check", "config", configuration], capture_output=True, check=True)


def test_every_metric_is_of_the_roles_that_the_reference_names(families: dict[str, Metric]) -> None:
    shown = {name for name in families if name.startswith("cogradar_")}
    there = METRICS.keys() - SECURED
    assert shown == {"cogradar_up", "cogradar_answers_dropped", *(f"cogradar_{name}" for name in there)}
    for name in there:
        meaning = METRICS[name]
        roles = {sample.labels["role"] for sample in families[f"cogradar_{name}"].samples}
        assert meaning.roles == "all" or roles == set(meaning.roles.split(", ")), name


def _expressions() -> list[str]:
    dashboard = json.loads((REPOSITORY / "deploy/grafana/cogradar.json").read_text(encoding="utf-8"))
    rules = yaml.safe_load((REPOSITORY / "deploy/prometheus/alerts.yml").read_text(encoding="utf-8"))
    drawn = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    return drawn + [rule["expr"] for group in rules["groups"] for rule in group["rules"]]


def test_dashboard_and_alarms_name_metrics_that_exist(families: dict[str, Metric]) -> None:
    there = {sample.name for family in families.values() for sample in family.samples}
    named = {name for text in _expressions() for name in re.findall(r"\b(?:cogradar|process)_\w+", text)}
    assert len(named) > 15
    assert named - there == {f"cogradar_{name}" for name in SECURED}


@pytest.fixture
def prometheus(address: str, tmp_path: Path) -> Iterator[str]:
    """A Prometheus that scrapes the page, with our configuration at another address and every two seconds."""
    configuration: dict[str, Any] = yaml.safe_load((REPOSITORY / "deploy/prometheus/prometheus.yml").read_text())
    configuration["global"] = {"scrape_interval": "2s", "scrape_timeout": "2s"}
    configuration["scrape_configs"][0]["static_configs"][0]["targets"] = [address]
    configuration["rule_files"] = [str(REPOSITORY / "deploy/prometheus/alerts.yml")]
    (tmp_path / "prometheus.yml").write_text(yaml.safe_dump(configuration))
    at, command = f"127.0.0.1:{free_port()}", [tool("prometheus"), f"--config.file={tmp_path / 'prometheus.yml'}"]
    command += [f"--storage.tsdb.path={tmp_path / 'data'}", f"--web.listen-address={at}", "--log.level=error"]
    process = subprocess.Popen(command)
    yield f"http://{at}/api/v1/query"
    process.terminate()
    assert process.wait(20.0) == 0


def test_a_real_prometheus_reads_it_and_evaluates_dashboard_and_alarms(prometheus: str) -> None:
    def ask(expression: str) -> list[dict[str, Any]]:
        answer = httpx.get(prometheus, params={"query": expression}).raise_for_status().json()
        assert answer["status"] == "success", answer
        found: list[dict[str, Any]] = answer["data"]["result"]
        return found

    deadline, up = time.monotonic() + 30.0, list[dict[str, Any]]()
    while time.monotonic() < deadline and len(up) < 7:
        time.sleep(0.25)
        try:
            up = ask("min_over_time(cogradar_up[30s])")
        except httpx.HTTPError:  # it is still starting, or answers that it is not ready
            continue
    assert [sample["value"][1] for sample in up] == ["1"] * 7
    (dwells,) = ask("sum(last_over_time(cogradar_dwells_total[30s]))")  # a scrape that was late leaves a gap
    assert float(dwells["value"][1]) >= 2 * DWELLS
    for expression in _expressions():
        ask(expression.replace("$__rate_interval", INTERVAL))
