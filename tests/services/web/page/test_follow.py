"""A page that follows the newest run, and says at once when its run or the service is gone."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import expect

from cogradar.services.recorder.journal import Journal
from cogradar.shared.protocol.messages import Message
from tests.services.web.conftest import record
from tests.services.web.page.conftest import BEGUN, Open, Watched, serve, until

pytestmark = pytest.mark.browser


@pytest.fixture
def store(smoke_run: list[Message], tmp_path: Path) -> Path:
    path = tmp_path / "runs.db"
    record(path, {"first": smoke_run})
    return path


@pytest.fixture
def served(store: Path) -> Iterator[str]:
    yield from serve(store)


def _heading(run: str) -> str:
    return f"document.getElementById('heading').title === '{run}'"


def test_a_dwell_without_a_run_is_of_the_newest(served: str, show: Open) -> None:
    for address in ("?dwell=7", "?run=newest&dwell=7"):
        page = show(f"{served}/{address}")
        expect(page.locator("#dwell")).to_have_text("7")
        until(page, "location.search === '?run=first&dwell=7'")


def test_it_moves_on_to_the_next_run_by_itself(served: str, store: Path, smoke_run: list[Message], show: Open) -> None:
    page, pinned = show(f"{served}/"), show(f"{served}/?run=first")
    for one in (page, pinned):
        expect(one.locator("#connection")).to_have_text("Complete")
    until(page, "location.search === '?run=newest'")
    record(store, {"second": smoke_run})
    until(page, _heading("second"))
    until(page, "location.search === '?run=newest'")
    expect(page.locator("#dwell")).to_have_text(str(2 * BEGUN))
    expect(pinned.locator("#heading")).to_have_attribute("title", "first")


def test_who_looks_back_is_left_alone_and_the_address_names_the_run(
    served: str, store: Path, smoke_run: list[Message], show: Open
) -> None:
    page = show(f"{served}/?run=newest")
    expect(page.locator("#dwell")).to_have_text(str(2 * BEGUN))
    page.keyboard.press("Home")
    until(page, "location.search.includes('run=first') && location.search.includes('dwell=1')")
    record(store, {"second": smoke_run})
    page.wait_for_timeout(4000)
    expect(page.locator("#heading")).to_have_attribute("title", "first")
    page.keyboard.press("End")
    until(page, _heading("second"))


def test_a_stored_run_that_is_gone_is_said_to_be_so(served: str, store: Path, show: Open, watched: Watched) -> None:
    page = show(f"{served}/?run=first")
    expect(page.locator("#connection")).to_have_text("Complete")
    watched.may_be_refused = True
    journal = Journal(str(store))
    journal.write("DELETE FROM run")
    journal.close()
    expect(page.locator("#connection")).to_have_text("No such run")
    expect(page.locator("#empty")).to_contain_text("There is no run first here")


def test_a_stored_run_whose_service_is_gone_says_so_until_it_is_back(store: Path, show: Open, watched: Watched) -> None:
    service = serve(store)
    page = show(f"{next(service)}/?run=first")
    expect(page.locator("#connection")).to_have_text("Complete")
    watched.may_be_refused = True
    next(service, None)  # it ends
    expect(page.locator("#connection")).to_have_text("Reconnecting")
    expect(page.locator("#notice")).to_contain_text("goes on by itself")
    assert page.locator("#dwell").inner_text() == str(2 * BEGUN)  # the picture stays
