"""What a campaign keeps of a finished run."""

from typing import Any

from cogradar.services.metrics.store import Store
from cogradar.services.recorder.store.tables import Recording


def snapshots(dwells: int) -> tuple[int, ...]:
    """Dwells t whose waveforms are kept: a quarter, two thirds, the end; 75, 200, 300 of 300 as in the paper."""
    return tuple(sorted({max(1, dwells // 4), max(1, 2 * dwells // 3), dwells}))


def take(store: Store, run: str) -> Recording | None:
    """What is kept of a run: its row, scores, picture, and the waveforms of its snapshots; None if it is not there."""
    store.derive([run])
    row = store.whole_row(run)
    if row is None:
        return None
    # Waveform k is radiated at dwell k+1; dwell t is scan number acquisition_scans - 1 + t, counted from 0.
    n_scan, taken = row["acquisition_scans"], snapshots(row["dwells"])
    messages = [] if n_scan is None else [m for t in taken for m in _waveform(store, run, n_scan - 2 + t)]
    scores = store.scored("SELECT * FROM score WHERE run = ? ORDER BY t, target", [run])
    picture = store.scored("SELECT * FROM picture WHERE run = ? ORDER BY t", [run])
    return Recording(row, scores, picture, messages)


def _waveform(store: Store, run: str, k: int) -> list[dict[str, Any]]:
    return store.stored("message", "WHERE run = ? AND topic = 'waveform' AND k = ?", [run, k])
