"""How figures look: colours of Okabe and Ito (2008), told apart by the colour-blind, and a line style each.

The line styles are told apart in grey print. More than four targets have colours of a map that runs through the hues.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import to_hex
from matplotlib.typing import RcKeyType

from cogradar.shared.scenario.radar_config import Strategy

INK, FAINT = "#222222", "#777777"
DASHED, DOTTED, FLOOR = (0, (5, 1.5)), (0, (1, 1.2)), (0, (3, 1, 1, 1, 1, 1))
LINES = ("-", DASHED, (0, (5, 1, 1, 1)), DOTTED)
STYLE: dict[RcKeyType, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same on every machine
    "font.size": 8,
    "axes.titlesize": 9,
    "axes.labelsize": 8.5,
    "axes.edgecolor": INK,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.5,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.3,
    "savefig.dpi": 200,
    "pdf.fonttype": 42,
}


@dataclass(frozen=True)
class Look:
    """How a strategy, or a target, is drawn."""

    colour: str
    line: Any


LOOKS: dict[str, Look] = {
    Strategy.POWER_AWARE: Look("#D55E00", "-"),
    Strategy.UNIFORM: Look("#0072B2", DASHED),
    Strategy.ORTHOGONAL: Look("#444444", DOTTED),
}
OTHERS = tuple(map(Look, ("#009E73", "#CC79A7", "#56B4E9", "#E69F00"), LINES))  # of further strategies
TARGETS = tuple(map(Look, ("#0072B2", "#D55E00", "#009E73", "#CC79A7"), LINES))


def looks(strategies: Sequence[str]) -> dict[str, Look]:
    """How each of these strategies is drawn; further ones than the paper's get the other looks, in their order."""
    others = dict(zip((name for name in strategies if name not in LOOKS), cycle(OTHERS), strict=False))
    return {name: LOOKS.get(name) or others[name] for name in strategies}


def target_looks(n: int) -> Sequence[Look]:
    """How each of n targets is drawn, no two in one colour."""
    if n <= len(TARGETS):
        return TARGETS[:n]
    colours = mpl.colormaps["turbo"](np.linspace(0.03, 0.97, n))
    return [Look(to_hex(colour), line) for colour, line in zip(colours, cycle(LINES), strict=False)]
