"""What was measured, into a page that says on which machine."""

import os
import platform
from collections.abc import Sequence
from pathlib import Path

from cogradar.services.analysis.pages import write_into
from cogradar.services.analysis.tables import Table
from cogradar.services.campaigns.pool import n_core


def caption() -> str:
    """What it was measured on."""
    return f"{n_core()} cores, {platform.machine()}, load {os.getloadavg()[0]:.1f} at the end"


def write(page: Path, name: str, tables: Sequence[Table], remark: str = "") -> None:
    """Replace what is between a Markdown page's markers of this name. Raises BadInput."""
    write_into(page, {name: [f"Measured on {caption()}{remark}.", *tables]})
