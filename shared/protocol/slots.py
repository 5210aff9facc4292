"""Which tracks a planner may plan for: its name and its certificate's may end in @FIRST-LAST, some of 16 slots.

Track m is in slot m modulo 16. What a planner says of tracks is on a key with its slots. A router can so refuse other
slots by the key, and a reader sees whether the tracks are in them.
"""

import re
from functools import cache

from cogradar.shared.protocol.fields import PROCESS_NAME
from cogradar.shared.protocol.messages import Message

N_SLOT = 16
ALL_SLOTS = f"0-{N_SLOT - 1}"
_SLOTS = re.compile("(0|[1-9][0-9]?)-(0|[1-9][0-9]?)")


def fault_of_name(name: str, role: str) -> str | None:
    """What is wrong with the name of a process, for its user."""
    if not re.fullmatch(PROCESS_NAME, name):
        return "1 to 64 letters, digits, '.', '_' and '-'; of a planner, @FIRST-LAST behind them"
    if "@" in name and (role != "planner" or not slots_in(slots_of(name))):
        return f"behind @ are a planner's slots, FIRST-LAST of {ALL_SLOTS}"
    return None


def slots_of(planner: str) -> str:
    """Slots that a planner's name limits it to, FIRST-LAST; all if it does not."""
    _, at, text = planner.partition("@")
    return text if at else ALL_SLOTS


@cache
def slots_in(text: str) -> range:
    """The slots of a text FIRST-LAST; none of any other: a planner with such a name plans for nothing."""
    found = _SLOTS.fullmatch(text)
    if found is None or not int(found[1]) <= int(found[2]) < N_SLOT:
        return range(0)
    return range(int(found[1]), int(found[2]) + 1)


def may_plan(planner: str, track: int) -> bool:
    """Whether a planner may plan for a track."""
    return track % N_SLOT in slots_in(slots_of(planner))


def may_be_said(message: Message, slots: str) -> bool:
    """Whether all tracks of a message, and its sender if it names one, belong to the slots on its key."""
    said = vars(message)  # to ask a model for what it lacks takes long
    tracks = [said["target"]] if "target" in said else said.get("targets", [])
    sender = next((said[name] for name in ("planner", "process") if name in said), f"@{slots}")
    is_sender = slots_of(sender) == slots
    return is_sender and all(track % N_SLOT in slots_in(slots) for track in tracks)
