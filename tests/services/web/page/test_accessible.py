"""Axe, which checks what people need who read the page with their ears or their fingers, finds nothing in any view."""

from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.services.web.page.conftest import Open

AXE = Path(__file__).resolve().parents[3] / "node" / "node_modules" / "axe-core" / "axe.min.js"

pytestmark = [pytest.mark.browser, pytest.mark.skipif(not AXE.exists(), reason="axe-core: make node")]


def _found(page: Page) -> list[str]:
    """Every violation, light and dark: rule, and the first elements with the reason."""
    found = []
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        said: dict[str, Any] = page.evaluate("() => axe.run(document, { resultTypes: ['violations'] })")
        for rule in said["violations"]:
            nodes = [f"{node['target']} {node['failureSummary']}" for node in rule["nodes"][:3]]
            found.append(f"{scheme}: {rule['id']}: {'; '.join(nodes)}")
    return found


@pytest.mark.parametrize(
    ("view", "drawn"),
    [
        ("radar", "#course .subplot"),
        ("list", "#track-list tbody tr"),
        ("machines", "#processes tbody tr"),
        ("runs", "#run-table tbody tr"),
    ],
)
def test_a_view_has_no_fault(view: str, drawn: str, quiet: str, show: Open) -> None:
    page = show(f"{quiet}/?run=over&dwell=50&target=1&view={view}", before=_with_axe)
    expect(page.locator(drawn).first).to_be_visible()
    assert _found(page) == []


def test_what_opens_has_no_fault(quiet: str, unknown: str, show: Open) -> None:
    """The command panel, the help, two runs beside each other, and a roster of tracks."""
    page = show(f"{unknown}/?run=sited&dwell=8&north=1&view=radar", before=_with_axe)
    page.get_by_role("button", name="Command").click()
    found = _found(page)
    page.locator("#help-open").click()
    found += _found(page)
    pair = show(f"{quiet}/?run=over&beside=begun&view=runs", before=_with_axe)
    expect(pair.locator("#compare canvas, #compare svg").first).to_be_visible()
    assert found + _found(pair) == []


def _with_axe(page: Page) -> None:
    page.add_init_script(path=AXE)
