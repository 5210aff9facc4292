"""ARM64 plays what x86-64 plays, byte for byte: alone, from each other's stores, and as one system.

Two small machines with Debian on this one (machine.sh), ARM64 under QEMU, which takes 30 to 60 times as long. The third
is the second on an emulated Haswell of 2013: AVX2, no AVX-512.
"""

import json
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from cogradar.services.bench.golden import DWELLS, FILE, NAME, SEED
from cogradar.services.errors import Failure
from cogradar.services.runs import cluster
from cogradar.shared.wire.session import free_port
from tests.services.stored import rows

MACHINE = Path(__file__).parent / "machine.sh"
HASWELL = {
    "NUMBA_CPU_NAME": "haswell",
    "NUMBA_CPU_FEATURES": "+sse2,+ssse3,+sse4.1,+sse4.2,+avx,+avx2,+fma,+bmi,+bmi2,+popcnt,+lzcnt,+cx16",
    "COGRADAR_CACHE_DIR": "/root/haswell-kernels",  # a checkout is made anew each time
}
OF_HASWELL = ("amd64", "env", *(f"{name}={value}" for name, value in HASWELL.items()))
GOLDEN = json.loads(FILE.read_text(encoding="utf-8"))[NAME][str(SEED)]
COGRADAR = (".venv/bin/python", "-m", "cogradar")
SMOKE = ("run", NAME, "--seed", str(SEED), "--json")
STORE, OTHERS = "/tmp/played.db", "/tmp/other.db"
WITHIN_S = 1800.0
TAKEOVER_DWELLS = 200
# Kernels against their plain versions and libraries.
OF_KERNELS = (
    *("tests/shared/numerics/test_elementwise.py", "tests/shared/numerics/test_linear.py"),
    *("tests/shared/signal/test_receiver.py", "tests/shared/tracking/test_motion.py"),
    "tests/shared/tracking/test_mixture.py",
    *("-k", "kernel or plain or equal"),
)

pytestmark = pytest.mark.arm


@pytest.fixture(scope="module", params=["arm64", "amd64"])
def machine(request: pytest.FixtureRequest) -> str:
    architecture: str = request.param
    return architecture


@pytest.fixture(scope="module")
def haswell() -> str:
    """Its kernels are compiled without QEMU, for its instructions."""
    script = "from cogradar.services.kernels import compile_all; compile_all(print)"
    subprocess.run([MACHINE, *OF_HASWELL, ".venv/bin/python", "-c", script], check=True)
    return "haswell"


def _in(architecture: str, *command: str) -> list[str]:
    if architecture != "haswell":
        return [str(MACHINE), architecture, *command]
    return [str(MACHINE), *OF_HASWELL, "qemu-x86_64-static", "-cpu", "Haswell", *command]


def _said(architecture: str, *command: str) -> str:
    done = subprocess.run(_in(architecture, *command), capture_output=True, text=True, check=False, timeout=WITHIN_S)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def _cogradar(architecture: str, *arguments: str) -> str:
    return _said(architecture, *COGRADAR, *arguments)


def _file(architecture: str, path: str) -> Path:
    return Path(f"/var/tmp/cogradar-{architecture}{path}")


@pytest.fixture(scope="module")
def played() -> dict[str, dict[str, Any]]:
    """The golden run in process by architecture; each store lies beside the other machine's."""
    found = {}
    for architecture, other in (("amd64", "arm64"), ("arm64", "amd64")):
        _file(architecture, STORE).unlink(missing_ok=True)
        text = _cogradar(architecture, *SMOKE, "--dwells", str(DWELLS), "--in-process", "--store", STORE)
        found[architecture] = json.loads(text)
        shutil.copy(_file(architecture, STORE), _file(other, OTHERS))
    return found


def test_one_process_plays_the_golden_run(played: dict[str, dict[str, Any]]) -> None:
    assert {architecture: run["digest"] for architecture, run in played.items()} == {"amd64": GOLDEN, "arm64": GOLDEN}


@pytest.mark.parametrize("core", ["planner", "allocator"])
def test_a_store_is_replayed_bit_for_bit_on_the_other_architecture(
    machine: str, core: str, played: dict[str, dict[str, Any]]
) -> None:
    assert len(played) == 2
    _cogradar(machine, "replay", "--to", core, "--store", OTHERS)


def test_the_page_is_answered_in_the_same_words(played: dict[str, dict[str, Any]]) -> None:
    """Two machines answer from the same file."""
    run = played["amd64"]["run"]
    answers = [
        json.loads(_said(architecture, ".venv/bin/python", "-m", "tests.arm.page_requests", store, run))
        for architecture, store in (("amd64", STORE), ("arm64", OTHERS))
    ]
    assert answers[0] == answers[1]


def test_kernels_compute_what_their_plain_versions_do() -> None:
    _said("arm64", ".venv/bin/python", "-m", "pytest", "-q", "-o", "faulthandler_timeout=1800", *OF_KERNELS)


@contextmanager
def _service(architecture: str, role: str, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(_in(architecture, *COGRADAR, "service", role, *arguments))
    try:
        yield process
    finally:
        process.terminate()
        process.wait(120)


@contextmanager
def _system(
    architecture: str, planners: tuple[str, ...], store: str, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[str, dict[str, subprocess.Popen[bytes]]]]:
    """Endpoint of services that are up, and the planners by architecture."""
    for limit in ("CONNECT_WITHIN_S", "START_WITHIN_S"):
        monkeypatch.setattr(cluster, limit, WITHIN_S)
    for left in ("", "-wal", "-shm"):  # of a recorder that was killed
        _file(architecture, store + left).unlink(missing_ok=True)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    to, stored = ("--connect", endpoint), ("--store", store)
    roles = {"recorder": stored, "metrics": stored, "emulator": (), "allocator": ()}
    with ExitStack() as closing:
        closing.enter_context(_service(architecture, "router", "--listen", endpoint))
        for role, more in roles.items():
            closing.enter_context(_service(architecture, role, *to, *more))
        up = {one: closing.enter_context(_service(one, "planner", *to, "--name", one)) for one in planners}
        cluster.wait_until_up(endpoint, (), lambda: None)
        cluster.wait_until_up(endpoint, planners, lambda: None)
        yield endpoint, up


def test_processes_play_the_golden_run(monkeypatch: pytest.MonkeyPatch) -> None:
    with _system("arm64", ("arm64",), "/tmp/processes.db", monkeypatch) as (endpoint, _):
        said = _cogradar("amd64", *SMOKE, "--dwells", str(DWELLS), "--connect", endpoint)
    assert json.loads(said)["digest"] == GOLDEN


def test_a_haswell_plays_the_golden_run(haswell: str) -> None:
    assert json.loads(_cogradar(haswell, *SMOKE, "--dwells", str(DWELLS), "--in-process"))["digest"] == GOLDEN


@pytest.mark.parametrize("other", ["arm64", "haswell"])
def test_a_planner_on_another_processor_takes_over(other: str, haswell: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """All others are on this x86-64; the planner there is killed in the middle of the run."""
    assert haswell
    alone = json.loads(_cogradar("amd64", *SMOKE, "--dwells", str(TAKEOVER_DWELLS), "--in-process"))
    store = "/tmp/both.db"
    with _system("amd64", ("amd64", other), store, monkeypatch) as (endpoint, planners):
        play = _in("amd64", *COGRADAR, *SMOKE, "--dwells", str(TAKEOVER_DWELLS), "--connect", endpoint)
        with subprocess.Popen(play, stdout=subprocess.PIPE, text=True) as run:
            deadline = time.monotonic() + WITHIN_S
            while _newest(_file("amd64", store)) < TAKEOVER_DWELLS // 10:
                assert time.monotonic() < deadline
                assert run.poll() is None
                time.sleep(0.05)
            planners["amd64"].kill()
            assert _newest(_file("amd64", store)) < TAKEOVER_DWELLS // 2
            said, _ = run.communicate(timeout=WITHIN_S)
    assert json.loads(said)["digest"] == alone["digest"]


def _newest(store: Path) -> int:
    """The newest in a store; 0 if there is none yet."""
    try:
        (found,) = rows(store, "SELECT COALESCE(MAX(k), 0) AS k FROM message WHERE topic = 'plan'")
    except Failure:
        return 0
    return int(found["k"])
