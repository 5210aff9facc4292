"""Clients of a run's HTTP, in a process of their own: they ask, listen, scrape, or stop reading.

Written on plain sockets, and run at the lowest priority: on a machine of their own they would cost the run nothing.
"""

import asyncio
import os
import re
import socket
from collections import Counter
from collections.abc import Callable, Coroutine
from multiprocessing.connection import Connection
from urllib.parse import urlsplit

RUNS = "/api/v1/runs"
PERIOD_S = 1.0  # between two questions of a client
RETRY_S = 0.1  # of a stream, until the run has begun
_LENGTH = re.compile(rb"content-length: *(\d+)", re.IGNORECASE)


def serve(kind: str, address: str, run: str, pipe: Connection) -> None:
    """Process: clients of one kind until the other end of the pipe sends something; then how often each was served."""
    os.nice(19)
    asyncio.run(_serve(kind, address, run, pipe))


async def _serve(kind: str, address: str, run: str, pipe: Connection) -> None:
    served, at = Counter[str](), urlsplit(address)
    host, port = str(at.hostname), int(at.port or 0)
    tasks = [asyncio.create_task(client) for client in KINDS[kind](host, port, run, served)]
    pipe.send(None)  # it begins
    await asyncio.to_thread(pipe.recv)
    for task in tasks:
        task.cancel()
    ended = await asyncio.gather(*tasks, return_exceptions=True)
    faults = [repr(error) for error in ended if not isinstance(error, asyncio.CancelledError)]
    pipe.send((dict(served), faults))


async def _ask(host: str, port: int, path: str, delay_s: float, served: Counter[str]) -> None:
    """One question each second over a connection that stays open, until the service ends one that was idle for long."""
    await asyncio.sleep(delay_s)
    loop = asyncio.get_running_loop()
    due = loop.time()
    while True:
        reader, writer = await asyncio.open_connection(host, port)
        try:
            while True:
                writer.write(f"GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
                head = await reader.readuntil(b"\r\n\r\n")
                length = _LENGTH.search(head)
                await reader.readexactly(int(length[1]) if length else 0)
                served["answers"] += head.startswith(b"HTTP/1.1 200")
                due = max(due + PERIOD_S, loop.time())
                await asyncio.sleep(due - loop.time())
        except (asyncio.IncompleteReadError, ConnectionError):
            await asyncio.sleep(RETRY_S)
        finally:
            writer.close()


async def _listen(host: str, port: int, run: str, served: Counter[str]) -> None:
    """The stream of a run's events, opened again as long as the run is not there."""
    while True:
        reader, writer = await asyncio.open_connection(host, port)
        writer.write(f"GET {RUNS}/{run}/events HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n".encode())
        while text := await reader.read(1 << 16):
            served["events"] += text.count(b"\nid: ") + text.startswith(b"id: ")
        writer.close()
        await asyncio.sleep(RETRY_S)


async def _freeze(host: str, port: int, run: str, served: Counter[str]) -> None:
    """The same stream, of which nothing is ever read."""
    while True:
        with socket.socket() as frozen:
            frozen.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            frozen.connect((host, port))
            frozen.sendall(f"GET {RUNS}/{run}/events HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
            frozen.setblocking(False)
            if await asyncio.get_running_loop().sock_recv(frozen, 12) == b"HTTP/1.1 200":
                served["streams"] += 1
                await asyncio.Event().wait()
        await asyncio.sleep(RETRY_S)


Clients = list[Coroutine[None, None, None]]


def _fifty(host: str, port: int, run: str, served: Counter[str]) -> Clients:
    asking = [_ask(host, port, f"{RUNS}/{run}/summary", i / 50 * PERIOD_S, served) for i in range(50)]
    return asking + _streams(host, port, run, served)


def _streams(host: str, port: int, run: str, served: Counter[str]) -> Clients:
    return [_listen(host, port, run, served) for _ in range(50)]


def _scrape(host: str, port: int, _run: str, served: Counter[str]) -> Clients:
    return [_ask(host, port, "/metrics", 0.0, served)]


def _frozen(host: str, port: int, run: str, served: Counter[str]) -> Clients:
    return [_freeze(host, port, run, served)]


KINDS: dict[str, Callable[[str, int, str, Counter[str]], Clients]] = {
    "50 clients ask each second and listen": _fifty,
    "50 streams of events": _streams,
    "a scrape of all processes each second": _scrape,
    "a browser that is frozen": _frozen,
}
