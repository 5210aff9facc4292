import re
from pathlib import Path

import pytest

from services import picture
from shared.messages import Scan
from shared.topics import TOPICS, Role, Topic

COMMITTED = Path(__file__).parents[2] / "docs" / "figures" / "loop.svg"


def arrows_of(svg: str) -> set[tuple[str, str, str]]:
    """(producer, reader, topic) of every arrow in the file; an arrow's id is producer-reader-topic-topic..."""
    roles = "|".join([*Role, "everybody"])
    found = re.findall(rf'<g id="({"|".join(Role)})-({roles})-([a-z-]+)">', svg)
    return {(producer, reader, topic) for producer, reader, topics in found for topic in topics.split("-")}


def arrows_expected() -> set[tuple[str, str, str]]:
    """The same, told from the table alone: `everybody` stands for all roles that speak or listen."""
    roles = {role for topic in TOPICS for role in (topic.producer, *topic.readers)}
    expected: set[tuple[str, str, str]] = set()
    for topic in TOPICS:
        name = next(chunk for chunk in topic.key.split("/")[3:])
        whole = set(topic.readers) == roles - {topic.producer}
        expected |= {(topic.producer, reader, name) for reader in (("everybody",) if whole else topic.readers)}
    return expected


def labels_of(svg: str) -> list[str]:
    """Texts of the file; matplotlib writes each as a comment before its outlines."""
    return re.findall(r"<!-- (.*?) -->", svg)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("picture") / "loop.svg"
    picture.write(path)
    return path.read_text(encoding="utf-8")


def test_arrows_are_the_table(drawn: str) -> None:
    assert arrows_of(drawn) == arrows_expected()


def test_committed_picture_is_up_to_date(drawn: str) -> None:
    committed = COMMITTED.read_text(encoding="utf-8")
    assert arrows_of(committed) == arrows_of(drawn)
    assert labels_of(committed) == labels_of(drawn), "run `make picture`"


def test_every_role_and_topic_is_named(drawn: str) -> None:
    labels = [word for label in labels_of(drawn) for word in label.split(", ")]
    for role in {role for topic in TOPICS for role in (topic.producer, *topic.readers)}:
        assert role in labels or f"{role}s" in labels
    for topic in TOPICS:
        assert picture.word(topic) in labels


def test_same_table_same_bytes_and_no_date(drawn: str, tmp_path: Path) -> None:
    picture.write(tmp_path / "again.svg")
    assert (tmp_path / "again.svg").read_text(encoding="utf-8") == drawn
    assert "<dc:date>" not in drawn


def test_new_listener_without_a_route_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    backwards = Topic("cogradar/run/{run}/scan", Scan, Role.METRICS, (Role.PLANNER,))
    monkeypatch.setattr(picture, "TOPICS", (*TOPICS, backwards))
    with pytest.raises(KeyError, match="metrics"):
        picture.write(tmp_path / "loop.svg")


def test_no_two_texts_overlap() -> None:
    figure = picture.picture()
    figure.draw_without_rendering()
    boxes = [(text.get_text(), text.get_window_extent()) for text in figure.axes[0].texts if text.get_text()]
    clashes = [(a, b) for i, (a, box) in enumerate(boxes) for b, other in boxes[:i] if box.overlaps(other)]
    assert clashes == []
