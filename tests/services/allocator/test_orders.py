"""Orders at the allocator and the emulator: a waveform obeys those of its dwell, and none is made too early."""

from dataclasses import replace

import numpy as np
import pytest

from cogradar.services.allocator.core import AllocatorCore
from cogradar.services.delivery import pacing
from cogradar.services.emulator.cycle import limited, transmission
from cogradar.shared.protocol.messages import Message, RunEnd, RunStart, Scan, Waveform
from cogradar.shared.protocol.orders import (
    Accuracy,
    Action,
    DropTrack,
    EndRun,
    Look,
    Order,
    PowerLimit,
    Priority,
    SectorSearch,
    Setting,
    nu_of,
)
from cogradar.shared.protocol.roster import Roster
from cogradar.shared.signal.array import across_km, bin_centres
from cogradar.shared.signal.waveform import beampattern
from tests.services.loop import checkpoint, plans, scans, smoke_start, waveforms
from tests.services.loop import play as played
from tests.skies import sky_start, small_sky

K = 10
BEAMS = "radar.search.beams=4"


def _played(start: RunStart, *actions: Action) -> list[Message]:
    """A run with these orders from dwell K on."""
    return played(start, orders=[Order(n=n, k=K, action=action) for n, action in enumerate(actions, 1)])


def _power(sent: Waveform) -> float:
    return sent.isotropic + float(np.sum(np.abs(sent.factor) ** 2))


def _roster(sent: Scan | Waveform) -> Roster:
    assert sent.roster is not None
    return sent.roster


@pytest.mark.parametrize("start", [smoke_start(dwells=20), sky_start(dwells=20)])
def test_a_limit_holds_from_its_dwell_on_and_nothing_differs_before(start: RunStart) -> None:
    before, after = waveforms(played(start)), waveforms(_played(start, PowerLimit(share=0.25)))
    assert [one for one in after if one.k + 1 < K] == [one for one in before if one.k + 1 < K]
    for sent in after:
        assert _power(sent) == pytest.approx(0.25 if sent.k + 1 >= K else 1.0, rel=1e-5)
        assert (None if sent.orders is None else sent.orders.tolist()) == ([1] if sent.k + 1 >= K else None)


def test_no_beam_is_steered_into_a_blanked_sector_and_tracks_in_it_coast() -> None:
    said = _played(sky_start(BEAMS, dwells=30), SectorSearch(from_deg=-90, to_deg=0, search="blank"))
    lit, coasting = 0, 0
    for sent in waveforms(said):
        if sent.k + 1 < K:
            continue
        roster = _roster(sent)
        is_lit = sent.beams[:, 0] >= 0
        assert sent.nus is not None
        half_beam = 0.5 / sent.factor.shape[0]
        for nus in (roster.searched, sent.nus[is_lit]):
            assert (nus >= half_beam).all()
            assert (nus <= 0.5 - half_beam).all()  # beyond, it would be as near to -90 degrees
        assert roster.searched.size > 0
        assert _power(sent) == pytest.approx(1.0, rel=1e-5)
        lit, coasting = lit + int(is_lit.sum()), coasting + int((roster.confirmed[~is_lit] == 1).sum())
    assert coasting > 5
    assert lit > 5
    kept = next(plan for plan in plans(said) if plan.k == K and plan.nus is not None and (plan.nus < 0.0).all())
    last = max(plan.k for plan in plans(said) if plan.target == kept.target)
    assert last > K + 5  # not to be lit is no evidence that there is nothing


def test_a_look_is_one_more_beam_with_its_share() -> None:
    look = Look(bearing_deg=33.0, dwells=3, share=0.3)
    sent = {one.k + 1: one for one in waveforms(_played(sky_start(BEAMS, dwells=20), look))}
    looked = [k for k, one in sent.items() if nu_of(33.0) in _roster(one).searched]
    assert looked == [K, K + 1, K + 2]
    for k in looked:
        roster = _roster(sent[k])
        assert roster.searched.size == 5
        assert _power(sent[k]) == pytest.approx(1.0, rel=1e-5)
        column = sent[k].factor[:, -5 + int(np.searchsorted(roster.searched, nu_of(33.0)))]
        assert float(np.sum(np.abs(column) ** 2)) == pytest.approx(0.3, rel=1e-5)
    scan = next(one for one in scans(_played(sky_start(BEAMS, dwells=20), look)) if one.k == K)
    assert scan.nus is not None
    assert nu_of(33.0) in scan.nus


@pytest.mark.parametrize("value", ["uniform", "orthogonal"])
@pytest.mark.parametrize("start", [smoke_start(dwells=20), sky_start(BEAMS, dwells=20)])
def test_a_strategy_holds_from_its_dwell_on_and_planners_read_its_scans_by_it(start: RunStart, value: str) -> None:
    before, said = waveforms(played(start)), _played(start, Setting(key="strategy", value=value))
    after, isotropic = waveforms(said), 1.0 if value == "orthogonal" else 0.0
    assert [one for one in after if one.k + 1 < K] == [one for one in before if one.k + 1 < K]
    for sent in (one for one in after if one.k + 1 >= K):
        assert (sent.isotropic, sent.status) == (isotropic, "fixed")
        assert sent.orders is not None
    assert [scan.settings is not None for scan in scans(said)] == [scan.k >= K for scan in scans(said)]
    last = max(scan.k for scan in scans(said))
    asked = [plan.bins.size for plan in plans(said) if plan.k >= K and plan.confirmed is not False]
    assert max(asked) == (1 if value == "orthogonal" or start.scenario["radar"]["tracks"] != "unknown" else max(asked))
    assert sum(plan.detected for plan in plans(said) if plan.k > last - 5) > 5  # tracks go on


def test_a_rule_of_looking_acts_after_its_dwell_and_an_objective_in_it() -> None:
    said = _played(smoke_start(dwells=20), Setting(key="rule", value="mode"))
    assert [plan.n_sim > 0 for plan in plans(said) if plan.status == "tracking"] == [
        plan.k < K for plan in plans(said) if plan.status == "tracking"
    ]
    start, objective = smoke_start(dwells=20), Setting(key="objective", value="detections")
    plain, other = (
        {one.k + 1: one.factor.tobytes() for one in waveforms(said)}
        for said in (played(start), _played(start, objective))
    )
    assert min(k for k in plain if plain[k] != other[k]) == K


@pytest.mark.parametrize(("start", "most"), [(smoke_start(dwells=20), 1.001), (sky_start(BEAMS, dwells=20), 2.5)])
@pytest.mark.parametrize("weight", [4.0, 0.5])
def test_a_priority_multiplies_what_is_wanted_of_its_track_from_its_dwell_on(
    start: RunStart, most: float, weight: float
) -> None:
    """Max-min of a known number does exactly so; detections of an unknown one where power is scarce do more."""
    undisturbed = played(start)
    known = {plan.target for plan in plans(undisturbed) if plan.k == K - 2 and plan.confirmed is not False}
    first, other, *_ = sorted(known)
    said = _played(start, Priority(track=first, weight=3.0), Priority(track=first, weight=weight))
    before, after = waveforms(undisturbed), waveforms(said)
    assert [one for one in after if one.k + 1 < K] == [one for one in before if one.k + 1 < K]
    echoes = []
    for one in (next(one for one in sent if one.k + 1 == K) for sent in (before, after)):
        ids = [first, other] if one.roster is None else one.roster.ids.tolist()
        lit = bin_centres(start.scenario["radar"]["array"]["n_bin"])[one.beams] if one.nus is None else one.nus
        towards = beampattern(0.0, one.factor.astype(np.complex128), lit[:, 0])
        echoes.append(towards[ids.index(first)] / towards[ids.index(other)])
    ratio = echoes[1] / echoes[0]
    assert 0.999 <= ratio / weight <= most
    assert (ratio > 1.0) == (weight > 1.0)
    obeyed = [one.orders.tolist() for one in after if one.orders is not None]
    assert obeyed == [[2]] * len(obeyed)  # the later one
    last = max(plan.k for plan in plans(said) if plan.target == first)
    assert [one.k + 1 for one in after if one.orders is not None] == list(range(K, last + 2))


def test_an_accuracy_is_kept_and_takes_or_gives_back_what_that_needs() -> None:
    """In 18 of 19 dwells after it has settled; where power is left over others have it."""
    start, first = sky_start(BEAMS, dwells=30), 0
    undisturbed = played(start)
    usual = [across_km(*plan.in_plane) for plan in plans(undisturbed) if plan.target == first and plan.k > K]
    for km, least, most in ((0.09, 2.0, 12.0), (1.0, 0.2, 0.8)):
        said = _played(start, Accuracy(track=first, km=9.0), Accuracy(track=first, km=km))
        sent = {one.k + 1: one for one in waveforms(said)}
        assert [one for one in sent.values() if one.k + 1 < K] == [o for o in waveforms(undisturbed) if o.k + 1 < K]
        had = [across_km(*plan.in_plane) for plan in plans(said) if plan.target == first and plan.k > K]
        assert sum(one <= km for one in had) >= 18
        assert max(usual) > 0.09
        power = {k: one.shares[_roster(one).ids.tolist().index(first)].sum() for k, one in sent.items() if k > K}
        before = [one.shares[_roster(one).ids.tolist().index(first)].sum() for one in waveforms(undisturbed)[K:]]
        assert least <= np.median(list(power.values())) / np.median(before) <= most
        assert all(one.orders is not None and one.orders.tolist() == [2] for k, one in sent.items() if k >= K)
        assert all(_power(one) == pytest.approx(1.0, rel=1e-5) for one in sent.values())


def test_a_priority_ends_with_its_track_and_is_none_of_one_that_begins_later() -> None:
    start = sky_start(BEAMS, dwells=20)
    undisturbed = played(start)
    roster = _roster(scans(undisturbed)[-1])
    later = roster.ids[roster.born_k >= K - 1].tolist()
    assert later
    for order in (Priority(track=0, weight=9.0), Accuracy(track=0, km=0.01)):
        given = (order.model_copy(update={"track": m}) for m in later)
        assert waveforms(_played(start, *given)) == waveforms(undisturbed)
    first = int(roster.ids[0])
    priority, drop = Priority(track=first, weight=9.0), DropTrack(track=first)
    said = waveforms(played(start, orders=[Order(n=1, k=K, action=priority), Order(n=2, k=14, action=drop)]))
    assert {one.k + 1: one.orders.tolist() for one in said if one.orders is not None} == {
        **{k: [1] for k in range(K, 14)},
        14: [2],
    }


def test_a_track_that_is_dropped_is_gone_and_its_target_may_begin_another() -> None:
    start = sky_start(BEAMS, dwells=20)
    ids = _roster(next(one for one in scans(played(start)) if one.k == K)).ids.tolist()
    said = _played(start, DropTrack(track=ids[0]), DropTrack(track=99))
    before, at = (next(one for one in waveforms(said) if one.k + 1 == k) for k in (K - 1, K))
    assert ids[0] in _roster(before).ids
    assert ids[0] not in _roster(at).ids
    assert at.orders is not None
    assert at.orders.tolist() == [1]
    assert all(one.orders is None for one in waveforms(said) if one.k + 1 != K)
    assert max(plan.k for plan in plans(said) if plan.target == ids[0]) == K - 1
    assert max(_roster(scans(said)[-1]).ids.tolist()) > max(ids)


def test_a_track_that_begins_after_the_dwell_of_its_drop_goes_on() -> None:
    """Else it would depend on who still knows the order."""
    start = sky_start(BEAMS, dwells=20)
    undisturbed = played(start)
    roster = _roster(scans(undisturbed)[-1])
    later = roster.ids[roster.born_k >= K - 1].tolist()
    assert later
    assert waveforms(_played(start, *(DropTrack(track=m) for m in later))) == waveforms(undisturbed)


def test_a_run_ends_before_its_dwell() -> None:
    said = _played(smoke_start(dwells=40), EndRun())
    (end,) = [one for one in said if isinstance(one, RunEnd)]
    assert (end.k, end.status) == (K - 1, "complete")
    assert max(scan.k for scan in scans(said)) == K - 1


def test_the_transmitter_scales_what_is_more_than_a_limit() -> None:
    """Where dwells do not wait: an allocator that is away knows no new one."""
    asked = transmission(small_sky().radar, None)
    found = limited(replace(asked, factor=np.full((asked.factor.shape[0], 1), 0.1 + 0j)), 0.5)
    assert found.isotropic + float(np.sum(np.abs(found.factor) ** 2)) == pytest.approx(0.5)
    assert limited(asked, 1.0) is asked


def test_no_waveform_is_made_that_a_newer_order_might_shape(monkeypatch: pytest.MonkeyPatch) -> None:
    """The checkpoint that says an order was lost on its way here, and the emulator has gone on by it."""
    start = smoke_start(dwells=20)
    said = played(start)
    monkeypatch.setattr(pacing, "MAX_AHEAD_DWELLS", 4)
    core = AllocatorCore()
    core.handle(checkpoint(start))
    made = [answer for plan in plans(said) for answer in core.handle(plan)]
    assert [one.k for one in waveforms(made)] == [0, 1, 2, 3]
    order = Order(n=1, k=5, action=PowerLimit(share=0.5))
    later = core.handle(checkpoint(start, 2, 0).model_copy(update={"orders": [order]}))
    assert [(one.k, one.orders is not None) for one in waveforms(list(later))] == [(4, True), (5, True)]
