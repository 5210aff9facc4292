"""What things of your own are made of; docs/howto/extending.md shows each kind.

A front end has a module of its own, `cogradar.front_end`.
"""

from cogradar.services.feed.output import Format, Output
from cogradar.services.feed.picture import Picture, Plot, Track
from cogradar.shared.planning.radar_pomdp import RadarPomdp
from cogradar.shared.planning.rules import BinRule, Choice, most_probable_bin
from cogradar.shared.power.rules import Emission, PowerRule, Requests
from cogradar.shared.scenario.plugins.sources import allow
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.signal.angle import bin_of
from cogradar.shared.signal.waveform import beam_factor
from cogradar.shared.tracking.belief.own import BeliefFilter, Observation, normal_states
from cogradar.shared.tracking.motion import mean_state, predicted_bins, predicted_mean
from cogradar.shared.world.disturbance import Disturbance

__all__ = [
    "BeliefFilter",
    "BinRule",
    "Choice",
    "Disturbance",
    "Emission",
    "Format",
    "Observation",
    "Output",
    "Picture",
    "Plot",
    "PowerRule",
    "RadarConfig",
    "RadarPomdp",
    "Requests",
    "Track",
    "allow",
    "beam_factor",
    "bin_of",
    "mean_state",
    "most_probable_bin",
    "normal_states",
    "predicted_bins",
    "predicted_mean",
]
