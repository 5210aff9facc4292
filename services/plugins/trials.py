"""What a thing of somebody else is tried with, by its kind: arguments, and the built-in one whose cost is shown, too.

Each call gets arguments of its own, made anew, so that what it does to them is seen.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cogradar.services.emulator.cycle import compared, scan_message, transmission
from cogradar.services.emulator.front_end import FrontEnd, Settings, Transmission
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.planning.radar_pomdp import problem_of
from cogradar.shared.power.rules import Requests
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.plugins.kinds import DISTURBANCE, FRONT_END, OBJECTIVE, RULE, STRATEGY, Kind
from cogradar.shared.scenario.plugins.names import PluginFailed
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.signal.array import bin_centres
from cogradar.shared.tracking.model import TrackerModel

N_DRAW = 4000  # cells of which the mean power of a disturbance is estimated
POWER_WITHIN = 0.1  # of 1; heavy tails make the mean uncertain
_SIGMA_HAT = 0.02
Case = Callable[[], tuple[Any, ...]]  # arguments of a call, made anew


@dataclass(frozen=True)
class Trial:
    """How a kind is tried."""

    cases: Sequence[tuple[str, Case]]  # in words, and the arguments
    beside: str  # the built-in one whose cost is shown; "": there is none to be called so
    call: Callable[..., Any] = lambda thing, *arguments: thing(*arguments)
    more: Callable[[Any], tuple[str, bool]] | None = None  # what else is found, and whether it is as it should be
    repeats: bool = True  # the same answer to the same arguments; no measurement does


def trial_of(kind: Kind) -> Trial:
    """How a kind is tried."""
    tried: dict[Kind, Callable[[], Trial]] = {
        RULE: _rule,
        STRATEGY: partial(_power, "power-aware"),
        OBJECTIVE: partial(_power, "max-min"),
        DISTURBANCE: _disturbance,
        FRONT_END: _front_end,
    }
    return tried[kind]()


def _rule() -> Trial:
    radar = load("smoke").radar
    model = TrackerModel.of(radar, Strategy.POWER_AWARE, seed=1)

    def case(spread_km: float, apart_km: float, i: int, time: Callable[[], bool] | None) -> Case:
        def made() -> tuple[Any, ...]:
            rng = generator(1, Purpose.INITIATION, 0, i)
            centre, beside = np.array([50.0, -0.05, 20.0, 0.1]), np.array([0.0, 0.0, apart_km, 0.0])
            states = (
                centre
                + beside * rng.choice(2, (3000, 1))
                + np.array([spread_km, 0.02, spread_km, 0.02]) * rng.standard_normal((3000, 4))
            )
            problem = problem_of(states, _SIGMA_HAT, model.sensor, model.motion)
            return problem, radar, generator(1, Purpose.SEARCH, 0, i), time

        return made

    return Trial(
        (
            ("a target in one bin", case(0.5, 0.0, 0, None)),
            ("a target in two bins", case(0.5, -12.0, 1, None)),
            ("a target anywhere", case(30.0, 0.0, 2, None)),
            ("no time left", case(0.5, -12.0, 3, lambda: False)),
        ),
        "pomcp",
    )


def _power(beside: str) -> Trial:
    radar = load("smoke").radar

    def case(n_track: int, n_cell: int, i: int) -> Case:
        def made() -> tuple[Any, ...]:
            rng = generator(1, Purpose.INITIATION, 1, i)
            centres = bin_centres(radar.array.n_bin)
            nus = centres[np.array([rng.choice(centres.size, n_cell, replace=False) for _ in range(n_track)])]
            chances = rng.dirichlet(np.ones(n_cell), n_track)
            ranges = rng.uniform(10.0, 90.0, n_track)
            return radar, Requests(nus, chances, ranges, 1e9 * ranges**-4.0, rng.random(n_track))

        return made

    cases = ((1, 1, "one track"), (2, 1, "two tracks"), (5, 3, "five tracks of three cells each"))
    return Trial([(name, case(m, n, i)) for i, (m, n, name) in enumerate(cases)], beside)


def _disturbance() -> Trial:
    def case(n: int, i: int) -> Case:
        return lambda: (n, generator(1, Purpose.DISTURBANCE, 3, i))

    def power(model: Any) -> tuple[str, bool]:
        spectrum = float(np.mean(model.power_spectrum(np.arange(64) / 64.0 - 0.5)))
        drawn: list[NDArray[np.complex128]] = [
            model.draw(64, generator(1, Purpose.DISTURBANCE, 4, i)) for i in range(N_DRAW)
        ]
        mean = float(np.mean(np.abs(drawn) ** 2))
        is_one = abs(mean - 1.0) < POWER_WITHIN and abs(spectrum - 1.0) < POWER_WITHIN
        return f"mean power {mean:.3f}, of the spectrum {spectrum:.3f}; both must be 1", is_one

    return Trial(
        (("256 samples", case(256, 0)), ("10 000 samples", case(10_000, 1))),
        "ar6-t",
        lambda model, n, rng: model.draw(n, rng),
        power,
    )


def _front_end() -> Trial:
    settings = Settings("check", load("smoke").radar, Strategy.POWER_AWARE, dwells=1, rate_hz=0.0)

    def call(make: Callable[[Settings], FrontEnd], asked: Transmission) -> Any:
        try:
            front_end = make(settings)
            try:
                measured = front_end.transmit(0, 0, asked)
            finally:
                front_end.close()
            return (
                None
                if measured is None
                else scan_message(settings, 0, 0, compared(settings.radar, asked, measured), None)
            )
        except Exception as error:
            raise PluginFailed(f"{type(error).__name__}: {error}") from error

    def everywhere() -> tuple[Any, ...]:
        return (transmission(settings.radar, None),)

    return Trial((("a dwell of the acquisition", everywhere),), "", call, repeats=False)
