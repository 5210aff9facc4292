"""Commands over HTTP: who may give them, what they must be, and what is answered; the recorder is a real one."""

import asyncio
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from starlette.applications import Starlette

from cogradar.services.errors import BadInput
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.recorder.core import RecorderCore
from cogradar.services.recorder.journal import Journal
from cogradar.services.web.address import COMMAND_FILE_VARIABLE, COMMAND_VARIABLE, TOKEN_VARIABLE, Admitted, commanders
from cogradar.services.web.app import create
from cogradar.shared.protocol.events import Tick
from tests.services.loop import smoke_start
from tests.services.web.conftest import ask
from tests.skies import sky_start

TOKEN, READER = "c0mmander-of-the-tower", "reads-only-reads-only"
HALF = {"action": {"kind": "power", "share": 0.5}}
ADMITTED = Admitted(None, READER, {TOKEN: "tower"})


@pytest.fixture
def metrics(tmp_path: Path) -> Iterator[MetricsCore]:
    """Metrics beside a recorder with a run that goes on, r, of an unknown number, and one that is over."""
    file = str(tmp_path / "runs.db")
    journal = Journal(file)
    recorder, core, stop = RecorderCore(journal), MetricsCore(file), threading.Event()
    recorder.handle(smoke_start(run="over"))
    journal.give_up_unfinished()
    journal.commit()
    recorder = RecorderCore(journal, resume=True)
    recorder.handle(sky_start(dwells=1000))

    def tick() -> None:
        while not stop.wait(0.02):
            for command in core.handle(Tick(time.monotonic())):
                recorder.handle(command)

    ticking = threading.Thread(target=tick)
    ticking.start()
    yield core
    stop.set()
    ticking.join()
    core.close()
    journal.close()


def _post(app: Starlette, run: str, token: str = TOKEN, **said: Any) -> httpx.Response:
    async def post() -> httpx.Response:
        transport = httpx.ASGITransport(app, raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
            headers = {"Authorization": f"Bearer {token}"} if token else {}
            return await client.post(f"/api/v1/runs/{run}/commands", headers=headers, **said)

    return asyncio.run(post())


def _get(app: Starlette, path: str) -> list[dict[str, Any]]:
    async def get() -> httpx.Response:
        transport = httpx.ASGITransport(app, raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
            return await client.get(path, headers={"Authorization": f"Bearer {READER}"})

    rows: list[dict[str, Any]] = asyncio.run(get()).json()["rows"]
    return rows


def test_a_command_is_granted_and_listed_with_who_asked(metrics: MetricsCore) -> None:
    app = create(metrics, ADMITTED, 0.1)
    found = _post(app, "r", json=HALF | {"at": 500})
    assert found.status_code == 201
    row = found.json()
    expected = {"run": "r", "n": 1, "by": "tower", "action": "power 0.5", "k": 500, "state": "pending", "reason": ""}
    assert {name: row[name] for name in expected} == expected
    assert _get(app, "/api/v1/runs/r/commands") == [row]
    refused = _post(app, "r", json={"action": "drop 7"})
    assert (refused.status_code, refused.json()["detail"]) == (
        409,
        "refused: there is no track 7; those that are there: none",
    )
    assert [one["state"] for one in _get(app, "/api/v1/runs/r/commands")] == ["pending", "refused"]
    assert _get(app, "/api/v1/runs/r/commands?state=open") == [row]


@pytest.mark.parametrize(
    ("run", "said", "status", "detail"),
    [
        ("nobody", {"json": HALF}, 404, "no such run"),
        ("over", {"json": HALF}, 409, "has ended already (failed)"),
        ("r", {"json": {}}, 400, "action: must be words such as"),
        ("r", {"json": []}, 400, "the body: must be an object of action"),
        ("r", {"json": HALF | {"by": "me"}}, 400, "the body: must be an object of action"),
        ("r", {"json": HALF | {"at": -1}}, 400, "at: must be a dwell"),
        ("r", {"json": {"action": {"kind": "power", "share": 2}}}, 400, "share = 2: must be a number"),
        ("r", {"json": {"action": {"kind": "drop", "track": 0}}}, 400, "track = 0: must be >= 1"),
        ("r", {"json": {"action": "power"}}, 400, "power: must be power SHARE"),
        ("r", {"json": {"action": ""}}, 400, "must be one of power SHARE; "),
        ("r", {"content": b"{", "extra": "application/json"}, 400, "the body is no JSON"),
        ("r", {"content": b" " * 5000, "extra": "application/json"}, 413, "longer than 4096 bytes"),
        ("r", {"content": b"power 0.5", "extra": "text/plain"}, 415, "must be application/json"),
    ],
)
def test_what_makes_no_sense_is_refused(
    metrics: MetricsCore, run: str, said: dict[str, Any], status: int, detail: str
) -> None:
    app = create(metrics, Admitted(None, "", {TOKEN: "tower"}), 0.1)
    if kind := said.pop("extra", ""):

        async def post() -> httpx.Response:
            transport = httpx.ASGITransport(app, raise_app_exceptions=False)
            async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
                headers = {"Authorization": f"Bearer {TOKEN}", "Content-Type": kind}
                return await client.post(f"/api/v1/runs/{run}/commands", headers=headers, **said)

        found = asyncio.run(post())
    else:
        found = _post(app, run, **said)
    assert found.status_code == status
    assert found.headers["content-type"] == "application/problem+json"
    assert detail in found.json()["detail"]


def test_only_a_commander_commands(metrics: MetricsCore) -> None:
    unable = _post(create(metrics, Admitted(None), 0.1), "r", json=HALF)
    assert unable.status_code == 403
    assert "commands are disabled: start metrics with COGRADAR_COMMAND_TOKENS=NAME:TOKEN" in unable.json()["detail"]
    app = create(metrics, ADMITTED, 0.1)
    assert _post(app, "r", token=READER, json=HALF).status_code == 403
    assert _post(app, "r", token=TOKEN[:-1], json=HALF).status_code == 401
    assert (
        _post(create(metrics, Admitted(None, "", {TOKEN: "tower"}), 0.1), "r", token="", json=HALF).status_code == 401
    )
    assert metrics.store.read("SELECT * FROM command") == []


def test_a_token_is_checked_before_it_commands(metrics: MetricsCore) -> None:
    app = create(metrics, Admitted(None, "", {TOKEN: "tower"}), 0.1)
    at = "/api/v1/commander"
    found = ask(app, at, Authorization=f"Bearer {TOKEN}")
    assert (found.status_code, found.json()) == (200, {"name": "tower"})
    assert ask(app, at, Authorization=f"Bearer {READER}").status_code == 403
    assert ask(app, at).status_code == 401
    assert ask(create(metrics, Admitted(None), 0.1), at, Authorization=f"Bearer {TOKEN}").status_code == 403


def test_a_command_that_nobody_confirms_is_said_to_be_open(
    metrics: MetricsCore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cogradar.services.web.views.commands.WITHIN_S", 0.2)
    monkeypatch.setattr(metrics, "command", lambda _: True)
    found = _post(create(metrics, ADMITTED, 0.1), "r", json=HALF)
    assert (found.status_code, found.json()["detail"][:38]) == (504, "no recorder confirmed it within 0 s: i")


def test_a_run_that_is_held_or_has_all_its_commands_is_not_commanded(
    metrics: MetricsCore, monkeypatch: pytest.MonkeyPatch
) -> None:
    app = create(metrics, ADMITTED, 0.1)
    metrics.store.held.add("r")
    held = _post(app, "r", json=HALF)
    assert (held.status_code, held.json()["detail"]) == (
        503,
        "run = 'r': is held, the recorder cannot write its journal",
    )
    metrics.store.held.clear()
    monkeypatch.setattr("cogradar.services.metrics.messages.MAX_COMMANDS", 2)
    assert _post(app, "r", json=HALF | {"at": 500}).status_code == 201
    monkeypatch.setattr("cogradar.services.metrics.messages.MAX_COMMANDS", 1)
    full = _post(app, "r", json=HALF)
    assert (full.status_code, full.json()["detail"]) == (409, "run = 'r': has 1 commands, which is all it can have")
    monkeypatch.setattr("cogradar.services.metrics.messages.MAX_COMMANDS", 3)
    kept = _post(app, "r", json={"action": "set strategy uniform"})
    assert (kept.status_code, kept.json()["detail"][-41:]) == (409, "; 2 more are kept for what is more urgent")


def test_a_run_that_ends_meanwhile_is_said_to_have_ended(metrics: MetricsCore, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its recorder refuses without a word to who asked."""
    monkeypatch.setattr("cogradar.services.web.views.commands.WITHIN_S", 0.0)
    answers = iter([[], [{"fault": "ended", "reason": "run = 'r': has ended already (complete)"}]])
    monkeypatch.setattr(
        "cogradar.services.web.views.commands.answer",
        lambda _, metric, __: next(answers) if metric == "refusal" else [],
    )
    found = _post(create(metrics, ADMITTED, 0.1), "r", json=HALF)
    assert (found.status_code, found.json()["detail"]) == (409, "run = 'r': has ended already (complete)")


def test_a_command_that_cannot_wait_is_refused(metrics: MetricsCore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cogradar.services.metrics.core.MAX_COMMANDS", 0)
    found = _post(create(metrics, ADMITTED, 0.1), "r", json=HALF)
    assert (found.status_code, found.json()["detail"][:36]) == (503, "too many commands wait for the recor")


def test_commanders_are_read_from_the_environment_or_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert commanders() == {}
    monkeypatch.setenv(COMMAND_VARIABLE, f"tower:{TOKEN}, deputy:{READER}")
    assert commanders() == {TOKEN: "tower", READER: "deputy"}
    monkeypatch.delenv(COMMAND_VARIABLE)
    file = tmp_path / "tokens"
    file.write_text(f"tower:{TOKEN}\n\n")
    monkeypatch.setenv(COMMAND_FILE_VARIABLE, str(file))
    assert commanders() == {TOKEN: "tower"}
    for text in ("tower", "tower:short", f":{TOKEN}", f"to wer:{TOKEN}"):
        file.write_text(text)
        with pytest.raises(BadInput, match=r"must be NAME:TOKEN"):
            commanders()
    for text, said in (
        (f"tower:{TOKEN},me:{TOKEN}", "tower and me have the same token"),
        (f"a:{READER}", "the reading token"),
    ):
        monkeypatch.setenv(TOKEN_VARIABLE, READER)
        file.write_text(text)
        with pytest.raises(BadInput, match=said) as caught:
            commanders()
        assert not {TOKEN, READER} & set(str(caught.value).split())
