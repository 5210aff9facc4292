"""The keys of a scenario file: type, range, unit, default and meaning."""

from collections.abc import Iterator, Mapping
from typing import Any

from cogradar.shared.scenario.combinations import LOOKS, RADARS, WHY, Allowed, one_of
from cogradar.shared.scenario.document import SCENARIO_DIR
from cogradar.shared.scenario.files import comments_of
from cogradar.shared.scenario.plugins.kinds import OBJECTIVE, RULE, STRATEGY, Kind
from cogradar.shared.scenario.plugins.resolver import resolve
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scenario.tables import FIDELITY, IF_UNKNOWN, marked
from docs.generator.markdown import code, prose, table

UNITS = {
    "_km_s2": "km/s²",
    "_km_s": "km/s",
    "_km": "km",
    "_m": "m",
    "_s": "s",
    "_db": "dB",
    "_deg": "°",
}  # the end of a key
ASSUMED = ("world.motion.sigma_s_km_s2", "world.echo.amplitude_db")
LISTS = ("world.targets", "world.targets.turns", "world.jammers")  # of tables
EXCEPTIONS = {"dwells": "dwells", "state": "km, km/s", "g": "9.80665 m/s²", "rate_deg_s": "°/s", "trajectory": "s, km"}
_HEADINGS = ("key", "type", "range", "unit", "if left out", "in `paper`", "meaning")


def keys() -> str:
    """A part for each table of the file, with a row per key."""
    schema = Scenario.model_json_schema()
    said = comments_of((SCENARIO_DIR / "paper.toml").read_text(encoding="utf-8"))
    parts: dict[str, list[tuple[str, ...]]] = {}
    texts = {}
    for path, name, field, model in _fields(schema, schema, ""):
        key = f"{path}{name}"
        value, comment = said.get(key.replace("targets.", "targets.1."), ("", ""))
        meaning = field.get("description") or comment.lstrip("# ").partition("  ")[0].rstrip()
        if not meaning:
            raise ValueError(f"{key}: neither a description nor a comment in paper.toml says what it is")
        shown = "" if key in ASSUMED else value or _default(path, name, "robust") or _own_default(field)
        row = (
            code(name),
            _type(field),
            _range(field),
            _unit(name),
            _left_out(path, name, field),
            code(shown),
            prose(meaning),
        )
        parts.setdefault(path, []).append(row)
        texts[path] = model.get("description", "")
    return "\n".join(
        f"### {_heading(path)}\n\n{prose(texts[path])}\n\n{table(_HEADINGS, rows)}" for path, rows in parts.items()
    )


def strategies() -> str:
    """The names of the power rules, and what each says of itself."""
    return _named("strategy", "what is radiated", STRATEGY)


def bin_rules() -> str:
    """The names of the action-selection policies, and what each says of itself."""
    return _named("rule", "what it asks for", RULE)


def objectives() -> str:
    """What power-aware beams may be to achieve, and what each says of itself."""
    return _named("objective", "what it does", OBJECTIVE)


def _named(kind: str, what: str, of: Kind) -> str:
    texts = {name: (resolve(of, name).__doc__ or "").split("\n\n")[0] for name in of.built_in}
    return table((kind, what), [(marked(code(name), name), prose(text)) for name, text in texts.items()])


def fidelities() -> str:
    """What `radar.fidelity` means for the keys that are left out."""
    rows = [
        (code(f"radar.{section}.{key}"), *(code(FIDELITY[name][section][key]) for name in FIDELITY))
        for section, values in FIDELITY["robust"].items()
        for key in values
    ]
    return table(("key", *(f'fidelity = "{name}"' for name in FIDELITY)), rows)


def radars() -> str:
    """The supported radars: filter, cells and number of tracks."""
    return _combined("radar", RADARS)


def looks() -> str:
    """The supported ways of looking: looks, and what power is for."""
    return _combined("looks", LOOKS)


def _combined(kind: str, supported: Mapping[str, Allowed]) -> str:
    rows = []
    for name, row in supported.items():
        settings = (code(f"{key} = {one_of(allowed)}") for key, allowed in row.items())
        rows.append((name, "; ".join(settings), prose(WHY.get(name, ""))))
    return table((kind, "settings", "why"), rows)


def _fields(
    schema: dict[str, Any], model: dict[str, Any], path: str
) -> Iterator[tuple[str, str, dict[str, Any], dict[str, Any]]]:
    """Path, name and schema of each key, and the model that it belongs to; tables after the plain keys."""
    inner = []
    for name, field in model["properties"].items():
        target = field.get("items", field)
        target = next((one for one in target.get("anyOf", ()) if "$ref" in one), target)
        if "$ref" in target:
            inner.append((f"{path}{name}.", schema["$defs"][target["$ref"].rpartition("/")[2]]))
        else:
            # Of something or nothing: as something. Of several kinds: as the first, and the words of the others.
            words = [one["const"] for one in field.get("anyOf", ()) if "const" in one]
            yield path, name, {**next(iter(field.get("anyOf", ())), {}), "words": words, **field}, model
    for inner_path, inner_model in inner:
        yield from _fields(schema, inner_model, inner_path)


def _heading(path: str) -> str:
    if not path:
        return "The file"
    name = path.rstrip(".")
    return f"`[[{name}]]`" if name in LISTS else f"`[{name}]`"


def _type(field: dict[str, Any]) -> str:
    if "enum" in field:
        own = ", or [your own](../howto/extending.md)" if "pattern" in field.get("anyOf", [{}])[-1] else ""
        return "one of " + ", ".join(map(code, field["enum"])) + own
    kinds = {
        "boolean": "true or false",
        "integer": "whole number",
        "number": "number",
        "string": "text",
        "array": "list of numbers" if "anyOf" not in field or "maxItems" in field else "list of rows, or text",
    }
    return " or ".join((kinds[field["type"]], *map(code, field["words"])))


def _range(field: dict[str, Any]) -> str:
    if "minItems" in field and "maxItems" not in field:
        return f"at least {field['minItems']} of them"
    if "minItems" in field:
        return f"{field['minItems']} of them"
    if "maxLength" in field:
        return f"at most {field['maxLength']} characters"
    if "pattern" in field:
        return code(field["pattern"])
    above, below = field.get("exclusiveMinimum"), field.get("exclusiveMaximum")
    low = f"above {_number(above)}" if above is not None else _number(field.get("minimum"))
    high = f"below {_number(below)}" if below is not None else _number(field.get("maximum"))
    return f"{low} to {high}" if low and high else ""


def _number(value: float | None) -> str:
    return "" if value is None else f"{int(value)}" if value == int(value) else f"{value:g}"


def _unit(name: str) -> str:
    return EXCEPTIONS.get(name) or next((unit for end, unit in UNITS.items() if name.endswith(end)), "")


def _default(path: str, name: str, fidelity: str) -> str:
    return str(FIDELITY[fidelity].get(path.removeprefix("radar.").rstrip("."), {}).get(name, ""))


def _own_default(field: dict[str, Any]) -> str:
    """The default of the key itself; empty if it has none."""
    value = field.get("default")
    return "" if value is None else str(value)


def _left_out(path: str, name: str, field: dict[str, Any]) -> str:
    if f"{path}{name}" in ASSUMED:
        return "as the radar assumes"
    if field.get("default", "") is None:
        return ""
    if "default" in field:
        return code(field["default"])
    if _default(path, name, "robust"):
        return "by `fidelity`"
    value = IF_UNKNOWN.get(path.removeprefix("radar.").rstrip("."), {}).get(name)
    return "refused" if value is None else code(value)
