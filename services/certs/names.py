"""Names on certificates: ROLE.NAME, planner.NAME@FIRST-LAST, and the list of those that a router lets in.

The NAME of a front end is the one that it has behind `zenoh:`.
"""

import re
from pathlib import Path

from cogradar.services.errors import BadInput
from cogradar.shared.protocol.permissions import HOLDERS
from cogradar.shared.protocol.slots import N_SLOT, slots_in, slots_of
from cogradar.shared.protocol.topics import FRONT_END, Role

SETTINGS, ALLOWED = "zenoh.json5", "allowed"  # files: what a process is told, and the list
_NAME = re.compile(r"([a-z]+)\.[A-Za-z0-9][A-Za-z0-9_.-]{0,47}(@.*)?")


def holder_of(name: str) -> str:
    """The role that a name begins with. Raises BadInput."""
    found = _NAME.fullmatch(name)
    if found is None or found[1] not in HOLDERS:
        raise BadInput(
            f"{name!r}: must be ROLE.NAME, such as planner.host-1: a role of {', '.join(HOLDERS)}; then letters,"
            " digits, '.', '_' and '-', at most 48"
        )
    if found[2] is not None and (found[1] != Role.PLANNER or not slots_in(slots_of(name))):
        raise BadInput(f"{name!r}: behind @ are a planner's slots, FIRST-LAST of 0-{N_SLOT - 1}")
    return found[1]


def limit_of(name: str) -> str:
    """What limits the part of a holder in the system: slots of a planner, the name of a front end."""
    return name.partition(".")[2] if holder_of(name) == FRONT_END else slots_of(name)


def allowed(file: str) -> list[str]:
    """The names in a file, one a line; what is behind # is a remark. Raises BadInput."""
    try:
        lines = Path(file).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"--allow {file}: {getattr(error, 'strerror', None) or 'not a text file'}") from None
    names = []
    for number, line in enumerate(lines, 1):
        if name := line.partition("#")[0].strip():
            try:
                holder_of(name)
            except BadInput as error:
                raise BadInput(f"--allow {file}, line {number}: {error}") from None
            names.append(name)
    if not names:
        raise BadInput(f"--allow {file}: no name in it, so no process could connect")
    return list(dict.fromkeys(names))
