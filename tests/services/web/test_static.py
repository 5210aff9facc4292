"""The page's files: as they are installed, compressed, kept by whoever has them, and under a strict policy."""

import re

import httpx
import pytest

from cogradar.services.web.address import FORM
from cogradar.services.web.static import CHARTS, PAGE


@pytest.mark.parametrize("path", ["/", *(f"/page/{file.name}" for file in PAGE.iterdir()), f"/page/{CHARTS}"])
def test_a_file_is_served_compressed_and_only_once(web: httpx.Client, path: str) -> None:
    plain, packed = web.get(path, headers={"Accept-Encoding": "identity"}), web.get(path)
    assert (plain.status_code, packed.headers["content-encoding"]) == (200, "gzip")
    assert plain.content == packed.content  # as it was before it was packed
    assert "content-encoding" not in plain.headers
    again = web.get(path, headers={"If-None-Match": packed.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert packed.headers["cache-control"] == "no-cache"


def test_a_browser_is_told_to_ask_nobody_else(web: httpx.Client) -> None:
    for path in ("/?run=whole&dwell=3", f"/page/{CHARTS}"):
        headers = web.get(path).headers
        policy = dict(part.strip().split(" ", 1) for part in headers["content-security-policy"].split(";"))
        assert policy["default-src"] == "'none'"
        assert {policy[name] for name in ("script-src", "connect-src")} == {"'self'"}
        assert policy["frame-ancestors"] == "'none'"
        assert (headers["x-content-type-options"], headers["referrer-policy"]) == ("nosniff", "no-referrer")


def test_the_page_takes_what_can_be_a_commanders_token() -> None:
    """A header cannot carry anything else: the request would fail as if there were no service."""
    html = (PAGE / "index.html").read_text(encoding="utf-8")
    assert re.findall(r'id="token" [^>]*pattern="([^"]+)"', html) == [rf"\s*{FORM}\s*"]


def test_the_page_is_html_and_the_charts_are_a_script(web: httpx.Client) -> None:
    assert web.get("/").headers["content-type"] == "text/html; charset=utf-8"
    assert web.get("/").text.startswith("<!doctype html>")
    charts = web.get(f"/page/{CHARTS}")
    assert charts.headers["content-type"] == "text/javascript; charset=utf-8"
    assert len(charts.content) > 1_000_000
