"""Pages and askers of one HTTP service for as long as it takes, in a process of their own."""

import asyncio
import json
import os
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, NamedTuple
from urllib.parse import urlsplit

RUNS = "/api/v1/runs"
PERIOD_S = 1.0  # between two questions of an asker
TIMEOUT_S = 30.0


class Served(NamedTuple):
    """What came of it."""

    answers_s: list[float]  # time of each answer, from the connection on
    failed: list[str]  # questions without an answer
    events: int  # of all streams


def serve(address: str, pages: int, askers: int, pipe: Connection) -> None:
    """Process: so many of both until the other end of the pipe sends something, then what came of it."""
    os.nice(10)
    pipe.send(asyncio.run(_serve(address, pages, askers, pipe)))


async def _serve(address: str, pages: int, askers: int, pipe: Connection) -> Served:
    clients = _Clients(address)
    tasks = [asyncio.create_task(clients.ask(n / askers * PERIOD_S)) for n in range(askers)]
    tasks += [asyncio.create_task(clients.look(n)) for n in range(pages)]
    pipe.send(None)  # it begins
    await asyncio.to_thread(pipe.recv)
    for task in tasks:
        task.cancel()
    ended = await asyncio.gather(*tasks, return_exceptions=True)
    faults = [repr(error) for error in ended if not isinstance(error, asyncio.CancelledError)]
    return Served(clients.answers_s, clients.failed + faults, clients.events)


class _Clients:
    def __init__(self, address: str) -> None:
        self._at = urlsplit(address)
        self.answers_s: list[float] = []
        self.failed: list[str] = []
        self.events = 0

    async def ask(self, delay_s: float) -> None:
        """Ask of the newest runs, one after the other."""
        await asyncio.sleep(delay_s)
        while True:
            for row in await self._newest():
                await asyncio.sleep(PERIOD_S)
                await self._question(f"{RUNS}/{row['run']}/summary" if row["t"] else "/readyz")
            await asyncio.sleep(PERIOD_S)

    async def look(self, n: int) -> None:
        """A page: its file, the runs, and the events of one of those that go on, to its end."""
        while True:
            await self._question("/")
            if running := [row for row in await self._newest() if row["status"] == "running"]:
                await self._get(f"{RUNS}/{running[n % len(running)]['run']}/events", self._count)
            await asyncio.sleep(PERIOD_S)

    def _count(self, part: bytes) -> None:
        self.events += part.count(b"id: ")

    async def _newest(self) -> list[dict[str, Any]]:
        found = await self._question(RUNS)
        return list(json.loads(found)["rows"])[-6:] if found else []

    async def _question(self, path: str) -> bytes:
        """One that counts."""
        body, began = bytearray(), time.monotonic()
        try:
            await asyncio.wait_for(self._get(path, body.extend), TIMEOUT_S)
        except (OSError, EOFError, TimeoutError) as error:
            self.failed.append(f"{path}: {error!r}")
            return b""
        self.answers_s.append(time.monotonic() - began)
        return bytes(body)

    async def _get(self, path: str, seen: Callable[[bytes], None]) -> None:
        reader, writer = await asyncio.open_connection(self._at.hostname, self._at.port)
        try:
            writer.write(f"GET {path} HTTP/1.1\r\nHost: {self._at.hostname}\r\nConnection: close\r\n\r\n".encode())
            head = await reader.readuntil(b"\r\n\r\n")
            while part := await reader.read(1 << 16):
                seen(part)
        finally:
            writer.close()
        if not head.startswith(b"HTTP/1.1 200"):
            raise ConnectionError(head.partition(b"\r\n")[0].decode())
