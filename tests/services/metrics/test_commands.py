"""The list of commands: which are open, which one has an id, and what the newest waveform obeys."""

import re

import numpy as np
import pytest

from cogradar.services.errors import BadInput
from cogradar.services.metrics.answers import answer
from cogradar.services.metrics.store import Store
from cogradar.services.recorder.journal import Journal
from cogradar.shared.protocol.messages import Command, Plan, Scan, Waveform
from cogradar.shared.protocol.orders import (
    Accuracy,
    Action,
    DropTrack,
    EndRun,
    Look,
    Pause,
    PowerLimit,
    Priority,
    Resume,
    SectorSearch,
    Setting,
)
from cogradar.shared.wire.codec import encode
from tests.services.loop import play, scans, waveforms
from tests.services.stored import seal
from tests.skies import sky_start

START = sky_start(dwells=20)
LOOK = Look(bearing_deg=1.0, dwells=5, share=0.1)
BLANK = SectorSearch(from_deg=-30.0, to_deg=-10.0, search="blank")


def _command(n: int, action: Action) -> Command:
    return Command(run="r", id=f"{n:032x}", by="me", action=action)


@pytest.fixture
def store() -> Store:
    journal = Journal(":memory:")
    journal.add_run(START)
    return Store(journal)


def _states(store: Store, state: str | None = "open") -> dict[int, str]:
    asked = {"run": "r"} | ({"state": state} if state else {})
    return {row["n"]: row["state"] for row in answer(store, "commands", asked)}


def test_of_many_commands_those_that_are_open_and_the_one_with_an_id_are_asked_for(store: Store) -> None:
    journal = store.journal
    for n in range(1, 1502):
        journal.add_command(_command(n, LOOK), n, 5, "")
        if n < 1500:
            journal.end_order("r", n, 10)
    journal.add_command(_command(1502, LOOK), 1502, None, "it is blanked")
    assert _states(store) == {1500: "pending", 1501: "pending"}
    assert len(_states(store, None)) == 1502
    assert [row["n"] for row in answer(store, "command", {"run": "r", "id": f"{77:032x}"})] == [77]
    assert answer(store, "command", {"run": "r", "id": f"{7777:032x}"}) == []
    plan = journal.rows("EXPLAIN QUERY PLAN SELECT * FROM command WHERE run = 'r' AND id = 'x'")
    assert "(run=? AND id=?)" in plan[0]["detail"]
    journal.give_up_unfinished()
    assert _states(store) == {}


@pytest.mark.parametrize("action", ["{bad", "[]", '{"kind": "power", "share": 9}'])
def test_a_command_that_cannot_be_read_is_named(store: Store, action: str) -> None:
    store.journal.add_command(_command(1, LOOK), 1, 5, "")
    assert [row["action"]["kind"] for row in answer(store, "orders", {"run": "r"})] == ["look"]
    store.journal.write("UPDATE command SET action = ?", action)
    seal(store.journal)
    for metric in ("commands", "orders"):
        with pytest.raises(BadInput, match="run = 'r': command 1 cannot be read: "):
            answer(store, metric, {"run": "r"})


def test_an_accuracy_that_the_newest_plan_lacks_is_not_met(store: Store) -> None:
    journal, said = store.journal, play(START)
    for n, km in enumerate((0.001, 5.0, 4.0), 1):
        journal.add_command(_command(n, Accuracy(track=n // 2, km=km)), n, 4, "")  # two of track 1, of which one counts
    for message in said:
        if isinstance(message, Scan | Plan | Waveform) and message.k < 6:
            topic, item = (type(message).__name__.lower(), message.target + 1 if isinstance(message, Plan) else 0)
            obeyed = {"orders": np.array([1, 3], np.int32)} if topic == "waveform" else {}
            journal.add_message("r", message.k, topic, item, encode(message.model_copy(update=obeyed)))
    row, *others = answer(store, "commands", {"run": "r", "state": "open"})
    assert [(one["n"], one["state"]) for one in (row, *others)] == [(1, "not met"), (3, "in force")]
    assert re.fullmatch(r"known to 0\.\d+ km across the line of sight in dwell 5", row["reason"])


def test_an_order_awaits_the_allocator_until_a_waveform_obeys_it(store: Store) -> None:
    journal = store.journal
    said = play(START)
    given: tuple[tuple[int, Action], ...] = ((3, BLANK), (4, PowerLimit(share=0.5)), (9, LOOK))
    for n, (k, action) in enumerate(given, 1):
        journal.add_command(_command(n, action), n, k, "")

    def add(sent: Scan | Waveform) -> None:
        journal.add_message("r", sent.k, "scan" if isinstance(sent, Scan) else "waveform", 0, encode(sent))

    for scan in scans(said)[:6]:
        add(scan)
    old, new = (one for one in waveforms(said) if one.k in {3, 4})
    add(old)
    assert _states(store) == {1: "awaits the allocator", 2: "in force", 3: "pending"}
    add(new.model_copy(update={"orders": np.array([1, 2], np.int32)}))
    assert _states(store) == {1: "in force", 2: "in force", 3: "pending"}


LATER: list[tuple[Action, Action, bool]] = [  # the second one ends the first, and is in force itself
    (Pause(), Resume(), False),
    (Pause(), Pause(dwells=9), True),
    (Pause(dwells=2), LOOK, True),
    (PowerLimit(share=0.5), PowerLimit(share=0.25), True),
    (PowerLimit(share=0.5), PowerLimit(share=1.0), False),
    (LOOK.model_copy(update={"dwells": 2}), LOOK, True),
    (BLANK, SectorSearch(from_deg=-40.0, to_deg=0.0, search="double"), True),
    (BLANK, SectorSearch(from_deg=-40.0, to_deg=0.0, search="normal"), False),
    (Priority(track=0, weight=4.0), Priority(track=0, weight=1.0), False),
    (Accuracy(track=0, km=1.0), Accuracy(track=0, km=None), False),
    (Setting(key="strategy", value="uniform"), Setting(key="strategy", value="power-aware"), True),
]


@pytest.mark.parametrize(("first", "second", "is_open"), LATER)
def test_an_order_that_a_later_one_replaces_is_over_from_its_dwell_on(
    store: Store, first: Action, second: Action, is_open: bool
) -> None:
    """Before the recorder notes it, some dwells later; drops and ends are open until then."""
    journal, said = store.journal, play(START)
    for n, (k, action) in enumerate(((2, first), (4, second), (2, DropTrack(track=1)), (3, EndRun())), 1):
        journal.add_command(_command(n, action), n, k, "")
    for scan, waveform in zip(scans(said)[:4], waveforms(said), strict=False):
        journal.add_message("r", scan.k, "scan", 0, encode(scan))
        obeying = waveform.model_copy(update={"orders": np.array([1, 2], np.int32)})
        journal.add_message("r", scan.k, "waveform", 0, encode(obeying))
    assert _states(store) == {1: "in force", 2: "pending", 3: "in force", 4: "in force"}
    journal.add_message("r", 4, "scan", 0, encode(scans(said)[4]))
    assert _states(store) == ({2: "in force"} if is_open else {}) | {3: "in force", 4: "in force"}
    assert _states(store, None)[1] == "over"
