"""zenoh_front_end.py: a front end in a process of its own. It needs `zenoh`, `msgpack` and `numpy`, and no cogradar.

    python zenoh_front_end.py roof --listen tcp/127.0.0.1:7448
    cogradar run mine.toml --front-end zenoh:roof@tcp/127.0.0.1:7448

Two aircraft fly straight in white noise. For real hardware replace `World`; paper_world.py beside this file has another
one, which tests the cells itself. What is asked is explained in docs/howto/front-end.md, the bytes in
docs/reference/wire.md.
"""

import argparse
import json
import logging
import secrets
import struct
import threading
import traceback
from pathlib import Path

import msgpack
import numpy as np
import zenoh
import zenoh.shm

PROTOCOL, SCHEMA = 10, 2  # of keys, and of messages
DTYPES = {b"i4": "<i4", b"f8": "<f8", b"c8": "<c8"}
TARGETS = ((40.0, -0.05, -30.0, 0.02), (50.0, -0.03, 20.0, 0.03))  # x, vx, y, vy; km, km/s


def pack(topic, body):
    """A message: an envelope of MessagePack."""
    return msgpack.packb({"v": SCHEMA, "topic": topic, "body": body}, default=_array)


def unpack(payload):
    """The body of a message."""
    message = msgpack.unpackb(payload, ext_hook=_unpacked)
    if message["v"] != SCHEMA:
        raise ValueError(f"schema {message['v']}, this front end speaks {SCHEMA}")
    return message["body"]


def _array(value):
    """An array: extension type 1 of element type, number of axes, their lengths and the elements, row by row."""
    name = {np.dtype(text): name for name, text in DTYPES.items()}[value.dtype]
    return msgpack.ExtType(1, struct.pack(f"<2sB{value.ndim}I", name, value.ndim, *value.shape) + value.tobytes())


def _unpacked(_code, data):
    shape = struct.unpack_from(f"<{data[2]}I", data, 3)
    return np.frombuffer(data, DTYPES[data[:2]], offset=3 + 4 * len(shape)).reshape(shape)


def place_of(error):
    """Where an exception comes from, FILE:LINE: in what was written for this front end, not in a library of it."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if "site-packages" not in frame.filename] or frames
    return f"{Path(own[-1].filename).name}:{own[-1].lineno}"


class World:
    """What the array receives: echoes of the targets, and noise of power 1 in each element of Y."""

    hands_over = "data"

    def __init__(self, opening, seed):
        """What the radar is, as its scenario says."""
        radar = opening["radar"]
        self.n_tx, self.n_rx = radar["array"]["n_tx"], radar["array"]["n_rx"]
        self._amplitude_db, self._dt_s = radar["echo"]["amplitude_db"], radar["motion"]["dt_s"]
        self._width_km, self._seed = radar["receiver"]["range_cell_km"], seed

    def receive(self, dwell):
        """Y of dwell k, (c, n_tx, n_rx): a row for each transmitted waveform, a column for each receive channel."""
        values, vectors = np.linalg.eigh(
            dwell["isotropic"] / self.n_tx * np.eye(self.n_tx) + dwell["factor"] @ dwell["factor"].conj().T
        )
        w = (vectors * np.sqrt(values.clip(0.0))) @ vectors.conj().T  # R^(1/2)
        cells = dwell["range_cells"].tolist() or [None]
        # The same noise if the same dwell is asked for again.
        rng = np.random.default_rng((self._seed, dwell["k"]))
        re, im = rng.standard_normal((2, len(cells), self.n_tx, self.n_rx), np.float32) * np.float32(0.5**0.5)
        y = re + 1j * im
        for x, vx, across, v_across in TARGETS:
            at = x + dwell["t"] * self._dt_s * vx, across + dwell["t"] * self._dt_s * v_across
            range_km = np.hypot(*at)
            cell = int(range_km / self._width_km) if self._width_km else None
            if cell in cells:
                nu = 0.5 * at[1] / range_km
                alpha = 10.0 ** (self._amplitude_db / 20.0) / range_km**2 * np.exp(2j * np.pi * rng.random())
                a_tx, a_rx = (np.exp(2j * np.pi * nu * np.arange(n)) for n in (self.n_tx, self.n_rx))
                y[cells.index(cell)] += alpha * np.outer(w.T @ a_tx, a_rx)
        return y


class FrontEnd:
    """Answers the questions of a radar, of one run at a time."""

    def __init__(self, session, name, begin, shared_mb):
        self._incarnation, self._begin, self._worlds = secrets.token_hex(8), begin, {}
        self._most = shared_mb << 20
        self._memory = zenoh.shm.ShmProvider.default_backend(self._most) if shared_mb else None
        key = f"cogradar/{PROTOCOL}/front-end/{name}"
        self._declared = [
            session.declare_queryable(f"{key}/opening", self._guarded(self._open), complete=True),
            session.declare_queryable(f"{key}/dwell", self._guarded(self._transmit), complete=True),
        ]

    def _guarded(self, answer):
        def on_query(query):
            with query:  # the radar waits until the query is dropped
                try:
                    answer(query, unpack(query.payload.to_bytes()))
                except Exception as error:  # the radar says it, and opens this front end again
                    logging.exception("not answered")
                    query.reply_err(f"{place_of(error)}: {type(error).__name__}: {error}".encode())

        return on_query

    def _open(self, query, opening):
        """A run begins, or goes on."""
        world = self._begin(opening)
        self._worlds = {opening["run"]: world}
        hello = {"run": opening["run"], "incarnation": self._incarnation, "n_tx": world.n_tx, "n_rx": world.n_rx}
        hello |= {"hands_over": world.hands_over, "max_rate_hz": 100.0, "clock": "none", "site": "an example"}
        query.reply(query.key_expr, pack("hello", hello), encoding="application/msgpack")

    def _transmit(self, query, dwell):
        """Looks as a message; or Y as the payload, the message as its attachment."""
        received = {"run": dwell["run"], "incarnation": self._incarnation, "k": dwell["k"]}
        if dwell["range_cells"].size:
            received["range_cells"] = dwell["range_cells"]
        if dwell["run"] not in self._worlds:  # another run was opened since, or this process is a new one
            query.reply_err(f"run {dwell['run']} is not open".encode())
            return
        measured = self._worlds[dwell["run"]].receive(dwell)
        if isinstance(measured, dict):
            query.reply(query.key_expr, pack("received", received | measured), encoding="application/msgpack")
            return
        y, attachment = self._payload(measured.astype("<c8").tobytes()), pack("received", received)
        query.reply(query.key_expr, y, encoding="application/octet-stream", attachment=attachment)

    def _payload(self, y):
        """In memory that a radar on this machine maps, if that was asked for; a receiver would write there itself."""
        if self._memory is None or len(y) > self._most:
            return y
        try:
            buffer = self._memory.alloc(len(y), zenoh.shm.GarbageCollect())
        except zenoh.ZError:  # answers that the radar has not copied yet fill it: waiting for room may have no end
            return y
        buffer[:] = y
        return zenoh.ZBytes(buffer)


def serve(world):
    """Be there until the process is ended; `world` makes what a run meets."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("name", help="behind zenoh: of --front-end")
    parser.add_argument("--listen", help="where the radar connects to, such as tcp/127.0.0.1:7448")
    parser.add_argument("--connect", help="the radar's router, such as tcp/127.0.0.1:7447")
    parser.add_argument("--zenoh-config", help="file of Zenoh's settings, with a certificate")
    parser.add_argument("--shared-memory", type=int, default=0, metavar="MB", help="four times a Y, on one machine")
    parser.add_argument("--seed", type=int, default=1, help="of the noise")
    given = parser.parse_args()
    logging.basicConfig(level=logging.INFO)
    config = zenoh.Config.from_file(given.zenoh_config) if given.zenoh_config else zenoh.Config()
    settings = {
        "mode": "peer" if given.listen else "client",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/tx/lease": 2000,
        "transport/shared_memory/enabled": given.shared_memory > 0,
    }
    settings |= {"listen/endpoints": [given.listen]} if given.listen else {}
    settings |= {"connect/endpoints": [given.connect], "connect/timeout_ms": 30_000} if given.connect else {}
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        front_end = FrontEnd(session, given.name, lambda opening: world(opening, given.seed), given.shared_memory)
        logging.info("front end %s is there", given.name)
        threading.Event().wait()
        del front_end


if __name__ == "__main__":
    serve(World)
