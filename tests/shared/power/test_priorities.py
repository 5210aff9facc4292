"""Priorities: so many times the signal-to-noise ratio for a track, and a look at it before those at others."""

import numpy as np
import pytest

from cogradar.shared.power.rules import Emission, Requests, power_rule
from cogradar.shared.power.search import LEAST_SHARE, search_power
from cogradar.shared.power.wide import KEPT, sure_powers
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.signal.array import bin_centres
from cogradar.shared.signal.waveform import beampattern

NUS = bin_centres(100)[[10, 40, 70]]
PLENTY, SCARCE = 4e3, 30.0  # gains: with all the power, of one look


def _radar(objective: str, *settings: str) -> RadarConfig:
    return load("paper", [f'radar.allocation.objective="{objective}"', *settings]).radar


def _sent(radar: RadarConfig, gain: float, *priorities: float) -> Emission:
    gains, chances = gain * np.array([1.0, 2.0, 0.5]), np.ones((3, 1))
    ranges, worths = (1e6 / gains) ** 0.25, np.full(3, 0.5)
    wanted = {"priorities": np.array(priorities)} if priorities else {}
    return power_rule("power-aware")(radar, Requests(NUS[:, np.newaxis], chances, ranges, gains, worths, k=1, **wanted))


@pytest.mark.parametrize("objective", ["max-min", "detections", "urgency"])
def test_the_expected_echo_over_that_of_others_follows_the_priority_where_there_is_power(objective: str) -> None:
    radar = _radar(objective)
    plain, wanted = (_sent(radar, PLENTY, *weights) for weights in ((), (1.0, 3.0, 1.0)))
    ratio = beampattern(0.0, wanted.factor, NUS) / beampattern(0.0, plain.factor, NUS)
    within = 1e-3 if objective == "max-min" else 0.25
    assert ratio[1] / ratio[0] == pytest.approx(3.0, rel=within)
    assert ratio[1] / ratio[2] == pytest.approx(3.0, rel=within)
    assert wanted.shares.sum() == pytest.approx(radar.array.power, rel=1e-9)


@pytest.mark.parametrize("settings", [[], ['radar.allocation.antennas="equal"'], ['radar.allocation.solver="sdp"']])
def test_max_min_follows_it_whatever_solves_it_and_also_below_1(settings: list[str]) -> None:
    radar = _radar("max-min", *settings)
    echo = beampattern(0.0, _sent(radar, PLENTY, 0.2, 5.0, 1.0).factor, NUS) * np.array([1.0, 2.0, 0.5])
    assert echo / echo[2] == pytest.approx([0.2, 5.0, 1.0], rel=0.03)


@pytest.mark.parametrize("objective", ["detections", "urgency"])
def test_where_power_suffices_for_few_looks_it_decides_for_which(objective: str) -> None:
    radar = _radar(objective)

    def lit(*priorities: float) -> list[int]:
        return np.flatnonzero(_sent(radar, SCARCE, *priorities).shares[:, 0] > 0.0).tolist()

    assert lit() == [0, 1]  # those with the strongest echoes
    assert lit(10.0, 1.0, 1.0) == [0]
    assert lit(1.0, 1.0, 10.0) == [2]  # though a look at it is not sure with all the power
    assert 1 not in lit(1.0, 0.1, 1.0)


def test_the_search_gives_up_what_is_wanted_and_no_more_than_it_can() -> None:
    scenario = load("paper-best-range", ['radar.tracks="unknown"'])
    radar, search = scenario.radar, scenario.radar.search
    assert search is not None
    plain = Requests.of_single(NUS, np.full(3, 50.0), np.full(3, 3e3))
    needed = KEPT * float(sure_powers(radar, plain.gains)[0])
    for weight, times in ((1.0, 3.0), (4.0, 6.0), (0.1, 3.0)):
        wanted = plain._replace(priorities=np.array([weight, 1.0, 1.0]))
        assert search_power(radar, search, wanted) == pytest.approx(max(1.0 - times * needed, LEAST_SHARE))
