"""A front end in a process of its own, in any language: asked over Zenoh in each dwell (docs/howto/front-end.md).

It is declared once, by a Hello. A process that was started again is opened again; the answers of a second one with the
same name are not used.
"""

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from cogradar.services.delivery.pacing import pacing_at
from cogradar.services.emulator.front_end import (
    FrontEndError,
    ScanData,
    SenselessScan,
    Settings,
    Transmission,
    receive,
)
from cogradar.shared.protocol.fields import MAX_SIDE
from cogradar.shared.protocol.front_ends.messages import Hello, Opening, Received, Transmit
from cogradar.shared.protocol.messages import EmulatorCheckpoint
from cogradar.shared.signal.looks import n_range_cells
from cogradar.shared.wire.front_ends.line import Line, Reply

PATIENCE_S = 10.0  # in lockstep, which has no deadlines: for any answer, and for a front end that is started again
FIRST_S, AGAIN_S = 3.0, 0.5  # in real time: for the Hello when a run begins, and in mid-run
PART, LONGEST = 0.5, 0.9  # of a period, in which an answer must come; and if the front end says that it takes longer
MAX_OTHERS = 100
_ROWS = (
    *("bins", "statistic", "alpha_hat", "sigma_hat", "signature_power"),
    *("nus", "limits", "ranges_km", "nu_hats", "nu_sigmas"),
)
log = logging.getLogger(__name__)


class Asking(Protocol):
    """What carries the questions, as `cogradar.shared.wire.front_ends.line.Line` does."""

    def open(self, opening: Opening, within_s: float) -> Iterator[Reply[Hello]]:
        """Replies to an opening."""

    def transmit(self, dwell: Transmit, within_s: float) -> Iterator[Reply[Received]]:
        """Replies to a dwell, and late ones to dwells before."""

    def close(self) -> None:
        """Ask no more."""


class OpensForeign:
    """Opens the front end of a name, wherever it is."""

    def __init__(self, name: str, endpoints: Sequence[str], check: Callable[[], None] = lambda: None) -> None:
        """`check` raises Interrupted when the process is to end: nothing is waited for any longer."""
        self._name, self._endpoints, self._check = name, endpoints, check

    def __call__(self, checkpoint: EmulatorCheckpoint) -> "ForeignFrontEnd":
        """Open it. Raises FrontEndError."""
        settings = Settings.of(checkpoint)
        within_s = FIRST_S if checkpoint.k == 0 else AGAIN_S
        if not pacing_at(settings.rate_hz).has_deadlines:
            within_s = PATIENCE_S
        try:
            line = Line(self._name, self._endpoints, within_s, self._check)
        except ConnectionError as error:
            cure = "start the front end first" if checkpoint.k == 0 else f"it was there until dwell {checkpoint.k}"
            raise FrontEndError(f"{self._name}: {error}; {cure}") from None
        try:
            return ForeignFrontEnd.open(self._name, settings, checkpoint.radar, line, within_s)
        except BaseException:
            line.close()
            raise


class ForeignFrontEnd:
    """One run's transmitter and receiver, behind a line."""

    def __init__(self, name: str, settings: Settings, hello: Hello, line: Asking, replier: str) -> None:
        """`hello` is of a front end that fits, and came from `replier`."""
        self._name, self._settings, self._hello, self._line, self._replier = name, settings, hello, line, replier
        self._others: set[str] = set()
        self._wait_s = PATIENCE_S
        if (period_s := pacing_at(settings.rate_hz).seconds(1)) > 0.0:
            self._wait_s = min(max(PART * period_s, 1.0 / hello.max_rate_hz), LONGEST * period_s)

    @classmethod
    def open(cls, name: str, settings: Settings, radar: dict[str, object], line: Asking, within_s: float) -> Self:
        """Ask what is there. Raises FrontEndError unless it is one, and one that fits."""
        opening = Opening(run=settings.run, radar=radar, dwells=settings.dwells, rate_hz=settings.rate_hz)
        hellos, faults = dict[tuple[str, str], Hello](), list[str]()
        for reply in line.open(opening, within_s):
            hello = reply.message
            if hello is None:
                faults.append(reply.fault)
            elif hello.run != settings.run:
                faults.append(f"its Hello is for {hello.run}, {settings.run} was opened")
            else:
                hellos[hello.incarnation, reply.replier] = hello
        if len(hellos) > 1:
            drawn = ", ".join(sorted(incarnation for incarnation, _ in hellos))
            raise FrontEndError(
                f"{name}: {len(hellos)} front ends have this name ({drawn}): stop all but one, or give each a name of"
                " its own"
            )
        if not hellos:
            why = next(iter(faults), f"nothing answers within {within_s:g} s: start it first")
            raise FrontEndError(f"{name}: {why}")
        (((_, replier), hello),) = hellos.items()
        _check(name, settings, hello)
        log.info("%s: front end %s: %s x %s channels %s", settings.run, name, hello.n_tx, hello.n_rx, hello.site)
        return cls(name, settings, hello, line, replier)

    def transmit(self, k: int, t: int, waveform: Transmission) -> ScanData | None:
        """Ask for dwell k. Raises FrontEndError if the front end has to be opened again, or SenselessScan."""
        faults, others, stray = list[Reply[Received]](), set[str](), None
        for reply in self._line.transmit(question(self._settings.run, k, t, waveform, self._wait_s), self._wait_s):
            received = reply.message
            if received is None:
                faults.append(reply)
            elif (received.incarnation, reply.replier) != (self._hello.incarnation, self._replier):
                others.add(received.incarnation)
                self._tell_other(received.incarnation)
            elif (received.run, received.k) == (self._settings.run, k):
                return self._measured(received, reply.data, waveform)
            else:
                stray = received
        if refused := next((fault for fault in faults if fault.refuses), None):
            raise FrontEndError(f"{self._name}: {refused.fault}")
        if faults:
            raise SenselessScan(f"{self._name}: {faults[0].fault}")
        if others:
            raise FrontEndError(f"{self._name}: it was started again, or another one took its place: {min(others)}")
        if stray is not None:  # late, or of a front end that counts otherwise
            raise SenselessScan(
                f"{self._name}: no answer to dwell {k} of {self._settings.run} within {self._wait_s:g} s, but one to"
                f" dwell {stray.k} of {stray.run}"
            )
        silence = f"{self._name}: no answer within {self._wait_s:g} s"
        if not pacing_at(self._settings.rate_hz).has_deadlines:
            raise FrontEndError(silence)
        return ScanData.not_measured(silence)

    def close(self) -> None:
        """There is nothing to tell: a front end that is not asked transmits nothing."""
        self._line.close()

    def _measured(self, received: Received, data: bytes | None, waveform: Transmission) -> ScanData | None:
        if received.ended:
            return None
        has_time = received.utc_s is not None
        if received.fault is not None and (self._hello.clock == "utc" or not has_time):
            return replace(ScanData.not_measured(f"{self._name}: {received.fault}"), utc_s=received.utc_s)
        if has_time != (self._hello.clock == "utc"):
            raise SenselessScan(f"utc_s = {received.utc_s}, though the Hello says clock = {self._hello.clock!r}")
        if self._hello.hands_over == "data":
            measured = receive(self._by_cell(received, data, waveform), waveform, self._settings.radar)
        else:
            measured = _of_looks(received)
        return replace(measured, utc_s=received.utc_s)

    def _by_cell(
        self, received: Received, data: bytes | None, waveform: Transmission
    ) -> NDArray[np.complex128] | dict[int, NDArray[np.complex128]]:
        """Y of each range cell, or of all ranges. Raises SenselessScan."""
        n_tx, n_rx = self._hello.n_tx, self._hello.n_rx
        has_cells = self._settings.radar.receiver.range_cell_km > 0.0
        if data is None:
            raise SenselessScan("the answer has no attachment: hands_over = 'data' needs Y as its payload")
        if (received.range_cells is not None) != has_cells:
            raise SenselessScan("range_cells must be there if radar.receiver.range_cell_km > 0, and not else")
        cells = [0] if received.range_cells is None else received.range_cells.tolist()
        if len(set(cells)) < len(cells):
            raise SenselessScan("range_cells must all be different")
        is_reference = self._settings.radar.receiver.noise == "range-cells"  # any other range cell is one
        if has_cells and (unasked := set(cells) - set(waveform.range_cells)) and (min(unasked) < 0 or not is_reference):
            raise SenselessScan(f"range_cells: {min(unasked)} was not asked for")
        if len(data) != (needed := 8 * len(cells) * n_tx * n_rx):
            shape = f"({len(cells)}, {n_tx}, {n_rx})"
            raise SenselessScan(f"Y of {len(data)} bytes: {shape} complex64 are {needed}")
        y = np.frombuffer(data, "<c8").reshape(len(cells), n_tx, n_rx)
        if not np.isfinite(y).all():
            raise SenselessScan("Y: must be finite")
        return dict(zip(cells, y, strict=True)) if has_cells else y[0]

    def _tell_other(self, incarnation: str) -> None:
        if incarnation not in self._others and len(self._others) < MAX_OTHERS:
            self._others.add(incarnation)
            log.warning(
                "%s: front end %s: a second one answers, %s beside %s: stop one of them, or give it another name",
                *(self._settings.run, self._name, incarnation, self._hello.incarnation),
            )


def question(run: str, k: int, t: int, waveform: Transmission, deadline_s: float) -> Transmit:
    """What a front end is asked for a dwell."""
    looks = waveform.looks
    has_cells = any(look.cells for look in looks)
    return Transmit(
        run=run,
        k=k,
        t=t,
        deadline_s=deadline_s,
        isotropic=waveform.isotropic,
        factor=waveform.factor.astype(np.complex64),
        bins=np.array([look.bin for look in looks], np.int32),
        nus=np.array([look.nu for look in looks], np.float64),
        limits=np.array([look.limit for look in looks], np.float64),
        first_cells=np.array([look.cells[0] if look.cells else 0 for look in looks], np.int32),
        n_cells=np.array([len(look.cells) for look in looks], np.int32),
        merged=np.array([look.is_merged for look in looks], np.int32),
        range_cells=np.array(waveform.range_cells if has_cells else [], np.int32),
        beams=waveform.beams,
        beam_nus=waveform.nus,
        gates=waveform.gates,
    )


def _of_looks(received: Received) -> ScanData:
    missing = [name for name in _ROWS[:5] if getattr(received, name) is None]
    if missing:
        raise SenselessScan(f"{missing[0]} is missing")
    rows = {name: getattr(received, name) for name in (*_ROWS, "lost_km")}
    return ScanData(**rows)


def _check(name: str, settings: Settings, hello: Hello) -> None:
    """Raise FrontEndError unless a front end fits the radar and its rate."""
    array = settings.radar.array
    if (hello.n_tx, hello.n_rx) != (array.n_tx, array.n_rx):
        raise FrontEndError(
            f"{name}: its array is {hello.n_tx} x {hello.n_rx}, the scenario's radar.array.n_tx x n_rx is"
            f" {array.n_tx} x {array.n_rx}: set these as the front end has them, or start another one"
        )
    width_km, ranges_km = settings.radar.receiver.range_cell_km, settings.radar.acquisition.ranges_km
    if (n_cell := n_range_cells(*ranges_km, width_km)) > MAX_SIDE:
        raise FrontEndError(
            f"{name}: radar.receiver.range_cell_km = {width_km:g} makes {n_cell} range cells, a front end over Zenoh"
            f" may be asked for {MAX_SIDE} at most: set a larger one, or a smaller radar.acquisition.range_max_km"
        )
    if settings.rate_hz > hello.max_rate_hz:
        raise FrontEndError(
            f"{name}: it makes at most {hello.max_rate_hz:g} dwells a second, the run has {settings.rate_hz:g}:"
            f" lower --rate, or motion.dt_s must be {1.0 / hello.max_rate_hz:g} s at least"
        )
