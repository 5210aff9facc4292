"""Acquisition of a known number: likelihood ratios over all scans, below the limit, too."""

from dataclasses import replace
from math import exp, log

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats
from scipy.special import i0e

from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.signal.array import around, bin_centres
from cogradar.shared.signal.detector import data_set
from cogradar.shared.signal.looks import range_cells
from cogradar.shared.signal.receiver import threshold
from cogradar.shared.signal.response import BinResponse, LobeResponse
from cogradar.shared.signal.scan import Detections
from cogradar.shared.signal.waveform import Signatures
from cogradar.shared.tracking.acquisition import Candidates, expected_scans
from cogradar.shared.tracking.model import TrackerModel
from cogradar.shared.tracking.track import Acquisition, start
from tests.shared.tracking.models import paper_model
from tests.shared.tracking.scans import bins_scan

Floats = NDArray[np.float64]
MODEL = paper_model()  # ranges 5 .. 200 km
SIGMA, THRESHOLD = 0.1, MODEL.sensor.threshold
NODES = [5.0 + (i + 0.5) * 195.0 / 32 for i in range(32)]  # km


def of(n_bin: int, n_track: int) -> TrackerModel:
    sensor = MODEL.sensor._replace(n_bin=n_bin)
    return replace(MODEL, sensor=sensor, response=BinResponse(n_bin), n_track=n_track)


def add(candidates: Candidates, k: int, statistic: Floats, n_track: int) -> None:
    n, alpha_hat = statistic.size, np.zeros(statistic.size, dtype=np.complex64)
    cells = {"bins": np.arange(n, dtype=np.int32), "statistic": statistic, "alpha_hat": alpha_hat}
    noise = {"sigma_hat": np.full(n, SIGMA), "signature_power": np.full(n, 100.0)}
    candidates.add(bins_scan(n, k=k, **cells, **noise, beams=np.full((n_track, 1), -1, np.int32)))


def acquired(statistic: Floats, n_track: int) -> list[int] | None:
    """From scans with these statistics, (n_scan, n_bin); one is a detection from 18.4 on."""
    candidates = Candidates(of(statistic.shape[1], n_track))
    for k, row in enumerate(statistic):
        add(candidates, k, row, n_track)
        if (found := candidates.bins()) is not None:
            return [int(bin_) for bin_ in found]
    return None


def acquired_slowly(statistic: Floats, n_track: int) -> list[int] | None:
    """With the sum over ranges and the product over scans written out; bins at both ends are one direction."""
    n_bin = statistic.shape[1]
    ends = {0: n_bin - 1, n_bin - 1: 0}
    us = [1000.0 / range_km**2 / SIGMA for range_km in NODES]

    def log_odds(b: int, k: int) -> float:
        rs = [(0.5 * s) ** 0.5 for s in statistic[:k, b].tolist()]
        each = [sum(log(i0e(2.0 * r * u)) + 2.0 * r * u - u * u for r in rs) for u in us]
        top = max(each)
        return float(top + log(sum(exp(one - top) for one in each) / len(us) * n_track / n_bin))

    for k in range(1, len(statistic) + 1):
        sums = statistic[:k].sum(axis=0)
        sure = [b for b in range(n_bin) if log_odds(b, k) >= -log(1e-4)]
        strength = {b: sums[b] + (sums[ends[b]] if ends.get(b) in sure else 0.0) for b in sure}
        strongest = sorted(sure, key=lambda b: (-strength[b], b))
        picked = [b for i, b in enumerate(strongest) if not (b in ends and ends[b] in strongest[:i])]
        if len(picked) >= n_track:
            return sorted(picked[:n_track])
    return None


SCANS = st.integers(1, 8).flatmap(
    lambda n_scan: st.lists(
        st.lists(st.floats(0.0, 50.0), min_size=5, max_size=5), min_size=n_scan, max_size=n_scan
    ).map(np.array)
)


@given(statistic=SCANS, n_track=st.integers(1, 4))
def test_against_a_plain_loop(statistic: Floats, n_track: int) -> None:
    before = statistic.copy()
    assert acquired(statistic, n_track) == acquired_slowly(statistic, n_track)
    np.testing.assert_array_equal(statistic, before)


@given(statistic=SCANS, n_track=st.integers(1, 3))
def test_later_scans_do_not_change_the_tracks(statistic: Floats, n_track: int) -> None:
    found = [acquired(statistic[:k], n_track) for k in range(1, len(statistic) + 1)]
    first = next((k for k, tracks in enumerate(found) if tracks is not None), len(found))
    assert all(tracks is None for tracks in found[:first])
    assert all(tracks == found[first] for tracks in found[first:])


def test_a_false_alarm_loses_to_the_targets() -> None:
    statistic = np.ones((3, 10))
    statistic[:, 7] = 25.0
    statistic[:, 4] = [12.0, 14.0, 30.0]  # a weak target, on an upward fluctuation
    statistic[2, 2] = 31.0  # a false alarm: strong once, nothing before
    assert acquired(statistic, 2) == [4, 7]


@pytest.mark.parametrize(("nu", "end", "other"), [(0.4965, 99, 1), (-0.4965, 0, 98)])
def test_a_target_that_an_array_hears_at_both_ends_is_one_at_its_own(nu: float, end: int, other: int) -> None:
    """One data set of 100 x 100 channels a scan: another target in the bin beside the other end, and white noise."""
    n, rng, centres = 100, np.random.default_rng(4), bin_centres(100)
    signatures = Signatures(1.0, np.empty((n, 0), dtype=np.complex128), n)
    candidates = Candidates(of(n, 2))
    for k in range(60):
        y = rng.standard_normal((2, n * n)).T.copy().view(np.complex128).ravel() * np.sqrt(0.5)
        for direction in (nu, float(centres[other])):
            y += 0.5 * np.exp(2j * np.pi * rng.random()) * np.kron(*signatures.at(direction)).astype(np.complex128)
        cells = data_set.wald_tests(y, signatures, centres)
        columns = cells._asdict() | {"alpha_hat": cells.alpha_hat.astype(np.complex64)}
        beams = np.full((2, 1), -1, np.int32)
        candidates.add(bins_scan(n, k=k, bins=np.arange(n, dtype=np.int32), beams=beams, **columns))
    assert {end, other} == set(np.asarray(candidates.bins()).tolist())


@pytest.mark.parametrize(("nu", "end"), [(0.498, 99), (-0.498, 0), (0.4995, 99)])
def test_a_target_near_an_end_is_where_its_directions_are_measured(nu: float, end: int) -> None:
    """By the looks at both ends, each as far off its axis as the other: what they measure is on the target's side."""
    n, rng = 100, np.random.default_rng(8)
    model = replace(of(n, 1), response=LobeResponse(n, n, n, np.inf))
    candidates = Candidates(model)
    for k in range(25):
        statistic = rng.exponential(2.0, n)
        statistic[[0, -1]] = 25.0
        alpha_hat = (SIGMA * np.sqrt(0.5 * statistic) * np.exp(2j * np.pi * rng.random(n))).astype(np.complex64)
        centres, nu_sigmas, ends = bin_centres(n), np.zeros(n), np.where(np.arange(n) % (n - 1) == 0)
        nu_hats = centres.copy()
        nu_hats[ends], nu_sigmas[ends] = around(nu + 1e-3 * rng.standard_normal(2)), 1e-3
        cells = {"bins": np.arange(n, dtype=np.int32), "statistic": statistic, "alpha_hat": alpha_hat}
        noise = {"sigma_hat": np.full(n, SIGMA), "signature_power": np.full(n, 100.0)}
        scan = bins_scan(n, k=k, **cells, **noise, beams=np.full((1, 1), -1, np.int32))
        candidates.add(scan._replace(nu_hats=nu_hats, nu_sigmas=nu_sigmas))
    assert np.asarray(candidates.bins()).tolist() == [end]


def test_no_track_before_all_targets_are_confirmed() -> None:
    statistic = np.ones((4, 10))
    statistic[:, 3], statistic[1, 8] = 20.0, 20.0
    assert acquired(statistic, 2) is None


def test_two_false_alarms_in_a_hundred_scans_are_no_target() -> None:
    statistic = stats.chi2(2).rvs((100, 10), random_state=np.random.default_rng(9))
    statistic = np.minimum(statistic, THRESHOLD - 1.0)
    statistic[:, 6] = 20.0
    statistic[[30, 60], 2] = 20.0  # false alarms, in a cell with nothing else
    assert acquired(statistic, 2) is None
    statistic[:, 4] += 5.0  # a weak target, which is stronger in all scans
    assert acquired(statistic, 2) == [4, 6]


def test_a_target_that_is_never_detected_is_found_by_all_scans_together() -> None:
    """Its mean statistic is 8, P_D 0.03: two detections take 70 scans."""
    rng = np.random.default_rng(5)
    candidates, scans = Acquisition(of(10, 1)), 0
    while candidates.bins is None and scans < 100:
        statistic = np.minimum(stats.ncx2(2, np.where(np.arange(10) == 4, 6.0, 1e-9)).rvs(10, random_state=rng), 18.0)
        alpha_hat = (SIGMA * np.sqrt(0.5 * statistic)).astype(np.complex64)
        cells = {"bins": np.arange(10, dtype=np.int32), "statistic": statistic, "alpha_hat": alpha_hat}
        noise = {"sigma_hat": np.full(10, SIGMA), "signature_power": np.full(10, 100.0)}
        candidates.add(bins_scan(10, k=scans, **cells, **noise, beams=np.full((1, 1), -1, np.int32)))
        scans += 1
    assert candidates.bins is not None
    assert (candidates.bins.tolist(), scans < 30) == ([4], True)
    state = start(candidates_model := of(10, 1), 0, 4, candidates.scans)
    ranges_km = np.hypot(state.belief.rows[:, 0], state.belief.rows[:, 2])
    true_km = (1000.0 / (SIGMA * 3.0**0.5)) ** 0.5  # u^2 is half of the noncentrality
    assert abs(np.median(ranges_km) - true_km) < 4.0 * ranges_km.std()
    assert state.sigma_hat == pytest.approx(SIGMA)
    assert candidates_model.p_fa == 1e-4


@pytest.mark.parametrize("rcs", ["known", "mean", "unknown"])
def test_noise_alone_has_a_likelihood_ratio_of_one(rcs: str) -> None:
    """In the mean, after any number of scans, so that it exceeds 1 / x with probability x at most."""
    model = of(100, 1)
    acquisition = model.acquisition.model_copy(update={"range_min_km": 120.0})  # u is 0.25 to 0.7
    model, rng = (
        replace(model, acquisition=acquisition, sensor=model.sensor._replace(rcs=rcs)),
        np.random.default_rng(3),
    )
    ratios = list[float]()
    for _ in range(100):
        candidates = Candidates(model)
        for k in range(4):
            add(candidates, k, rng.chisquare(2, 100), 1)
        ratios += np.exp(candidates.log_odds - log(1 / 100)).tolist()
    assert np.mean(ratios) == pytest.approx(1.0, abs=4.0 * np.std(ratios) / len(ratios) ** 0.5)


def _with_ranges(model: TrackerModel, rng: np.random.Generator, u: float, at: int) -> tuple[Floats, Floats]:
    """Statistics and ranges of a dwell's rows: of each the largest of all its tests; of row 40 one has an echo."""
    width, low = model.response.range_cell_km, range_cells(*model.acquisition.ranges_km, model.response.range_cell_km)
    n = 2 * len(low)
    r = np.sqrt(rng.exponential(1.0, (model.sensor.n_bin, n)))
    r[40, 2 * (at - low[0])] = np.abs(u + np.sqrt(0.5) * (rng.standard_normal() + 1j * rng.standard_normal()))
    best = r.argmax(axis=1)
    return 2.0 * r.max(axis=1) ** 2, (low[0] + best // 2 + 0.5) * width


def ranged(model: TrackerModel, k: int, statistic: Floats, ranges_km: Floats, sigma: float) -> Detections:
    """An acquisition scan of the paper's array with range cells."""
    width_km, centres = model.response.range_cell_km, bin_centres(100)
    limit = threshold(model.p_fa, 2 * len(range_cells(*model.acquisition.ranges_km, width_km)))
    columns = {"statistic": statistic, "alpha_hat": (sigma * np.sqrt(0.5 * statistic)).astype(np.complex64)}
    columns |= {"sigma_hat": np.full(100, sigma), "signature_power": np.ones(100), "nus": centres}
    columns |= {"limits": np.full(100, limit), "ranges_km": ranges_km, "nu_hats": centres}
    columns |= {"nu_sigmas": np.full(100, 1e-3), "beam_nus": np.zeros((1, 1)), "gates": np.zeros((1, 2))}
    columns |= {"bins": np.arange(100, dtype=np.int32), "beams": np.full((1, 1), -1, np.int32)}
    return bins_scan(100, k=k, **columns)


RANGED = replace(TrackerModel.of(load("paper-best-range").radar, Strategy.POWER_AWARE, 1), n_track=1)


def test_with_range_cells_what_agrees_in_range_is_a_target() -> None:
    rng, sigma = np.random.default_rng(2), 0.085
    u = 1000.0 / 60.0**2 / sigma  # 3.3: the largest of a row in some of the scans
    quiet, candidates = Candidates(RANGED), Candidates(RANGED)
    for k in range(60):
        for one, strength in ((quiet, 0.0), (candidates, u)):
            one.add(
                ranged(
                    RANGED, k, *_with_ranges(RANGED, rng, strength, int(60.0 / RANGED.response.range_cell_km)), sigma
                )
            )
        assert quiet.bins() is None
        if (found := candidates.bins()) is not None:
            break
    assert found is not None
    assert (found.tolist(), k < 25) == ([40], True)


def _far_apart(n_range: int, rcs: str) -> TrackerModel:
    """A radar of the paper with so many range cells, from 5 to 200 km, and bins that are few."""
    width_km = 200.0 / n_range
    radar = load("paper-best-range", [f"radar.receiver.range_cell_km={width_km}", f"radar.assumes.rcs={rcs}"]).radar
    model = replace(TrackerModel.of(radar, Strategy.POWER_AWARE, 1), n_track=1)
    return replace(model, sensor=model.sensor._replace(n_bin=20), response=replace(model.response, n_bin=20))


def _noise_scan(model: TrackerModel, k: int, rng: np.random.Generator) -> Detections:
    """The largest of all tests of each of 20 rows, without a target."""
    width_km, n_bin = model.response.range_cell_km, model.sensor.n_bin
    numbers = range_cells(*model.acquisition.ranges_km, width_km)
    n = 2 * len(numbers)
    statistic = -2.0 * np.log1p(-(rng.uniform(size=n_bin) ** (1.0 / n)))
    columns = {"statistic": statistic, "alpha_hat": np.zeros(n_bin, np.complex64), "sigma_hat": np.full(n_bin, 0.1)}
    columns |= {"signature_power": np.ones(n_bin), "nus": bin_centres(n_bin), "nu_hats": bin_centres(n_bin)}
    columns |= {"limits": np.full(n_bin, threshold(model.p_fa, n)), "nu_sigmas": np.full(n_bin, 1e-3)}
    columns |= {"ranges_km": (numbers[0] + rng.integers(0, len(numbers), n_bin) + 0.5) * width_km}
    columns |= {"beam_nus": np.zeros((1, 1)), "gates": np.zeros((1, 2)), "beams": np.full((1, 1), -1, np.int32)}
    return bins_scan(n_bin, k=k, bins=np.arange(n_bin, dtype=np.int32), **columns)


@pytest.mark.parametrize(
    ("n_range", "rcs"),
    [(4, "known"), (5, "unknown"), (8, "known"), pytest.param(40, "mean", marks=pytest.mark.nightly)],
)
def test_noise_alone_is_no_target_however_long_the_acquisition(n_range: int, rcs: str) -> None:
    """Positions begin when a scan first speaks for them, and have fewer neighbours at the first and last range cell."""
    model, rng = _far_apart(n_range, rcs), np.random.default_rng(n_range)
    candidates, most = Candidates(model), -np.inf
    for k in range(400):
        candidates.add(_noise_scan(model, k, rng))
        most = max(most, float(candidates.log_odds.max(initial=-np.inf)))
    assert most < log(1e3)  # with probability 1e-3 in each of the settings


@pytest.mark.parametrize("end", [0, 99])
def test_with_range_cells_the_stronger_end_is_the_target_s(end: int) -> None:
    """Its looks are a quarter of a bin off the end; beside them noise has the larger amplitudes."""
    rng, statistic, ranges_km = np.random.default_rng(6), np.full(100, 14.0), np.full(100, 50.25)
    statistic[[end, 99 - end]], statistic[98 if end == 0 else 1] = (80.0, 50.0), 200.0
    candidates = Candidates(RANGED)
    for k in range(3):
        ranges_km[1:-1] = rng.integers(10, 190, 98) + 0.25
        candidates.add(ranged(RANGED, k, statistic, ranges_km.copy(), 0.05))
    assert np.asarray(candidates.bins()).tolist() == [end]


@pytest.mark.parametrize(("u", "rcs"), [(1.5, "known"), (2.5, "known"), (2.5, "mean")])
def test_expected_scans_are_those_that_it_takes(u: float, rcs: str) -> None:
    rng, radar = np.random.default_rng(11), load("paper", [f"radar.assumes.rcs={rcs}"]).radar
    model = replace(of(100, 3), sensor=MODEL.sensor._replace(rcs=rcs))
    taken = list[int]()
    for _ in range(12):
        candidates, k = Candidates(model), 0
        while k < 400 and candidates.log_odds[:1].sum() < -log(1e-4):
            echo = u * np.sqrt(0.5 * rng.exponential(2.0)) if rcs == "mean" else u
            r = np.abs(echo + np.sqrt(0.5) * (rng.standard_normal() + 1j * rng.standard_normal()))
            add(candidates, k, np.concatenate(([2.0 * r * r], rng.chisquare(2, 99))), 3)
            k += 1
        taken.append(k)
    assert 0.5 < np.mean(taken) / expected_scans(radar, u) < 2.0


@pytest.mark.parametrize("lost", [[], [{5}], [{5}, {5}], [{12}], [{12}, {5}], [{5}, set(), {5}]])
def test_a_row_that_was_not_measured_in_a_scan_gives_its_target_to_no_neighbour(lost: list[set[int]]) -> None:
    """The echo in 5 is heard in 6, too, and is a detection there."""
    n, rng, model = 16, np.random.default_rng(0), of(16, 2)
    acquisition = Acquisition(model)
    for k, left in enumerate([*lost, *[set[int]()] * 4]):
        statistic = 2.0 * rng.exponential(size=n)
        statistic[[5, 6, 12]] = 90.0, 62.0, 90.0
        kept = np.array(sorted(set(range(n)) - left), dtype=np.int32)
        cells = {"bins": kept, "statistic": statistic[kept], "alpha_hat": np.zeros(kept.size, np.complex64)}
        noise = {"sigma_hat": np.full(kept.size, SIGMA), "signature_power": np.full(kept.size, 100.0)}
        unmeasured = {"unmeasured": bin_centres(n)[sorted(left)]} if left else {}
        scan = bins_scan(n, k=k, **cells, **noise, beams=np.full((2, 1), -1, np.int32), **unmeasured)
        if acquisition.add(scan) is not None:
            break
    assert acquisition.bins is not None
    assert acquisition.bins.tolist() == [5, 12]
