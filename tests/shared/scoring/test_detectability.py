"""From when on a target counts."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cogradar.shared.scenario.files import load, parse
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scoring.detectability import Detectability
from cogradar.shared.scoring.prospects import prospects
from cogradar.shared.signal.radar_equation import snr_db
from cogradar.shared.signal.receiver import detection_probability, threshold
from cogradar.shared.tracking.existence import alert_p_fa

SMOKE, PAPER = load("smoke"), load("paper")
RCS = ("constant", "swerling1", "swerling3")
# What P_D of so many channels is off that of infinitely many, for which the limit is drawn.
FINITE = {"smoke": 0.25, "paper": 0.06}  # 256, 10^4


ANGLES = st.floats(-1.2, 1.2).filter(lambda angle: abs(angle) > 1e-6)  # the border of two bins: either may be its own


@pytest.mark.parametrize("scenario", [SMOKE, PAPER], ids=lambda scenario: scenario.name)
@settings(max_examples=30)
@given(st.floats(0.9, 1.1), ANGLES, st.sampled_from(RCS), st.sampled_from(["bins", "steered"]))
def test_what_counts_is_what_a_beam_with_all_power_finds_half_the_time(
    scenario: Scenario, away: float, angle: float, rcs: str, cells: str
) -> None:
    """Near the range where that is so, where it shows."""

    def placed(range_km: float) -> Scenario:
        state = [range_km * float(np.cos(angle)), 0.0, range_km * float(np.sin(angle)), 0.0]
        document = scenario.model_dump()
        document["radar"]["tracks"], document["radar"]["receiver"]["cells"] = 1, cells
        document["world"] |= {"targets": [document["world"]["targets"][0] | {"state": state}], "rcs": rcs}
        return parse(document, source="one")

    def is_found(made: Scenario, range_km: float) -> bool:
        states = np.array([made.simulated.targets[0].state])
        snrs = snr_db(np.array([range_km]), made.simulated.echo.amplitude_db)
        return bool(Detectability.of(made).finds(np.array([0]), states, snrs)[0])

    somewhere, low, high = placed(100.0), 5.0, 1000.0
    while high / low > 1.001:
        middle = (low * high) ** 0.5
        low, high = (middle, high) if is_found(somewhere, middle) else (low, middle)
    made = placed(away * low)
    p_d = prospects(made)[0].p_d["power-aware"]
    assert is_found(made, away * low) == (p_d >= 0.5) or p_d == pytest.approx(0.5, abs=FINITE[scenario.name])


def test_more_range_cells_need_a_stronger_echo() -> None:
    plain, ranged = (Detectability.of(load("smoke", [f"radar.fidelity={name}"])) for name in ("best", "best-range"))
    assert (ranged.needed > plain.needed).all()
    assert (plain.needed > 0.0).all()


def test_what_nobody_announced_is_found_by_looks_of_the_search() -> None:
    """Their limit follows from how many looks there are, and not from the detector's P_FA."""
    of_all, of_four = (
        Detectability.of(load("smoke", ["radar.fidelity=best", 'radar.tracks="unknown"', *more])).needed[0]
        for more in (["radar.detector.p_fa=1e-2"], ["radar.search.beams=4"])
    )
    radar = load("smoke", ["radar.fidelity=best", 'radar.tracks="unknown"']).radar
    assert detection_probability(of_all, threshold(alert_p_fa(radar.array.n_bin))) == pytest.approx(0.5, abs=1e-6)
    assert of_four < of_all


def test_a_target_s_own_law_of_echoes_says_what_it_needs() -> None:
    state = SMOKE.simulated.targets[0].state
    document = SMOKE.model_dump()
    document["world"]["targets"][1] |= {"rcs": "swerling1"}
    sight = Detectability.of(parse(document, source="two laws"))
    (steady, fluctuating), (other, _) = sight.needed, Detectability.of(load("smoke", ["world.rcs=swerling1"])).needed
    assert (steady, fluctuating) == (Detectability.of(SMOKE).needed[0], other)
    assert steady < fluctuating
    between = 5.0 * np.log10(steady * fluctuating / (2.0 * sight.signature_power) ** 2)
    same = (np.array([state, state]), np.full(2, between))
    alike = sight._replace(disturbance="white")
    assert alike.finds(np.array([1, 0]), *same).tolist() == [False, True]
