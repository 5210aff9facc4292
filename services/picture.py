"""The loop picture of the README: roles as boxes, topics as arrows, drawn from the table of topics itself."""

import sys
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch
from matplotlib.typing import RcKeyType

from shared.topics import TOPICS, Role, Topic

Point = tuple[float, float]
Link = tuple[Role, Role | None]  # producer and reader; None: every other role

WIDTH, HEIGHT = 10.4, 5.6  # inches, and the units of every place below
INK, FAINT = "#1f2933", "#5f6b7a"
LOOP, LISTEN, CONTROL = "#0b6e99", "#66717e", "#b45309"
STYLE: dict[RcKeyType, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same outlines on every machine
    "svg.fonttype": "path",
    "svg.hashsalt": "cogradar",  # else the ids in the file are random
}


@dataclass(frozen=True)
class Box:
    """A role's place and what it does."""

    x: float
    y: float
    width: float
    height: float
    does: str
    processes: int = 1  # drawn as a stack if there may be more than one


@dataclass(frozen=True)
class Route:
    """A straight arrow, where its label stands and how wide its caption may run."""

    tail: Point
    head: Point
    label: Point
    align: str = "center"
    wrap: int = 0  # letters per line of the caption; 0: no caption


BOXES = {
    Role.OPERATOR: Box(0.1, 2.2, 1.3, 1.2, "starts a run,\nwaits for\nits end"),
    Role.EMULATOR: Box(2.75, 0.5, 1.65, 4.45, "moves the targets,\ndraws echoes and\ndisturbance,\ntests the cells"),
    Role.PLANNER: Box(7.0, 3.85, 3.0, 1.1, "one belief and POMCP\ntree per target", processes=3),
    Role.METRICS: Box(6.2, 2.25, 2.0, 1.0, "stores everything,\nanswers queries"),
    Role.ALLOCATOR: Box(7.0, 0.5, 3.0, 1.1, "shares the power out\nso that the worst SNR is best"),
}
FRAME = (2.3, 0.12, 8.0, 5.33)  # around every role that `start` and `end` reach

ROUTES: dict[Link, Route] = {
    (Role.EMULATOR, Role.PLANNER): Route((4.4, 4.4), (7.0, 4.4), (5.7, 4.4), wrap=30),
    (Role.PLANNER, Role.ALLOCATOR): Route((9.5, 3.85), (9.5, 1.6), (9.35, 2.75), "right", wrap=14),
    (Role.ALLOCATOR, Role.EMULATOR): Route((7.0, 1.05), (4.4, 1.05), (5.7, 1.05), wrap=30),
    (Role.EMULATOR, Role.METRICS): Route((4.4, 2.75), (6.2, 2.75), (5.3, 2.75), wrap=24),
    (Role.PLANNER, Role.METRICS): Route((7.6, 3.85), (7.6, 3.25), (7.72, 3.55), "left"),
    (Role.ALLOCATOR, Role.METRICS): Route((7.6, 1.6), (7.6, 2.25), (7.72, 1.92), "left"),
    (Role.OPERATOR, None): Route((1.4, 3.1), (2.3, 3.1), (1.85, 3.1)),
    (Role.EMULATOR, None): Route((2.75, 2.5), (1.4, 2.5), (1.85, 2.5)),
}


def links() -> dict[Link, list[Topic]]:
    """Which topics run from whom to whom; what every other role reads is one link, to None."""
    roles = {role for topic in TOPICS for role in (topic.producer, *topic.readers)}
    found: dict[Link, list[Topic]] = {}
    for topic in TOPICS:
        everybody = {topic.producer, *topic.readers} == roles
        for reader in (None,) if everybody else topic.readers:
            found.setdefault((topic.producer, reader), []).append(topic)
    return found


def word(topic: Topic) -> str:
    """What the topic is called in its key: `cogradar/run/{run}/plan/{target}` -> plan."""
    return topic.key.split("{run}/")[1].split("/")[0]


def caption(topic: Topic) -> str:
    """What its message says: the docstring up to the colon."""
    text = (topic.message.__doc__ or "").split(":")[0]
    return text[0].lower() + text[1:]


def draw_box(axes: Axes, role: Role, box: Box) -> None:
    """One role; a shadow for each further process."""
    for behind in reversed(range(box.processes)):
        patch = FancyBboxPatch(
            (box.x + 0.07 * behind, box.y + 0.07 * behind), box.width, box.height,
            boxstyle="round,pad=0,rounding_size=0.1", facecolor="white", edgecolor=INK, linewidth=1.1, zorder=3,
        )  # fmt: skip
        axes.add_patch(patch)
    middle, centre = box.x + box.width / 2, box.y + box.height / 2
    lines = box.does.count("\n") + 1
    name = f"{role}s" if box.processes > 1 else str(role)
    up = 0.11 * lines
    axes.text(middle, centre + up, name, ha="center", va="center", size=12, weight="bold", color=INK, zorder=4)
    axes.text(middle, centre + up - 0.17, box.does, ha="center", va="top", size=8.5, color=FAINT, zorder=4)


def draw_link(axes: Axes, link: Link, topics: list[Topic]) -> None:
    """One arrow with the names of its topics, and what they say where the route has room for it."""
    producer, reader = link
    route = ROUTES[link]
    colour = CONTROL if reader is None else LISTEN if reader is Role.METRICS else LOOP
    names = [word(topic) for topic in topics]
    arrow = FancyArrowPatch(
        route.tail, route.head, arrowstyle="-|>", mutation_scale=16, shrinkA=0, shrinkB=0,
        color=colour, linewidth=2.4 if colour == LOOP else 1.4, zorder=5,
    )  # fmt: skip
    arrow.set_gid(f"{producer}-{reader or 'everybody'}-{'-'.join(names)}")
    axes.add_patch(arrow)
    x, y = route.label
    sideways = route.align != "center"
    prefix = f"{names[-1]}: " if len(names) > 1 else ""
    said = textwrap.fill(prefix + caption(topics[-1]), route.wrap) if route.wrap else ""
    above = 0.09 * (said.count("\n") + 1) if sideways and said else 0.0 if sideways else 0.18
    heading = ", ".join(names)
    axes.text(x, y + above, heading, ha=route.align, va="center", size=11, weight="bold", color=colour)
    axes.text(x, y + (above - 0.15 if sideways else -0.12), said, ha=route.align, va="top", size=8.5, color=FAINT)


def picture() -> Figure:
    """The whole picture."""
    figure = Figure(figsize=(WIDTH, HEIGHT), facecolor="white")
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, WIDTH), ylim=(0, HEIGHT))
    axes.set_axis_off()
    x, y, width, height = FRAME
    frame = FancyBboxPatch(
        (x, y), width, height, boxstyle="round,pad=0,rounding_size=0.15",
        facecolor="#f6f8fa", edgecolor=CONTROL, linestyle=(0, (4, 3)), linewidth=1.0,
    )  # fmt: skip
    axes.add_patch(frame)
    for role, box in BOXES.items():
        draw_box(axes, role, box)
    for link, topics in links().items():
        draw_link(axes, link, topics)
    control = [word(topic) for (_, reader), topics in links().items() if reader is None for topic in topics]
    note = f"{' and '.join(control)} reach every role"
    axes.text(x + 0.2, y + height - 0.1, note, ha="left", va="top", size=8.5, color=CONTROL)
    return figure


def write(path: Path) -> None:
    """Draw and save; the same table gives the same bytes."""
    with mpl.rc_context(STYLE):
        picture().savefig(path, format="svg", metadata={"Date": None, "Creator": None})


if __name__ == "__main__":
    write(Path(sys.argv[1]))
