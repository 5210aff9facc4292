"""The kinds of things that are chosen by name, on one page."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from cogradar.shared.scenario.tables import BELIEFS, DISTURBANCES, OBJECTIVES, POWER_RULES, RULES, SIGNALS


@dataclass(frozen=True)
class Kind:
    """One kind of thing: what is built in, and what a user's own must be."""

    name: str
    stands: str  # where its name does, for messages
    built_in: Mapping[str, str] = field(repr=False, compare=False)  # name -> where it is, "module:attribute"
    protocol: str = ""  # in `cogradar.plugins`; "": there are only the built-in ones
    guard: str = ""  # "module:function" of (thing, caller) -> thing whose answers make sense, or PluginFailed
    loaded_by: tuple[str, ...] = ()  # roles; checks load all

    @property
    def group(self) -> str:
        """Entry points of installed packages that are of this kind."""
        plural = f"{self.name[:-1]}ies" if self.name.endswith("y") else f"{self.name}s"
        return f"cogradar.{plural}"


RULE = Kind(
    "rule",
    "radar.planner.rule",
    RULES,
    "BinRule",
    "cogradar.shared.planning.rules:guarded",
    ("planner",),
)
STRATEGY = Kind(
    "strategy",
    "--strategy",
    POWER_RULES,
    "PowerRule",
    "cogradar.shared.power.rules:guarded",
    ("allocator",),
)
OBJECTIVE = Kind(
    "objective",
    "radar.allocation.objective",
    OBJECTIVES,
    "PowerRule",
    "cogradar.shared.power.rules:guarded",
    ("allocator",),
)
BELIEF = Kind(
    "belief",
    "radar.belief.filter",
    BELIEFS,
    "BeliefFilter",
    "cogradar.shared.tracking.filters:guarded",
    ("planner",),
)
DISTURBANCE = Kind(
    "disturbance",
    "world.disturbance.model",
    DISTURBANCES,
    "Disturbance",
    "cogradar.shared.world.disturbance:guarded",
    ("emulator",),
)
FRONT_END = Kind("front-end", "--front-end", {}, "FrontEnd", "cogradar.services.front_ends:guarded", ("emulator",))
FEED = Kind("feed", "--to", {}, "Format", "cogradar.services.feed.feed:guarded")
SIGNAL = Kind("signal", "world.signal", SIGNALS, loaded_by=("emulator",))

IN_SCENARIO = (RULE, BELIEF, OBJECTIVE, DISTURBANCE)  # whose names stand in a scenario, and may be a user's own
OF_RUN = (STRATEGY, *IN_SCENARIO)
