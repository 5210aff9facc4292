"""Whether recorded data fit the array that the radar assumes: signs, order, gains, phases and noise.

Symbols: Y_k snapshot k of K, n_tx x n_rx after matched filtering; u = W^T a_T and a_R halves of a signature; e_T, e_R
complex gains of the antennas, 1 as assumed; C disturbance.

    Y_k = alpha_k (W^T (e_T o a_T(nu))) (e_R o a_R(nu))^T + C_k

The sign of the steering vector is tested with nu and -nu at both ends, with the data and their conjugate, with rows and
columns as they are and exchanged. The simplest that explains the echo is what was recorded. A mirrored end has its
antennas counted from the other side; conjugate data are mirrored at both. What was found is undone, and the three
factors alpha_k, transmit and receive half are fitted in turn (alternating least squares).
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.signal.array import steering_vector
from cogradar.shared.signal.detector.noise_faults import (
    Finding,
    NoiseLevels,
    level_faults,
    levels,
    listed,
    value_faults,
)
from cogradar.shared.signal.waveform import Signatures

Complexes = NDArray[np.complex128]
Floats = NDArray[np.float64]

STANDS_OUT = 15.0  # power of an echo after the array's gain, over the noise
EXPLAINS = 0.9  # of the power that the best hypothesis explains: a simpler one with so much is preferred
OFF_LOBES = 0.5  # main lobes between the direction given and the direction found
OFF_GAIN_DB, OFF_PHASE_DEG, DEAD_GAIN_DB = 3.0, 30.0, -15.0
OFF_AMPLITUDE_DB = 3.0
TELLS = 0.07  # standard deviation of a gain up to which errors of single antennas are told
_FITS = 6  # turns of the alternating fit
_PER_LOBE = 4  # directions of the grid in half of a main lobe
_FINE = 20  # and steps on either side of the best one
_ENDS = ("transmit", "receive")
_TINY = 1e-300


class Target(NamedTuple):
    """What is known of the recorded target."""

    nu: float  # spatial frequency of its direction
    amplitude_db: float | None = None  # 20 log10 |alpha| expected; None: unknown


class Antennas(NamedTuple):
    """The antennas of one end of the array, as the echo shows them."""

    nu: float  # direction found
    gains: Complexes  # (n,) over those assumed; their median modulus is 1, their mean phase 0
    sigma: float  # standard deviation of each


class Calibration(NamedTuple):
    """What a recording says of the array."""

    snapshots: int
    noise: NoiseLevels
    transmit: Antennas | None  # None: without a target, or with beams, which mix the antennas
    receive: Antennas | None
    amplitude_db: float | None  # 20 log10 of the rms of alpha_k
    findings: list[Finding]  # what is suspicious
    notes: list[str]  # what the recording cannot tell


class _Orientation(NamedTuple):
    """How recorded data differ from what is assumed."""

    exchanged: bool = False  # rows and columns
    conjugate: bool = False
    transmit: bool = False  # mirrored
    receive: bool = False

    def undone(self, y: Complexes) -> Complexes:
        """Data as they should be, (K, n_tx, n_rx)."""
        k, n_tx, n_rx = y.shape
        y = y.reshape(k, n_rx, n_tx).swapaxes(1, 2) if self.exchanged else y
        y = y[:, ::-1] if self.transmit else y
        y = y[:, :, ::-1] if self.receive else y
        return y.conj() if self.conjugate else y


def calibrate(
    snapshots: Complexes, signatures: Signatures, centres: Floats, *, by_rows: bool, target: Target | None = None
) -> Calibration:
    """Test a recording of noise alone, or of a target in a known direction.

    snapshots  : (K, n_tx, n_rx) complex, Y of dwells, or of range cells, with the same waveform
    signatures : of this waveform
    centres    : (n_bin,) spatial frequencies whose noise is told
    by_rows    : the radar estimates the noise from transmit channels as clusters
    Raises ValueError if values are not finite, or all 0.
    """
    y = np.ascontiguousarray(snapshots, dtype=np.complex128)
    if wrong := int(np.count_nonzero(~np.isfinite(y))):
        raise ValueError(f"{wrong} of {y.size} values are NaN or infinite, must be numbers")
    if not y.any():
        raise ValueError("all values are 0, must be what the array received")
    findings, notes, transmit, receive, amplitude_db = value_faults(y), list[str](), None, None, None
    if target is not None:
        echo = _Echo(y, signatures, target)
        findings += echo.findings
        notes, transmit, receive, amplitude_db = echo.notes, echo.transmit, echo.receive, echo.amplitude_db
        y = echo.left
    noise = levels(y, signatures, centres, by_rows=by_rows)
    findings += level_faults(y, noise, is_alone=target is None, by_rows=by_rows)
    return Calibration(len(y), noise, transmit, receive, amplitude_db, findings, notes)


class _Echo:
    """The echo of a target in a recording."""

    def __init__(self, y: Complexes, signatures: Signatures, target: Target) -> None:
        self._signatures, self._target = signatures, target
        self._n_tx, self._n_rx = y.shape[1:]
        self._is_isotropic = signatures.isotropic_level is not None
        self.findings, self.notes = list[Finding](), list[str]()
        self.transmit: Antennas | None = None
        self.receive: Antennas | None = None
        self.amplitude_db: float | None = None
        orientation, found = self._oriented(y)
        nus = self._directions(orientation.undone(y))
        is_there = all(self._is_expected(nu) for nu in nus) or found >= 0.5 * self._power(orientation.undone(y), nus)
        if not is_there:  # then nothing is known of the orientation
            orientation = _Orientation()
            nus = self._directions(y)
        y = orientation.undone(y)
        fit = _fitted(y, *self._halves(nus))
        self.left = fit.left
        noise = float(np.mean(np.abs(self.left) ** 2))
        if self._power(y, nus) < STANDS_OUT * noise:
            cure = "Record a stronger target or more snapshots, and check its bearing."
            self.findings.append(Finding("No echo stands out from the noise.", cure))
            self.left = y
            return
        if is_there:
            self._tell_orientation(orientation)
        else:
            self._tell_elsewhere(nus)
        self._tell_antennas(y, nus, fit)

    def _halves(self, nus: tuple[float, float]) -> tuple[Complexes, Complexes]:
        """Both halves of a signature whose ends have directions of their own."""
        return self._signatures.at(nus[0])[0], steering_vector(nus[1], self._signatures.n_rx)

    def _power(self, y: Complexes, nus: tuple[float, float]) -> float:
        """Mean power that a signature has of snapshots; 0 where nothing is sent."""
        u, a = self._halves(nus)
        power = float(np.vdot(u, u).real) * a.size
        return float(np.mean(np.abs(np.conj(u) @ y @ np.conj(a)) ** 2)) / power if power > 0.0 else 0.0

    def _is_expected(self, nu: float) -> bool:
        off = abs(nu - self._target.nu)
        return bool(min(off, 1.0 - off) * min(self._n_tx, self._n_rx) <= OFF_LOBES)

    def _oriented(self, y: Complexes) -> tuple[_Orientation, float]:
        """The simplest orientation that explains the echo in the known direction, and its power."""
        all_of_them = [_Orientation(*flags) for flags in sorted(product((False, True), repeat=4), key=sum)]
        known = self._target.nu, self._target.nu
        powers = [self._power(one.undone(y), known) for one in all_of_them]
        i = next(i for i, power in enumerate(powers) if power >= EXPLAINS * max(powers))
        return all_of_them[i], powers[i]

    def _directions(self, y: Complexes) -> tuple[float, float]:
        """Where the strongest echo is, at the transmit and at the receive end."""
        n = _PER_LOBE * max(self._n_tx, self._n_rx)
        nus, u = self._signatures.grid(n)
        powers = np.sum(np.abs(u) ** 2, axis=1)
        is_lit = powers > 1e-6 * powers.max()
        total = np.zeros((int(is_lit.sum()), n))
        a = steering_vector(nus, self._n_rx).conj().T
        for one in y:
            total += np.abs(u[is_lit].conj() @ one @ a) ** 2
        i, j = np.unravel_index(int(np.argmax(total / powers[is_lit, np.newaxis])), total.shape)
        return float(nus[is_lit][i]), float(nus[j])

    def _tell_elsewhere(self, nus: tuple[float, float]) -> None:
        given, sent, received = (_degrees(nu) for nu in (self._target.nu, *nus))
        self.findings.append(
            Finding(
                f"The strongest echo is at {sent:.1f} degrees by the transmit and {received:.1f} degrees by the receive"
                f" antennas, and the target was given at {given:.1f} degrees.",
                "Check the bearing, the boresight, the spacing of half a wavelength and the order of the antennas.",
            )
        )

    def _tell_orientation(self, orientation: _Orientation) -> None:
        n_tx, n_rx = self._n_tx, self._n_rx
        if orientation.exchanged:
            what = "transposed" if n_tx == n_rx else "stored with the receive antenna first"
            cure = "Hand over Y.T" if n_tx == n_rx else f"Hand over Y.reshape({n_rx}, {n_tx}).T"
            self.findings.append(Finding(f"Rows and columns are exchanged: Y is {what}.", f"{cure}."))
        if orientation.conjugate:
            self.findings.append(
                Finding(
                    "The sign of the steering vector is wrong at both ends: phases fall where they should grow.",
                    "Hand over the conjugate of Y (I and Q may be exchanged); or the bearing has the wrong sign.",
                )
            )
        for is_off, side, lines in (
            (orientation.transmit, "transmit", "rows"),
            (orientation.receive, "receive", "columns"),
        ):
            if is_off:
                self.findings.append(
                    Finding(
                        f"The sign of the steering vector is wrong at the {side} end alone.",
                        f"Reverse the {lines} of Y: the {side} antennas are counted from the other side.",
                    )
                )
        if 2.0 * abs(self._target.nu) < 1.0 / min(n_tx, n_rx):
            self.notes.append(
                f"The target is too near to boresight to tell the sign of the steering vector: record one beyond"
                f" {_degrees(0.5 / min(n_tx, n_rx)):.1f} degrees."
            )
        if n_tx == n_rx and self._is_isotropic:
            self.notes.append(
                "Rows and columns look alike with an isotropic waveform and as many antennas at both ends: record a"
                " waveform with beams to tell whether Y is transposed."
            )

    def _tell_antennas(self, y: Complexes, nus: tuple[float, float], fit: "_Fit") -> None:
        level = self._signatures.isotropic_level
        turned = [self._turned(y, fit, end) for end in (0, 1)]
        for end, is_turned in enumerate(turned):
            if is_turned.any():
                self._tell(end, is_turned, "deliver conjugate data", "Exchange I and Q of these channels.")
        if any(is_turned.any() for is_turned in turned):
            y = np.where(turned[0][:, np.newaxis] ^ turned[1], y.conj(), y)
            fit = _fitted(y, *self._halves(nus))
            self.left = fit.left
        noise, total = float(np.mean(np.abs(fit.left) ** 2)), float(np.sum(np.abs(fit.alphas) ** 2))
        model = self._signatures.at(nus[0])[0]
        scale = float(np.median(np.abs(fit.v)) * np.linalg.norm(fit.u) / np.linalg.norm(model))
        self.amplitude_db = float(10.0 * np.log10(total / fit.alphas.size * scale**2))
        expected = self._target.amplitude_db
        if expected is not None and abs(off := self.amplitude_db - expected) > OFF_AMPLITUDE_DB:
            self.findings.append(
                Finding(
                    f"The echo has an amplitude of {self.amplitude_db:.1f} dB, and radar.echo.amplitude_db says"
                    f" {expected:.1f} dB at its range.",
                    f"Add {off:.1f} dB to radar.echo.amplitude_db, unless the target's cross section explains it.",
                )
            )
        sigma = float(np.sqrt(noise / (total * np.vdot(fit.u, fit.u).real)))
        self.receive = _antennas(fit.v, (self._target.nu, nus[1]), sigma)
        self._tell_side(1, self.receive)
        if level is None:
            self.notes.append("Beams mix the transmit antennas: record an isotropic waveform to tell their gains.")
            return
        sigma = float(np.sqrt(noise / (total * np.vdot(fit.v, fit.v).real)) / level)
        self.transmit = _antennas(fit.u / level, (self._target.nu, nus[0]), sigma)
        self._tell_side(0, self.transmit)

    def _turned(self, y: Complexes, fit: "_Fit", end: int) -> NDArray[np.bool_]:
        """Antennas of an end without the echo that have it in the conjugate of their data."""
        other, own = ((fit.v, fit.u), (fit.u, fit.v))[end]
        is_dead = np.abs(own) < 10.0 ** (DEAD_GAIN_DB / 20.0) * np.median(np.abs(own))
        if end == 0 and not self._is_isotropic:
            return np.zeros_like(is_dead)
        echo = np.einsum("k,j,kij->i", fit.alphas, other, y if end == 0 else y.swapaxes(1, 2))
        echo /= np.sum(np.abs(fit.alphas) ** 2) * np.vdot(other, other).real
        return np.asarray(is_dead & (np.abs(echo) > 0.5 * np.median(np.abs(own))))

    def _tell_side(self, end: int, antennas: Antennas) -> None:
        """Errors of the antennas of an end."""
        gains = antennas.gains
        if antennas.sigma > TELLS:
            self.notes.append(
                f"The echo is too weak to tell errors of single {_ENDS[end]} antennas (standard deviation"
                f" {antennas.sigma:.2f} of a gain): record more snapshots."
            )
            return
        gain_db, phase = 20.0 * np.log10(np.maximum(np.abs(gains), 1e-15)), np.abs(np.degrees(np.angle(gains)))
        is_dead = gain_db < DEAD_GAIN_DB
        if is_dead.any():
            self._tell(end, is_dead, "are dead: the echo is not in them", "Check cable and amplifier.")
        is_phase = ~is_dead & (phase > OFF_PHASE_DEG)
        exchanged = _exchanged(gains, np.flatnonzero(is_phase), steering_vector(antennas.nu, gains.size))
        for one, other in exchanged:
            what = f"The {_ENDS[end]} antennas {one} and {other} are exchanged."
            self.findings.append(Finding(what, "Exchange their channels."))
            is_phase[[one, other]] = False
        if is_phase.any():
            most = float(phase[is_phase].max())
            cure = "Divide each channel by its gain, a complex number, which --json prints."
            self._tell(end, is_phase, f"have phases up to {most:.0f} degrees off", cure)
        is_gain = ~is_dead & (np.abs(gain_db) > OFF_GAIN_DB)
        if is_gain.any():
            most = float(np.abs(gain_db[is_gain]).max())
            cure = "Divide each channel by its gain, a complex number, which --json prints."
            self._tell(end, is_gain, f"have gains up to {most:.1f} dB off", cure)

    def _tell(self, end: int, which: NDArray[np.bool_], what: str, cure: str) -> None:
        self.findings.append(Finding(f"The {_ENDS[end]} antennas {listed(np.flatnonzero(which))} {what}.", cure))


class _Fit(NamedTuple):
    """An echo in all snapshots, fitted in turn."""

    alphas: Complexes  # (K,)
    u: Complexes  # (n_tx,) transmit half
    v: Complexes  # (n_rx,) receive half
    left: Complexes  # (K, n_tx, n_rx)


def _fitted(y: Complexes, u: Complexes, v: Complexes) -> _Fit:
    """Both halves from where they begin; the norm of each stays its own."""
    lengths = np.linalg.norm(u), np.linalg.norm(v)
    for _ in range(_FITS):
        alphas = np.conj(u) @ y @ np.conj(v) / (np.vdot(u, u) * np.vdot(v, v)).real
        u = np.einsum("k,kir,r->i", alphas.conj(), y, v.conj(), optimize=True)
        u *= lengths[0] / max(float(np.linalg.norm(u)), _TINY)
        v = np.einsum("k,kir,i->r", alphas.conj(), y, u.conj(), optimize=True)
        v *= lengths[1] / max(float(np.linalg.norm(v)), _TINY)
    alphas = np.conj(u) @ y @ np.conj(v) / (np.vdot(u, u) * np.vdot(v, v)).real
    return _Fit(alphas, u, v, y - np.einsum("k,i,r->kir", alphas, u, v))


def _antennas(measured: Complexes, nus: tuple[float, float], sigma: float) -> Antennas:
    """Gains over a steering vector: of the direction given or of that found, whichever leaves fewer phases off.

    nus : given, and found on a grid
    """
    fine = nus[1] + np.linspace(-1.0, 1.0, 2 * _FINE + 1) / (2 * _PER_LOBE * measured.size)
    best = float(fine[np.argmax(np.abs(steering_vector(fine, measured.size).conj() @ measured))])
    sets = [_normalised(measured / steering_vector(nu, measured.size)) for nu in (best, nus[0])]
    n_off = [int(np.sum(np.abs(np.degrees(np.angle(gains))) > OFF_PHASE_DEG)) for gains in sets]
    return Antennas(best, sets[int(np.argmin(n_off))], sigma)


def _normalised(gains: Complexes) -> Complexes:
    return np.asarray(gains / (np.median(np.abs(gains)) * np.exp(1j * np.angle(gains.sum()))))


def _exchanged(gains: Complexes, off: NDArray[np.int64], model: Complexes) -> list[tuple[int, int]]:
    """Pairs of antennas whose phases are right once they are exchanged; off: those with wrong phases."""
    found: list[tuple[int, int]] = []
    for i, j in product(off.tolist(), repeat=2):
        turn = model[i] / model[j]
        phases = np.degrees(np.angle([gains[i] * turn, gains[j] / turn]))
        if i < j and (np.abs(phases) < OFF_PHASE_DEG).all() and not {i, j} & {one for pair in found for one in pair}:
            found.append((i, j))
    return found


def _degrees(nu: float) -> float:
    return float(np.degrees(np.arcsin(2.0 * nu)))
