"""Front ends behind a queryable, in this process: a device whose answers a test makes."""

import json
from collections.abc import Callable
from types import TracebackType
from typing import Any, NamedTuple, Self

import numpy as np
import zenoh
from numpy.typing import NDArray

from cogradar.services.emulator.front_end import FrontEnd, ScanData, Transmission
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.shared.protocol.front_ends.messages import Hello, Opening, Received, Transmit
from cogradar.shared.protocol.messages import EmulatorCheckpoint
from cogradar.shared.protocol.topics import DWELL, OPENING
from cogradar.shared.signal.looks import Look
from cogradar.shared.wire.codec import decode_answer, encode
from cogradar.shared.wire.session import free_port

NAME = "roof"
ROWS: tuple[str, ...] = ("bins", "statistic", "alpha_hat", "sigma_hat", "signature_power", "nus", "limits", "ranges_km")
ROWS += ("nu_hats", "nu_sigmas", "lost_km")


class Answer(NamedTuple):
    """Bytes of an answer; with Y it is the attachment."""

    payload: bytes
    attachment: bytes | None = None
    is_error: bool = False
    times: int = 1


class Device:
    """As a context it answers where it listens, or at a router."""

    def __init__(
        self,
        answer: Callable[["Device", Transmit], Answer | None],
        router: str = "",
        incarnation: str = "first",
        name: str = NAME,
        opens: Callable[[], zenoh.Session] | None = None,
        **hello: Any,
    ) -> None:
        """`answer` None: it drops the question; `opens` gives another session than one without certificates."""
        self._name, self._opens = name, opens
        self.endpoint, self._is_router = router or f"tcp/127.0.0.1:{free_port()}", bool(router)
        self.incarnation, self._answer, self._declared = incarnation, answer, list[Any]()
        said = {"n_tx": 16, "n_rx": 16, "hands_over": "looks", "max_rate_hz": 100.0, "clock": "none"} | hello
        self._hello = said
        self.openings, self.asked = list[Opening](), list[Transmit]()

    def __enter__(self) -> Self:
        self._session = self._opened() if self._opens is None else self._opens()
        for exchange, answer in ((OPENING, self._open), (DWELL, self._transmit)):
            self._declared.append(self._session.declare_queryable(exchange.key_of(self._name), answer, complete=True))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._session.close()

    def _opened(self) -> zenoh.Session:
        config = zenoh.Config()
        side = "connect" if self._is_router else "listen"
        for key, value in {
            "mode": "client" if self._is_router else "peer",
            f"{side}/endpoints": [self.endpoint],
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
        }.items():
            config.insert_json5(key, json.dumps(value))
        return zenoh.open(config)

    def received(self, asked: Transmit, **rows: Any) -> Received:
        """An answer to a question."""
        return Received.model_validate({"run": asked.run, "k": asked.k, "incarnation": self.incarnation} | rows)

    def looks(self, asked: Transmit, scan: ScanData) -> Answer:
        """Looks that were tested."""
        return Answer(encode(self.received(asked, **{name: getattr(scan, name) for name in ROWS})))

    def data(self, asked: Transmit, y: NDArray[np.complex64], **rows: Any) -> Answer:
        """Y of each range cell, (c, n_tx, n_rx)."""
        cells = {"range_cells": asked.range_cells} if asked.range_cells.size else {}
        return Answer(y.tobytes(), encode(self.received(asked, **cells, **rows)))

    def _open(self, query: zenoh.Query) -> None:
        with query:
            opening = decode_answer(bytes(query.payload or b""), Opening)
            self.openings.append(opening)
            hello = {"run": opening.run, "incarnation": self.incarnation} | self._hello
            query.reply(query.key_expr, encode(Hello.model_validate(hello)))

    def _transmit(self, query: zenoh.Query) -> None:
        with query:
            asked = decode_answer(bytes(query.payload or b""), Transmit)
            self.asked.append(asked)
            answer = self._answer(self, asked)
            if answer is not None and answer.is_error:
                query.reply_err(answer.payload)
            elif answer is not None:
                for _ in range(answer.times):
                    query.reply(query.key_expr, answer.payload, attachment=answer.attachment)


def simulated(checkpoint: EmulatorCheckpoint) -> Callable[[Device, Transmit], Answer]:
    """The simulated world behind a queryable."""
    front_end: FrontEnd = SimulatedFrontEnd.open(checkpoint)

    def answer(device: Device, asked: Transmit) -> Answer:
        scan = front_end.transmit(asked.k, asked.t, transmission_of(asked))
        assert scan is not None
        return device.looks(asked, scan)

    return answer


def transmission_of(asked: Transmit) -> Transmission:
    """What a front end in Python would have been asked."""
    columns = (asked.nus, asked.bins, asked.first_cells, asked.n_cells, asked.limits, asked.merged)
    looks = [
        Look(nu, bin_, range(first, first + n) if n else range(0), limit, merged == 1)
        for nu, bin_, first, n, limit, merged in zip(*(column.tolist() for column in columns), strict=True)
    ]
    bins = np.unique(asked.bins)
    factor = asked.factor.astype(np.complex128)
    return Transmission(asked.isotropic, factor, asked.beams, bins, looks, asked.beam_nus, asked.gates)
