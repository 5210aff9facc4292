"""How each target fared in each dwell, computed from what was sent in it."""

from collections.abc import Iterable, Mapping
from typing import Any

from shared.protocol.messages import RunStart
from shared.scenario.scenario import Scenario

Fields = Mapping[str, Any]  # of a message
Score = tuple[Any, ...]  # a row of the table `score`, whose columns `Scorer.score` explains
SCORED = ("plan", "scan", "truth", "waveform")  # topics that scores are made of


class Scorer:
    """One run's dwells in their order; tracks are matched with targets at the end of the acquisition, once."""

    def __init__(self, start: RunStart) -> None:
        from shared.signal.receiver import threshold  # not imported by those who only ask for scores

        scenario = Scenario.model_validate(start.scenario)
        self.k = 0  # next dwell
        self._run = start.run
        self._n_track = scenario.radar.tracks
        self._threshold = threshold(scenario.radar.detector.p_fa)
        self._has_truth = scenario.world is not None
        self._tracks: list[int | None] | None = None  # of each target, None: of false tracks; without truth: its own
        self._n_bin = scenario.radar.array.n_bin
        self._waveforms: dict[int, Fields] = {}  # that may be radiated yet
        self._plans: dict[int, Fields] = {}  # newest of each track

    def score(self, k: int, messages: Iterable[tuple[str, Fields]]) -> list[Score]:
        """Scores of dwell k, by target; none while targets are acquired, or if what they are made of is missing."""
        self.k = k + 1
        scan: Fields | None = None
        truth: Fields | None = None
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
            return []
        sent_k = k - 1 if truth is None else truth["waveform_k"]
        self._waveforms = {k: waveform for k, waveform in self._waveforms.items() if k >= sent_k}
        plans = [plan for _, plan in sorted(self._plans.items()) if plan["status"] == "tracking"]
        if len(plans) < self._n_track:
            return []
        if self._tracks is None:  # the last dwell of the acquisition, t = 0
            self._tracks = list(range(self._n_track)) if truth is None else self._matched(plans, truth["states"])
            return []
        if scan["t"] == 0:  # in real time: the first tracking waveform came too late for this dwell
            return []
        return self._rows(k, scan, truth, plans, self._waveforms.get(sent_k))

    def _matched(self, plans: list[Fields], states: Any) -> list[int | None]:
        """Track of each target, None where no track began near it."""
        from shared.scoring.matching import associate

        targets = associate([plan["estimate"] for plan in plans], states, self._n_bin).tolist()
        return [targets.index(target) if target in targets else None for target in range(self._n_track)]

    def _rows(
        self, k: int, scan: Fields, truth: Fields | None, plans: list[Fields], sent: Fields | None
    ) -> list[Score]:
        detected_bins = set(scan["bins"][scan["statistic"] >= self._threshold].tolist())
        signature_powers = dict(zip(scan["bins"].tolist(), scan["signature_power"].tolist(), strict=True))
        rows = []
        for target, track in enumerate(self._tracks or ()):
            beam = None if track is None else int(scan["beams"][track])  # bin that the track asked for
            true_bin = None if truth is None else int(truth["bins"][target])
            own = {"share": 0.0, "late": False}  # of a track that has no beam
            if sent is not None and track is not None:
                own = {"share": float(sent["shares"][track]), "late": bool(sent["late"][track])}
            rows.append(
                (
                    self._run,
                    k,
                    scan["t"],
                    target + 1,
                    None if track is None else track + 1,
                    true_bin,
                    beam,
                    # The cell of the true bin (without truth: of the beam) was tested and exceeded the threshold,
                    # whoever asked for it.
                    (beam if true_bin is None else true_bin) in detected_bins,
                    None if truth is None else float(truth["snr_db"][target]),
                    *(4 * [None] if truth is None else truth["states"][target].tolist()),
                    *(4 * [None] if track is None else plans[track]["estimate"].tolist()),  # mean after this scan
                    own["share"],  # power on the beam
                    None if true_bin is None else signature_powers.get(true_bin, 0.0),  # ||v||^2 there; 0: not tested
                    own["late"],  # beam of a plan extrapolated from an earlier dwell
                    None if truth is None else truth["waveform_k"] != k - 1,  # stale: an older waveform was radiated
                )
            )
        return rows
