import numpy as np
import pytest
from numpy.random import Generator
from numpy.typing import NDArray

from cogradar.services.delivery.pacing import MAX_AHEAD_DWELLS
from cogradar.services.delivery.resend import MAX_DWELLS
from cogradar.services.emulator.core import EmulatorCore
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.protocol.events import Tick
from cogradar.shared.protocol.messages import Message, RunEnd, Scan, Truth, Waveform
from cogradar.shared.protocol.orders import PAUSED, Order, Pause
from cogradar.shared.protocol.recovery import History, WaveformRecall
from cogradar.shared.protocol.roster import no_tracks
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.wire.codec import encode
from cogradar.shared.world import scene
from cogradar.shared.world.disturbance import draw
from tests.services.loop import SMOKE, checkpoint, play, scans, smoke_begin, smoke_start, waveforms
from tests.skies import sky_start


def _waveform(k: int, tracking: bool, isotropic: float = 1.0, beams: tuple[int, ...] = (3, 12)) -> Waveform:
    factor = np.ones((SMOKE.radar.array.n_tx, 0 if isotropic else 1), dtype=np.complex64) / np.float32(4)
    return Waveform(
        run="r",
        k=k,
        tracking=tracking,
        isotropic=isotropic,
        factor=factor,
        beams=np.array(beams if tracking else (-1, -1), dtype=np.int32)[:, np.newaxis],
        shares=np.zeros((len(beams), 1)),
        status="fixed",
        late=np.zeros(len(beams), dtype=np.int32),
    )


@pytest.fixture(scope="module")
def said() -> list[Message]:
    return play(smoke_start(dwells=6))


def _truths(said: list[Message]) -> list[Message]:
    return [message for message in said if isinstance(message, Truth)]


def test_a_run_begins_with_a_scan_of_every_cell() -> None:
    scan, truth = EmulatorCore(SimulatedFrontEnd.open).handle(smoke_begin())
    assert isinstance(truth, Truth)
    assert isinstance(scan, Scan)
    assert (scan.k, scan.t, truth.k, truth.t) == (0, 0, 0, 0)
    assert scan.bins.tolist() == list(range(SMOKE.radar.array.n_bin))
    assert np.array_equal(truth.states, SMOKE.simulated.initial_states())
    # Orthogonal waveform: a^T R a^* = P, times n_rx (||v||^2 = n_rx a^T R a^*).
    assert np.allclose(scan.signature_power, SMOKE.radar.array.power * SMOKE.radar.array.n_rx)


def test_targets_stand_still_during_acquisition_and_fly_afterwards() -> None:
    core = EmulatorCore(SimulatedFrontEnd.open)
    core.handle(smoke_begin())
    _, still = core.handle(_waveform(0, tracking=False))
    scan, moved = core.handle(_waveform(1, tracking=True))
    assert isinstance(still, Truth)
    assert isinstance(moved, Truth)
    assert isinstance(scan, Scan)
    assert (still.k, still.t, moved.k, moved.t, scan.t) == (1, 0, 2, 1, 1)
    assert np.array_equal(still.states, SMOKE.simulated.initial_states())
    drift = moved.states[:, [0, 2]] - still.states[:, [0, 2]] - still.states[:, [1, 3]] * SMOKE.radar.motion.dt_s
    assert np.all(np.abs(drift) < 6 * 0.5 * SMOKE.radar.motion.sigma_s_km_s2)  # G w, 6 sigma
    assert np.any(drift != 0)


def test_beams_let_only_their_own_cells_be_tested() -> None:
    core = EmulatorCore(SimulatedFrontEnd.open)
    core.handle(smoke_begin())
    scan, _ = core.handle(_waveform(0, tracking=True, isotropic=0.0, beams=(9, 4)))
    assert isinstance(scan, Scan)
    assert scan.bins.tolist() == [4, 9]
    assert scan.beams.tolist() == [[9], [4]]


def test_a_repeated_waveform_changes_nothing_and_an_early_one_waits() -> None:
    core = EmulatorCore(SimulatedFrontEnd.open)
    core.handle(smoke_begin())
    core.handle(_waveform(0, tracking=True))
    assert core.handle(_waveform(0, tracking=True)) == []
    assert core.handle(_waveform(2, tracking=True)) == []
    assert [m.k for m in core.handle(_waveform(1, tracking=True)) if isinstance(m, Scan)] == [2, 3]


def test_what_is_not_acknowledged_is_resent_when_the_recorder_asks() -> None:
    core, start = EmulatorCore(SimulatedFrontEnd.open), smoke_start()
    said = [*core.handle(checkpoint(start))]
    said += [m for k in range(3) for m in core.handle(_waveform(k, tracking=True))]
    assert core.handle(checkpoint(start, 2)) == []
    assert core.handle(checkpoint(start, 2, resend=True)) == []
    assert core.has_deferred
    assert core.handle(Tick(0.0, drained=False)) == []  # it may have been sent just now
    assert core.handle(Tick(0.0)) == said[4:]
    assert core.handle(Tick(0.0)) == []
    core.handle(checkpoint(start, 2, resend=True))
    core.handle(checkpoint(start, 2))  # for who joins
    assert core.handle(Tick(0.0, drained=False)) == []
    core.handle(checkpoint(start, 2, resend=True))  # all is handled that had waited when it was asked first
    assert core.handle(Tick(0.0, drained=False)) == said[4:]
    core.handle(checkpoint(start, 2, resend=True))
    core.handle(checkpoint(start, 3))  # meanwhile it has come
    assert core.handle(Tick(0.0)) == []


def test_an_emulator_that_comes_back_begins_at_the_checkpoint(said: list[Message]) -> None:
    """It asks for the waveform that lit up the first dwell that is not stored, and says the rest as it was said."""
    start, sent = smoke_start(dwells=6), waveforms(said)
    middle = next(scan for scan in scans(said) if scan.t == 3)
    core = EmulatorCore(SimulatedFrontEnd.open)
    assert core.handle(checkpoint(start, middle.k, 2)) == [WaveformRecall(run="r", k=middle.k - 1)]
    history = History(run="r", to="emulator", topic="waveform", k=middle.k - 1, payloads=[encode(sent[middle.k - 1])])
    again = [*core.handle(history)]
    for waveform in sent[middle.k :]:
        again += core.handle(waveform)
    expected = [m for m in said if isinstance(m, Scan | Truth | RunEnd) and m.k >= middle.k]
    assert [encode(m) for m in again] == [encode(m) for m in expected]


def test_the_run_is_never_further_ahead_of_the_store_than_others_keep() -> None:
    core, start = EmulatorCore(SimulatedFrontEnd.open), smoke_start(dwells=2 * MAX_AHEAD_DWELLS)
    received = [*core.handle(checkpoint(start))]
    for k in range(MAX_AHEAD_DWELLS + 10):
        received += core.handle(_waveform(k, tracking=True))
    assert getattr(received[-1], "k", None) == MAX_AHEAD_DWELLS - 1
    assert MAX_DWELLS > MAX_AHEAD_DWELLS
    more = core.handle(checkpoint(start, 5, 5))
    assert [m.k for m in more if isinstance(m, Scan)] == [*range(MAX_AHEAD_DWELLS, MAX_AHEAD_DWELLS + 5)]


def test_in_real_time_the_radar_searches_before_anybody_has_told_it_of_tracks_and_waits_once_somebody_has() -> None:
    """Where nobody knows how many targets there are: one that comes back must not forget the tracks there are."""
    start = sky_start(dwells=6)
    (first, *_) = waveforms(play(sky_start(dwells=2)))
    start = start.model_copy(update={"rate_hz": 1.0})
    core = EmulatorCore(SimulatedFrontEnd.open)
    assert list(core.handle(checkpoint(start))) == []
    said = [answer for now_s in range(3) for answer in core.handle(Tick(float(now_s)))]
    assert [(scan.k, scan.t, scan.roster) for scan in scans(said)] == [(k, k + 1, no_tracks()) for k in range(3)]
    assert all(scan.bins.size == SMOKE.radar.array.n_bin for scan in scans(said))
    assert list(core.handle(first)) == []
    (told,) = scans(list(core.handle(Tick(3.0))))
    assert (told.t, told.roster) == (4, first.roster)
    back = EmulatorCore(SimulatedFrontEnd.open)
    assert list(back.handle(checkpoint(start, 4, 4))) == [WaveformRecall(run="r", k=3)]
    assert list(back.handle(Tick(4.0))) == []
    back.handle(first)
    (again,) = scans(list(back.handle(Tick(5.0))))
    assert (again.k, again.t, again.roster) == (4, 5, first.roster)


@pytest.mark.parametrize("receiver_s", [0.01, 0.25])
def test_after_a_receiver_that_is_too_slow_a_dwell_waits_for_the_waveform_of_the_one_before(receiver_s: float) -> None:
    """At 10 Hz, with answers 30 ms after their scans: it radiated each dwell at once, with the waveform before."""
    core, now_s, answers = EmulatorCore(SimulatedFrontEnd.open), 0.0, list[tuple[float, Waveform]]()
    core.handle(checkpoint(smoke_start(dwells=1000).model_copy(update={"rate_hz": 10.0})))
    core.handle(_waveform(0, tracking=True))
    sent = list[tuple[float, Scan]]()
    while now_s < 8.0 and len(sent) < 25:
        now_s += 0.005
        for at_s, answer in answers:
            if at_s <= now_s:
                core.handle(answer)
        answers = [one for one in answers if one[0] > now_s]
        if core.has_deferred or (core.wake_s or 0.0) <= now_s:
            for scan in scans(list(core.handle(Tick(now_s)))):
                now_s += receiver_s
                sent.append((now_s, scan))
                answers.append((now_s + 0.03, _waveform(scan.k, tracking=True)))
    tracked = [scan for _, scan in sent][3:]
    assert {scan.waveform_k for scan in tracked} == {None}, "each is of the waveform of the dwell before"
    gaps_s = np.diff([at_s for at_s, _ in sent])[3:]
    assert gaps_s.max() < max(0.1, receiver_s + 0.03) + 0.02
    for _ in range(8):  # nobody answers any more
        now_s += 0.25
        core.handle(Tick(now_s))
    assert all(scans(list(core.handle(Tick(now_s + 0.25 * i)))) for i in range(1, 9))


def test_a_pause_of_some_dwells_is_over_after_so_many_also_while_targets_are_acquired() -> None:
    """In real time each took five seconds: a dwell of the acquisition that measures nothing is no dwell."""
    core, order = EmulatorCore(SimulatedFrontEnd.open), Order(n=1, k=1, action=Pause(dwells=3))
    begun = checkpoint(smoke_start(dwells=30).model_copy(update={"rate_hz": 10.0}))
    core.handle(begun.model_copy(update={"orders": [order]}))
    found = [scan for i in range(12) for scan in scans(list(core.handle(Tick(0.1 * i))))]
    assert [scan.k for scan in found] == list(range(12))
    assert [scan.k for scan in found if not scan.bins.size] == [1, 2, 3]
    assert {scan.fault for scan in found if not scan.bins.size} == {PAUSED}


def test_in_real_time_an_emulator_that_comes_back_goes_on_with_the_dwell_that_is_due(said: list[Message]) -> None:
    """Others may know scans that the journal has not acknowledged; a dwell that is measured again would be another.

    It says which dwells never happened, or the tracks would wait for their scans.
    """
    start = smoke_start(dwells=60).model_copy(update={"rate_hz": 1.0})
    core = EmulatorCore(SimulatedFrontEnd.open)
    assert core.handle(checkpoint(start, 4, 1, newest_k=6, due_k=9)) == [WaveformRecall(run="r", k=8)]
    assert core.handle(waveforms(said)[-1].model_copy(update={"k": 3})) == []
    (scan,) = scans(list(core.handle(Tick(0.0))))
    assert (scan.k, scan.t, scan.waveform_k, scan.skipped) == (9, 7, 3, 2)


def test_an_emulator_goes_on_behind_the_acquisition_though_only_a_part_of_that_is_acknowledged() -> None:
    """It began the acquisition once more; only an allocator that had gone ahead by its clock kept it from that."""
    core, start = EmulatorCore(SimulatedFrontEnd.open), smoke_start(dwells=50).model_copy(update={"rate_hz": 10.0})
    core.handle(checkpoint(start, 1, 0, newest_k=6, newest_t=4, due_k=9))
    core.handle(_waveform(8, tracking=True))
    (scan,) = scans(list(core.handle(Tick(0.0))))
    assert (scan.k, scan.t, scan.skipped) == (9, 7, 2)


def test_the_acquisition_has_no_dwell_to_spare_when_an_emulator_comes_back() -> None:
    start = smoke_start(dwells=60).model_copy(update={"rate_hz": 1.0})
    core = EmulatorCore(SimulatedFrontEnd.open)
    assert core.handle(checkpoint(start, due_k=9)) == []
    assert [(scan.k, scan.t) for scan in scans(list(core.handle(Tick(0.0))))] == [(0, 0)]


def test_a_scan_says_how_many_dwells_before_it_never_happened() -> None:
    """Only the process knows that sent the scan before them: another one may have transmitted some."""
    start = smoke_start(dwells=60).model_copy(update={"rate_hz": 1.0})
    core, skipped = EmulatorCore(SimulatedFrontEnd.open), list[int | None]()
    core.handle(checkpoint(start))
    for now_s, k in enumerate((-1, 0, 1, 5, 6)):  # after the fourth dwell, others have gone on to dwell 6
        if k >= 0:
            core.handle(_waveform(k, tracking=True))
        skipped += [scan.skipped for scan in scans(list(core.handle(Tick(float(now_s)))))]
    assert skipped == [None, None, None, 3, None]
    back = EmulatorCore(SimulatedFrontEnd.open)
    back.handle(checkpoint(start, 3, 3))
    back.handle(_waveform(8, tracking=True))
    assert [(scan.k, scan.skipped) for scan in scans(list(back.handle(Tick(9.0))))] == [(9, None)]


def test_the_run_ends_after_its_last_dwell() -> None:
    core = EmulatorCore(SimulatedFrontEnd.open)
    core.handle(smoke_begin(dwells=2))
    core.handle(_waveform(0, tracking=True))
    core.handle(_waveform(1, tracking=True))
    (end,) = core.handle(_waveform(2, tracking=True))
    assert isinstance(end, RunEnd)
    assert (end.status, end.k, end.t) == ("complete", 2, 2)
    assert core.handle(_waveform(2, tracking=True)) == []
    assert core.handle(checkpoint(smoke_start(dwells=2), 3, 2)) == []
    core.handle(checkpoint(smoke_start(dwells=2), 3, 2, resend=True))
    assert core.handle(Tick(0.0)) == [end]
    core.handle(checkpoint(smoke_start(dwells=2), 3, 2, ended=True))
    assert core.handle(_waveform(2, tracking=True)) == ()


def test_an_acquisition_without_end_fails_the_run_with_a_reason() -> None:
    core = EmulatorCore(SimulatedFrontEnd.open)
    core.handle(smoke_begin())
    for k in range(SMOKE.radar.acquisition.max_scans - 1):
        core.handle(_waveform(k, tracking=False))
        core.handle(checkpoint(smoke_start(), k))
    (end,) = core.handle(_waveform(SMOKE.radar.acquisition.max_scans - 1, tracking=False))
    assert isinstance(end, RunEnd)
    assert end.status == "failed"
    assert str(SMOKE.radar.acquisition.max_scans) in end.reason


def test_strategies_share_truth_and_disturbance(monkeypatch: pytest.MonkeyPatch) -> None:
    """Common random numbers: same trajectories, same acquisition, same noise vector in every (bin, dwell)."""
    noise: dict[Strategy, dict[tuple[int, int], bytes]] = {}
    said: dict[Strategy, list[Message]] = {}
    for strategy in Strategy:
        drawn: dict[tuple[int, int], bytes] = {}
        pending: list[tuple[int, int]] = []

        def keyed(
            seed: int, purpose: Purpose, index: int, k: int, pending: list[tuple[int, int]] = pending
        ) -> Generator:
            if purpose is Purpose.DISTURBANCE:
                pending.append((index, k))
            return generator(seed, purpose, index, k)

        def recorded(
            model: str,
            n: int,
            rng: Generator,
            pending: list[tuple[int, int]] = pending,
            drawn: dict[tuple[int, int], bytes] = drawn,
        ) -> NDArray[np.complex128]:
            vector = draw(model, n, rng)
            drawn[pending.pop()] = vector.tobytes()
            return vector

        monkeypatch.setattr(scene, "generator", keyed)
        monkeypatch.setattr(scene, "draw", recorded)
        said[strategy], noise[strategy] = play(smoke_start(strategy, dwells=6)), drawn
    reference = noise[Strategy.ORTHOGONAL]  # tests every cell
    assert len(reference) == 16 * len(scans(said[Strategy.ORTHOGONAL]))
    for strategy in (Strategy.UNIFORM, Strategy.POWER_AWARE):
        assert noise[strategy].items() <= reference.items()
        assert len(noise[strategy]) < len(reference)
        for kind in (_truths, _acquired):
            assert [encode(m) for m in kind(said[strategy])] == [encode(m) for m in kind(said[Strategy.ORTHOGONAL])]


def _acquired(said: list[Message]) -> list[Message]:
    return [scan for scan in scans(said) if scan.t == 0]


def test_the_disturbance_of_a_cell_depends_on_seed_bin_and_dwell_only() -> None:
    """The same cell tested through two kinds of scan, once among all cells and once alone, reads the same."""
    core, alone = EmulatorCore(SimulatedFrontEnd.open), EmulatorCore(SimulatedFrontEnd.open)
    core.handle(smoke_begin())
    alone.handle(smoke_begin())
    everything, _ = core.handle(_waveform(0, tracking=True))
    one, _ = alone.handle(_waveform(0, tracking=True, isotropic=0.0, beams=(3, 12)))
    assert isinstance(everything, Scan)
    assert isinstance(one, Scan)
    # Different waveforms: S = sigma_hat^2 ||v||^2 is the disturbance's own level, whatever is sent, up to the
    # estimator's spread; for another dwell's draw the amplitudes differ. Here the draw is compared through the seed.
    again, _ = _second_scan(isotropic=0.0, beams=(3, 12))
    assert encode(again) == encode(one)
    with_other_neighbour, _ = _second_scan(isotropic=0.0, beams=(3, 5))
    assert isinstance(with_other_neighbour, Scan)
    assert with_other_neighbour.alpha_hat[0] == one.alpha_hat[0]
    assert with_other_neighbour.sigma_hat[0] == one.sigma_hat[0]


def test_an_emulator_prepares_each_dwell_once_and_says_the_same(said: list[Message]) -> None:
    core = EmulatorCore(SimulatedFrontEnd.open)
    again = list(core.handle(checkpoint(smoke_start(dwells=6))))
    assert not core.prepare()  # targets do not fly before they are tracked
    for waveform in waveforms(said):
        answers = core.handle(waveform)
        again += answers
        flies = any(isinstance(message, Scan) and message.t > 0 for message in answers)
        assert [core.prepare(), core.prepare()] == [flies, False]
    assert isinstance(again[-1], RunEnd)
    assert [encode(m) for m in again] == [encode(m) for m in said if isinstance(m, Scan | Truth | RunEnd)]


def _second_scan(isotropic: float, beams: tuple[int, ...]) -> tuple[Message, ...]:
    core = EmulatorCore(SimulatedFrontEnd.open)
    core.handle(smoke_begin())
    return tuple(core.handle(_waveform(0, tracking=True, isotropic=isotropic, beams=beams)))
