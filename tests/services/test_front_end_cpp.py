"""The skeleton of a front end in C++: what does not need a library of Zenoh, over pipes."""

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from cogradar.services.emulator.cycle import compared, scan_message, transmission
from cogradar.services.emulator.foreign import ForeignFrontEnd, question
from cogradar.services.emulator.front_end import Settings
from cogradar.shared.protocol.front_ends.messages import Hello, Opening, Received, Transmit
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.codec import decode_answer, encode
from cogradar.shared.wire.front_ends.line import Reply
from tests.samples import sample
from tests.services.loop import checkpoint
from tests.vectors.cases import vectors

SOURCE = Path(__file__).resolve().parents[2] / "deploy/front-end/front_end.cpp"
HEADER = Path("/usr/include/msgpack.hpp")
needs_compiler = pytest.mark.skipif(
    shutil.which("g++") is None or not HEADER.is_file(), reason="g++ and msgpack.hpp are not installed"
)


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
