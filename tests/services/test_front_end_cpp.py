"""The skeleton of a front end in C++: over pipes what needs no library of Zenoh, and with one a whole front end."""

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from cogradar.services.emulator.cycle import compared, scan_message, transmission
from cogradar.services.emulator.foreign import ForeignFrontEnd, OpensForeign, question
from cogradar.services.emulator.front_end import Settings
from cogradar.shared.protocol.front_ends.messages import Hello, Opening, Received, Transmit
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.codec import decode_answer, encode
from cogradar.shared.wire.front_ends.line import Reply
from cogradar.shared.wire.session import free_port
from tests.samples import sample
from tests.services.loop import checkpoint
from tests.vectors.cases import vectors

SOURCE = Path(__file__).resolve().parents[2] / "deploy/front-end/front_end.cpp"
HEADER = Path("/usr/include/msgpack.hpp")
needs_compiler = pytest.mark.skipif(
    shutil.which("g++") is None or not HEADER.is_file(), reason="g++ and msgpack.hpp are not installed"
)


def _zenoh() -> list[str]:
    """Options of a compiler for zenoh-cpp with zenoh-pico, as far as they are found; empty: they are not."""
    if shutil.which("g++") is None or shutil.which("pkg-config") is None:
        return []
    asked = ["pkg-config", "--cflags", "--libs", "zenohpico"]
    found = subprocess.run(asked, capture_output=True, text=True, check=False).stdout.split()
    header = ["g++", "-M", "-E", "-xc++", "-DZENOHCXX_ZENOHPICO", "-DZENOH_LINUX", "-", *found]
    said = subprocess.run(header, input=b"#include <zenoh.hxx>", capture_output=True, check=False)
    return [] if said.returncode else found


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("cpp") / "front_end"
    options = ["-std=c++17", "-Wall", "-Wextra", "-Werror", "-DMSGPACK_NO_BOOST"]
    subprocess.run(["g++", *options, SOURCE, "-o", made], check=True)
    return made


def _answered(program: Path, which: str, asked: bytes, *more: str) -> "subprocess.CompletedProcess[bytes]":
    return subprocess.run([program, which, *more], input=asked, capture_output=True, check=False)


class _Line(NamedTuple):
    """What one process has answered."""

    hello: Hello
    received: Received

    def open(self, _opening: Opening, _within_s: float) -> Iterator[Reply[Hello]]:
        yield Reply(self.hello)

    def transmit(self, _dwell: Transmit, _within_s: float) -> Iterator[Reply[Received]]:
        yield Reply(self.received)

    def close(self) -> None:
        pass


@needs_compiler
def test_it_answers_with_messages_that_the_radar_takes(program: Path) -> None:
    said = _answered(program, "opening", encode(sample(Opening)))
    hello = decode_answer(said.stdout, Hello)
    assert (hello.run, hello.n_tx, hello.n_rx, hello.hands_over) == ("run-1", 16, 16, "looks")
    asked: Any = sample(Transmit)
    received = decode_answer(_answered(program, "dwell", encode(asked)).stdout, Received)
    assert (received.run, received.k) == (asked.run, asked.k)
    assert np.array_equal(np.asarray(received.bins), asked.bins)
    assert np.asarray(received.alpha_hat).dtype == np.complex64
    assert np.asarray(received.signature_power).tolist() == [8.0, 8.0, 8.0]


@needs_compiler
@pytest.mark.parametrize("fidelity", ["paper", "best", "best-range"])
def test_a_radar_takes_what_it_measured(program: Path, fidelity: str) -> None:
    begun = checkpoint(RunStart.of(load("smoke", [f"radar.fidelity={fidelity}"]), Strategy.POWER_AWARE, 1, 5))
    settings = Settings.of(begun)
    asked = transmission(settings.radar, None)
    opening = Opening(run=begun.run, radar=begun.radar, dwells=5, rate_hz=0.0)
    said = decode_answer(_answered(program, "opening", encode(opening)).stdout, Hello)
    width = str(settings.radar.receiver.range_cell_km)
    answer = _answered(program, "dwell", encode(question(begun.run, 0, 0, asked, 1.0)), width).stdout
    received = decode_answer(answer, Received).model_copy(update={"incarnation": said.incarnation})
    line = _Line(said, received)
    measured = ForeignFrontEnd.open("roof", settings, begun.radar, line, 1.0).transmit(0, 0, asked)
    assert measured is not None
    scan = scan_message(settings, 0, 0, compared(settings.radar, asked, measured), None)
    assert scan.fault is None
    assert scan.unmeasured is None
    assert scan.bins.size


@needs_compiler
def test_it_reads_the_vectors_and_refuses_what_is_broken(program: Path) -> None:
    questions = {"opening": Opening, "transmit": Transmit}
    found = [(name, encode(message)) for name, message in vectors() if type(message) in questions.values()]
    assert len(found) == 6
    for name, payload in found:
        which = "opening" if name.startswith("opening") else "dwell"
        assert _answered(program, which, payload).returncode == 0, name
        assert _answered(program, which, payload[:-1]).returncode == 2
        assert _answered(program, which, payload.replace(b"\xa1v\x02", b"\xa1v\x03")).returncode == 2


@needs_compiler
@pytest.mark.zenoh
def test_with_a_library_of_zenoh_it_is_a_front_end(tmp_path: Path) -> None:
    if not (zenoh := _zenoh()):
        pytest.skip("zenoh-cpp and zenoh-pico are not installed")
    made, endpoint = tmp_path / "front_end", f"tcp/127.0.0.1:{free_port()}"
    options = ["-std=c++17", "-DMSGPACK_NO_BOOST", "-DWITH_ZENOH", "-DZENOHCXX_ZENOHPICO", "-DZENOH_LINUX"]
    subprocess.run(["g++", *options, SOURCE, *zenoh, "-lpthread", "-o", made], check=True)
    begun = checkpoint(RunStart.of(load("smoke"), Strategy.POWER_AWARE, 1, 5)).model_copy(update={"world": None})
    with subprocess.Popen([made, "roof", endpoint], stdin=subprocess.PIPE) as process:
        with closing(OpensForeign("roof", [endpoint])(begun)) as front_end:
            asked = transmission(Settings.of(begun).radar, None)
            scans = [front_end.transmit(k, 0, asked) for k in range(3)]
        assert [scan.bins.tolist() for scan in scans if scan is not None] == 3 * [asked.bins.tolist()]
        process.communicate(b"\n", timeout=10)
    assert process.returncode == 0
