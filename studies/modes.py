"""How many conditions of the product ask for a mode, by room and by mode, and how long each room is.

    python -m studies.modes [--show] [FOLDER]

A condition is the test of an `if`, a conditional expression or a `while`, the filter of a comprehension, or a `case`
with its guard. It asks for a mode if its text matches a pattern of MODES. A condition that asks for two modes counts
once in its room and once for each mode. Commit 269a91e: 203 of 753 in the nine rooms of ROOMS
(tracking 76, planner 30, allocator 29), 66 elsewhere.
"""

import argparse
import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOMS = (
    *(f"shared/{name}" for name in ("planning", "power", "protocol", "scoring", "signal", "tracking")),
    *(f"services/{name}" for name in ("allocator", "emulator", "planner")),
)
PRODUCT = ("shared", "services", "cogradar")
MODES = {
    "unannounced": r"is_unknown|announced|\b(roster|confirmation|ids|expected) is (not )?None|isinstance\(roster",
    "bins/steered": r"steered|'bins'|\b(aperture|nus|beam_nus) is (not )?None"
    r"|isinstance\([^)]*\b(Observation|Looks|(Steered)?Likelihood)\b",
    "real time": r"period_s|rate_hz|\bpace\b|real_time",
    "law of the RCS": r"tells_range|fluctuates|\brcs\b|by_range|\becho > 0",
    "range cells": r"\b(range_)?cell_km\b|measures_range",
    "modes of motion": r"has_modes|is_mixture|has_turns\(model|\bmodes\b",
    "other": r"\.(update|filter) ==|is_exact|wide_looks|is_beam|is_acquisition|tests_every_cell|looks =="
    r"|reacquire_below|\b(initiation|search|existence|gate) is (not )?None",
}


def conditions(tree: ast.AST) -> Iterator[ast.AST]:
    """Every condition of a file: one of several parts is one."""
    for node in ast.walk(tree):
        match node:
            case ast.If() | ast.IfExp() | ast.While():
                yield node.test
            case ast.comprehension():
                yield from node.ifs
            case ast.match_case():
                yield node.pattern if node.guard is None else node.guard


def modes_asked(condition: ast.AST) -> list[str]:
    """The modes that a condition asks for."""
    text = ast.unparse(condition)
    return [mode for mode, pattern in MODES.items() if re.search(pattern, text)]


def sources(product: Path) -> dict[str, list[Path]]:
    """The program's files by room, that is by the first two folders."""
    rooms: dict[str, list[Path]] = {}
    for file in sorted(file for top in PRODUCT for file in (product / top).rglob("*.py")):
        rooms.setdefault("/".join(file.relative_to(product).parent.parts[:2]), []).append(file)
    return rooms


def counts(files: list[Path], shown: list[str]) -> Counter[str]:
    """Lines, conditions, those that ask for a mode, and those that ask for each; what asks is added to `shown`."""
    found: Counter[str] = Counter()
    for file in files:
        text = file.read_text(encoding="utf-8")
        found["lines"] += text.count("\n")
        for condition in conditions(ast.parse(text)):
            asked = modes_asked(condition)
            found["conditions"] += 1
            found["modes"] += bool(asked)
            found.update(asked)
            if asked:
                line = getattr(condition, "lineno", 0)
                shown.append(f"{file}:{line}: {', '.join(asked)}: {ast.unparse(condition)}")
    return found


def table(rooms: dict[str, Counter[str]]) -> str:
    """The counts as text: the nine rooms, the others, and both sums."""
    columns = ["lines", "conditions", "modes", *MODES]
    nine = {room: found for room, found in rooms.items() if room in ROOMS}
    others = {room: found for room, found in rooms.items() if room not in ROOMS}
    lines = [f"{'room':<22}" + "".join(f"{name:>16}" for name in columns)]
    for name, group in (("the nine rooms", nine), ("other rooms", others)):
        total: Counter[str] = sum(group.values(), Counter())
        rows = [*sorted(group.items(), key=lambda item: -item[1]["modes"]), (name, total)]
        lines += [f"{room:<22}" + "".join(f"{found[column]:>16}" for column in columns) for room, found in rows] + [""]
    lines.append(f"{'product':<22}{sum(found['lines'] for found in rooms.values()):>16} lines of Python")
    return "\n".join(lines)


def main() -> None:
    """Print the conditions of a checkout."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.modes", description="Count conditions that ask for a mode."
    )
    parser.add_argument("folder", nargs="?", type=Path, default=Path(__file__).parents[1], help="A checkout.")
    parser.add_argument("--show", action="store_true", help="List every condition that asks for a mode.")
    given = parser.parse_args()
    shown: list[str] = []
    rooms = {room: counts(files, shown) for room, files in sources(given.folder).items()}
    print("\n".join([*(shown if given.show else []), table(rooms)]))


if __name__ == "__main__":
    main()
