"""The tracks of a run as arrays. T dwells, N tracks, all that ever were: tracks of an unknown number come and go."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.protocol.messages import Plan, Scan, Truth, Waveform
from cogradar.shared.scoring.scan_rows import radiated_k, row_of_track

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


class Tracks(NamedTuple):
    """Column n is track `numbers[n]`, whenever it was there; NaN, False or 0 while it was not.

    As an xarray.Dataset: dimensions dwell, track, state, with `numbers` as the coordinate of track.
    """

    numbers: Ints  # (N,) ascending, from 1; of an unknown number one is never used again
    alive: Bools  # (T, N) there is a plan of the dwell, and not its last one
    confirmed: Bools  # (T, N) or tentative
    existence: Floats  # (T, N) probability that there is a target; NaN, too, if their number is known
    estimates: Floats  # (T, N, 4) mean of the belief after the dwell's scan, [x, vx, y, vy], km and km/s
    covariance: Floats  # (T, N, 4, 4) of the belief
    detections: Bools  # (T, N) a cell that it asked for was over the threshold
    shares: Floats  # (T, N) power on its beams, linear
    targets: Ints  # (T, N) number of the target that it follows, from 1; 0: of none, or without truth

    @classmethod
    def of(cls, plans: Sequence[Plan], sent: Sequence[Waveform | None], ks: Sequence[int], followed: Floats) -> Self:
        """Of all plans. ks: dwells of the rows; sent: what each radiated; followed: track of each target, (T, M)."""
        places, told = {k: i for i, k in enumerate(ks)}, [plan for plan in plans if plan.status == "tracking"]
        numbers = np.unique([plan.target + 1 for plan in told if plan.k in places]).astype(np.int64)
        shape = len(ks), numbers.size
        columns = {number: n for n, number in enumerate(numbers.tolist())}
        nothing, no = np.full(shape, np.nan), np.zeros(shape, dtype=np.bool_)
        found = cls(
            numbers=numbers,
            alive=no.copy(),
            confirmed=no.copy(),
            existence=nothing.copy(),
            estimates=np.full((*shape, 4), np.nan),
            covariance=np.full((*shape, 4, 4), np.nan),
            detections=no.copy(),
            shares=nothing.copy(),
            targets=np.zeros(shape, dtype=np.int64),
        )
        for plan in told:
            if plan.k in places:
                found._add(plan, sent[places[plan.k]], (places[plan.k], columns[plan.target + 1]))
        for i, m in np.argwhere(~np.isnan(followed)).tolist():
            if (n := columns.get(int(followed[i, m]))) is not None:
                found.targets[i, n] = m + 1
        return found

    def _add(self, plan: Plan, sent: Waveform | None, at: tuple[int, int]) -> None:
        self.alive[at], self.detections[at] = True, plan.detected
        self.confirmed[at] = plan.confirmed is not False
        self.existence[at] = np.nan if plan.existence is None else plan.existence
        self.estimates[at], self.covariance[at] = plan.estimate, plan.covariance
        row = -1 if sent is None else row_of_track(vars(sent), plan.target)
        if sent is not None and row >= 0:
            self.shares[at] = sent.shares[row].sum()


def sent_in(found: Iterable[Waveform | Truth | Scan], ks: Sequence[int]) -> list[Waveform | None]:
    """The waveform that each dwell k radiated, of these scans; None: it is not stored."""
    messages = list(found)
    waveforms = {message.k: message for message in messages if isinstance(message, Waveform)}
    truths = {message.k: vars(message) for message in messages if isinstance(message, Truth)}
    scans = {message.k: vars(message) for message in messages if isinstance(message, Scan)}
    return [waveforms.get(radiated_k(k, scans.get(k, {}), truths.get(k))) for k in ks]
