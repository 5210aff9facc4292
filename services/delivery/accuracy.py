"""Whether the accuracy that is asked of a track can be had, by itself and together with what is asked of others.

The power is that which the allocator has for such tracks; what a track needs is what its filter settles to.
"""

from collections.abc import Mapping

import numpy as np

from cogradar.shared.power.search import most_for_tracks
from cogradar.shared.power.wide import levelled, most_fixed, sure_powers
from cogradar.shared.protocol.messages import Plan, Refused
from cogradar.shared.scenario.radar_config import RadarConfig, Strategy
from cogradar.shared.tracking.belief.across import AIM, echo_gain, settled_km, settled_zeta
from cogradar.shared.tracking.model import TrackerModel

_LEAST_GAIN = 1e-12


def check_accuracies(
    radar: RadarConfig,
    strategy: Strategy,
    share: float,
    asked: Mapping[int, float],
    new: int,
    plans: Mapping[int, Plan],
) -> None:
    """Raises Refused with the bound if what is asked of a track cannot be had where it is now.

    share : of the array's power that may be radiated
    asked : km of each track
    new   : the track of which it is asked now; of one without a plan nothing is said
    plans : newest ones of the tracks
    """
    plans = {track: plan for track, plan in plans.items() if plan.status == "tracking"}
    if new not in plans:
        return
    model, power = TrackerModel.of(radar, strategy, 0), share * most_for_tracks(radar)
    tracks, gains = list(plans), np.array([plan.gain for plan in plans.values()])
    sure = dict(zip(tracks, sure_powers(radar, gains).tolist(), strict=True))
    alone = most_fixed(power, sum(sure.values()) - sure[new])
    plan = plans[new]
    gain = _gain(radar, plan)
    best_km = settled_km(model, radar.array.n_rx, plan.in_plane, gain * alone) / AIM
    whole = radar.array.power
    if best_km > asked[new]:
        raise Refused(
            f"with {alone / whole:.0%} of the power in each dwell, which is all that one track can have now, track"
            f" {new + 1} at {plan.range_km:.0f} km is known to {best_km:.3g} km across the line of sight;"
            f" asked: {asked[new]:g} km"
        )
    there = {track: km for track, km in asked.items() if track in plans}
    needed = {track: max(_needed(radar, model, plans[track], km, alone), sure[track]) for track, km in there.items()}
    most = most_fixed(power, sum(sure[track] for track in tracks if track not in there))
    if len(there) > 1 and sum(needed.values()) > most:
        others = ", ".join(f"{track + 1} ({needed[track] / whole:.0%})" for track in sorted(there) if track != new)
        left = levelled(np.array([*needed.values()]), most)[list(there).index(new)]
        raise Refused(
            f"it takes {needed[new] / whole:.0%} of the power, beside the accuracies of tracks {others};"
            f" all together can have {most / whole:.0%}, this one {left / whole:.0%}"
        )


def load(radar: RadarConfig, strategy: Strategy) -> None:
    """Load the kernels that `check_accuracies` runs, so that the first one takes no longer than others."""
    belief = np.array([30.0, 0.0, 0.0, 0.0]), np.diag([0.1, 0.1, 0.1, 0.1]) ** 2
    settled_km(TrackerModel.of(radar, strategy, 0), radar.array.n_rx, belief, 100.0)


def _gain(radar: RadarConfig, plan: Plan) -> float:
    return max(echo_gain(radar, plan.gain, np.zeros(2) if plan.gate is None else plan.gate), _LEAST_GAIN)


def _needed(radar: RadarConfig, model: TrackerModel, plan: Plan, km: float, most: float) -> float:
    """Power that keeps an accuracy; `most` if that does not suffice."""
    gain = _gain(radar, plan)
    return min(settled_zeta(model, radar.array.n_rx, plan.in_plane, AIM * km, gain * most) / gain, most)
