"""How each target fared in each dwell, and all tracks and targets together, computed from what was sent in it."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from cogradar.services.metrics.scoring.coasting import coasted
from cogradar.services.metrics.scoring.pairing import Assigned, Matched, estimate_in_plane
from cogradar.shared.protocol.messages import RunStart
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scoring.columns import PICTURE, SCORE, PictureDwell, TargetDwell, row
from cogradar.shared.scoring.figures import Totals

REMEMBERED = 4096  # tracks of a run without truth, the newest: as `shared.scoring.picture` has it
MessageFields = Mapping[str, Any]  # of a message
Row = dict[str, Any]  # of the table `score` or `picture`
# Bins between a belief and its target from which on the track is out of the bin: steered cells as joint looks.
OUT_BY = {"single": 1, "joint": 2}
SCORED = ("plan", "scan", "truth", "waveform")  # topics that scores are made of


class Scored(NamedTuple):
    """A dwell."""

    t: int
    targets: list[Row]
    picture: Row


class Scorer:
    """One run's dwells in their order."""

    def __init__(self, start: RunStart) -> None:
        from cogradar.shared.scoring.scan_rows import ScanRows  # not imported by those who only ask for scores

        scenario = Scenario.model_validate(start.scenario)
        self.k = 0  # next dwell
        self._run = start.run
        self._scan_rows = ScanRows.of(scenario.radar)
        self._has_truth = scenario.world is not None
        self._pairing = Assigned(scenario) if scenario.radar.is_unknown else Matched(scenario)
        self._n_bin, self._dt_s = scenario.radar.array.n_bin, scenario.radar.motion.dt_s
        self._waveforms: dict[int, MessageFields] = {}  # that may be radiated yet
        self._plans: dict[int, MessageFields] = {}  # newest of each track that is there,
        self._now: dict[int, MessageFields] = {}  # ... as they are in the dwell that is scored
        self._motion = scenario.radar.motion
        is_steered = scenario.radar.receiver.cells == "steered"
        self._out_by = OUT_BY["joint" if is_steered else scenario.radar.planner.looks]
        self._picture = AirPictureScorer(scenario)
        self._outages = [0] * scenario.n_target  # dwells in a row that each target's track has been out of its bin
        self._flown: tuple[int, Any] | None = None  # clock and velocities, (M, 2), in the last dwell with a truth

    def score(self, k: int, messages: Iterable[tuple[str, MessageFields]]) -> Scored | None:
        """Scores of dwell k; None while targets are acquired, or if what they are made of is missing."""
        self.k = k + 1
        best_bins = {track: self._expected_bin(plan, k) for track, plan in self._plans.items()}
        scan: MessageFields | None = None
        truth: MessageFields | None = None
        for topic, fields in messages:
            match topic:
                case "plan":
                    self._plans[fields["target"]] = fields
                case "scan":
                    scan = fields
                case "truth":
                    truth = fields
                case "waveform":
                    self._waveforms[k] = fields
        if scan is None or (truth is None and self._has_truth):
            return None
        accelerations = self._accelerations(truth)
        from cogradar.shared.scoring.scan_rows import radiated_k

        sent_k, places = radiated_k(k, scan, truth), _rows_of(scan)
        self._waveforms = {k: waveform for k, waveform in self._waveforms.items() if k >= sent_k}
        sent = self._waveforms.get(sent_k)
        if sent is not None and _rows_of(sent) != places:  # it is not known which waveform was radiated
            sent = None
        self._plans = {track: self._plans[track] for track in places if track in self._plans}
        self._now = {track: coasted(plan, k, self._motion) for track, plan in self._plans.items()}
        plans = [plan for plan in self._now.values() if _is_shown(plan)]
        if not self._pairing.is_made(scan["t"], plans, truth):
            return None
        best_bins |= {track: self._born_bin(scan, places[track]) for track in self._plans.keys() - best_bins.keys()}
        picture, followers = self._picture.advance(scan["t"], plans, truth)
        tracks = self._pairing.tracks(followers)
        said = scan, truth, sent, sent_k != k - 1
        targets = [row(SCORE, dwell) for dwell in self._rows(k, tracks, said, best_bins, accelerations)]
        n_track, began, total = picture
        n_late = 0 if sent is None else int((sent["late"] > 0).sum())
        counts = (n_track, began, *_cell_counts(scan), sent_k, n_late, total)
        return Scored(scan["t"], targets, row(PICTURE, PictureDwell(self._run, k, scan["t"], *counts)))

    def _born_bin(self, scan: MessageFields, row: int) -> int:
        """Where a track was expected in the dwell that its first plan is of, which it was born before."""
        from cogradar.shared.signal.array import angle_bin

        return int(angle_bin(scan["roster"]["expected"][row, 0], self._n_bin))

    def _expected_bin(self, plan: MessageFields, k: int) -> int:
        """Most probable bin in dwell k; if that dwell's plan is late, the one that the newest estimate flies to."""
        if plan["k"] >= k - 1 or plan["status"] != "tracking":
            return int(plan["best_bin"])
        from cogradar.shared.signal.array import angle_bin, spatial_frequency
        from cogradar.shared.tracking.motion import predicted_mean

        state = predicted_mean(estimate_in_plane(plan), self._dt_s * (k - plan["k"]))
        return int(angle_bin(spatial_frequency(state), self._n_bin))

    def _rows(
        self,
        k: int,
        tracks: list[int | None],
        said: tuple[MessageFields, MessageFields | None, MessageFields | None, bool],
        best_bins: Mapping[int, int],
        accelerations: Sequence[float | None],
    ) -> list[TargetDwell]:
        """A row for each target; said: scan, truth, the waveform that was radiated, and whether it was stale."""
        (scan, truth, sent, is_stale), rows = said, list[TargetDwell]()
        places = _rows_of(scan)
        beams = [-1 if track is None else places[track] for track in tracks]
        seen = None if truth is None else self._seen(scan, truth, beams)
        for target, track in enumerate(tracks):
            lit = None if track is None else places[track]  # row of its beams
            cells = [] if lit is None else _cells(scan, sent, lit)
            true_bin = None if truth is None or truth["bins"][target] < 0 else int(truth["bins"][target])
            state = None if truth is None or true_bin is None else truth["states"][target]
            detected, power, hit = None, None, None  # of a target that is not there
            if seen is None:
                detected = False if track is None else self._scan_rows.beam_is_over(scan, track)
            elif true_bin is not None:
                detected, power, hit = seen[0][target], seen[1][target], seen[2][target]
            plan, best_bin = (None, None) if track is None else (self._now[track], best_bins[track])
            may_be_out = true_bin is not None and (track is not None or target in self._pairing.begun)
            is_out = may_be_out and (best_bin is None or true_bin is None or abs(best_bin - true_bin) >= self._out_by)
            self._outages[target] = self._outages[target] + 1 if is_out else 0
            rows.append(
                TargetDwell(
                    run=self._run,
                    k=k,
                    t=scan["t"],
                    target=target + 1,
                    track=None if track is None else track + 1,
                    true_bin=true_bin,
                    bin=cells[0][0] if cells else None,
                    detected=detected,
                    snr_db=None if truth is None or true_bin is None else float(truth["snr_db"][target]),
                    **_components(state, ""),
                    z=None if truth is None or true_bin is None else float(truth["heights_km"][target]),
                    **_components(None if plan is None else plan["estimate"], "_hat"),  # mean after this scan
                    covariance=None if plan is None else plan["covariance"],
                    signature_power=power,
                    late=sent is not None
                    and lit is not None
                    and bool(sent["late"][lit]),  # an extrapolated plan's beam
                    stale=is_stale,
                    hit=hit,
                    best_bin=best_bin,
                    outage=self._outages[target] if may_be_out else None,
                    cells=cells,
                    acceleration_g=accelerations[target],
                    visible=None if true_bin is None else target + 1 in self._picture.counting,
                )
            )
        return rows

    def _accelerations(self, truth: MessageFields | None) -> list[float | None]:
        """Acceleration of each target since the last dwell with a truth, in g; None: it was not there in both."""
        from numpy import isnan, nan, newaxis, where

        if truth is None:
            return [None] * len(self._outages)
        from cogradar.shared.scoring.errors import acceleration_g

        velocities = where(truth["bins"][:, newaxis] >= 0, truth["states"][:, 1::2], nan)
        before, self._flown = self._flown, (truth["t"], velocities)
        if before is None or before[0] >= truth["t"]:  # targets stand still while they are acquired
            return [None] * len(velocities)
        found = acceleration_g(before[1], velocities, self._dt_s * (truth["t"] - before[0]))
        return [None if isnan(value) else value for value in found.tolist()]

    def _seen(
        self, scan: MessageFields, truth: MessageFields, beams: Sequence[int]
    ) -> tuple[list[bool | None], list[float], list[bool]]:
        """Of each target: whether a cell that holds it was over its limit, for any track. Then the largest ||v||^2 that
        an echo from there met, 0: none tested, and whether a direction within half a bin was lit for its track, whose
        row of the beams is given. The first is None if a look that would have heard it was not measured, whatever
        others found.
        """
        states, rows = _measured(truth), self._scan_rows.read(scan)
        detected, met, lit = self._scan_rows.seen(rows, states, beams)
        is_open = self._scan_rows.misses_looks(rows, states)
        known = [None if is_one else found for is_one, found in zip(is_open.tolist(), detected.tolist(), strict=True)]
        return known, met.tolist(), lit.tolist()


class AirPictureScorer:
    """Tracks and targets of one run, all together."""

    def __init__(self, scenario: Scenario) -> None:
        from cogradar.shared.scoring.detectability import Detectability
        from cogradar.shared.scoring.picture import AirPicture, Objects  # not imported by those who only ask for scores

        self._air, self._objects = AirPicture(), Objects
        self._detectability = None if scenario.world is None else Detectability.of(scenario)
        self.counting: set[int] = set()  # targets that could be found by now, from 1
        self._known: set[int] = set()  # tracks, without truth

    def advance(
        self, t: int, plans: list[MessageFields], truth: MessageFields | None
    ) -> tuple[tuple[int, int, Totals | None], dict[int, int]]:
        """Tracks, new tracks, and with truth what dwell t comes to; the track of each target that has one, from 0."""
        tracks = [plan["target"] + 1 for plan in plans]
        if truth is None or self._detectability is None:
            began = len(set(tracks) - self._known)
            self._known.update(tracks)
            if len(self._known) > 2 * REMEMBERED:
                self._known = {*sorted(self._known)[-REMEMBERED:], *tracks}
            return (len(tracks), began, None), {}
        from numpy import array, flatnonzero

        estimates = array([plan["estimate"] for plan in plans]).reshape(-1, 4)
        rows = flatnonzero(truth["bins"] >= 0)  # an absent target has no bin
        targets, states = (rows + 1).tolist(), truth["states"][rows]
        if not self.counting.issuperset(targets):
            found = self._detectability.finds(rows, _measured(truth)[rows], truth["snr_db"][rows]).tolist()
            self.counting.update(target for target, is_found in zip(targets, found, strict=True) if is_found)
        counts = [target in self.counting for target in targets]
        total, followers = self._air.advance(
            t, self._objects(tracks, estimates), self._objects(targets, states), counts
        )
        followed = {target - 1: track - 1 for target, track in followers.items()}
        return (total.tracks, total.began, total), followed


def _cell_counts(scan: MessageFields) -> tuple[int, int, int]:
    """Cells that were tested, of them the blind ones, and looks that were not measured."""
    from cogradar.shared.scoring.scan_rows import is_blind, is_tested

    unmeasured = scan.get("unmeasured")
    return int(is_tested(scan).sum()), int(is_blind(scan).sum()), 0 if unmeasured is None else len(unmeasured)


def _measured(truth: MessageFields) -> Any:
    """States where the array measures the targets, (M, 4); 0 of those that are not there."""
    from numpy import newaxis, where

    from cogradar.shared.signal.array import in_plane

    return in_plane(where(truth["bins"][:, newaxis] >= 0, truth["states"], 0.0), truth["heights_km"])


def _is_shown(plan: MessageFields) -> bool:
    """Whether a plan is of a track that users are told of: if their number is unknown, it must be confirmed."""
    return bool(plan["status"] == "tracking" and plan.get("confirmed", True))


def _components(state: Any, suffix: str) -> dict[str, Any]:
    """A state by the names of its columns."""
    names = [name + suffix for name in ("x", "vx", "y", "vy")]
    return dict(zip(names, 4 * [None] if state is None else state.tolist(), strict=True))


def _rows_of(scan: MessageFields) -> dict[int, int]:
    """Row of the beams of each track."""
    from cogradar.shared.scoring.scan_rows import tracks_in

    return {track: row for row, track in enumerate(tracks_in(scan).tolist())}


def _cells(scan: MessageFields, sent: MessageFields | None, row: int) -> list[tuple[int, float]]:
    """The cells that were lit for a track, and the power on each as far as its waveform is known."""
    beams = scan["beams"][row].tolist()
    is_known = sent is not None and sent["beams"][row].tolist() == beams
    shares = sent["shares"][row].tolist() if sent is not None and is_known else [0.0] * len(beams)
    return [(bin_, share) for bin_, share in zip(beams, shares, strict=True) if bin_ >= 0]
