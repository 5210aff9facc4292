"""The contract that programs read: it is valid, has all that the tables have, and every message is as it says."""

import base64
import hashlib
import inspect
import json
import re
from pathlib import Path
from typing import Any

import jsonschema
import msgpack
import pytest
from typer.testing import CliRunner

from cogradar.services.cli.app import app
from cogradar.shared.protocol.front_ends.messages import Received
from cogradar.shared.protocol.messages import Scan, Truth
from cogradar.shared.protocol.permissions import OBSERVER
from cogradar.shared.protocol.topics import (
    BY_MESSAGE,
    FRONT_END,
    KINDS,
    PROTOCOL,
    QUERYABLES,
    TOPICS,
    Role,
    encoding_of,
    name_of,
)
from cogradar.shared.wire.contract import asyncapi, json_schema
from cogradar.shared.wire.contract.meanings import meanings
from cogradar.shared.wire.front_ends.line import MAX_DATA
from docs.generator import messages as generated
from tests import contract
from tests.vectors.cases import FILE, stored

VECTORS = stored()
SCHEMAS = json_schema.document()
MESSAGES = {name: schema for name, schema in SCHEMAS["$defs"].items() if "x-encoding" in schema}


def test_the_contract_is_what_its_specifications_say() -> None:
    document, schemas = asyncapi.document(), json_schema.document()
    assert contract.faults_of_asyncapi(document) + contract.faults_of_schemas(schemas) == []
    document["channels"]["scan"]["address"] = 7
    schemas["$defs"]["Scan"] |= {"required": "k"}
    assert contract.faults_of_asyncapi(document)[0].startswith("$.channels")
    assert "'k' is not of type 'array'" in contract.faults_of_schemas(schemas)[0]


@pytest.mark.skipif(contract.missing_parser() != "", reason=contract.NO_PARSER)
def test_asyncapi_is_understood_by_its_own_parser() -> None:
    channels = f"{len(TOPICS) + len(QUERYABLES) + len(asyncapi.TOKENS)} channels"
    assert contract.faults_by_parser(asyncapi.document()) == ([], channels)


def test_asyncapi_has_what_the_tables_have() -> None:
    document = asyncapi.document()
    channels, operations = document["channels"], document["operations"]
    for topic in TOPICS:
        said = {
            (operation["action"], operation["x-role"])
            for operation in operations.values()
            if operation["channel"] == {"$ref": f"#/channels/{topic.name}"}
        }
        assert said == {("send", topic.producer), *(("receive", reader) for reader in topic.readers)}
        assert channels[topic.name]["address"] == topic.key
    truth = channels[BY_MESSAGE[Truth].name]["x-zenoh"]
    assert (truth["maySend"], truth["mayRead"]) == ([Role.EMULATOR], [Role.RECORDER])
    scan = channels[BY_MESSAGE[Scan].name]["x-zenoh"]
    assert OBSERVER in scan["mayRead"]
    assert (scan["congestionControl"], scan["priority"], scan["express"]) == ("block", "data", True)
    answered = {channels[name]["address"] for name in ("query", "timestamps", "exposition", "link")}
    asked = {channels[f"front-end-{end}"]["address"] for end in ("opening", "dwell")}
    assert answered | asked == {q.key for q in QUERYABLES}
    assert channels["front-end-dwell"]["x-zenoh"]["mayAsk"] == [Role.EMULATOR]
    assert channels["front-end-dwell"]["x-zenoh"]["mayAnswer"] == [FRONT_END]
    (reply,) = (one["reply"] for name, one in operations.items() if name.endswith("answers.front-end-dwell"))
    looks, data = (document["components"]["messages"][f"front-end-dwell.{kind}"] for kind in ("answer", "data"))
    assert [one["$ref"].rpartition("/")[2] for one in reply["messages"]] == ["answer", "data"]
    assert (looks["contentType"], data["contentType"]) == (encoding_of(Received), "application/octet-stream")
    assert data["x-zenoh"] == {
        "attachment": {"$ref": "#/components/messages/front-end-dwell.answer"},
        "maxBytes": MAX_DATA,
    }
    assert OBSERVER in channels["query"]["x-zenoh"]["mayAsk"]


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["name"])
def test_every_message_is_as_its_schema_says(vector: dict[str, Any]) -> None:
    topic = {"const": vector["json"]["topic"], "description": "kind of message"}
    (name,) = (name for name, schema in MESSAGES.items() if schema["properties"]["topic"] == topic)
    validator = jsonschema.Draft202012Validator({"$ref": f"#/$defs/{name}", "$defs": SCHEMAS["$defs"]})
    validator.validate(vector["json"])
    body = vector["json"]["body"]
    for wrong in (
        {**body, "one_more": 1},
        {name: value for name, value in body.items() if name != "run"},
        {**body, "run": 7},
        *({**body, name: {**value, "dtype": "f4"}} for name, value in body.items() if "dtype" in str(value)[:10]),
        *({**body, name: str(value)} for name, value in body.items() if type(value) in {int, float, bool}),
    ):
        assert not validator.is_valid({**vector["json"], "body": wrong})


def test_a_schema_is_found_by_the_name_that_a_sample_has() -> None:
    jsonschema.Draft202012Validator.check_schema(SCHEMAS)
    validator = jsonschema.Draft202012Validator(SCHEMAS)
    assert all(validator.is_valid(vector["json"]) for vector in VECTORS[1::3])
    assert {schema["x-encoding"] for schema in MESSAGES.values()} >= {topic.encoding for topic in TOPICS}
    assert len(MESSAGES) == len(KINDS)
    parts = {part for kind in KINDS for part in json_schema.described(kind)[1]}
    assert parts.isdisjoint({*MESSAGES, *(kind.__name__ for kind in KINDS)})


@pytest.mark.parametrize("vector", VECTORS[1::3], ids=lambda vector: vector["name"])
def test_arrays_are_packed_as_the_schema_says(vector: dict[str, Any]) -> None:
    (kind,) = (kind for kind in KINDS if name_of(kind) == vector["json"]["topic"])
    fields = SCHEMAS["$defs"][kind.__name__]["properties"]
    for name, value in msgpack.unpackb(base64.b64decode(vector["bytes"]))["body"].items():
        said = [part["x-msgpack"] for part in (fields[name], *fields[name].get("anyOf", ())) if "x-msgpack" in part]
        if isinstance(value, msgpack.ExtType):
            packed = {"dtype": value.data[:2].decode(), "axes": value.data[2], "order": "C", "endian": "little"}
            assert said == [{"extensionType": value.code} | packed], name
    assert "x-msgpack" in json.dumps(asyncapi.document()["components"]["schemas"]["Scan"])


def test_no_field_with_a_comment_lacks_its_meaning() -> None:
    """A comment behind a field whose type takes several lines would be lost."""
    for kind in KINDS:
        source = inspect.getsource(kind)
        split = re.findall(r"^    (\w+): [^\n]*[(\[]\n(?:        .*\n)*    [)\]].*#", source, re.MULTILINE)
        assert split == [], kind
        commented = re.findall(r"^    (\w+): .*#", source, re.MULTILINE)
        lacking = [name for name in commented if name in kind.model_fields and name not in meanings(kind)]
        assert lacking == [], kind


def test_meanings_are_the_comments_of_the_source() -> None:
    fields = json_schema.described(Scan)[0]["properties"]
    assert fields["alpha_hat"]["description"] == "(n,) estimated echo amplitude"
    assert fields["unmeasured"]["description"].startswith("(u,) directions of the looks that were asked for")
    assert (fields["ranges_km"]["x-unit"], fields["gates"]["x-shape"]) == ("km", "(M, 2)")
    assert "Annotated" not in generated.messages() + generated.parts()
    assert "| `lacking` | list of at most 4096: whole number, 0 .. 2^31 - 1, or none | none |" in generated.messages()


@pytest.mark.parametrize("form", ["asyncapi", "jsonschema"])
def test_the_command_prints_or_writes_it(form: str, tmp_path: Path) -> None:
    file, runner = tmp_path / "contract.json", CliRunner()
    printed = runner.invoke(app, ["schema", "--format", form])
    assert runner.invoke(app, ["schema", "--format", form, "--out", str(file)]).exit_code == 0
    assert printed.stdout == file.read_text(encoding="utf-8")
    assert {"asyncapi": '"asyncapi": "3.0.0"', "jsonschema": '"$schema": "https://json-schema.org'}[
        form
    ] in printed.stdout
    assert '"asyncapi"' not in printed.stdout or form == "asyncapi"
    assert runner.invoke(app, ["schema", "--format", form, "--out", str(file)]).exit_code != 0


def _bare(part: Any) -> Any:
    """What programs depend on: without texts for people."""
    texts = {"description", "summary", "title", "x-shape", "x-unit", "acknowledgement", "lateJoiner"}
    if isinstance(part, dict):
        return {name: _bare(value) for name, value in part.items() if name not in texts or not isinstance(value, str)}
    return [_bare(value) for value in part] if isinstance(part, list) else part


def test_the_protocol_has_another_number_when_the_wire_has_changed() -> None:
    """If this fails: raise PROTOCOL, if older programs cannot read or send what is sent now, and put both here.

    Keys, encodings, rights, fields and limits are in the contract; envelope and arrays are in the bytes of the vectors.
    Which keys a scenario has is no part of it.
    """
    of_scenarios = {"runstart", "checkpoint", "emulatorcheckpoint", "opening"}
    payloads = [vector["bytes"] for vector in VECTORS if vector["json"]["topic"] not in of_scenarios]
    digest = hashlib.sha256(json.dumps(_bare(asyncapi.document()), sort_keys=True).encode())
    digest.update("\n".join(payloads).encode())
    assert FILE.stat().st_size < 320_000
    assert (PROTOCOL, digest.hexdigest()[:8]) == (10, "159415b6")


def test_the_keys_of_tokens_in_the_pages_have_the_number_of_the_protocol() -> None:
    pages = (Path(__file__).parents[3] / "docs").rglob("*.md")
    keys = [key for page in pages for key in re.findall(r"cogradar/(?:alive|claim|share)/\d+", page.read_text("utf-8"))]
    assert len(keys) > 5
    assert [key for key in keys if not key.endswith(f"/{PROTOCOL}")] == []
