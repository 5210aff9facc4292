"""Which tracks there are after a dwell, where nobody knows how many targets."""

from typing import Any

import numpy as np
import pytest

from cogradar.services.allocator.core import AllocatorCore
from cogradar.services.allocator.track_update import expected, updated
from cogradar.services.allocator.tracks import FoundTracks
from cogradar.services.allocator.waveform import waveform
from cogradar.services.delivery.pacing import COASTED_S
from cogradar.services.delivery.resend import MAX_DWELLS
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Plan, Scan, Waveform
from cogradar.shared.protocol.roster import Roster, no_tracks
from cogradar.shared.scenario.radar_config import RadarConfig, Strategy
from cogradar.shared.signal.array import angle_bin, bin_centres
from cogradar.shared.tracking.motion import Motion, propagate_into
from tests.services.loop import checkpoint
from tests.skies import sky_start, small_sky

RADAR = small_sky().radar
ROW = {"statistic": 60.0, "alpha_hat": 0.1, "sigma_hat": 0.02, "signature_power": 50.0, "limits": 25.0}


def _scan(*rows: tuple[float, float], roster: Roster | None = None, **changed: Any) -> Scan:
    """Rows by direction and range; no track was lit."""
    nus = np.array([nu for nu, _ in rows])
    n, m = nus.size, 0 if roster is None else roster.ids.size
    columns: dict[str, Any] = {name: np.full(n, value) for name, value in (ROW | changed).items()}
    return Scan(
        run="r",
        k=5,
        t=6,
        bins=angle_bin(nus, RADAR.array.n_bin).astype(np.int32),
        **columns | {"alpha_hat": columns["alpha_hat"].astype(np.complex64)},
        beams=np.full((m, 1), -1, np.int32),
        nus=nus,
        ranges_km=np.array([range_km for _, range_km in rows]),
        nu_hats=nus,
        nu_sigmas=np.full(n, 0.003),
        beam_nus=np.zeros((m, 1)),
        gates=np.zeros((m, 2)),
        roster=no_tracks() if roster is None else roster,
    )


def _roster(*ids: int) -> Roster:
    n = len(ids)
    return no_tracks().model_copy(
        update={
            "ids": np.array(ids, np.int32),
            "next_id": max(ids) + 3,
            "confirmed": np.ones(n, np.int32),
            "born_k": np.arange(n, dtype=np.int32),
            "expected": np.tile([0.0, 0.0, 0.0, 0.0, 0.99], (n, 1)),
        }
    )


def _plan(target: int, nu: float, range_km: float, vx: float = 0.1, **changed: Any) -> Plan:
    state = np.array([range_km * np.sqrt(1.0 - 4.0 * nu * nu), vx, 2.0 * nu * range_km, 0.0])
    bins = angle_bin(np.array([nu]), RADAR.array.n_bin).astype(np.int32)
    fields: dict[str, Any] = {
        "run": "r",
        "k": 5,
        "t": 6,
        "target": target,
        "status": "tracking",
        "bins": bins,
        "chances": np.ones(1),
        "best_bin": int(bins[0]),
        "worth": 1.0,
        "gain": 1e3,
        "range_km": range_km,
        "estimate": state,
        "covariance": np.diag([0.02, 0.0004] * 2),
        "nus": np.array([nu]),
        "gate": np.array([range_km - 1.0, range_km + 1.0]),
        "existence": 0.999,
        "confirmed": True,
        "in_doubt": False,
    }
    return Plan(**fields | changed)


def _waveform(scan: Scan, *plans: Plan, radar: RadarConfig = RADAR) -> Waveform:
    assert scan.roster is not None
    return waveform(radar, Strategy.POWER_AWARE, updated(radar, scan, scan.roster, plans))


def _roster_of(sent: Waveform) -> Roster:
    assert sent.roster is not None
    return sent.roster


def test_what_no_track_explains_begins_one_which_is_looked_at_at_once() -> None:
    expected = np.array([[0.1, 0.001, 60.2, 0.1, 0.99], [-0.4, 0.001, 30.0, 0.1, 0.99]])
    known = _roster(2, 4).model_copy(update={"expected": expected})
    scan = _scan((-0.2, 40.25), (0.1, 60.25), (0.3, 80.25), roster=known, limits=25.0)
    scan = scan.model_copy(update={"alpha_hat": np.array([0.072, 0.1, 0.1], np.complex64)})
    sent = _waveform(scan, _plan(2, 0.1, 60.0), _plan(4, -0.4, 30.0))
    roster = _roster_of(sent)
    assert roster.ids.tolist() == [2, 4, 7, 8]  # 5 and 6 have ended before
    assert roster.next_id == 9
    assert roster.born_k.tolist() == [0, 1, 5, 5]
    assert roster.confirmed.tolist() == [1, 1, 0, 1]  # one that hardly passes its limit is tentative
    assert sorted(zip(roster.births[:, 0], roster.births[:, 2], strict=True)) == [(-0.2, 40.25), (0.3, 80.25)]
    assert (sent.beams[:, 0] >= 0).all()
    assert sent.gates is not None
    low, high = sent.gates[2]
    assert low < roster.births[0, 2] < high
    power = float(np.sum(np.abs(sent.factor) ** 2))
    assert power == pytest.approx(RADAR.array.power, rel=1e-5)
    assert sent.shares.sum() + roster.search_share == pytest.approx(RADAR.array.power)


def test_a_track_that_the_scan_does_not_know_yet_is_not_born_again() -> None:
    """Where dwells are lost, the roster has gone on without the scan."""
    scan = _scan((0.1, 60.25), (0.3, 80.25), roster=no_tracks())
    update = updated(RADAR, scan, _roster(7), [_plan(7, 0.1, 60.25)])
    assert [plan.target for plan in update.plans] == [7, 10]
    assert update.births[:, 2].tolist() == [80.25]


def test_one_echo_in_neighbouring_cells_begins_one_track_and_the_strongest_come_first() -> None:
    scan = _scan((0.1, 60.25), (0.12, 60.25), (0.3, 80.25))
    scan = scan.model_copy(update={"statistic": np.array([60.0, 90.0, 70.0])})
    roster = _roster_of(_waveform(scan))
    assert roster.births[:, 0].tolist() == [0.12, 0.3]
    few = RADAR.model_copy(update={"max_tracks": 1})
    assert _roster_of(_waveform(scan, radar=few)).births[:, 0].tolist() == [0.12]


def test_what_is_below_its_limit_begins_nothing() -> None:
    roster = _roster_of(_waveform(_scan((0.1, 60.25), limits=61.0)))
    assert roster.ids.size == 0
    assert roster.search_share == RADAR.array.power


def test_a_track_that_has_ended_leaves_and_its_number_is_not_used_again() -> None:
    ended = Plan(run="r", k=5, t=6, target=4, status="ended", existence=0.001, confirmed=True, in_doubt=False)
    scan = _scan((0.1, 60.25), roster=_roster(2, 4))
    roster = _roster_of(_waveform(scan, _plan(2, -0.3, 60.0), ended))
    assert roster.ids.tolist() == [2, 7]


@pytest.mark.parametrize(
    ("other", "left"),
    [
        ({}, [1, 7]),  # both confirmed: the older one stays
        ({"confirmed": False}, [1, 7]),
        ({"vx": -0.1}, [1, 2, 7]),  # two that meet
    ],
)
def test_of_two_tracks_of_one_target_one_ends(other: dict[str, Any], left: list[int]) -> None:
    scan = _scan((0.3, 20.25), roster=_roster(1, 2, 4))
    ended = Plan(run="r", k=5, t=6, target=4, status="ended", existence=0.001, confirmed=True, in_doubt=False)
    roster = _roster_of(_waveform(scan, _plan(1, 0.1, 60.0), _plan(2, 0.1005, 60.1, **other), ended))
    assert roster.ids.tolist() == left


@pytest.mark.parametrize(("range_km", "left"), [(60.1, [1, 7]), (64.0, [1, 2, 7])])
def test_tracks_of_one_echo_at_both_ends_are_one(range_km: float, left: list[int]) -> None:
    """The array hears one direction there: a second track had no detection of its own, was hidden, and never ended."""
    scan = _scan((0.3, 20.25), roster=_roster(1, 2, 4))
    ended = Plan(run="r", k=5, t=6, target=4, status="ended", existence=0.001, confirmed=True, in_doubt=False)
    roster = _roster_of(_waveform(scan, _plan(1, 0.4997, 60.0), _plan(2, -0.4997, range_km), ended))
    assert roster.ids.tolist() == left


def test_a_tentative_track_gives_way_to_a_younger_one_that_is_confirmed() -> None:
    scan = _scan((0.3, 20.25), roster=_roster(1, 2), limits=99.0)
    roster = _roster_of(_waveform(scan, _plan(1, 0.1, 60.0, confirmed=False), _plan(2, 0.1, 60.0)))
    assert roster.ids.tolist() == [2]


@pytest.mark.parametrize(("lost", "left"), [([], [2]), ([0.1], [2]), ([0.1, 0.105], [1, 2]), ([0.105, 0.3], [2])])
def test_two_tracks_are_not_compared_while_the_looks_of_neither_are_measured(
    lost: list[float], left: list[int]
) -> None:
    """What else the scan holds says nothing of them."""
    nus = np.array([0.1, 0.105, 0.3])
    kept = [(nu, 60.0) for nu in nus.tolist() if nu not in lost]
    beams = angle_bin(nus[:2], RADAR.array.n_bin).astype(np.int32)[:, np.newaxis]
    asked = {"beams": beams, "beam_nus": nus[:2, np.newaxis], "unmeasured": np.array(lost) if lost else None}
    scan = _scan(*kept, roster=_roster(1, 2), statistic=1.0).model_copy(update=asked)
    roster = _roster_of(_waveform(scan, _plan(1, 0.1, 60.0, confirmed=False), _plan(2, 0.1, 60.0)))
    assert roster.ids.tolist() == left


def test_where_a_track_is_expected_is_where_its_particles_will_be() -> None:
    """Against a cloud of particles that is moved one by one."""
    plan = _plan(3, 0.2, 50.0, covariance=np.diag([0.3, 0.0004, 0.5, 0.0002]))
    rng = np.random.default_rng(1)
    particles = rng.multivariate_normal(plan.estimate, plan.covariance, 200_000)
    propagate_into(particles, Motion(RADAR.motion.dt_s, RADAR.motion.sigma_s_km_s2), rng, particles)
    ranges = np.hypot(particles[:, 0], particles[:, 2])
    nus = 0.5 * particles[:, 2] / ranges
    (found,) = expected(RADAR, [plan], 6)
    assert found == pytest.approx((nus.mean(), nus.std(), ranges.mean(), ranges.std()), rel=0.01)


def test_in_real_time_a_track_whose_planner_is_late_is_looked_at_where_it_will_be() -> None:
    """Also one that has just begun; one of which nothing was heard for long ends."""
    rate_hz = 2.0
    core, start = AllocatorCore(), sky_start().model_copy(update={"rate_hz": rate_hz})
    core.handle(checkpoint(start))
    everywhere = [(nu, 20.25) for nu in bin_centres(RADAR.array.n_bin).tolist()]
    loud = np.where(np.arange(RADAR.array.n_bin) == 11, 99.0, 1.0)
    (first,) = core.handle(_scan(*everywhere).model_copy(update={"k": 0, "t": 1, "statistic": loud}))
    assert isinstance(first, Waveform)
    born = _roster_of(first)
    assert (born.ids.tolist(), first.late.tolist()) == ([0], [0])
    seen, now_s = [first], 0.0
    for k in range(1, round(rate_hz * COASTED_S) + 4):
        roster = _roster_of(seen[-1])
        scan = _scan(*everywhere, roster=roster, limits=99.0).model_copy(update={"k": k, "t": k + 1})
        assert not core.handle(scan) or not roster.ids.size
        if not roster.ids.size:
            break
        core.handle(Tick(now_s))
        now_s += 1.0 / rate_hz
        (answer,) = core.handle(Tick(now_s))
        assert isinstance(answer, Waveform)
        assert answer.k == k
        seen.append(answer)
    assert [sent.late.tolist() for sent in seen[1:-1]] == [[k] for k in range(1, len(seen) - 1)]  # its age in dwells
    assert seen[-1].late.tolist() == []
    assert seen[-1].k == round(rate_hz * COASTED_S) + 1


def _live() -> AllocatorCore:
    """An allocator in real time that knows nothing but the run."""
    core = AllocatorCore()
    core.handle(checkpoint(sky_start().model_copy(update={"rate_hz": 2.0})))
    return core


def _of_dwell(k: int, *detections: tuple[float, float], roster: Roster | None = None) -> Scan:
    """All bins without one, and the detections."""
    empty = [(nu, 20.25) for nu in bin_centres(RADAR.array.n_bin).tolist()]
    rows = sorted([*empty, *detections])
    found = np.array([60.0 if row in detections else 1.0 for row in rows])
    return _scan(*rows, roster=roster).model_copy(update={"k": k, "t": k + 1, "statistic": found})


def _ids(core: AllocatorCore, scan: Scan) -> list[int]:
    (answer,) = core.handle(scan)
    assert isinstance(answer, Waveform)
    return [int(m) for m in _roster_of(answer).ids]


def test_in_real_time_an_allocator_that_comes_back_uses_no_number_again() -> None:
    """What its predecessor said last comes late to the front end: no scan had it, and then one has."""
    before, after = _live(), _live()
    assert _ids(before, _of_dwell(0, (0.1, 60.25))) == [0]
    (late,) = before.handle(_of_dwell(1, (0.3, 80.25), roster=no_tracks()))
    assert isinstance(late, Waveform)
    assert _roster_of(late).next_id == 2
    (first,) = after.handle(_of_dwell(2, (-0.2, 40.25)))
    assert isinstance(first, Waveform)
    assert _roster_of(first).ids.size == 0  # none begins before it is heard
    assert (late.begins_none, first.begins_none) == (None, True)
    (second,) = after.handle(_of_dwell(3, roster=no_tracks().model_copy(update={"next_id": 2})))
    assert isinstance(second, Waveform)
    (third,) = after.handle(_of_dwell(4, (-0.2, 40.25), (-0.4, 70.25), roster=_roster_of(second)))
    assert isinstance(third, Waveform)
    assert (_roster_of(third).ids.tolist(), third.begins_none) == ([2, 3], None)


def test_in_real_time_the_radar_may_have_been_away_for_more_dwells_than_are_kept() -> None:
    core = _live()
    assert _ids(core, _of_dwell(0, (0.1, 60.25))) == [0]
    (late,) = core.handle(_of_dwell(MAX_DWELLS + 9, roster=no_tracks()))
    assert isinstance(late, Waveform)
    assert late.k == MAX_DWELLS + 9
    core.validate()


def test_in_real_time_an_old_scan_that_is_sent_again_does_not_set_numbers_back() -> None:
    """It comes first to an allocator that is back; the others have gone on, with tracks that it does not know."""
    core = _live()
    assert _ids(core, _of_dwell(0, (0.1, 60.25))) == [0]
    alive = _roster(3, 5)
    assert core.handle(_of_dwell(40, (0.3, 80.25), roster=alive)) == ()
    said: dict[str, Any] = {"k": 40, "t": 41, "in_doubt": False, "modes": np.array([0.8, 0.1, 0.1])}
    (answer,) = [one for m in (3, 5) for one in core.handle(_plan(m, 0.1 - 0.1 * m, 60.0, **said))]
    assert isinstance(answer, Waveform)
    old, new = _roster_of(answer).ids.tolist()[:2], _roster_of(answer).ids.tolist()[2:]
    assert old == [3, 5]
    assert len(new) == 1
    assert new[0] >= alive.next_id


@pytest.mark.parametrize("rate_hz", [0.0, 2.0])
def test_nothing_is_kept_of_tracks_that_have_ended(rate_hz: float) -> None:
    core, start = AllocatorCore(), sky_start(dwells=1000).model_copy(update={"rate_hz": rate_hz})
    core.handle(checkpoint(start))
    roster, judged = no_tracks(), {"existence": 0.0, "confirmed": False, "in_doubt": False, "modes": np.eye(3)[0]}
    for k in range(200):
        answers = list(core.handle(_of_dwell(k, (0.1, 60.25), roster=roster)))
        for m in roster.ids.tolist():  # each of them ends at once
            answers += core.handle(Plan(run="r", k=k, t=k + 1, target=m, status="ended", **judged))
        (answer,) = answers
        assert isinstance(answer, Waveform)
        roster = _roster_of(answer)
        core.validate()
    (run,) = core._runs.values()
    assert roster.next_id > 50
    assert isinstance(run.tracks, FoundTracks)
    assert len(run.tracks._last_sent.planned) <= len(roster.ids)


def test_it_is_the_same_whoever_computes_it() -> None:
    scan = _scan((-0.2, 40.25), (0.3, 80.25), roster=_roster(2))
    assert scan.roster is not None
    made = [updated(RADAR, scan, scan.roster, [_plan(2, 0.1, 60.0)]) for _ in range(2)]
    assert made[0].births.tobytes() == made[1].births.tobytes()
    assert made[0].plans == made[1].plans
