"""What recorded values and their noise say of a receiver: clipped, repeated, of the wrong scale, too strong somewhere.

Symbols as in `calibration`.
"""

from collections.abc import Iterable
from hashlib import sha256
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.signal.detector.data_set import DataSet, Processing
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.signal.waveform import Signatures

Complexes = NDArray[np.complex128]
Floats = NDArray[np.float64]

OFF_SCALE_DB = 1.0  # mean noise power in an element, from 1
DEAD_DB, HOT_DB = -10.0, 6.0  # median noise power of a channel, over the other channels'
LOUD_DB = 10.0  # noise level of a bin, over the other bins'
BLIND = 0.2  # share of snapshots in which a bin has no estimate of its noise
COARSE = 0.5  # step of quantised values, in standard deviations of the noise
P_FA, ALARMS = 1e-2, 5.0  # a limit, and times as many detections in noise as it should have
SMALL = 100.0  # elements of a data set up to which there are twice as many
CONSTANT = 0.05  # share of the power that is the same in all snapshots
IMPROPER = 0.2  # |E y^2| / E |y|^2
_FEWEST = 30  # values of a channel that a median needs
_SHOWN = 8  # numbers of channels or bins in a sentence


class Finding(NamedTuple):
    """Something suspicious in a recording, a sentence each."""

    what: str
    cure: str


class NoiseLevels(NamedTuple):
    """The noise of a recording."""

    power_db: float  # mean power in an element
    nus: Floats  # (n_bin,) directions
    levels_db: Floats  # (n_bin,) B / ||v||^2, the mean over snapshots with an estimate; NaN without any, or unlit
    blind: Floats  # (n_bin,) share of snapshots without an estimate
    alarms: float  # share of looks over a limit for P_FA


def listed(numbers: Iterable[int]) -> str:
    """Numbers in a sentence; of many the first."""
    texts = [str(number) for number in numbers]
    if len(texts) > _SHOWN:
        return f"{', '.join(texts[:_SHOWN])} and {len(texts) - _SHOWN} others"
    *most, last = texts
    return f"{', '.join(most)} and {last}" if most else last


def levels(y: Complexes, signatures: Signatures, centres: Floats, *, by_rows: bool) -> NoiseLevels:
    """The noise in snapshots (K, n_tx, n_rx), as the receiver of the radar estimates it."""
    processing = Processing(is_steered=False, monopulse=False, by_rows=by_rows)
    signatures.prepare(centres.tolist())
    cells = [DataSet(one.ravel(), signatures, processing).tests(centres) for one in y]
    sigma, statistic = np.array([one.sigma_hat for one in cells]), np.array([one.statistic for one in cells])
    power = cells[0].signature_power
    is_lit = power > 1e-3 * power.max()
    is_known = (sigma > 0.0) & is_lit
    level = np.sum(np.where(is_known, sigma**2 * power, 0.0), axis=0) / np.maximum(is_known.sum(axis=0), 1)
    level = np.where(is_known.any(axis=0), level, np.nan)
    over = statistic[:, is_lit][:, ::2] >= threshold(P_FA)  # neighbours are hardly independent
    with np.errstate(divide="ignore"):
        return NoiseLevels(
            float(10.0 * np.log10(np.mean(np.abs(y) ** 2))),
            centres,
            10.0 * np.log10(level),
            np.where(is_lit, 1.0 - is_known.mean(axis=0), 0.0),
            float(over.mean()),
        )


def value_faults(y: Complexes) -> list[Finding]:
    """What is suspicious in the values of snapshots (K, n_tx, n_rx) as such."""
    found = []
    parts = np.stack((y.real, y.imag))
    if not parts[1].any():
        found.append(Finding("The values have no imaginary part.", "Record I and Q, and hand over I + jQ."))
    names = [sha256(one.tobytes()).digest() for one in y]
    if len(set(names)) < len(names):
        first = [names.index(name) for name in names]
        i = next(i for i, one in enumerate(first) if one != i)
        found.append(
            Finding(
                f"{len(names) - len(set(names))} of {len(names)} snapshots repeat another: snapshot {i + 1} is snapshot"
                f" {first[i] + 1}.",
                "Check that the buffer is filled anew in each dwell.",
            )
        )
    values, counts = np.unique(np.abs(parts), return_counts=True)
    if values.size > 1 and counts[-1] >= 3 and counts[-1] > 2 * counts[-2]:
        found.append(
            Finding(
                f"{counts[-1]} values are exactly {values[-1]:.4g}, the largest one: they are clipped.",
                "Lower the gain before the converter.",
            )
        )
    spread = float(np.median(np.abs(parts[parts != 0.0]))) / 0.6745  # standard deviation, if it is normal
    if 1 < values.size <= parts.size / 10 and (step := float(np.diff(values).min())) > COARSE * spread:
        found.append(
            Finding(
                f"The values are quantised in steps of {step:.4g}, {step / spread:.1f} standard deviations.",
                "Raise the gain before the converter, or keep more bits after matched filtering.",
            )
        )
    return found


def level_faults(y: Complexes, noise: NoiseLevels, *, is_alone: bool, by_rows: bool) -> list[Finding]:
    """What is suspicious in the noise of snapshots (K, n_tx, n_rx).

    is_alone : nothing but noise was recorded
    """
    found = []
    if is_alone and noise.alarms > ALARMS * P_FA * (1.0 + SMALL / y[0].size):  # first: what follows takes all for noise
        found.append(
            Finding(
                f"{100.0 * noise.alarms:.1f} % of the looks are detections, in noise {100.0 * P_FA:g} % would be.",
                "Record without targets, or say in which direction the target is; of clutter and interference the radar"
                " detects as much.",
            )
        )
    if abs(noise.power_db) > OFF_SCALE_DB:
        found.append(
            Finding(
                f"The noise has a power of {noise.power_db:+.1f} dB in an element of Y, must be 0 dB.",
                f"Divide Y by {10.0 ** (noise.power_db / 20.0):.4g}.",
            )
        )
    for side, axes in (("transmit", (0, 2)), ("receive", (0, 1))):
        if y.size // y.shape[1 if side == "transmit" else 2] >= _FEWEST:
            found += _channels(side, np.median(np.abs(y) ** 2, axis=axes))
    if is_alone:
        found += _constant(y)
        ratio = float(np.abs(np.mean(y**2)) / np.mean(np.abs(y) ** 2))
        if y.imag.any() and ratio > IMPROPER:
            found.append(
                Finding(
                    f"I and Q are unequal or correlated: |E y^2| is {ratio:.2f} of E |y|^2, must be 0.",
                    "Balance the gains of I and Q and their 90 degrees.",
                )
            )
    if (is_blind := noise.blind > BLIND).any():
        found.append(
            Finding(
                f"Bins {listed(np.flatnonzero(is_blind))} are blind: their noise has no estimate in up to"
                f" {100.0 * float(noise.blind.max()):.0f} % of the snapshots.",
                "Look for a source of noise in one direction"
                + ("." if by_rows else ', and set radar.receiver.noise = "rows".'),
            )
        )
    over_db = noise.levels_db - np.nanmedian(noise.levels_db) if np.isfinite(noise.levels_db).any() else noise.blind
    if (is_loud := over_db > LOUD_DB).any():
        i = int(np.nanargmax(over_db))
        found.append(
            Finding(
                f"Bins {listed(np.flatnonzero(is_loud))} have up to {float(over_db[i]):.0f} dB more noise than the"
                f" others, most at {float(np.degrees(np.arcsin(2.0 * noise.nus[i]))):.1f} degrees.",
                "Look for a source of noise or a standing echo in this direction.",
            )
        )
    return found


def _channels(side: str, medians: Floats) -> list[Finding]:
    """Dead and hot channels by their noise, (n,)."""
    found, typical = [], float(np.median(medians))
    with np.errstate(divide="ignore", invalid="ignore"):
        over_db = 10.0 * np.log10(medians / typical) if typical > 0.0 else np.where(medians > 0.0, np.inf, -np.inf)
    for which, what, cure in (
        (over_db < DEAD_DB, "less noise than the others: they are dead", "Check cable and amplifier."),
        (over_db > HOT_DB, "more noise than the others: they are hot", "Check for interference and oscillation."),
    ):
        if which.any():
            most = np.abs(over_db[which]).max()
            by = f"up to {most:.1f} dB" if np.isfinite(most) else "infinitely"
            found.append(Finding(f"The {side} channels {listed(np.flatnonzero(which))} have {by} {what}.", cure))
    return found


def _constant(y: Complexes) -> list[Finding]:
    share = float(np.sum(np.abs(y.mean(axis=0)) ** 2) / np.mean(np.sum(np.abs(y) ** 2, axis=(1, 2))))
    if len(y) < 4 or share <= 3.0 / len(y) + CONSTANT:
        return []
    return [
        Finding(
            f"{100.0 * share:.0f} % of the power is the same in all snapshots.",
            "Look for leakage of the transmitter or standing clutter, and subtract it.",
        )
    ]
