"""What the smoke scenario plays wherever the arithmetic is the same: every x86-64 with fused multiply-add, and ARM64.

The file has the digests of all shipped scenarios; `python -m tests.golden` of the repository compares and writes it.
"""

import json
from pathlib import Path
from typing import Any, NamedTuple

from cogradar.services.campaigns.pool import play_one
from cogradar.shared.protocol.build import build
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy

FILE = Path(__file__).parent / "golden_digests.json"
NAME, SEED, DWELLS = "smoke", 1, 12


class Digest(NamedTuple):
    """Digest of a short run here and everywhere."""

    expected: str
    measured: str

    @property
    def passed(self) -> bool:
        """Whether they are the same."""
        return self.expected == self.measured

    def as_json(self) -> dict[str, Any]:
        """One row of `cogradar verify --json`."""
        return {"name": f"digest of {NAME}", **self._asdict(), "passed": self.passed}

    def __str__(self) -> str:
        if self.passed:
            return f"digest of {NAME}, seed {SEED}, {DWELLS} dwells: {self.measured}, as everywhere"
        return (
            f"digest of {NAME}, seed {SEED}, {DWELLS} dwells: {self.measured}, elsewhere {self.expected}: this machine"
            " computes otherwise, or the program was changed"
        )


def digest() -> Digest:
    """Play a short run and look its digest up."""
    start = RunStart.of(load(NAME), Strategy.POWER_AWARE, seed=SEED, dwells=DWELLS)
    expected = json.loads(FILE.read_text(encoding="utf-8"))[NAME][str(SEED)]
    return Digest(expected, str(play_one(start, build())[0].run["digest"]))
