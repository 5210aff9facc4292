"""Which track follows which target: matched once, at the end of the acquisition, or assigned anew in each dwell."""

from collections.abc import Mapping, Sequence
from typing import Any

from cogradar.shared.scenario.scenario import Scenario

MessageFields = Mapping[str, Any]


class Matched:
    """Announced tracks: each is the one of a target, or false, from the acquisition on."""

    def __init__(self, scenario: Scenario) -> None:
        self._n_track, self._n_target = scenario.radar.announced, scenario.n_target
        self._n_bin = scenario.radar.array.n_bin
        self._tracks: list[int | None] | None = None  # of each target, None: it has none; without truth: its own
        self.begun = set[int]()  # targets that were there then: a track was begun for each, if only a false one

    def is_made(self, t: int, plans: Sequence[MessageFields], truth: MessageFields | None) -> bool:
        """Whether tracks are followed in dwell t, of which these plans tell; they are matched in the dwell before."""
        if len(plans) < self._n_track:
            return False
        if self._tracks is None:  # t = 0
            self._tracks = list(range(self._n_track)) if truth is None else self._matched(plans, truth)
            return False
        return t > 0  # in real time the first tracking waveform may come too late for this dwell

    def tracks(self, followers: Mapping[int, int]) -> list[int | None]:  # noqa: ARG002 - as of `Assigned`
        """Track of each target."""
        return self._tracks or []

    def _matched(self, plans: Sequence[MessageFields], truth: MessageFields) -> list[int | None]:
        """Track of each target, None where no track began near it, or where it was not there yet."""
        from cogradar.shared.scoring.matching import associate
        from cogradar.shared.signal.array import in_plane

        there = (truth["bins"] >= 0).nonzero()[0]
        self.begun = set(there.tolist())
        measured = in_plane(truth["states"], truth["heights_km"])[there]
        found = associate([estimate_in_plane(plan) for plan in plans], measured, self._n_bin).tolist()
        targets = [int(there[target]) if target >= 0 else None for target in found]
        return [targets.index(target) if target in targets else None for target in range(self._n_target)]


def estimate_in_plane(plan: MessageFields) -> Any:
    """Estimate of a plan with the range and direction that the array measures, (4,)."""
    in_plane = plan.get("plane_estimate")
    return plan["estimate"] if in_plane is None else in_plane


class Assigned:
    """Tracks of an unknown number: each target has the one that follows it in the air picture."""

    def __init__(self, scenario: Scenario) -> None:
        self._n_target = scenario.n_target
        self.begun = set[int]()  # targets that a track has followed

    def is_made(self, t: int, plans: Sequence[MessageFields], truth: MessageFields | None) -> bool:  # noqa: ARG002
        """There is no acquisition."""
        return True

    def tracks(self, followers: Mapping[int, int]) -> list[int | None]:
        """Track of each target, of those that follow one in this dwell."""
        self.begun |= followers.keys()
        return [followers.get(target) for target in range(self._n_target)]
