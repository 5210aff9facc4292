"""The loop at the edge of what a scenario may ask for: it goes on, or ends and says why."""

import pytest

from cogradar.services.errors import RunFailed
from cogradar.services.metrics.store import in_memory
from cogradar.services.runs.in_process import play
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.files import ScenarioError, load
from cogradar.shared.scenario.radar_config import Strategy

SMALL = ("radar.belief.n_particle=60", "radar.planner.n_sim=20", "radar.belief.max_tries=20")
UNKNOWN = ("radar.fidelity=best-range", 'radar.tracks="unknown"', "radar.search.beams=2")
NEAR, FAR = "[40.0, 0.1, -30.0, 0.05]", "[50.0, -0.05, 20.0, 0.1]"


def targets(*tables: str) -> str:
    return f"world.targets=[{', '.join(tables)}]"


def loudness(db: float) -> tuple[str, str]:
    return f"radar.echo.amplitude_db={db}", f"world.echo.amplitude_db={db}"


STRONGEST = (  # above 1.8e19, so that their squares overflow in single precision
    targets("{state=[0.0, 0.0, 0.001, 0.0], rcs_db=100.0}", f"{{state={FAR}, rcs_db=100.0}}"),
    "radar.acquisition.range_min_km=0.001",
    "radar.array.power=1e6",
    *loudness(200.0),
)
TOO_WEAK = "hardly any power"
EXTREMES: dict[str, tuple[int, tuple[str, ...]]] = {
    "targets that come to one place": (
        12,
        (
            targets("{state=[40.0, 0.0, -30.0, 0.0], stays=true}", "{state=[40.0, 0.0, -21.0, -1.0]}"),
            "world.motion.sigma_s_km_s2=0.0",
            "radar.acquisition.v_max_km_s=2.0",
        ),
    ),
    "coincident targets that nobody announced": (8, (*UNKNOWN, targets(f"{{state={NEAR}}}", f"{{state={NEAR}}}"))),
    "1/R^4 over 12 orders": (
        8,
        (
            targets("{state=[4.0, 0.0, 1.0, 0.0]}", "{state=[4000.0, 0.0, -1000.0, 0.0]}"),
            "radar.acquisition.range_min_km=1",
            "radar.acquisition.range_max_km=10000",
            *loudness(160.0),
        ),
    ),
    "10 particles": (8, ("radar.belief.n_particle=10",)),
    "everybody leaves": (300, (targets(f"{{state={NEAR}, gone_s=3.0}}", f"{{state={FAR}, gone_s=3.0}}"),)),
    "everybody whom nobody announced leaves": (
        60,
        (*UNKNOWN, targets(f"{{state={NEAR}, gone_s=20.0}}", f"{{state={FAR}, gone_s=20.0}}")),
    ),
    "nothing is ever detected": (300, (*UNKNOWN, *loudness(-100.0))),
    "the strongest echoes": (8, STRONGEST),
    "the strongest echoes of whom nobody announced": (8, (*UNKNOWN, *STRONGEST)),
    "the most power": (8, ("radar.array.power=1e6",)),
    TOO_WEAK: (4, ("radar.array.power=1e-6", "radar.acquisition.max_scans=5")),
    "hardly any power for whom nobody announced": (8, (*UNKNOWN, "radar.array.power=1e-6")),
    "the longest dwells": (8, ("radar.motion.dt_s=60.0", "radar.motion.sigma_s_km_s2=1.0")),
    "hardly any dwell": (8, ("radar.motion.dt_s=5e-324",)),
}
STRATEGIES = [Strategy.POWER_AWARE, pytest.param(Strategy.ORTHOGONAL, marks=pytest.mark.nightly)]


@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize(
    "extreme", [pytest.param(one, marks=[pytest.mark.nightly] * (EXTREMES[one][0] > 100)) for one in EXTREMES]
)
def test_a_run_ends_or_says_why(extreme: str, strategy: Strategy) -> None:
    dwells, changed = EXTREMES[extreme]
    start, store = RunStart.of(load("smoke", (*SMALL, *changed)), strategy, 1, dwells), in_memory()
    if extreme == TOO_WEAK:
        with pytest.raises(RunFailed, match="not every target was detected within 5 scans"):
            play(start, store=store)
        return
    assert play(start, store=store).run["status"] == "complete"
    (row,) = store.read("SELECT acknowledged_t AS t FROM run")
    assert row["t"] == dwells


@pytest.mark.parametrize("setting", ["radar.array.power=0", "radar.array.power=1e-300", "radar.belief.n_particle=1"])
def test_no_power_and_a_single_particle_are_refused(setting: str) -> None:
    with pytest.raises(ScenarioError, match=f"{setting}: must be .* >"):
        load("smoke", [setting])
