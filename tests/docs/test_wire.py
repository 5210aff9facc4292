"""The page of the wire: its listeners, exactly as they are printed, follow a radar; its numbers are the program's."""

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from cogradar.shared.wire.codec import decode
from docs.generator import wire
from tests.docs.documents import REPOSITORY, blocks
from tests.vectors.cases import stored

PAGE = REPOSITORY / "docs" / "reference" / "wire.md"
DWELLS = 12


class Radar(NamedTuple):
    """A radar that runs as processes."""

    run: str
    endpoint: str
    address: str


@pytest.fixture(scope="module")
def radar() -> Iterator[Radar]:
    """Until the tests are over."""
    command = [sys.executable, "-m", "cogradar", "run", "smoke", "--planners", "1", "--http", "127.0.0.1:0"]
    paced = ["--pace", "realtime", "--rate", "5", "--dwells", "unlimited"]
    environment = os.environ | {"PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(
        [*command, *paced], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment
    ) as process:
        said = ""
        assert process.stdout is not None
        try:
            for line in process.stdout:
                said += line
                if found := re.search(r"watch it: (\S+)/\?run=(\S+)(?s:.*)--connect (\S+)", said):
                    yield Radar(found[2], found[3], found[1])
                    break
            else:
                pytest.fail(said)
        finally:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=60)


def _heard(command: list[str], name: str, folder: Path) -> list[str]:
    """The first lines that a listener of the page prints."""
    (text,) = (block.text for block in blocks(PAGE) if block.mark == f"file: {name}")
    (folder / name).write_text(text, encoding="utf-8")
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            return [process.stdout.readline().rstrip("\n") for _ in range(DWELLS)]
        finally:
            process.kill()


@pytest.mark.slow
@pytest.mark.zenoh
def test_a_listener_in_python_without_cogradar_follows_a_radar(radar: Radar, tmp_path: Path) -> None:
    lines = _heard([sys.executable, "listener.py", radar.endpoint], "listener.py", tmp_path)
    found = [re.fullmatch(r"(\S+) (\d+) \(([\d.e-]+), (\d+)\)", line) for line in lines]
    assert {one[1] for one in found if one} == {radar.run}, lines
    dwells = {int(one[2]) for one in found if one}  # the first ones may be sent again
    assert dwells == set(range(min(dwells), max(dwells) + 1))


@pytest.mark.slow
@pytest.mark.zenoh
@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
def test_a_listener_in_javascript_follows_it_over_http(radar: Radar, tmp_path: Path) -> None:
    lines = _heard(["node", "listener.mjs", radar.address, radar.run], "listener.mjs", tmp_path)
    dwells, tracked = zip(*(map(int, line.split()) for line in lines), strict=True)
    assert dwells == tuple(range(dwells[0], dwells[0] + DWELLS))
    assert set(tracked) <= {0, 1, 2, 3}


def test_the_listeners_are_short_and_know_nothing_of_the_program() -> None:
    for block in blocks(PAGE):
        if block.mark.startswith("file: "):
            assert len(block.text.splitlines()) <= 35
            assert "import cogradar" not in block.text


def test_the_example_in_hexadecimal_is_a_message() -> None:
    """Each byte of it has its line."""
    (vector,) = (one for one in stored() if one["name"] == wire.EXAMPLE)
    rows = re.findall(r"^ *((?:[0-9a-f]{2} )*[0-9a-f]{2})(?:  |$)", wire.example(), re.MULTILINE)
    payload = bytes.fromhex("".join(rows))
    assert decode(payload).run == vector["json"]["body"]["run"]
    assert vector["bytes"] in wire.example()
