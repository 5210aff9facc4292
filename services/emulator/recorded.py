"""The recorded front end: plays the scans of a stored run back, whatever is to be transmitted (open loop).

Where the loop is the one that was recorded, its waveforms are those that were radiated then, and the run comes out as
it was. Another planner sees the recorded scans and beams, not the results of its own waveforms. With an unknown number
of targets it also sees the recorded tracks, whose beams they are.
"""

from collections.abc import Callable
from dataclasses import fields

from cogradar.services.emulator.front_end import FrontEndError, ScanData, Transmission
from cogradar.shared.protocol.messages import Scan
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.wire.codec import decode

# What must be as it was: the cells, and when the acquisition is complete. Later scans are only of the beams.
_SAME = ("tracks", "max_tracks", "array", "detector", "receiver", "acquisition", "search", "initiation")


class RecordedFrontEnd:
    """One run's scans, read one by one."""

    def __init__(self, scan_of: Callable[[int], bytes | None], close: Callable[[], None] = lambda: None) -> None:
        """`scan_of` gives the encoded scan of dwell k, None after the last one."""
        self._scan_of = scan_of
        self.close = close

    def transmit(self, k: int, t: int, waveform: Transmission) -> ScanData | None:  # noqa: ARG002 - open loop
        """The recorded scan of dwell k."""
        payload = self._scan_of(k)
        if payload is None:
            return None
        scan = decode(payload)
        if not isinstance(scan, Scan):
            raise FrontEndError(f"the recording of dwell {k} is no scan")
        return ScanData(**{column.name: getattr(scan, column.name) for column in fields(ScanData)})


def check_fits(recorded: RadarConfig, asked: RadarConfig) -> None:
    """Raise FrontEndError for a radar to which recorded scans mean nothing."""
    other = [f"radar.{name}" for name in _SAME if getattr(recorded, name) != getattr(asked, name)]
    if other:
        raise FrontEndError(f"recorded with another {' and '.join(other)}: scans would not fit")
