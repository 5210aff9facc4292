"""The vectors are what the program sends, and programs that know nothing of it read and write them byte for byte."""

import base64
import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from cogradar.shared.protocol.topics import BY_NAME, EXCHANGES, KINDS, name_of
from cogradar.shared.wire.codec import decode, decode_answer, encode
from tests.services.loop import play, smoke_start
from tests.vectors import foreign, plain
from tests.vectors.cases import FILE, SIZES, as_json, lines, stored

VECTORS = stored()
NODE = Path(__file__).parents[1] / "node"
EXCHANGED = {name_of(kind): kind for one in EXCHANGES for kind in (one.question, one.answer)}


def test_the_vectors_are_those_of_the_program() -> None:
    assert FILE.read_text(encoding="utf-8") == lines(), "python -m tests.vectors --write"
    assert [vector["name"] for vector in VECTORS] == [f"{name_of(kind)}.{size}" for kind in KINDS for size in SIZES]


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["name"])
def test_bytes_and_json_are_the_same_message(vector: dict[str, Any]) -> None:
    payload = base64.b64decode(vector["bytes"])
    topic = vector["json"]["topic"]
    message = decode(payload) if topic in BY_NAME else decode_answer(payload, EXCHANGED[topic])
    assert json.dumps(as_json(message)) == json.dumps(vector["json"])
    assert encode(message) == payload


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["name"])
def test_python_with_msgpack_alone_reads_and_writes_them(vector: dict[str, Any]) -> None:
    payload = base64.b64decode(vector["bytes"])
    assert json.dumps(plain.read(payload)) == json.dumps(vector["json"])
    assert plain.written(vector["json"]) == payload


@pytest.mark.skipif(foreign.MISSING != "", reason=foreign.MISSING)
def test_cpp_reads_them_and_writes_them_back(tmp_path: Path) -> None:
    reader = foreign.compiled(tmp_path)
    for vector, line in zip(
        VECTORS, foreign.read(reader, [base64.b64decode(v["bytes"]) for v in VECTORS]), strict=True
    ):
        verdict, _, text = line.partition(" ")
        assert verdict == "same", vector["name"]
        assert json.dumps(json.loads(text)) == json.dumps(vector["json"]), vector["name"]
    played = [encode(message) for message in play(smoke_start(dwells=8))]
    assert foreign.counted(reader, played)[:2] == (len(played), 0)
    changed = base64.b64decode(VECTORS[0]["bytes"]).replace(b"\x02", b"\xcd\x00\x02", 1)  # 2, longer than it need be
    assert foreign.counted(reader, [changed])[:2] == (1, 1)


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
@pytest.mark.skipif(not (NODE / "node_modules" / "@msgpack").is_dir(), reason="@msgpack/msgpack: make node")
def test_javascript_reads_and_writes_them() -> None:
    command = ["node", "--harmony-json-parse-with-source", str(NODE / "messages.mjs"), str(FILE)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == f"{len(VECTORS)}\n"
