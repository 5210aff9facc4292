"""An hour of the compose file's radar, with commands over HTTP and from the page, and services that are killed.

The run ends by a command. Its store is copied out of the volume and replayed by this machine's program. It needs
Docker, Chromium and root. What happened is in build/hour/hour.jsonl; the last line printed is the result, which
docs/reliability.md has.
"""

import argparse
import json
import os
import re
import secrets
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
from playwright.sync_api import Page, expect, sync_playwright

from cogradar.shared.wire.session import free_port
from tests.containers.engine import compose, containers, crash, docker, wait_for
from tests.services.web.page.conftest import CHROMIUM, wait_for_dwell

OUT = Path("build/hour")
HOUR = 60.0  # minutes of the timetable below
NAME, TOKEN, PORT = "tower", secrets.token_hex(16), free_port()
ADDRESS = f"http://127.0.0.1:{PORT}"
UP = {  # as the compose file has it, but for the journal: a planner is replayed from the first dwell on
    "COGRADAR_SCENARIO": "traffic",
    "COGRADAR_DWELLS": "unlimited",
    "COGRADAR_KEEP_BYTES": "8000000000",
    "COGRADAR_COMMAND_TOKENS": f"{NAME}:{TOKEN}",
    "COGRADAR_HTTP_PORT": str(PORT),  # the same after metrics was started again
}


class Hour:
    """The run on the services, and what was done to it."""

    def __init__(self) -> None:
        self.http = httpx.Client(base_url=f"{ADDRESS}/api/v1", timeout=60.0)
        (row,) = wait_for("a run", lambda: self.rows("runs"))
        self.run: str = row["run"]
        self.sent: list[dict[str, Any]] = []
        self.kills: list[str] = []
        self.samples: list[dict[str, Any]] = []
        self.faults: list[str] = []

    def rows(self, path: str) -> list[dict[str, Any]]:
        """Rows of an answer; metrics may be away for a moment."""
        for _ in range(60):
            try:
                answer = self.http.get(path, params={"limit": 1000})
                if answer.status_code == httpx.codes.OK:
                    found: list[dict[str, Any]] = answer.json()["rows"]
                    return found
            except httpx.TransportError:
                pass
            time.sleep(1.0)
        raise AssertionError(f"{path}: no answer within a minute")

    def note(self, kind: str, **what: Any) -> dict[str, Any]:
        """Keep what happened, with the time and the load of the machine."""
        entry = {"at": time.strftime("%H:%M:%S"), "kind": kind, "load": round(os.getloadavg()[0], 1), **what}
        with (OUT / "hour.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")
        sys.stdout.write(f"{json.dumps(entry)[:300]}\n")
        sys.stdout.flush()
        return entry

    def tracks(self) -> list[int]:
        """Confirmed tracks of the newest dwell, the oldest first."""
        t = self.rows("runs")[-1]["t"]
        dwells = self.http.get(f"runs/{self.run}/dwells", params={"dwells": f"{t - 3}:{t}"}).json()["dwells"]
        return [one["track"] for one in dwells[-1]["tracks"] if (one["existence"] or 0.0) > 0.99]

    def command(self, words: str) -> None:
        """Over HTTP; TRACK, SECOND: a confirmed track."""
        if "TRACK" in words or "SECOND" in words:
            first, second = [*self.tracks(), 0, 0][:2]
            words = words.replace("TRACK", str(first)).replace("SECOND", str(second))
        answer = self.http.post(
            f"runs/{self.run}/commands", json={"action": words}, headers={"Authorization": f"Bearer {TOKEN}"}
        )
        said = answer.json()
        self.sent.append({"words": words, "status": answer.status_code, "by": "http"})
        self.note("command", words=words, status=answer.status_code, said=said.get("detail", said.get("k")))

    def kill(self, service: str) -> None:
        """As a crash would: kill -9 of its process; the engine starts it again."""
        crash(containers(service)[0])
        self.kills.append(service)
        self.note("kill", service=service)

    def sample(self, minute: float) -> None:
        """Memory of each container, size of the store, dwells, and what was late."""
        lines = docker("stats", "--no-stream", "--format", "{{json .}}", *containers("")).splitlines()
        memory = {one["Name"]: one["MemUsage"].split(" / ")[0] for one in map(json.loads, lines)}
        size = int(compose("exec", "-T", "recorder", "du", "-sb", "/data").split()[0])
        t = self.rows("runs")[-1]["t"]
        self.samples.append(self.note("sample", minute=minute, memory=memory, store_bytes=size, t=t))

    def on_page(self, acts: Callable[["Hour", Page], None]) -> None:
        """A page of its own, with its panel open and the token typed; what goes wrong there is a fault."""
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
            page = browser.new_context(viewport={"width": 1280, "height": 800}).new_page()
            page.set_default_timeout(60_000)
            page.on("pageerror", lambda error: self.faults.append(f"page: {error.message}"))
            page.goto(f"{ADDRESS}/?run={self.run}")
            wait_for_dwell(page, 1)
            page.keyboard.press("c")
            page.get_by_label("Commander's token").fill(TOKEN)
            page.keyboard.press("Enter")
            acts(self, page)
            browser.close()

    def answered(self, page: Page, like: str) -> None:
        """Wait for the panel's answer, and keep it."""
        answer = page.locator("#command-answer")
        expect(answer).to_have_text(re.compile(f"{like}(?!.*asked …)"), timeout=60_000)
        text = answer.inner_text()
        self.sent.append({"words": text.partition(":")[0], "status": 201 if "granted" in text else 409, "by": "page"})
        self.note("page", said=text)


def _pause_look_and_track(hour: Hour, page: Page) -> None:
    page.get_by_role("button", name="Pause transmission").click()
    hour.answered(page, r"^pause: granted")
    expect(page.locator("#legend")).to_contain_text("transmission paused")
    page.wait_for_timeout(2_000)
    page.get_by_role("button", name="Resume").click()
    hour.answered(page, r"^resume: granted")
    page.get_by_role("button", name="Aim").click()
    box = page.locator("#scope").bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + 0.4 * box["width"], box["y"] + 0.5 * box["height"])
    hour.answered(page, r"^look .*: granted")
    page.locator("#tracks tbody tr[data-state=detected]").first.get_by_role("button").click()
    page.get_by_role("button", name="Priority").click()
    hour.answered(page, r"^priority .*: granted")
    page.get_by_label("within, km").fill("2")
    page.get_by_role("button", name="Accuracy", exact=True).click()
    hour.answered(page, r"^accuracy ")
    page.wait_for_timeout(30_000)
    page.get_by_role("button", name="Any accuracy").click()
    hour.answered(page, r"^accuracy .* none")


def _sector_and_drop(hour: Hour, page: Page) -> None:
    page.keyboard.press("Tab")
    page.keyboard.press("s")
    box = page.locator("#scope").bounding_box()
    assert box is not None
    y = box["y"] + 0.5 * box["height"]
    page.mouse.move(box["x"] + 0.7 * box["width"], y)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.65 * box["width"], y)
    page.mouse.move(box["x"] + 0.6 * box["width"], y)
    page.mouse.up()
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Blank").click()
    hour.answered(page, r"^sector blank .*: granted")
    page.wait_for_timeout(20_000)
    page.get_by_role("button", name="Normal").click()
    hour.answered(page, r"^sector normal .*: granted")
    page.locator("#tracks tbody tr[data-state=detected]").first.get_by_role("button").click()
    page.locator("#drop").click()
    hour.answered(page, r"^drop .*: granted")


def _end(hour: Hour, page: Page) -> None:
    page.get_by_role("button", name="End the run …").click()
    page.get_by_role("button", name="End the run", exact=True).click()
    hour.answered(page, r"^end: granted")
    expect(page.locator("#connection")).to_have_text("Complete: ended by command", timeout=60_000)


# Minute, what, with what. A rule is refused: the scenario's looks are joint ones.
TIMETABLE: tuple[tuple[float, str, Any], ...] = (
    (4, "command", "power 0.5"),
    (5, "sample", None),
    (6, "command", "power 1"),
    (7, "on_page", _pause_look_and_track),
    (10, "kill", "planner"),
    (12, "command", "look 12.5 20 0.2"),
    (13, "command", "sector blank -30 -10"),
    (16, "command", "sector normal -90 90"),
    (18, "command", "sector double 0 25"),
    (20, "kill", "allocator"),
    (21, "command", "sector normal -90 90"),
    (23, "command", "priority TRACK 4"),
    (24, "command", "accuracy SECOND 0.5"),
    (26, "command", "set strategy uniform"),  # refused while a priority is in force
    (27, "command", "priority TRACK 1"),
    (28, "command", "accuracy SECOND none"),
    (29, "command", "set strategy uniform"),
    (30, "sample", None),
    (31, "kill", "recorder"),
    (33, "command", "set strategy power-aware"),
    (35, "command", "set objective urgency"),
    (37, "command", "set rule mode"),
    (39, "command", "set objective max-min"),
    (41, "kill", "router"),
    (44, "on_page", _sector_and_drop),
    (47, "command", "pause 50"),
    (49, "command", "drop TRACK"),
    (51, "kill", "emulator"),
    (54, "kill", "metrics"),
    (57, "command", "power 0.8"),
    (58, "command", "drop 999999"),  # refused: there is no such track
    (59, "sample", None),
    (60, "on_page", _end),
)


def _replayed(store: Path, run: str, to: str) -> dict[str, Any]:
    command = [sys.executable, "-m", "cogradar", "replay", run, "--to", to, "--store", str(store), "--json"]
    found: dict[str, Any] = json.loads(subprocess.run(command, capture_output=True, text=True, check=False).stdout)
    return found


def play(minutes: float) -> dict[str, Any]:
    """Follow the timetable, end the run, copy its store and replay it; what came of it."""
    OUT.mkdir(parents=True, exist_ok=True)
    began_s, hour = time.time(), Hour()
    hour.note("begin", run=hour.run)
    for minute, what, how in TIMETABLE:
        time.sleep(max(0.0, began_s + minute * 60.0 * minutes / HOUR - time.time()))
        try:
            getattr(hour, what)(minute if how is None else how)
        except Exception as error:  # noqa: BLE001 - the hour goes on, and its result says so
            hour.faults.append(f"{what} at {minute}: {type(error).__name__}: {error}"[:600])
            hour.note("fault", text=hour.faults[-1])
    listed = hour.rows(f"runs/{hour.run}/commands")
    (row,) = (one for one in hour.rows("runs") if one["run"] == hour.run)
    compose("stop")
    shutil.rmtree(OUT / "data", ignore_errors=True)
    docker("cp", f"{containers('recorder')[0]}:/data", str(OUT / "data"))
    replays = {to: _replayed(OUT / "data/cogradar.db", hour.run, to) for to in ("planner", "allocator")}
    how = {"kills": hour.kills, "sent": hour.sent, "listed": listed, "samples": hour.samples, "faults": hour.faults}
    return hour.note("end", row=row, replays=replays, **how)


def verdict(end: dict[str, Any]) -> tuple[str, list[str]]:
    """What came of an hour in a line, and all that is wrong."""
    planner, allocator = end["replays"]["planner"], end["replays"]["allocator"]
    granted = [one for one in end["listed"] if one["k"] is not None]
    wrong = [*end["faults"]]
    wrong += [f"replay: {each['difference']}" for each in (planner, allocator) if each["difference"] is not None]
    wrong += [
        f"not listed: {one}" for one in end["sent"] if one["status"] == httpx.codes.CREATED and not _is_in(one, granted)
    ]
    wrong += [f"by {one['by']}: {one}" for one in end["listed"] if one["by"] != NAME]
    first, last = end["samples"][0], end["samples"][-1]
    said = (
        f"{end['row']['t']} dwells, {len(granted)} commands granted and {len(end['listed']) - len(granted)} refused,"
        f" {len(end['kills'])} kills; {planner['agreed']} plans and {allocator['agreed']} waveforms agree,"
        f" {planner['other_scans']} plans and {allocator['late']} waveforms were not compared,"
        f" {planner['cut_short']} without their bins, {planner['missing']} dwells have no scan;"
        f" store {first['store_bytes'] / 1e6:.0f} MB after dwell {first['t']},"
        f" {last['store_bytes'] / 1e6:.0f} MB after dwell {last['t']}; {len(wrong)} faults"
    )
    return said, wrong


def _is_in(sent: dict[str, Any], listed: list[dict[str, Any]]) -> bool:
    return any(one["action"] == sent["words"] for one in listed)


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--minutes", type=float, default=HOUR, help="The timetable, faster.")
    given = arguments.parse_args()
    try:
        compose("build", "--quiet", "router")
        compose("up", "--detach", "--no-build", "--wait", **UP)
        text, faults = verdict(play(given.minutes))
    finally:
        compose("down", "--volumes", "--remove-orphans", "--timeout", "5")
    sys.stdout.write("".join(f"{fault}\n" for fault in faults) + f"{text}\n")
    sys.exit(bool(faults))
