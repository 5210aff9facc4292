"""Compiled kernels: make them once per state of the sources, and say so while it lasts."""

import tomllib
from collections.abc import Callable

from shared.jit import CACHE_DIR
from shared.scenario import FIDELITY, SCENARIO_DIR, Strategy, parse


def are_compiled() -> bool:
    """Whether an earlier start compiled the kernels of exactly these sources."""
    return (CACHE_DIR / "complete").exists()


def compile_all(say: Callable[[str], None]) -> None:
    """Compile every kernel, unless that was done, by playing a few dwells of the smoke scenario in this process."""
    if are_compiled():
        return
    say("compiling kernels: once after an installation or a change of the sources, about a minute")
    from services.in_process import play
    from services.runs import start_of

    document = tomllib.loads((SCENARIO_DIR / "smoke.toml").read_text(encoding="utf-8"))
    for fidelity in FIDELITY:
        for strategy in Strategy:
            play(start_of(parse(document | {"fidelity": fidelity}, source="smoke"), strategy, seed=1, dwells=2))
    (CACHE_DIR / "complete").touch()
