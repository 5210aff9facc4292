"""What is said in one dwell, whether the run is being played or was stored."""

from dataclasses import dataclass, field

from cogradar.shared.protocol.messages import Plan, Scan, Truth, Waveform


@dataclass
class DwellMessages:
    """All messages about one dwell."""

    k: int
    scan: Scan
    sent: Waveform | None  # what was radiated; None: before the first waveform, or it is not stored
    truth: Truth | None = None
    plans: list[Plan] = field(default_factory=list)
    next: Waveform | None = None  # what the allocator will have radiated in the dwell that follows
