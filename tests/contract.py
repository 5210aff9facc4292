"""Whether what `cogradar schema` prints is valid: `make lint` asks, and so do the tests of the contract."""

import json
import lzma
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import jsonschema

from cogradar.shared.wire.contract import asyncapi, json_schema

TESTS = Path(__file__).parent
NODE = TESTS / "node"
SCHEMA = TESTS / "shared/wire/asyncapi-3.0.0.json.xz"  # the published one (Apache License 2.0), compressed
NEWER = "asyncapi-latest-version"  # its parser knows a later one
NO_PARSER = "AsyncAPI's own parser is not asked: `make node` installs it, and needs npm"


def missing_parser() -> str:
    """Why AsyncAPI's own parser cannot be asked; "": it can."""
    is_there = shutil.which("node") is not None and (NODE / "node_modules/@asyncapi").is_dir()
    return "" if is_there else NO_PARSER


def faults_of_asyncapi(document: dict[str, Any]) -> list[str]:
    """What the published schema of AsyncAPI 3.0.0 says."""
    published = json.loads(lzma.decompress(SCHEMA.read_bytes()))
    return _texts(jsonschema.Draft7Validator(published).iter_errors(document))


def faults_of_schemas(document: dict[str, Any]) -> list[str]:
    """What JSON Schema says of itself."""
    return _texts(jsonschema.Draft202012Validator(jsonschema.Draft202012Validator.META_SCHEMA).iter_errors(document))


def _texts(errors: Iterable[jsonschema.ValidationError]) -> list[str]:
    return [f"{error.json_path}: {error.message[:200]}" for error in errors]


def faults_by_parser(document: dict[str, Any]) -> tuple[list[str], str]:
    """What AsyncAPI's own parser says, and its last line, which counts channels."""
    command, asked = ["node", "asyncapi.mjs"], json.dumps(document)
    done = subprocess.run(command, cwd=NODE, input=asked, capture_output=True, text=True, timeout=60, check=False)
    *faults, last = done.stdout.splitlines() or ["no answer"]
    return [line for line in [*faults, *done.stderr.splitlines()] if NEWER not in line], last


def main() -> int:
    """Print what is wrong, and return the exit code."""
    found, document = faults_of_schemas(json_schema.document()), asyncapi.document()
    if missing := missing_parser():
        sys.stdout.write(f"{missing}\n")
        found += faults_of_asyncapi(document)
    else:
        faults, last = faults_by_parser(document)
        found += faults if last.endswith(" channels") else [*faults, last]
    sys.stdout.writelines(f"cogradar schema: {fault}\n" for fault in found)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
