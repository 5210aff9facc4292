"""The heartbeat of a process: a file that it writes each second as long as it is well, with what troubles it.

A supervisor of the process looks how old the file is (deploy/container/healthy.sh): some milliseconds. To ask over the
network took a Python that loads Zenoh, a second of processor each time.
"""

import logging
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol, runtime_checkable

VARIABLE = "COGRADAR_HEARTBEAT"  # the file; empty: none
EVERY_S = 1.0
log = logging.getLogger(__name__)


@runtime_checkable
class Troubled(Protocol):
    """A core that can be up and yet not do its work."""

    @property
    def trouble(self) -> str:
        """What keeps it; "": nothing."""


class Heartbeat:
    """To be called in the main loop: one that hangs is not well."""

    def __init__(self, is_well: Callable[[], bool] = lambda: True, core: object = None) -> None:
        self._file = os.environ.get(VARIABLE, "")
        self._is_well = is_well
        self._core = core if isinstance(core, Troubled) else None
        self._due_s = 0.0

    def __call__(self) -> None:
        """Beat, if it is time."""
        now_s = time.monotonic()
        if not self._file or now_s < self._due_s or not self._is_well():
            return
        self._due_s = now_s + EVERY_S
        try:
            Path(self._file).write_text(self._core.trouble if self._core is not None else "", encoding="utf-8")
        except OSError as error:
            log.warning("%s = %s: %s; no heartbeat", VARIABLE, self._file, error.strerror)
            self._file = ""
