"""What was measured, into a page that says on which machine."""

import os
import platform
from collections.abc import Sequence
from pathlib import Path

from cogradar.services.analysis.pages import write_into
from cogradar.services.analysis.tables import Table, check_page
from cogradar.services.campaigns.pool import n_core
from cogradar.services.errors import BadInput

BUSY = 0.5  # load from which a machine is too busy to be timed


def check_quiet(page: Path, names: Sequence[str]) -> None:
    """Raises BadInput if the page lacks markers of these names, or if other programs use this machine."""
    check_page(page, names)
    if (load := os.getloadavg()[0]) > BUSY:
        raise BadInput(
            f"{page}: the load of this machine is {load:.2f}, must be at most {BUSY} for times on a page; end the other"
            " programs and wait a minute, or leave out --into"
        )


def caption() -> str:
    """What it was measured on."""
    return f"{n_core()} cores, {platform.machine()}, load {os.getloadavg()[0]:.1f} at the end"


def write(page: Path, name: str, tables: Sequence[Table], remark: str = "") -> None:
    """Replace what is between a Markdown page's markers of this name. Raises BadInput."""
    write_into(page, {name: [f"Measured on {caption()}{remark}.", *tables]})
