import itertools
import re
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from matplotlib.path import Path as Line
from matplotlib.transforms import Bbox

from services.cli import topic_map as picture
from services.cli.topic_map import BOXES, HEIGHT, ROUTES, WIDTH, Box, Link
from shared.protocol.messages import Scan
from shared.protocol.topics import TOPICS, Role, Topic

COMMITTED = Path(__file__).parents[3] / "docs" / "figures" / "loop.svg"
LOOP = set(itertools.pairwise([Role.EMULATOR, Role.PLANNER, Role.ALLOCATOR, Role.EMULATOR]))


def arrows_of(svg: str) -> set[tuple[str, str, str]]:
    """(producer, reader, topic) of every arrow in the file; an arrow's id is producer-reader-topic-topic..."""
    roles = "|".join(Role)
    found = re.findall(rf'<g id="({roles})-({roles})-([a-z-]+)">', svg)
    return {(producer, reader, topic) for producer, reader, topics in found for topic in topics.split("-")}


def labels_of(svg: str) -> list[str]:
    """Lines of text in the file; matplotlib writes each as a comment before its outlines."""
    return re.findall(r"<!-- (.*?) -->", svg)


def area(box: Box) -> Bbox:
    return Bbox.from_bounds(box.x, box.y, box.width, box.height)


def stack(box: Box) -> Bbox:
    """The box and the shadows of further processes, up and to the right."""
    shift = 0.07 * (box.processes - 1)
    return Bbox.from_bounds(box.x, box.y, box.width + shift, box.height + shift)


def inside(small: Bbox, big: Bbox) -> bool:
    return all(big.fully_contains(x, y) for x, y in small.corners())


def line(link: Link) -> Line:
    return picture.bent(ROUTES[link].points)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("picture") / "loop.svg"
    picture.write(path)
    return path.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def figure() -> Figure:
    drawing = picture.picture()
    drawing.draw_without_rendering()
    return drawing


@pytest.fixture(scope="module")
def texts(figure: Figure) -> list[tuple[str, Bbox]]:
    """Every text and its place, in the units of the picture."""
    axes = figure.axes[0]
    to_units = axes.transData.inverted()
    return [(text.get_text(), text.get_window_extent().transformed(to_units)) for text in axes.texts]


def test_arrows_are_the_table(drawn: str) -> None:
    expected = {(topic.producer, reader, topic.name) for topic in TOPICS for reader in topic.readers}
    assert arrows_of(drawn) == expected


def test_committed_picture_is_up_to_date(drawn: str) -> None:
    committed = COMMITTED.read_text(encoding="utf-8")
    assert arrows_of(committed) == arrows_of(drawn)
    assert labels_of(committed) == labels_of(drawn), "run `make picture`"


def test_every_role_is_named_and_every_topic_is_named_and_explained(drawn: str) -> None:
    labels = labels_of(drawn)
    for role in {role for topic in TOPICS for role in (topic.producer, *topic.readers)}:
        assert role in labels or f"{role}s" in labels
    said = " ".join(labels)
    for topic in TOPICS:
        on_loop = not LOOP.isdisjoint((topic.producer, reader) for reader in topic.readers)
        in_list = 0 if on_loop else 1
        assert labels.count(picture.word(topic)) == len(topic.readers) + in_list
        assert picture.caption(topic) in said


def test_topics_have_names_of_their_own() -> None:
    assert len({picture.word(topic) for topic in TOPICS}) == len(TOPICS)


def test_same_table_same_bytes_and_no_date(drawn: str, tmp_path: Path) -> None:
    picture.write(tmp_path / "again.svg")
    assert (tmp_path / "again.svg").read_text(encoding="utf-8") == drawn
    assert "<dc:date>" not in drawn


def test_new_listener_without_a_route_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    backwards = Topic("cogradar/run/{run}/scan", Scan, Role.PLANNER, (Role.EMULATOR,))
    monkeypatch.setattr(picture, "TOPICS", (*TOPICS, backwards))
    with pytest.raises(KeyError, match="planner"):
        picture.write(tmp_path / "loop.svg")


def test_no_route_and_no_box_is_left_over() -> None:
    assert set(ROUTES) == set(picture.links())
    assert set(BOXES) == {role for link in ROUTES for role in link}


def test_only_the_loop_is_bold(figure: Figure) -> None:
    arrows = [patch for patch in figure.axes[0].patches if patch.get_gid()]
    width = {tuple(str(arrow.get_gid()).split("-")[:2]): arrow.get_linewidth() for arrow in arrows}
    assert set(width) == set(ROUTES)
    assert min(width[link] for link in LOOP) > 2 * max(width[link] for link in set(width) - LOOP)


@pytest.mark.parametrize("link", ROUTES, ids="-".join)
def test_arrow_runs_from_producer_to_reader_and_through_nothing(link: Link, texts: list[tuple[str, Bbox]]) -> None:
    arrow, points = line(link), ROUTES[link].points
    for role, (x, y) in zip(link, (points[0], points[-1]), strict=True):
        box = area(BOXES[role])
        assert box.padded(1e-9).contains(x, y)
        assert not box.padded(-1e-9).contains(x, y)
    assert not [role for role, box in BOXES.items() if arrow.intersects_bbox(area(box).padded(-1e-9), filled=False)]
    assert not [text for text, extent in texts if arrow.intersects_bbox(extent.padded(0.03), filled=False)]


def test_no_two_arrows_cross() -> None:
    pairs = itertools.combinations(ROUTES, 2)
    assert [(a, b) for a, b in pairs if line(a).intersects_path(line(b), filled=False)] == []


def test_no_two_texts_overlap_and_none_runs_over_an_edge(texts: list[tuple[str, Bbox]]) -> None:
    pairs = itertools.combinations(texts, 2)
    assert [(a, b) for (a, extent), (b, other) in pairs if extent.overlaps(other)] == []
    sheet = Bbox.from_bounds(0, 0, WIDTH, HEIGHT)
    assert [text for text, extent in texts if not inside(extent, sheet)] == []
    for box in BOXES.values():
        touching = [(text, extent) for text, extent in texts if extent.overlaps(stack(box))]
        assert [text for text, extent in touching if not inside(extent, area(box))] == []
