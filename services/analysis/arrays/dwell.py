"""One dwell of a run, with the tables of a `Result`."""

from collections.abc import Sequence

from cogradar.services.analysis.arrays import records
from cogradar.services.analysis.arrays.records import Records
from cogradar.services.errors import BadInput
from cogradar.services.runs.dwell import DwellMessages
from cogradar.shared.protocol.messages import Plan, Waveform
from cogradar.shared.scenario.scenario import Scenario


class Dwell:
    """One dwell of a run that is being played, or is stored; its tables have the same columns as in `Result`."""

    def __init__(self, said: DwellMessages, scenario: Scenario) -> None:
        self._said, self.scenario = said, scenario
        self.k: int = said.k  # counted from 0, acquisition included
        self.t: int = said.scan.t  # counted from 1 after the acquisition, 0 during it

    def __repr__(self) -> str:
        return f"<Dwell k = {self.k}, t = {self.t}: {len(self.detections())} detections, {len(self.tracks())} tracks>"

    def detections(self, *, all_looks: bool = False) -> Records:
        """Every tested cell over its limit, or all tested cells."""
        truths = None if self._said.truth is None else {self.k: self._said.truth}
        return records.detections(self.scenario.radar, [self._said.scan], truths, all_looks=all_looks)

    def tracks(self) -> Records:
        """The tracks after this dwell; which target each follows is known at the end only."""
        return records.tracks(self._dt_s, self._said.plans, self._sent)

    def requests(self) -> Records:
        """The cells that each track asks for in the next dwell."""
        return records.requests(self._dt_s, self.scenario.radar.array.n_bin, self._said.plans)

    def truth(self) -> Records:
        """The targets. Raises BadInput where there is no truth."""
        if self._said.truth is None:
            raise BadInput("there is no truth: the front end does not know where targets are")
        return records.truth(self._dt_s, [self._said.truth])

    def waveforms(self) -> Records:
        """What was radiated, one row."""
        return records.waveforms(self._dt_s, [(self.k, self.t)], self._sent, self.scenario.radar.array.n_tx)

    @property
    def has_truth(self) -> bool:
        """Whether it is known where the targets are."""
        return self._said.truth is not None

    @property
    def utc_s(self) -> float | None:
        """When the dwell was measured, s since 1970 in UTC, if the front end says so."""
        return self._said.scan.utc_s

    @property
    def front_end(self) -> str | None:
        """Your own front end that measured the dwell, FILE.py:NAME with the hash of its source; None: another one."""
        return self._said.scan.front_end

    @property
    def plans(self) -> Sequence[Plan]:
        """What each track asks for, as messages."""
        return self._said.plans

    @property
    def next(self) -> Waveform | None:
        """What will be radiated in the dwell that follows, as a message."""
        return self._said.next

    @property
    def _dt_s(self) -> float:
        return self.scenario.radar.motion.dt_s

    @property
    def _sent(self) -> dict[int, Waveform]:
        return {} if self._said.sent is None else {self.k: self._said.sent}
