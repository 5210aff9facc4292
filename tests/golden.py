"""Golden digests: what the shipped scenarios, and settings that meet every branch of the loop, have to play.

`python -m tests.golden` compares; `--write` makes the file anew after a change that is meant to change a digest (the
commit says why). The file is part of the package. The digests are those of every processor, but for one (`PINNED`).
"""

import argparse
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import cogradar
from cogradar.services.bench.golden import FILE

# Scenario -> dwells. Each is played with two seeds.
SHIPPED = {
    "crossing": 30,
    "hard-turns": 30,
    "meeting": 40,
    "nobody": 60,
    "paper": 30,
    "paper-best": 12,
    "paper-best-range": 12,
    "paper-literal": 8,
    "smoke": 12,
    "starved": 12,
    "traffic": 24,
    "turn": 40,
}
_LIGHT = ("radar.belief.n_particle=2000", "radar.planner.n_sim=1000")
_JOINT = "radar.planner.looks=joint"
_STRONG = "radar.echo.amplitude_db=72"  # acquired within a few scans
_UNKNOWN_RCS = ("radar.assumes.rcs=unknown",)
# Name -> scenario, strategy, dwells, settings. Each is played with one seed, few particles and few simulations.
VARIANTS: dict[str, tuple[str, str, int, tuple[str, ...]]] = {
    "bins, orthogonal": ("paper", "orthogonal", 12, ()),
    "bins, uniform": ("paper", "uniform", 16, ()),
    "bins, joint looks": ("paper", "power-aware", 16, (_JOINT,)),
    "bins, joint looks, narrow": ("paper", "power-aware", 16, (_JOINT, "radar.planner.wide_looks=false")),
    "bins, joint looks, uniform": ("paper", "uniform", 16, (_JOINT,)),
    "bins, joint looks, turns": ("turn", "power-aware", 60, (_JOINT,)),
    "bins, urgency": ("starved", "power-aware", 16, ("radar.allocation.objective=urgency",)),
    "bins, mode": ("paper", "power-aware", 16, ("radar.planner.rule=mode",)),
    "bins, mean": ("paper", "power-aware", 16, ("radar.planner.rule=mean",)),
    "bins, exact": ("paper", "power-aware", 4, ("radar.planner.rule=exact",)),
    "bins, oracle": ("paper", "power-aware", 16, ("radar.planner.rule=oracle",)),
    "bins, RCS unknown": ("paper", "power-aware", 16, _UNKNOWN_RCS),
    "bins, RCS unknown, joint looks": ("paper", "power-aware", 16, (*_UNKNOWN_RCS, _JOINT)),
    "bins, RCS unknown, orthogonal": ("paper", "orthogonal", 12, _UNKNOWN_RCS),
    "bins, mean RCS": ("paper", "power-aware", 16, ("radar.assumes.rcs=mean", "world.rcs=swerling1")),
    "bins, turns": ("turn", "power-aware", 60, ("radar.motion.modes=mixture",)),
    "bins, weak": ("paper", "power-aware", 40, ("radar.echo.amplitude_db=57",)),
    "published, orthogonal": ("paper-literal", "orthogonal", 8, ()),
    "published, joint looks": ("paper-literal", "power-aware", 12, (_JOINT,)),
    "published, mean RCS": ("paper-literal", "power-aware", 8, ("radar.assumes.rcs=mean",)),
    "published, turns": ("turn", "power-aware", 12, ("radar.fidelity=paper", "radar.motion.modes=mixture")),
    "array, echoes told apart": (
        "paper-best",
        "power-aware",
        8,
        (_STRONG, "world.signal=array", "radar.receiver.separation=joint", "radar.receiver.noise=rows"),
    ),
    "steered, orthogonal": ("paper-best", "orthogonal", 8, (_STRONG,)),
    "steered, uniform": ("paper-best", "uniform", 8, (_STRONG,)),
    "steered, single looks": (
        "paper-best",
        "power-aware",
        10,
        (_STRONG, "radar.planner.looks=single", "radar.allocation.objective=max-min"),
    ),
    "equal antennas": ("starved", "power-aware", 10, ("radar.allocation.antennas=equal",)),
    "conventional beams": ("starved", "power-aware", 10, ("radar.allocation.beams=conventional",)),
    "reference solver": ("starved", "power-aware", 6, ("radar.allocation.solver=sdp",)),
    "array, noise of other range cells": (
        "paper-best-range",
        "power-aware",
        8,
        (_STRONG, "world.signal=array", "radar.receiver.noise=range-cells"),
    ),
    "steered, urgency": (
        "paper-best",
        "power-aware",
        10,
        (
            _STRONG,
            "radar.allocation.objective=urgency",
        ),
    ),
    "steered, no monopulse": (
        "paper-best",
        "power-aware",
        10,
        (
            _STRONG,
            "radar.receiver.monopulse=false",
        ),
    ),
    "steered, mean RCS": ("paper-best", "power-aware", 10, (_STRONG, "radar.assumes.rcs=mean", "world.rcs=swerling3")),
    "steered, RCS unknown": ("paper-best", "power-aware", 10, (_STRONG, *_UNKNOWN_RCS)),
    "steered, turns": ("turn", "power-aware", 60, ("radar.fidelity=best", "radar.motion.modes=mixture")),
    "range cells, RCS known": (
        "paper-best-range",
        "power-aware",
        10,
        (
            _STRONG,
            "radar.assumes.rcs=known",
        ),
    ),
    "range cells, orthogonal": ("paper-best-range", "orthogonal", 6, (_STRONG,)),
    "unknown number, orthogonal": ("crossing", "orthogonal", 20, ()),
    "unknown number, uniform": ("crossing", "uniform", 20, ()),
    "unknown number, isotropic search": ("crossing", "power-aware", 20, ("radar.search.pattern=isotropic",)),
    "unknown number, urgency": ("traffic", "power-aware", 20, ("radar.allocation.objective=urgency",)),
    "unknown number, particles": ("crossing", "power-aware", 20, ("radar.belief.filter=likelihood",)),
    "unknown number, no range cells": ("crossing", "power-aware", 20, ("radar.fidelity=best",)),
    "unknown number, single looks": (
        "crossing",
        "power-aware",
        20,
        ("radar.planner.looks=single", "radar.allocation.objective=max-min"),
    ),
    "unknown number, constant velocity": ("crossing", "power-aware", 20, ("radar.motion.modes=constant-velocity",)),
}
# The one that differs between processors (ADR 42), which is played with OpenBLAS's code for AVX2.
PINNED = {"reference solver": {"OPENBLAS_CORETYPE": "Haswell"}}
README = Path(__file__).parents[1] / "README.md"
SEEDS, SEED = (1, 2), 3  # of the shipped ones; of the variants
FIRST_RUN = "README"  # `make run`: its digest stands there, too


def played(name: str) -> dict[str, str]:
    """Digests of a shipped scenario by seed, of one of the variants, or of the first run of the README."""
    if name == FIRST_RUN:
        return {"1": cogradar.run("paper", seed=1).digest}
    if name in SHIPPED:
        return {str(seed): cogradar.run(name, seed=seed, dwells=SHIPPED[name]).digest for seed in SEEDS}
    scenario, strategy, dwells, settings = VARIANTS[name]
    loaded = cogradar.load(scenario, [*_LIGHT, *settings])
    return {str(SEED): cogradar.run(loaded, strategy=strategy, seed=SEED, dwells=dwells).digest}


def played_apart(name: str) -> dict[str, str]:
    """The same as `played`, in a process with the variables that it needs."""
    code = f"import json; from tests.golden import played; print(json.dumps(played({name!r})))"
    variables = os.environ | PINNED[name]
    found = subprocess.run([sys.executable, "-c", code], env=variables, capture_output=True, check=True, text=True)
    digests: dict[str, str] = json.loads(found.stdout)
    return digests


def with_digest(readme: str, digest: str) -> str:
    """The README with the digest of its first run."""
    text, n = re.subn(r"`digest [0-9a-f]{64}`", f"`digest {digest}`", readme)
    if n != 1:
        raise ValueError(f"{README} has {n} digests")
    return text


def main() -> int:
    """Play what is named, or everything; compare it with the file or write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="scenarios or variants; none: all")
    parser.add_argument("--write", action="store_true", help="write the file anew")
    given = parser.parse_args()
    golden = json.loads(FILE.read_text()) if FILE.exists() else {}
    differs = []
    for name in given.names or [*SHIPPED, *VARIANTS, FIRST_RUN]:
        found = played_apart(name) if name in PINNED else played(name)
        if golden.get(name) != found:
            differs.append(name)
            print(f"{name}: {golden.get(name)} -> {found}", flush=True)
        golden[name] = found
    if given.write:
        FILE.write_text(json.dumps(golden, indent=1) + "\n")
        README.write_text(with_digest(README.read_text(), golden[FIRST_RUN]["1"]))
        return 0
    print(f"{len(differs)} differ" if differs else "all as in the file")
    return int(bool(differs))


if __name__ == "__main__":
    sys.exit(main())
