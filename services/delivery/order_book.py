"""The orders of one run: which commands are granted, from which dwell on, and which orders are over."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cogradar.services.delivery.pacing import ORDER_S, Pacing
from cogradar.shared.protocol.messages import Command, Plan, Refused
from cogradar.shared.protocol.orders import (
    MAX_LOOKS,
    MAX_ORDERS,
    OF_TRACK,
    Accuracy,
    Action,
    DropTrack,
    EndRun,
    Look,
    Order,
    Pause,
    PowerLimit,
    Priority,
    Resume,
    SectorSearch,
    Setting,
    accuracies,
    dropped,
    in_force,
    is_over,
    looks,
    of_tracks,
    power_share,
    searches,
    settings_of,
    under,
)
from cogradar.shared.protocol.words.orders import text_of
from cogradar.shared.scenario.combinations import check_combination
from cogradar.shared.scenario.faults import listed
from cogradar.shared.scenario.radar_config import RadarConfig, Strategy
from cogradar.shared.signal.array import bin_centres

# Of MAX_ORDERS, so many are kept free for what must not wait. These are the end of a run, a pause or its end and a
# limit that take effect at once, and other orders that take effect at once.
FOR_END, FOR_PAUSES, FOR_LIMITS, FOR_NOW = 1, 16, 15, 8
NEEDS = {"priority": "priorities", "accuracy": "accuracies"}
NAMED = 8  # tracks, where one that is not there is asked for
URGENT_COMMANDS = 500  # of all that a run may ever have, for pauses, their ends and limits


@dataclass(frozen=True)
class Moment:
    """How far a run is when something is asked of it."""

    newest_k: int  # dwell of which a scan has come
    acknowledged_k: int
    last_k: int  # dwell, if it goes on to its end
    tracks: Collection[int]  # that are there
    plans: Mapping[int, Plan]  # newest ones, of tracks with a plan
    is_acquiring: bool  # a known number of targets: the dwell after the newest one may wait until it is measured


class OrderBook:
    """Orders in force, or that will be."""

    def __init__(self, radar: RadarConfig, strategy: Strategy, pacing: Pacing, orders: Iterable[Order] = ()) -> None:
        self._radar, self._strategy, self._pacing = radar, strategy, pacing
        self.orders = list(orders)

    def grant(self, command: Command, n: int, at: Moment) -> tuple[Order, list[Order]]:
        """The order with this number, and those that it replaces before they have shaped a dwell.

        Raises Refused, whose text is for those who asked.
        """
        notice_s = 0.0 if at.is_acquiring else ORDER_S
        first_k = self._pacing.first_ordered(at.newest_k, at.acknowledged_k, notice_s)
        order = Order(n=n, k=max(first_k, command.at), action=command.action)
        last_k = min([at.last_k, *(other.k - 1 for other in self.orders if isinstance(other.action, EndRun))])
        if order.k > last_k:
            raise Refused(f"it would take effect at dwell {order.k}; the run ends with dwell {last_k}")
        replaced = [other for other in self.orders if _is_replaced(other, order)]
        kept = [other for other in self.orders if other not in replaced]
        most = MAX_ORDERS - _kept_free(order, is_now=order.k == first_k)
        if len(kept) >= most:
            raise Refused(f"{len(kept)} orders are in force or pending; this one must be among the first {most}")
        if at.is_acquiring and self._pacing.loses_dwells and order.k == first_k:
            _check_still(order.action)
        self._check(order, at, is_later=command.at > 0)
        if isinstance(order.action, Accuracy) and command.at < first_k:  # of later dwells nothing is known
            self._check_accuracy(order.action, order.k, at.plans)
        self.orders = [*kept, order]
        return order, replaced

    @property
    def takes_accuracies(self) -> bool:
        """Whether an accuracy may be granted; its bound takes a second to load."""
        return self._radar.belief.filter == "gaussian"

    def load(self) -> None:
        """Load what an accuracy is refused by. It may go on in a thread while commands are granted."""
        from cogradar.services.delivery.accuracy import load

        load(self._radar, self._strategy)

    def end(self, k: int, known_k: int, born_ks: Mapping[int, int]) -> list[int]:
        """Drop the orders that shape no dwell from k on; their numbers.

        known_k : the newest dwell before k whose tracks are known; -1: none is
        born_ks : dwell with whose scan each of its tracks began
        """
        over = [order for order in self.orders if order.k < k and self._is_over(order, k, known_k, born_ks)]
        self.orders = [order for order in self.orders if order not in over]
        return [order.n for order in over]

    def _is_over(self, order: Order, k: int, known_k: int, born_ks: Mapping[int, int]) -> bool:
        match order.action:
            case EndRun():
                return False
            case DropTrack():
                return order.k <= known_k and not dropped([order], k, born_ks)
            case Priority() | Accuracy() if (
                self._radar.is_unknown and order.k <= known_k and not of_tracks([order], born_ks)
            ):
                return True
            case _:
                return is_over(order, self.orders, k)

    def _check(self, order: Order, at: Moment, *, is_later: bool) -> None:
        """Raises Refused for an order that makes no sense; one for later may be of a track that is still to come."""
        match order.action:
            case PowerLimit() | Pause() | Resume() | EndRun():
                pass
            case DropTrack():
                self._needs_roster(order.action)
                self._needs_track(order.action, at.tracks, is_later=is_later)
            case Priority():
                self._needs_track(order.action, at.tracks, is_later=is_later)
                self._check_together(order)
            case Accuracy():
                self._needs_track(order.action, at.tracks, is_later=is_later)
                if not self.takes_accuracies:
                    raise Refused(
                        "accuracy: only where directions and ranges are measured and beliefs are Gaussians"
                        ' (radar.belief.filter = "gaussian")'
                    )
                self._check_together(order)
            case Look() | SectorSearch():
                self._needs_roster(order.action)
                self._check_together(order)
            case Setting():
                if order.action.key == "rule" and self._radar.planner.looks == "joint":
                    raise Refused('rule: tracks have none with radar.planner.looks = "joint"')
                self._check_together(order)

    def _needs_roster(self, action: Action) -> None:
        if not self._radar.is_unknown:
            raise Refused(f"{action.kind}: only where the number of targets is unknown (radar.tracks)")

    def _check_accuracy(self, action: Accuracy, k: int, plans: Mapping[int, Plan]) -> None:
        """Raises Refused if all the power there is cannot do it."""
        if action.km is None:
            return
        from cogradar.services.delivery.accuracy import check_accuracies  # a second of import: `load`

        there = in_force(self.orders, k)
        radar, strategy = under(self._radar, self._strategy, settings_of(there))
        asked = accuracies(there) | {action.track: action.km}
        check_accuracies(radar, strategy, power_share(there), asked, action.track, plans)

    def _needs_track(self, action: DropTrack | Priority | Accuracy, tracks: Collection[int], *, is_later: bool) -> None:
        announced = self._radar.announced
        is_there = is_later or action.track in tracks if self._radar.is_unknown else action.track < announced
        if not is_there:
            there = sorted(tracks) if self._radar.is_unknown else range(announced or 0)
            named = listed([f"{track + 1}" for track in there], NAMED)
            raise Refused(f"there is no track {action.track + 1}; those that are there: {named or 'none'}")

    def _check_together(self, new: Order) -> None:
        """At each dwell with other orders: settings are a supported combination, there are beams where some are asked
        for, some direction is searched, no look is blanked, none takes too much.
        """
        orders, centres = [*self.orders, new], bin_centres(self._radar.array.n_bin)
        for k in sorted({order.k for order in orders if order.k >= new.k}):
            there = in_force(orders, k)
            self._check_settings(there, k)
            if not searches(there, centres).any():
                raise Refused(f"from dwell {k} on, every direction would be blanked")
            is_blanked = (
                new in there and isinstance(new.action, Look) and not searches(there, np.array([new.action.nu]))
            )
            if is_blanked:
                raise Refused(f"in dwell {k} this direction is blanked")
            if (share := sum(look.share for look in looks(there))) > MAX_LOOKS + 1e-9:
                raise Refused(f"in dwell {k}, looks would take {share:.2f} of the power, at most {MAX_LOOKS:g} may be")

    def _check_settings(self, there: Sequence[Order], k: int) -> None:
        radar, strategy = under(self._radar, self._strategy, settings_of(there))
        try:
            check_combination(radar.model_dump())
        except ValueError as error:
            raise Refused(f"in dwell {k}: {error}") from None
        wanted = [order.action for order in there if isinstance(order.action, OF_TRACK)]
        if wanted and strategy is not Strategy.POWER_AWARE:
            raise Refused(
                f'in dwell {k} the strategy is "{strategy}", which knows no {NEEDS[wanted[0].kind]} such as'
                f" `{text_of(wanted[0])}`:"
                ' only "power-aware" gives tracks the power that they need'
            )
        is_everywhere = strategy is Strategy.ORTHOGONAL or (
            radar.search is not None and radar.search.pattern == "isotropic"
        )
        if is_everywhere and (steered := [o.action for o in there if isinstance(o.action, Look | SectorSearch)]):
            raise Refused(
                f"in dwell {k} the radar would search in all directions at once: there are no beams to steer for"
                f" `{text_of(steered[0])}`"
            )


def _check_still(action: Action) -> None:
    """Raises Refused for what would last for ever: in real time an acquisition stands still without measurements."""
    if isinstance(action, Pause) and action.dwells is not None:
        raise Refused("pause: no dwells are counted while targets are acquired: pause without a number, then resume")


def _is_replaced(pending: Order, new: Order) -> bool:
    """Whether an order shapes no dwell because of a new one: nothing follows the end of a run."""
    if isinstance(new.action, EndRun):
        return pending.k >= new.k
    if pending.k != new.k:
        return False
    match new.action, pending.action:
        case (PowerLimit(), PowerLimit()) | (Pause() | Resume(), Pause() | Resume()):
            return True
        case (
            (Setting(key=one), Setting(key=other))
            | (Priority(track=one), Priority(track=other))
            | (Accuracy(track=one), Accuracy(track=other))
        ):
            return one == other
        case SectorSearch() as sector, SectorSearch() as earlier:
            return sector.contains(earlier)
        case _:
            return False


def commands_kept_free(command: Command) -> int:
    """How many of the commands that a run may ever have must be left for what is more urgent than this one.

    An end that is asked for at once is granted once; there is no later one.
    """
    match command.action:
        case EndRun() if command.at == 0:
            return 0
        case Pause() | Resume() | PowerLimit():
            return FOR_END
        case _:
            return FOR_END + URGENT_COMMANDS


def _kept_free(new: Order, *, is_now: bool) -> int:
    """How many of MAX_ORDERS must be left for what is more urgent than this order."""
    if isinstance(new.action, EndRun):
        return 0
    if is_now and isinstance(new.action, Pause | Resume):
        return FOR_END
    if is_now and isinstance(new.action, PowerLimit):
        return FOR_END + FOR_PAUSES
    return FOR_END + FOR_PAUSES + FOR_LIMITS + (0 if is_now else FOR_NOW)
