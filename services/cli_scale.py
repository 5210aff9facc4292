"""`cogradar bench scale`."""

import json
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from rich.console import Console

from services import bench_scale, scale_tables


def scale(out: Console, say: Callable[[str], None], stop: threading.Event, *, into: str | None, as_json: bool) -> None:
    """Measure, show, and rewrite a page if one is named. Raises BadPage, RunFailed, Interrupted."""
    if into:
        scale_tables.check_page(Path(into))
    measured = bench_scale.measure(say, stop)
    if into:
        scale_tables.write_into(Path(into), measured)
    if as_json:
        sys.stdout.write(json.dumps(scale_tables.as_json(measured)) + "\n")
        return
    for table in scale_tables.rich_tables(measured):
        out.print(table)
    out.print(scale_tables.caption(), highlight=False, soft_wrap=True)
