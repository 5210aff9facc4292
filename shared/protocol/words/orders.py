"""Actions of commands as people write them: as words, or as a document; tracks count from 1."""

from collections.abc import Sequence
from typing import Any

from pydantic import ValidationError

from cogradar.shared.protocol.orders import (
    Accuracy,
    Action,
    DropTrack,
    EndRun,
    Look,
    Pause,
    PowerLimit,
    Priority,
    Resume,
    SectorSearch,
    Setting,
)
from cogradar.shared.scenario.faults import explain


def text_of(action: Action) -> str:
    """An action as `cogradar command` takes it."""
    _, _, names = FORMS[action.kind]
    told = [(name, getattr(action, name)) for name in names]
    return " ".join([action.kind, *(_word(name, value) for name, value in told if (name, value) != ("dwells", None))])


def _word(name: str, value: str | float | None) -> str:
    if value is None:
        return NONE
    if isinstance(value, float):
        return f"{value:g}" if float(f"{value:g}") == value else repr(value)
    return f"{int(value) + 1}" if name == "track" else f"{value}"


# Of each kind: how it is written, and the fields of what is written, a number each but for WORDS. What stands in
# brackets may be left out.
_Kind = type[PowerLimit | SectorSearch | Look | DropTrack | Priority | Accuracy | Setting | Pause | Resume | EndRun]
FORMS: dict[str, tuple[_Kind, str, tuple[str, ...]]] = {
    "power": (PowerLimit, "power SHARE", ("share",)),
    "sector": (SectorSearch, "sector blank|normal|double FROM TO", ("search", "from_deg", "to_deg")),
    "look": (Look, "look BEARING DWELLS SHARE", ("bearing_deg", "dwells", "share")),
    "drop": (DropTrack, "drop TRACK", ("track",)),
    "priority": (Priority, "priority TRACK WEIGHT", ("track", "weight")),
    "accuracy": (Accuracy, "accuracy TRACK KM|none", ("track", "km")),
    "set": (Setting, "set strategy|rule|objective VALUE", ("key", "value")),
    "pause": (Pause, "pause [DWELLS]", ("dwells",)),
    "resume": (Resume, "resume", ()),
    "end": (EndRun, "end", ()),
}


EXAMPLES = {  # of kinds that take values
    "power": "power 0.5",
    "sector": "sector blank -20 10",
    "look": "look 12.5 20 0.3",
    "drop": "drop 3",
    "priority": "priority 3 2.5",
    "accuracy": "accuracy 3 0.5 (track 3 to 0.5 km), or accuracy 3 none",
    "set": "set rule mode",
    "pause": "pause 20",
}
WORDS = {"search", "key", "value"}
NONE = "none"  # of `km`


def forms() -> list[str]:
    """How each kind of action is written."""
    return [form for _, form, _ in FORMS.values()]


def parsed(words: Sequence[str]) -> Action:
    """The action that these words are. Raises ValueError."""
    kind, values = (words[0], words[1:]) if words else ("", ())
    _, form, names = _form(kind)
    if not len(names) - form.count("[") <= len(values) <= len(names):
        raise ValueError(f"{' '.join(words)}: must be {form}, as in {EXAMPLES.get(kind, kind)}")
    try:
        return action_of({"kind": kind} | {name: _value(name, text) for name, text in zip(names, values, strict=False)})
    except ValueError as error:
        raise ValueError(f"{error}; write {form}, as in {EXAMPLES[kind]}") from None


def action_of(document: dict[str, Any]) -> Action:
    """The action of a document in which tracks count from 1. Raises ValueError."""
    model, _, _ = _form(document.get("kind"))
    track = document.get("track")
    if isinstance(track, int) and not isinstance(track, bool):
        if track < 1:
            raise ValueError(f"track = {track}: must be >= 1")
        document = document | {"track": track - 1}
    try:
        return model.model_validate(document)
    except ValidationError as error:
        raise ValueError(explain(error, model)) from None


def _form(kind: object) -> tuple[_Kind, str, tuple[str, ...]]:
    """What a kind of action is made of. Raises ValueError."""
    if not isinstance(kind, str) or kind not in FORMS:
        raise ValueError(f"action = {str(kind)[:40]!r}: must be one of {'; '.join(forms())}")
    return FORMS[kind]


def _value(name: str, text: str) -> str | int | float | None:
    """A number where one is wanted. Raises ValueError."""
    if name in WORDS:
        return text
    if (name, text) == ("km", NONE):
        return None
    is_whole = name in {"track", "dwells"}
    try:
        return int(text) if is_whole else float(text)
    except ValueError:
        raise ValueError(f"{name} = {text}: must be a {'whole ' * is_whole}number{_meant(text)}") from None


def _meant(text: str) -> str:
    """The fraction that a percentage is."""
    percent = text.removesuffix("%")
    if percent == text or not percent.isascii() or not percent.isdecimal():
        return ""
    return f" (did you mean {int(percent[:9]) / 100:g}?)"
