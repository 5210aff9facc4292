"""Which orders are in force: a function of the dwell, whatever has been left out because it is over."""

import re
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cogradar.shared.protocol.orders import (
    Accuracy,
    Action,
    DropTrack,
    EndRun,
    Look,
    Order,
    Pause,
    PowerLimit,
    Priority,
    Resume,
    SectorSearch,
    Setting,
    accuracies,
    dropped,
    ends,
    in_force,
    is_over,
    is_paused,
    looks,
    nu_of,
    of_tracks,
    power_share,
    priorities,
    searches,
)
from cogradar.shared.protocol.words.orders import EXAMPLES, FORMS, action_of, parsed, text_of
from cogradar.shared.signal.array import steering_vector

SEARCHES: tuple[Literal["blank", "normal", "double"], ...] = ("blank", "normal", "double")
EDGES = (-90.0, -30.0, 0.0, 30.0, 90.0)
SECTORS = st.tuples(st.sampled_from(EDGES), st.sampled_from(EDGES), st.sampled_from(SEARCHES))
ACTIONS: st.SearchStrategy[Action] = st.one_of(
    st.sampled_from((0.5, 0.7, 1.0)).map(lambda share: PowerLimit(share=share)),
    SECTORS.filter(lambda s: s[0] < s[1]).map(lambda s: SectorSearch(from_deg=s[0], to_deg=s[1], search=s[2])),
    st.sampled_from(("uniform", "orthogonal")).map(lambda value: Setting(key="strategy", value=value)),
    st.tuples(st.integers(0, 1), st.sampled_from((1.0, 3.0))).map(lambda p: Priority(track=p[0], weight=p[1])),
    st.tuples(st.integers(0, 1), st.sampled_from((0.1, 3.0, None))).map(lambda p: Accuracy(track=p[0], km=p[1])),
    st.sampled_from((Pause(), Pause(dwells=3), Resume())),
    st.integers(1, 9).map(lambda dwells: Look(bearing_deg=10.0, dwells=dwells, share=0.1)),
)
GIVEN = st.lists(st.tuples(st.integers(0, 20), ACTIONS), max_size=12).map(
    lambda given: [Order(n=n, k=k, action=action) for n, (k, action) in enumerate(given, 1)]
)
NUS = np.linspace(-0.5, 0.5, 41)


@given(given_=GIVEN, k=st.integers(0, 25), later=st.integers(0, 10))
def test_orders_that_are_over_may_be_left_out(given_: list[Order], k: int, later: int) -> None:
    kept = [order for order in given_ if not is_over(order, given_, k)]
    assert in_force(kept, k + later) == in_force(given_, k + later)


@given(given_=GIVEN, k=st.integers(0, 25))
def test_what_is_in_force_is_what_all_that_has_begun_comes_to(given_: list[Order], k: int) -> None:
    """One after the other, without leaving anything out."""
    begun = sorted((order for order in given_ if order.k <= k), key=lambda order: (order.k, order.n))
    share, times, seen, paused_until = 1.0, np.ones(NUS.size, int), list[Look](), 0
    weights, wanted_km = {0: 1.0, 1: 1.0}, dict[int, float | None]()
    for order in begun:
        match order.action:
            case PowerLimit():
                share = order.action.share
            case SectorSearch():
                low, high = (nu_of(edge) for edge in (order.action.from_deg, order.action.to_deg))
                times[(low <= NUS) & (high >= NUS)] = {"blank": 0, "normal": 1, "double": 2}[order.action.search]
            case Pause():
                paused_until = order.k + (order.action.dwells or 100)
            case Resume():
                paused_until = 0
            case Priority():
                weights[order.action.track] = order.action.weight
            case Accuracy():
                wanted_km[order.action.track] = order.action.km
            case Look() if k < order.k + order.action.dwells:
                seen.append(order.action)
            case _:
                pass
    if 0 in times[[0, -1]]:  # one direction
        times[[0, -1]] = 0
    there = in_force(given_, k)
    assert power_share(there) == share
    assert {0: 1.0, 1: 1.0} | priorities(there) == weights
    assert accuracies(there) == {track: km for track, km in wanted_km.items() if km is not None}
    assert is_paused(there) == (k < paused_until)
    assert searches(there, NUS).tolist() == times.tolist()
    is_blanked = not searches(there, np.array([nu_of(10.0)]))[0]
    assert looks(there) == ([] if is_blanked else seen)


@pytest.mark.parametrize("sector", [(-90, -60), (60, 90), (-30, -10), (-90, -10)])
def test_no_beam_radiates_its_main_lobe_into_a_blanked_sector(sector: tuple[float, float]) -> None:
    """The half power of a beam is 0.44 / n_tx off its axis, and a later sector beside it changes nothing."""
    n_tx, grid = 16, np.linspace(-0.5, 0.5, 1601)
    blank = Order(n=1, k=0, action=SectorSearch(from_deg=sector[0], to_deg=sector[1], search="blank"))
    beside = Order(n=2, k=1, action=SectorSearch(from_deg=-10, to_deg=60, search="double"))
    low, high = (nu_of(edge) for edge in sector)
    kept = grid[searches([blank, beside], grid, 0.5 / n_tx) > 0]
    inside = np.linspace(low, high, 201)
    gains = np.abs(steering_vector(kept, n_tx).conj() @ steering_vector(inside, n_tx).T / n_tx) ** 2
    edge_gain = np.abs(steering_vector(0.5 / n_tx, n_tx).sum() / n_tx) ** 2  # 0.41
    assert gains.max() <= edge_gain + 1e-9
    assert kept.size > 100
    assert searches([blank], np.array([-0.5, 0.5])).tolist() == ([1, 1] if abs(low) + abs(high) < 0.5 else [0, 0])


def test_a_track_ends_and_a_run_ends_at_their_dwells() -> None:
    """A track only if it is in the roster of the dwell before: one that begins later is none of the order's."""
    orders = [Order(n=3, k=7, action=DropTrack(track=4)), Order(n=4, k=9, action=EndRun())]
    assert [dropped(orders, k, {4: 5}) for k in (6, 7, 8)] == [{}, {4: 3}, {4: 3}]
    assert [dropped(orders, k, {3: 0, 4: 6}) for k in (7, 8)] == [{}, {}]
    wanted = [Order(n=1, k=7, action=Priority(track=4, weight=2.0))]
    assert [born_ks for born_ks in ({4: 5}, {4: 6}, {3: 0}, None) if of_tracks(wanted, born_ks)] == [{4: 5}, None]
    assert [ends(orders, k) for k in (8, 9)] == [False, True]
    assert in_force(orders, 20) == []


@pytest.mark.parametrize(
    ("text", "action"),
    [
        ("power 0.25", PowerLimit(share=0.25)),
        ("sector blank -20.5 10", SectorSearch(from_deg=-20.5, to_deg=10, search="blank")),
        ("look 12.123456789 20 0.2", Look(bearing_deg=12.123456789, dwells=20, share=0.2)),
        ("drop 3", DropTrack(track=2)),
        ("priority 3 2.5", Priority(track=2, weight=2.5)),
        ("accuracy 3 0.05", Accuracy(track=2, km=0.05)),
        ("accuracy 3 none", Accuracy(track=2, km=None)),
        ("set rule mode", Setting(key="rule", value="mode")),
        ("pause", Pause()),
        ("pause 20", Pause(dwells=20)),
        ("resume", Resume()),
        ("end", EndRun()),
    ],
)
def test_actions_are_shown_as_they_are_written(text: str, action: Action) -> None:
    assert parsed(text.split()) == action
    assert text_of(action) == text


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", "action = '': must be one of power SHARE; sector blank|normal|double FROM TO; "),
        ("pow 0.5", "action = 'pow': must be one of power SHARE"),
        ("power", "power: must be power SHARE"),
        ("power half", "share = half: must be a number"),
        ("power 0", "share = 0.0: must be a number >= 0.01 and <= 1.0"),
        ("power nan", "share = nan: must be"),
        ("sector shut -20 10", "search = 'shut': must be"),
        ("sector blank 10 -20", "from_deg must be below to_deg"),
        ("look 95 20 0.2", "bearing_deg = 95.0: must be"),
        ("drop 0", "track = 0: must be >= 1"),
        ("drop 1.5", "track = 1.5: must be a whole number"),
        ("pause 1.5", "dwells = 1.5: must be a whole number"),
        ("power 50%", "share = 50%: must be a number (did you mean 0.5?)"),
        ("power x%", "share = x%: must be a number"),
        ("priority 3 11", "weight = 11.0: must be a number >= 0.1 and <= 10.0"),
        ("priority 0 2", "track = 0: must be >= 1"),
        ("accuracy 3 0", "km = 0.0: must be a number >= 0.001 and <= 100.0"),
        ("accuracy 3 any", "km = any: must be a number"),
        ("accuracy none 3", "track = none: must be a whole number"),
        ("set rule oracle", "rule must be one of pomcp, mode, "),
        ("set belief gaussian", "key = 'belief': must be"),
        ("set strategy", "set strategy: must be set strategy|rule|objective VALUE"),
        ("pause 0", "dwells = 0: must be"),
        ("pause 2 3", "pause 2 3: must be pause [DWELLS]"),
        ("resume 2", "resume 2: must be resume"),
    ],
)
def test_what_is_no_action_is_refused(text: str, fault: str) -> None:
    with pytest.raises(ValueError, match=re.escape(fault)):
        parsed(text.split())


@pytest.mark.parametrize("kind", EXAMPLES)
def test_a_refused_action_comes_with_its_form_and_an_example_that_is_one(kind: str) -> None:
    """An accuracy of 0 km was refused without a word of `none`."""
    example, form = EXAMPLES[kind], FORMS[kind][1]
    parsed(example.partition(" (")[0].split())
    for wrong in (f"{kind} " + " ".join(["x"] * len(FORMS[kind][2])), f"{kind} 1 2 3 4"):
        with pytest.raises(ValueError, match=re.escape(form)) as caught:
            parsed(wrong.split())
        assert str(caught.value).endswith(f"{form}, as in {example}")


@pytest.mark.parametrize("document", [{}, {"kind": "power"}, {"kind": "drop", "track": True}, {"kind": "end", "k": 1}])
def test_a_document_must_be_one_of_them(document: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="must be"):
        action_of(document)
