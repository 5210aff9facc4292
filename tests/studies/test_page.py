"""Times on a page are of a quiet machine."""

import os
from pathlib import Path

import pytest

from cogradar.services.errors import BadInput
from studies import page


def test_a_busy_machine_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "scaling.md"
    file.write_text("<!-- scale -->\n<!-- /scale -->\n", encoding="utf-8")
    monkeypatch.setattr(os, "getloadavg", lambda: (0.5, 9.0, 9.0))
    page.check_quiet(file, ["scale"])
    monkeypatch.setattr(os, "getloadavg", lambda: (0.51, 0.0, 0.0))
    with pytest.raises(BadInput, match=r"scaling.md: the load of this machine is 0.51, must be at most 0.5"):
        page.check_quiet(file, ["scale"])
    monkeypatch.setattr(os, "getloadavg", lambda: (0.0, 0.0, 0.0))
    with pytest.raises(BadInput, match="crowd"):
        page.check_quiet(file, ["crowd"])
