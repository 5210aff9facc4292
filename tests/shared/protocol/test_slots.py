"""Names that limit a planner to some of the tracks."""

import pytest

from cogradar.shared.protocol.slots import fault_of_name, may_plan, slots_in, slots_of


@pytest.mark.parametrize(
    ("name", "tracks"),
    [("p", range(40)), ("p@0-15", range(40)), ("p@3-4", [3, 4, 19, 20, 35, 36]), ("p@15-15", [15, 31]), ("p@4-3", [])],
)
def test_tracks_of_a_planner(name: str, tracks: range | list[int]) -> None:
    assert [m for m in range(40) if may_plan(name, m)] == list(tracks)


@pytest.mark.parametrize("slots", ["", "3", "0-16", "00-3", "0-03", "-1-3", "0-\u0663", "0-7@0-7", "0-7 ", "a-b", "*"])
def test_nonsense_is_no_slot(slots: str) -> None:
    assert not slots_in(slots)
    assert slots_of(f"p@{slots}") == slots


@pytest.mark.parametrize(
    ("name", "role", "said"),
    [
        ("p@0-7", "planner", None),
        ("planner.a_b-1", "recorder", None),
        ("", "planner", "1 to 64 letters"),
        ("@0-7", "planner", "1 to 64 letters"),
        ("p@", "planner", "@FIRST-LAST behind them"),
        ("p@0-100", "planner", "@FIRST-LAST behind them"),
        ("p@7-3", "planner", "slots, FIRST-LAST of 0-15"),
        ("r@0-7", "recorder", "slots, FIRST-LAST of 0-15"),
        ("p" * 65, "planner", "1 to 64 letters"),
    ],
)
def test_faults_of_names(name: str, role: str, said: str | None) -> None:
    found = fault_of_name(name, role)
    assert found is None if said is None else said in str(found)
