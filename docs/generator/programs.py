"""How the program is asked: its commands, and its paths over HTTP."""

import inspect
import re
from pathlib import Path
from typing import Any

import typer
from typer.main import get_command

import cogradar.services.web
from cogradar.services.cli.app import app
from cogradar.services.cli.manual.examples import COMMANDS
from cogradar.services.web.openapi import describe
from docs.generator.markdown import code, prose, table

PAGE = Path(cogradar.services.web.__path__[0]) / "page"


def commands() -> str:
    """A part per command: what it does, arguments and options."""
    group: Any = get_command(app)
    panels = list(dict.fromkeys(shown.panel for shown in COMMANDS.values()))
    listed = [(panel, [name for name in COMMANDS if COMMANDS[name].panel == panel]) for panel in panels]
    parts = [table(("panel", "commands"), [(panel, ", ".join(map(code, names))) for panel, names in listed])]
    parts += [_command(name, group.commands[name]) for _, names in listed for name in names]
    return "\n".join(parts)


def _command(name: str, command: Any) -> str:
    context = typer.Context(command, info_name=f"cogradar {name}")
    usage = " ".join(["cogradar", name, *command.collect_usage_pieces(context)])
    text = "\n\n".join(prose(part) for part in inspect.cleandoc(command.help or "").split("\n\n"))
    records = [record for option in command.params if (record := option.get_help_record(context))]
    rows = [(code(shown.replace("<", "").replace(">", "")), prose(meaning)) for shown, meaning in records]
    shown = "\n".join(f"cogradar {example}" for example in COMMANDS[name].examples)
    examples = f"```sh\n{shown}\n```\n\n"
    options = table(("argument, option", "meaning"), rows)
    return f"### cogradar {name}\n\n{text}\n\n```\n{usage}\n```\n\n{examples}{options}"


def paths() -> str:
    """A part per path: what it answers, its parameters, its statuses."""
    parts = []
    for path, methods in describe()["paths"].items():
        for method, asked in methods.items():
            rows = [
                (code(one["name"]), one["in"], _type(one["schema"]), prose(one["description"]))
                for one in asked["parameters"]
            ]
            given = [
                f"- {status}: {_content(answer)}{prose(answer['description'])}"
                for status, answer in asked["responses"].items()
            ]
            parts += [f"### {method.upper()} {path}".replace("{", "\\{"), prose(asked["summary"])]
            parts += [table(("parameter", "in", "type", "meaning"), rows)] if rows else []
            parts += ["\n".join(given)]
    return "\n\n".join(parts) + "\n"


def page_keys() -> str:
    """The keys of the page, as its own help lists them."""
    listed = re.findall(r"<dt>(.*?)</dt><dd>(.*?)</dd>", (PAGE / "index.html").read_text(encoding="utf-8"))
    return table(("key", "what it does"), [(prose(keys), prose(act)) for keys, act in listed])


def answers() -> str:
    """A part per kind of answer, with a row per field."""
    parts = []
    for name, schema in describe()["components"]["schemas"].items():
        rows = [
            (code(field), _type(what), prose(what.get("description", "")))
            for field, what in schema.get("properties", {}).items()
        ]
        content = table(("field", "type", "meaning"), rows) if rows else f"{_type(schema)}.\n"
        parts.append(f"### {name}\n\n{prose(schema.get('description', ''))}\n\n{content}")
    return "\n".join(parts)


def _content(answer: dict[str, Any]) -> str:
    kinds = []
    for kind, content in answer.get("content", {}).items():
        schema = content.get("schema", {})
        rows = schema.get("properties", {}).get("rows", {}).get("items")
        named = f"rows of {_type(rows)}" if rows else _type(schema)
        kinds.append(f"{named} (`{kind}`)" if schema else f"`{kind}`")
    return ", ".join(kinds) + ". " if kinds else ""


def _type(schema: dict[str, Any]) -> str:
    """A JSON schema in a few words."""
    if "anyOf" in schema:
        return ", ".join(_type(one) for one in schema["anyOf"])
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "enum" in schema:
        return " or ".join(map(code, schema["enum"]))
    if "const" in schema:
        return code(schema["const"])
    if schema.get("type") == "array":
        return f"list of {_type(schema.get('items', {}))}"
    kinds = schema.get("type", "anything")
    words = {"integer": "whole number", "string": "text", "boolean": "true, false", "null": "null"}
    text = ", ".join(words.get(kind, kind) for kind in ([kinds] if isinstance(kinds, str) else kinds))
    low, high = schema.get("minimum"), schema.get("maximum")
    return (
        f"{text} from {low}" + (f" to {high}" if high is not None and high < 2**31 - 1 else "")
        if low is not None
        else text
    )
