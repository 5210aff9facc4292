"""A front end that answers each dwell with the same: to measure the way to it."""

from threading import Event
from typing import NamedTuple

import numpy as np
import zenoh
from zenoh.shm import BlockOn, GarbageCollect, ShmProvider

from cogradar.shared.protocol.front_ends.messages import Hello, Opening, Received, Transmit
from cogradar.shared.protocol.topics import DWELL, OPENING
from cogradar.shared.wire.codec import decode_answer, encode
from cogradar.shared.wire.session import listen_session

POOL = 128 << 20  # bytes of shared memory


class Steady(NamedTuple):
    """What it is and where."""

    name: str
    endpoint: str  # where the emulator connects to
    hello: bytes  # encoded messages; with `hands_over` "data" Y is as large as the question asks for
    answer: bytes
    shares_memory: bool


def serve(steady: Steady, is_up: Event, stop: Event) -> None:
    """Be it until `stop` is set."""
    said, received = decode_answer(steady.hello, Hello), decode_answer(steady.answer, Received)
    memory = ShmProvider.default_backend(POOL) if steady.shares_memory else None
    rng, data = np.random.default_rng(1), dict[int, bytes]()

    def y(n_cell: int) -> bytes:
        shape = n_cell, said.n_tx, said.n_rx
        return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(np.complex64).tobytes()

    def payload(y: bytes) -> zenoh.ZBytes:
        """Written once, into memory that the emulator maps, if it is shared."""
        if memory is None:
            return zenoh.ZBytes(y)
        buffer = memory.alloc(len(y), BlockOn(GarbageCollect()))
        buffer[:] = y
        return zenoh.ZBytes(buffer)

    def on_opening(query: zenoh.Query) -> None:
        with query:
            opening = decode_answer(_payload(query), Opening)
            query.reply(query.key_expr, encode(said.model_copy(update={"run": opening.run})))

    def on_dwell(query: zenoh.Query) -> None:
        with query:
            asked = decode_answer(_payload(query), Transmit)
            update = {"run": asked.run, "k": asked.k}
            if said.hands_over == "looks":
                query.reply(query.key_expr, encode(received.model_copy(update=update)))
                return
            n_cell = asked.range_cells.size
            if n_cell not in data:
                data[n_cell] = y(n_cell)
            attachment = encode(received.model_copy(update=update | {"range_cells": asked.range_cells}))
            query.reply(query.key_expr, payload(data[n_cell]), attachment=attachment)

    with listen_session(steady.endpoint, shares_memory=steady.shares_memory) as session:
        declared = [
            session.declare_queryable(OPENING.key_of(steady.name), on_opening, complete=True),
            session.declare_queryable(DWELL.key_of(steady.name), on_dwell, complete=True),
        ]
        is_up.set()
        stop.wait()
        for one in declared:
            one.undeclare()


def _payload(query: zenoh.Query) -> bytes:
    return b"" if query.payload is None else query.payload.to_bytes()
