"""The loop picture of the README: roles as boxes, topics as arrows, drawn from the table of topics itself."""

import math
import sys
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch
from matplotlib.path import Path as Line
from matplotlib.typing import RcKeyType

from shared.protocol.topics import TOPICS, Role, Topic

Point = tuple[float, float]
Link = tuple[Role, Role]  # producer and reader

WIDTH, HEIGHT = 9.6, 5.9  # inches, and the units of every place below
INK, FAINT = "#1f2933", "#5f6b7a"
LOOP, STORE, RECALL, CONTROL = "#0b6e99", "#66717e", "#7a4fa3", "#b45309"
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
    """An arrow, from corner to corner, and where its label stands: around it (`center`) or at its side."""

    points: tuple[Point, ...]
    label: Point
    align: str = "center"
    wrap: int = 0  # letters per line of the caption; 0: its topics are explained in the list


# The loop is the upper half. Below it lies its memory, as wide as the loop, so that all that is remembered goes
# straight down and all that is recalled comes straight up.
BOXES = {
    Role.EMULATOR: Box(0.2, 3.6, 2.2, 1.25, "moves the targets,\ndraws echoes and disturbance,\ntests the cells"),
    Role.PLANNER: Box(3.7, 3.6, 2.2, 1.25, "one belief and POMCP\ntree per target", processes=3),
    Role.ALLOCATOR: Box(7.2, 3.6, 2.2, 1.25, "shares the power out so that\nthe worst SNR is best"),
    Role.RECORDER: Box(0.2, 1.75, 9.2, 0.65, "journals every message, acknowledges, brings back what was lost"),
    Role.METRICS: Box(8.0, 0.15, 1.4, 0.8, "scores, and\nanswers queries"),
    Role.OPERATOR: Box(0.2, 0.15, 2.2, 0.8, "starts or cancels a run,\nasks how far it is"),
}

ROUTES: dict[Link, Route] = {
    (Role.EMULATOR, Role.PLANNER): Route(((2.4, 4.22), (3.7, 4.22)), (3.05, 4.22), wrap=17),
    (Role.PLANNER, Role.ALLOCATOR): Route(((5.9, 4.22), (7.2, 4.22)), (6.62, 4.22), wrap=16),
    (Role.ALLOCATOR, Role.EMULATOR): Route(((8.3, 4.85), (8.3, 5.4), (1.3, 5.4), (1.3, 4.85)), (4.8, 5.4), wrap=40),
    (Role.EMULATOR, Role.RECORDER): Route(((1.45, 3.6), (1.45, 2.4)), (1.37, 3), "right"),
    (Role.RECORDER, Role.EMULATOR): Route(((1.65, 2.4), (1.65, 3.6)), (1.73, 3), "left"),
    (Role.PLANNER, Role.RECORDER): Route(((4.7, 3.6), (4.7, 2.4)), (4.62, 3), "right"),
    (Role.RECORDER, Role.PLANNER): Route(((4.9, 2.4), (4.9, 3.6)), (4.98, 3), "left"),
    (Role.ALLOCATOR, Role.RECORDER): Route(((8.2, 3.6), (8.2, 2.4)), (8.12, 3), "right"),
    (Role.RECORDER, Role.ALLOCATOR): Route(((8.4, 2.4), (8.4, 3.6)), (8.48, 3), "left"),
    (Role.RECORDER, Role.METRICS): Route(((8.5, 1.75), (8.5, 0.95)), (8.58, 1.33), "left"),
    (Role.OPERATOR, Role.RECORDER): Route(((1.4, 0.95), (1.4, 1.75)), (1.48, 1.33), "left"),
    (Role.RECORDER, Role.OPERATOR): Route(((1.2, 1.75), (1.2, 0.95)), (1.12, 1.33), "right"),
}
LIST = (3.95, 1.54)  # where the list of what has no caption begins,
LIST_HEIGHT = 1.42  # ... and how far down it goes


def links() -> dict[Link, list[Topic]]:
    """Which topics run from whom to whom."""
    found: dict[Link, list[Topic]] = {}
    for topic in TOPICS:
        for reader in topic.readers:
            found.setdefault((topic.producer, reader), []).append(topic)
    return found


def word(topic: Topic) -> str:
    """What the topic is called in its key: `.../{run}/plan/{target}` -> plan, `.../recall/scan` -> recall/scan."""
    chunks = topic.key.split("{run}/")[1].split("/")
    return "/".join(chunk for chunk in chunks if not chunk.startswith("{"))


def caption(topic: Topic) -> str:
    """What its message says: the docstring up to the colon."""
    text = (topic.message.__doc__ or "").split(":")[0]
    return text[0].lower() + text[1:]


def colour_of(link: Link) -> str:
    """The loop, what it tells its memory, what the memory tells it, and the order to begin."""
    producer, reader = link
    if producer is Role.OPERATOR:
        return CONTROL
    return RECALL if producer is Role.RECORDER else STORE if reader is Role.RECORDER else LOOP


def bent(points: tuple[Point, ...], radius: float = 0.2) -> Line:
    """The line through the points, with round corners."""
    vertices, codes = [points[0]], [Line.MOVETO]
    for before, corner, after in zip(points, points[1:], points[2:], strict=False):
        vertices += [_towards(corner, before, radius), corner, _towards(corner, after, radius)]
        codes += [Line.LINETO, Line.CURVE3, Line.CURVE3]
    return Line([*vertices, points[-1]], [*codes, Line.LINETO])


def _towards(start: Point, end: Point, distance: float) -> Point:
    part = distance / math.dist(start, end)
    return start[0] + part * (end[0] - start[0]), start[1] + part * (end[1] - start[1])


def draw_box(axes: Axes, role: Role, box: Box) -> None:
    """One role; a shadow for each further process."""
    for behind in reversed(range(box.processes)):
        patch = FancyBboxPatch(
            (box.x + 0.07 * behind, box.y + 0.07 * behind), box.width, box.height,
            boxstyle="round,pad=0,rounding_size=0.1", facecolor="white", edgecolor=INK, linewidth=1.1, zorder=3,
        )  # fmt: skip
        axes.add_patch(patch)
    middle, centre = box.x + box.width / 2, box.y + box.height / 2
    name = f"{role}s" if box.processes > 1 else str(role)
    up = 0.09 * (box.does.count("\n") + 1)
    axes.text(middle, centre + up, name, ha="center", va="center", size=12, weight="bold", color=INK, zorder=4)
    axes.text(middle, centre + up - 0.14, box.does, ha="center", va="top", size=9, color=FAINT, zorder=4)


def draw_link(axes: Axes, link: Link, topics: list[Topic]) -> None:
    """One arrow with the names of its topics, and what they say where the route has room for it."""
    route, colour = ROUTES[link], colour_of(link)
    arrow = FancyArrowPatch(
        path=bent(route.points), arrowstyle="-|>", mutation_scale=22 if colour == LOOP else 11,
        color=colour, linewidth=3.2 if colour == LOOP else 1.1, joinstyle="miter", zorder=2,
    )  # fmt: skip
    arrow.set_gid("-".join([*link, *(topic.name for topic in topics)]))
    axes.add_patch(arrow)
    x, y = route.label
    names = "\n".join(word(topic) for topic in topics)
    if not route.wrap:
        axes.text(x, y, names, ha=route.align, va="center", size=10, color=colour, linespacing=1.25)
        return
    axes.text(x, y + 0.1, names, ha=route.align, va="bottom", size=12, weight="bold", color=colour)
    said = "\n".join(textwrap.fill(caption(topic), route.wrap) for topic in topics)
    axes.text(x, y - 0.13, said, ha=route.align, va="top", size=9, color=FAINT)


def draw_list(axes: Axes) -> None:
    """What the topics of the memory say."""
    drawn = links()
    captioned = {topic.name for link, topics in drawn.items() if ROUTES[link].wrap for topic in topics}
    listed = [topic for topic in TOPICS if topic.name not in captioned]
    x, y = LIST
    for row, topic in enumerate(listed):
        colour = colour_of((topic.producer, topic.readers[0]))
        place = y - LIST_HEIGHT * row / (len(listed) - 1)
        axes.text(x, place, word(topic), ha="right", va="baseline", size=9, color=colour)
        axes.text(x + 0.12, place, caption(topic), ha="left", va="baseline", size=9, color=FAINT)


def picture() -> Figure:
    """The whole picture."""
    figure = Figure(figsize=(WIDTH, HEIGHT), facecolor="white")
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, WIDTH), ylim=(0, HEIGHT))
    axes.set_axis_off()
    for role, box in BOXES.items():
        draw_box(axes, role, box)
    for link, topics in links().items():
        draw_link(axes, link, topics)
    draw_list(axes)
    return figure


def write(path: Path) -> None:
    """Draw and save; the same table gives the same bytes."""
    with mpl.rc_context(STYLE):
        picture().savefig(path, format="svg", metadata={"Date": None, "Creator": None})


if __name__ == "__main__":
    write(Path(sys.argv[1]))
