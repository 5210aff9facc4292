"""Three hosts on this machine: network namespaces, joined by a bridge in a fourth. Nothing touches its own network."""

import json
import os
import subprocess
import sys
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any, Self

ROOT = Path(__file__).parents[2]
HOSTS = ("a", "b", "c")
SWITCH = "switch"
GRACE_S = 5.0
LEFT = ("router", "recorder", "metrics", "emulator", "allocator")  # on host a; a planner on each of the others


class Hosts:
    """The namespaces and the services in them, as a context: left, all of them are gone."""

    def __init__(self, folder: Path) -> None:
        self.endpoint = "tcp/10.77.0.1:7447"
        self._folder = folder
        self._processes: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> Self:
        try:
            self._join()
            for role in LEFT:
                self.start("a", role)
            for host in ("b", "c"):
                self.start(host, "planner")
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end()

    @staticmethod
    def namespace(host: str) -> str:
        """Name of a host's network namespace."""
        return f"cogradar-{os.getpid()}-{host}"

    def start(self, host: str, role: str) -> None:
        """Start a service on a host."""
        command = [
            *self._inside(host),
            sys.executable,
            "-m",
            "cogradar",
            "service",
            role,
            "--name",
            f"{role}-{host}",
        ]
        command += ["--listen" if role == "router" else "--connect", self.endpoint]
        if role in {"recorder", "metrics"}:
            command += ["--store", str(self._folder / "store.db")]
        with (self._folder / f"{role}-{host}.log").open("ab") as log:
            self._processes[f"{role}-{host}"] = subprocess.Popen(command, cwd=ROOT, stdout=log, stderr=log)

    def play(self, *arguments: str) -> Future[Any]:
        """`cogradar run paper ...` on host a, in the background: what it prints with --json."""
        return ThreadPoolExecutor(1).submit(self.cli, "run", "paper", *arguments)

    def cli(self, *arguments: str) -> Any:
        """What a command of cogradar prints on host a, with --json."""
        command = [*self._inside("a"), sys.executable, "-m", "cogradar", *arguments, "--connect", self.endpoint]
        done = subprocess.run([*command, "--json"], cwd=ROOT, capture_output=True, text=True, check=False, timeout=240)
        assert done.returncode == 0, f"{done.stderr[-2000:]}\n{self.logs()}"
        return json.loads(done.stdout)

    def wait_until(self, t: int) -> str:
        """Name of the one run that goes on, once its dwell t is done."""
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            for row in self.cli("query", "runs"):
                if row["status"] == "running" and row["t"] >= t:
                    return str(row["run"])
        raise AssertionError(f"no dwell {t} within a minute\n{self.logs()}")

    def link(self, host: str, state: str) -> None:
        """Plug a host's cable in or out, at the switch: the host itself sees nothing."""
        _ip("-n", self.namespace(SWITCH), "link", "set", f"to-{host}", state)

    def lose(self, host: str, *rule: str) -> None:
        """Drop packets that come to a host and match an iptables rule; without a rule, none any more."""
        tables = [*self._inside(host), "iptables", "--wait"]
        subprocess.run([*tables, "-F", "INPUT"], check=True, capture_output=True)
        if rule:
            subprocess.run([*tables, "-A", "INPUT", *rule, "-j", "DROP"], check=True, capture_output=True)

    def logs(self) -> str:
        """The last lines of every service."""
        tails = ((log.name, log.read_text(errors="replace").splitlines()[-5:]) for log in self._folder.glob("*.log"))
        return "\n".join(f"{name}: {line}" for name, tail in sorted(tails) for line in tail)

    def _inside(self, host: str) -> list[str]:
        return ["ip", "netns", "exec", self.namespace(host)]

    def _join(self) -> None:
        """A namespace per host with one cable each to the bridge: 10.77.0.1, .2, .3."""
        switch = self.namespace(SWITCH)
        _ip("netns", "add", switch)
        _ip("-n", switch, "link", "add", "bridge", "type", "bridge")
        _ip("-n", switch, "link", "set", "bridge", "up")
        for number, host in enumerate(HOSTS, start=1):
            name = self.namespace(host)
            _ip("netns", "add", name)
            _ip("-n", switch, "link", "add", f"to-{host}", "type", "veth", "peer", "name", "eth0", "netns", name)
            _ip("-n", switch, "link", "set", f"to-{host}", "master", "bridge", "up")
            _ip("-n", name, "address", "add", f"10.77.0.{number}/24", "dev", "eth0")
            for device in ("lo", "eth0"):
                _ip("-n", name, "link", "set", device, "up")

    def _end(self) -> None:
        for process in self._processes.values():
            process.terminate()
        deadline = time.monotonic() + GRACE_S
        for process in self._processes.values():
            try:
                process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        for host in (*HOSTS, SWITCH):
            subprocess.run(["ip", "netns", "delete", self.namespace(host)], check=False, capture_output=True)


def namespaces() -> list[str]:
    """Network namespaces that this test session made."""
    done = subprocess.run(["ip", "netns", "list"], capture_output=True, text=True, check=True)
    return [line.split()[0] for line in done.stdout.splitlines() if line.startswith(f"cogradar-{os.getpid()}-")]


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True)
