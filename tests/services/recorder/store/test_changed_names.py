"""A bit of a run's name in a file: wherever it is, in a table or in an index, it is found."""

from contextlib import closing
from pathlib import Path

import pytest

from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.journal import Journal
from cogradar.services.recorder.store.check import check
from cogradar.shared.protocol.messages import Command
from cogradar.shared.protocol.orders import PowerLimit
from tests.services.loop import play, smoke_start

RUN, OTHER = "a-run-whose-name-is-nothing-else", "a-run-whose-name-is-nothing-elsd"
COMMAND = Command(run=RUN, id="0" * 32, by="operator", action=PowerLimit(share=0.5), at=0)


@pytest.fixture(scope="module")
def content(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A file with a run that goes on, and a command to it."""
    path = tmp_path_factory.mktemp("names") / "runs.db"
    with closing(Journal(str(path), owner="recorder")) as journal:
        core = RecorderCore(journal)
        start, *messages, _ = play(smoke_start(dwells=3, run=RUN))
        for message in (start.model_copy(update={"dwells": 400}), *messages):
            core.handle(message)
        core.handle(COMMAND)
        journal.commit()
    return path.read_bytes()


@pytest.fixture
def changed(content: bytes, tmp_path: Path) -> list[str]:
    """Files in each of which the name is another one in one place."""
    places, at, paths = list[int](), content.find(RUN.encode()), list[str]()
    while at >= 0:
        places.append(at)
        at = content.find(RUN.encode(), at + 1)
    for place in places:
        path = tmp_path / f"{place}.db"
        path.write_bytes(content[:place] + OTHER.encode() + content[place + len(RUN) :])
        paths.append(str(path))
    assert len(paths) > 20
    return paths


def test_a_store_in_which_a_name_is_another_one_is_damaged(changed: list[str]) -> None:
    assert [path for path in changed if not check(path)] == []


def test_no_run_goes_on_without_an_order_whose_row_is_of_another_name(changed: list[str]) -> None:
    """One went on from there, and its recorder ended with an error whenever the command was sent again."""
    going_on = 0
    for path in changed:
        with closing(Journal(path, owner="recorder")) as journal:
            core = RecorderCore(journal, resume=True)
            if RUN not in core._runs:
                continue
            going_on += 1
            assert [order.n for order in core._runs[RUN].orders.orders] == [1]
            assert list(core.handle(COMMAND)) == []  # it is known
    assert going_on < len(changed) - 3
