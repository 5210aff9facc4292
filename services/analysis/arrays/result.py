"""One run as NumPy arrays. Lengths are in km, velocities in km/s; targets count from 1 where they are asked for."""

import weakref
from collections.abc import Callable, Iterator
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cogradar.services.analysis.arrays import records
from cogradar.services.analysis.arrays.dwell import Dwell
from cogradar.services.analysis.arrays.messages import ByBin, OfTargets, Picture, by_target, radiated
from cogradar.services.analysis.arrays.tracks import Tracks, sent_in
from cogradar.services.errors import BadInput
from cogradar.shared.protocol.messages import Plan, Scan, Truth, Waveform
from cogradar.shared.protocol.topics import BY_MESSAGE
from cogradar.shared.scenario.plugins.names import PluginError
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scoring.columns import REAL, SHOWN
from cogradar.shared.scoring.errors import position_error, rmse, velocity_error, wilson_interval
from cogradar.shared.scoring.scan_rows import ScanRows
from cogradar.shared.signal.array import in_plane
from cogradar.shared.signal.waveform import antenna_powers, beampattern, peak_to_average_db
from cogradar.shared.wire.codec import decode

if TYPE_CHECKING:
    from cogradar.services.analysis.drawing.run_plots import RunPlots
    from cogradar.services.analysis.stored_run import StoredRun

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


class Result:
    """A run, as far as it has come. T dwells, M targets, L bins; row i is dwell `t[i]`, column m target m + 1.

    Everything is read, or worked out, when it is first asked for, and kept. What the run does not have raises BadInput:
    the truth where the scenario has no [world]; scans and waveforms in a campaign's store, which has few of them.
    """

    def __init__(
        self,
        stored: "StoredRun",
        save: Callable[[str], None] | None = None,
        close: Callable[[], None] | None = None,
    ) -> None:
        """save  : writes the store of a run that is in no file into one
        close : closes a store that nothing else reads; called with the last reference to the result
        """
        self._stored, self._save = stored, save
        if close is not None:
            weakref.finalize(self, close)
        row = stored.row
        self.run: str = stored.name
        self.scenario = stored.scenario
        self.strategy: Strategy = stored.start.strategy
        self.seed: int = row["seed"]
        self.status: str = row["status"]  # running, complete, stopped, failed or quarantined
        self.acquisition_scans: int = row["acquisition_scans"]  # scans before dwell 1; None while targets are searched
        self.digest: str = row["digest"]  # SHA-256 over scans, plans, waveforms: of the same inputs the same

    def __repr__(self) -> str:
        what = f"seed {self.seed}, {len(self.t)} dwells of {self.scenario.n_target} targets"
        return f"<Result {self.run}: {self.strategy}, {what}, {self.status}>"

    def save(self, file: str | Path) -> None:
        """Keep the run in a new file, which `cogradar.open` and the command line read. Raises BadInput."""
        if self._save is None:
            raise BadInput(f"{self.run}: is in a store already: copy its file")
        self._save(str(file))

    @property
    def plot(self) -> "RunPlots":
        """Pictures of it, on matplotlib: `plot.scope(dwell)`, `plot.track(2)`, `plot.beampattern(dwell)`."""
        from cogradar.services.analysis.drawing.run_plots import RunPlots

        return RunPlots(self)

    @property
    def t(self) -> Ints:
        """Dwells after the acquisition, (T,); in real time some may be missing."""
        return self._scores[0]

    @property
    def times_s(self) -> Floats:
        """Their times after the acquisition, (T,), s."""
        return np.asarray(self.t * self.scenario.radar.motion.dt_s, dtype=np.float64)

    @property
    def estimates(self) -> Floats:
        """Mean of the belief after the dwell's scan, [x, vx, y, vy], (T, M, 4), km and km/s; NaN without a track."""
        return self._states("x_hat", "vx_hat", "y_hat", "vy_hat")

    @property
    def bins(self) -> Ints:
        """Angle bin lit for the track, of several the brightest, (T, M); -1 if none was, or without a track."""
        return self.column("bin")

    @property
    def shares(self) -> Floats:
        """Power on the track's beams, linear, (T, M)."""
        return self._column("share")

    @cached_property
    def cells(self) -> Floats:
        """All cells lit for the track, brightest first: bin and power of each, (T, M, most, 2); NaN: no further one."""
        places, rows = {t: i for i, t in enumerate(self.t.tolist())}, self._stored.scores()
        most = max((len(row["cells"]) for row in rows), default=0)
        found = np.full((len(places), self.scenario.n_target, most, 2), np.nan)
        for row in (row for row in rows if row["cells"]):
            found[places[row["t"]], row["target"] - 1, : len(row["cells"])] = row["cells"]
        return found

    @property
    def best_bins(self) -> Ints:
        """Most probable bin of the belief before the dwell's scan, (T, M); -1 without a track."""
        return self.column("best_bin")

    @property
    def outages(self) -> Ints:
        """Dwells in a row, up to this one, that the track has been out of its target's bin, (T, M); 0 without it."""
        self._known_truth()
        return self.column("outage")

    @property
    def nees(self) -> Floats:
        """Error of the estimate over its covariance, squared, (T, M); NaN of a belief that spans no volume."""
        self._known_truth()
        return self._column("nees")

    @property
    def detected(self) -> Bools:
        """A cell that holds the target (without truth: that the track asked for) was over the threshold, (T, M)."""
        return self.column("detected")

    @property
    def hits(self) -> Bools:
        """The true bin, or a direction half a bin from the target, was lit for the track, (T, M); with truth only."""
        return self.column("hit")

    @property
    def late(self) -> Bools:
        """The track's plan came too late, and an older one was extrapolated, (T, M)."""
        return self.column("late")

    @property
    def stale(self) -> Bools:
        """The waveform came too late, and an older one was radiated, (T, M)."""
        return self.column("stale")

    @property
    def has_truth(self) -> bool:
        """Whether it is known where the targets were."""
        return bool(self._stored.row["has_truth"])

    @property
    def present(self) -> Bools:
        """Whether the target is there, (T, M)."""
        return ~np.isnan(self._column("detected"))

    @property
    def true_states(self) -> Floats:
        """State of the target, [x, vx, y, vy], (T, M, 4), km and km/s; NaN while it is not there."""
        self._known_truth()
        return self._states("x", "vx", "y", "vy")

    @property
    def heights_km(self) -> Floats:
        """Height of the target, (T, M); NaN while it is not there."""
        self._known_truth()
        return self._column("z")

    @property
    def true_bins(self) -> Ints:
        """Angle bin that the target was in, (T, M); -1 while it is not there."""
        self._known_truth()
        return self.column("true_bin")

    @property
    def snr_db(self) -> Floats:
        """Signal-to-noise ratio per virtual channel, before the array's gain, (T, M), dB."""
        self._known_truth()
        return self._column("snr_db")

    @property
    def scored(self) -> Bools:
        """Dwells that P_D is of, (T, M): with the target and, of an unknown number, from the one that followed it."""
        self._known_truth()
        return self.present & (~np.isnan(self._column("outage")) | (not self.scenario.radar.is_unknown))

    @property
    def p_d(self) -> Floats:
        """Share of the dwells `scored` in which the target was detected, (M,); NaN of one that has none."""
        return np.asarray(np.ma.masked_array(self.detected, ~self.scored).mean(axis=0).filled(np.nan))

    @property
    def p_d_interval(self) -> Floats:
        """Wilson's 95 % interval of `p_d`, (M, 2), as if dwells were independent; (0, 1) of one that has none."""
        return np.stack(wilson_interval((self.detected & self.scored).sum(axis=0), self.scored.sum(axis=0)), axis=-1)

    @property
    def position_rmse_km(self) -> Floats:
        """Root mean squared distance between estimate and truth over the dwells, (M,), km."""
        return rmse(position_error(self.estimates, self.true_states))

    @property
    def velocity_rmse_km_s(self) -> Floats:
        """Root mean squared error of the velocity over the dwells, (M,), km/s."""
        return rmse(velocity_error(self.estimates, self.true_states))

    @cached_property
    def picture(self) -> Picture:
        """All tracks and targets together: GOSPA and its parts, OSPA of each dwell, and figures of the whole run."""
        self._known_truth()
        return Picture.of(self._stored.pictures(), self._stored.figures())

    # From the scans. L bins: NaN where a bin was not tested (`ByBin`).

    @property
    def has_scans(self) -> bool:
        """Whether its scans are stored."""
        return next(self._stored.messages("scan"), None) is not None

    @cached_property
    def utc_s(self) -> Floats:
        """When each dwell was, (T,), s since 1970 in UTC; NaN: unknown.

        As the front end says, or, if it says no time in the whole run, as the site.
        """
        begin_s = None if self.scenario.site is None else self.scenario.site.begin_s
        places, found = {k: i for i, k in enumerate(self._scores[1].tolist())}, np.full(len(self.t), np.nan)
        for scan in self._stored_of(Scan) if self.has_scans else ():
            if scan.utc_s is not None and scan.k in places:
                found[places[scan.k]] = scan.utc_s
        return begin_s + self.times_s if begin_s is not None and np.isnan(found).all() else found

    @property
    def tested(self) -> Bools:
        """Whether the cell of a bin was tested, (T, L)."""
        return ~np.isnan(self.statistics)

    @property
    def statistics(self) -> Floats:
        """Wald-type statistic of each cell, (T, L)."""
        return self._scans.statistic

    @property
    def sigma_hat(self) -> Floats:
        """Estimated standard deviation of `alpha_hat`, (T, L)."""
        return self._scans.sigma_hat

    @property
    def alpha_hat(self) -> NDArray[np.complex128]:
        """Estimated echo amplitude of each cell, (T, L), complex."""
        return self._scans.alpha_hat

    @cached_property
    def measured(self) -> OfTargets:
        """What the scans say of each target, (T, M) each: statistic, direction and range as far as measured."""
        numbers = np.nan_to_num(self._column("track")[:1]).astype(np.int64).ravel().tolist()
        tracks = [None if self.has_truth else number - 1 for number in numbers]
        states = in_plane(self._states("x", "vx", "y", "vy"), self._column("z"))
        scans, ks = self._stored_of(Scan), self._scores[1].tolist()
        return OfTargets.of(ScanRows.of(self.scenario.radar), scans, ks, states, tracks)

    @property
    def isotropic(self) -> Floats:
        """Power that was radiated evenly in all directions, (T,)."""
        return self._waveforms[0]

    @property
    def factors(self) -> NDArray[np.complex128]:
        """F of what was radiated, R = isotropic / n_tx I + F F^H, (T, n_tx, r); columns of zeros where it has fewer."""
        return self._waveforms[1]

    def beampatterns(self, nu: ArrayLike) -> Floats:
        """Power a^T R a^* that each dwell sent towards spatial frequencies nu = 0.5 sin(angle), (n,) -> (T, n)."""
        beyond = np.atleast_1d(np.asarray(nu, dtype=np.float64))
        beyond = beyond[~(np.abs(beyond) <= 0.5)]
        if beyond.size:
            raise BadInput(f"nu = {beyond[0]:g}: must be -0.5 .. 0.5, half the sine of an angle from boresight")
        return np.array([beampattern(*sent, nu) for sent in zip(self.isotropic.tolist(), self.factors, strict=True)])

    @cached_property
    def antenna_powers(self) -> Floats:
        """Power of each transmit antenna in each dwell, (T, n_tx)."""
        sent = zip(self.isotropic.tolist(), self.factors, strict=True)
        return np.array([antenna_powers(*one) for one in sent])

    @cached_property
    def papr_db(self) -> Floats:
        """Peak over mean power of each transmit antenna, (T, n_tx), dB, with shifts of one Zadoff-Chu sequence."""
        sent = zip(self.isotropic.tolist(), self.factors, strict=True)
        return np.array([peak_to_average_db(*one) for one in sent])

    # From the plans.

    @cached_property
    def covariance(self) -> Floats:
        """Covariance of the belief about [x, vx, y, vy], (T, M, 4, 4), km and km/s; NaN without a track, or a plan."""
        found = np.full((*self.present.shape, 4, 4), np.nan)
        i, n = np.nonzero(self.by_track.targets)
        found[i, self.by_track.targets[i, n] - 1] = self.by_track.covariance[i, n]
        return found

    @cached_property
    def by_track(self) -> Tracks:
        """All tracks that ever were, whatever they follow: of an unknown number they begin and end (`Tracks`)."""
        ks = self._scores[1].tolist()
        plans, sent = self._stored_of(Plan), sent_in(self._stored_of(Waveform, Truth, Scan), ks)
        return Tracks.of(plans, sent, ks, self._column("track"))

    def dwells(self) -> Iterator[Dwell]:
        """Its dwells in their order, acquisition included, as `cogradar.play` has them: one at a time is in memory.

        Raises BadInput if no scan is stored.
        """
        return (Dwell(said, self.scenario) for said in self._stored.dwells())

    # Tables: structured arrays, a row per thing and dwell, acquisition included (`Records`).

    def detections(self, *, all_looks: bool = False) -> records.Records:
        """Every tested cell over its limit, or all tested cells: direction, range, statistic, limit, amplitude, sigma.

        Columns as in `cogradar.services.analysis.arrays.records.detections`.
        """
        truths = {truth.k: truth for truth in self._stored_of(Truth)} if self.has_truth else None
        return records.detections(self.scenario.radar, self._stored_of(Scan), truths, all_looks=all_looks)

    def tracks(self) -> records.Records:
        """The tracks of each dwell: state and covariance, existence, detection, share of the power, target followed."""
        followed = {
            (int(k), int(track)): m + 1
            for k, row in zip(self._scores[1], self._column("track"), strict=True)
            for m, track in enumerate(row)
            if track > 0
        }
        plans = self._stored_of(Plan)
        return records.tracks(self._dt_s, plans, self._sent, followed if self.has_truth else None)

    def requests(self) -> records.Records:
        """The cells that each track asked for, after each dwell, with the probabilities of the target in them."""
        return records.requests(self._dt_s, self.scenario.radar.array.n_bin, self._stored_of(Plan))

    def truth(self) -> records.Records:
        """The targets of each dwell: state on the ground, height, bin, signal-to-noise ratio."""
        self._known_truth()
        return records.truth(self._dt_s, self._stored_of(Truth))

    def waveforms(self) -> records.Records:
        """What each dwell radiated: power spread evenly, and the factor of its covariance."""
        dwells = [(scan.k, scan.t) for scan in self._stored_of(Scan)]
        return records.waveforms(self._dt_s, dwells, self._sent, self.scenario.radar.array.n_tx)

    # From the beliefs, which follow from the scans. A dwell costs what the planner's update of it did, without search.

    def particles(self, target: int | None, dwell: int, track: int | None = None) -> Floats:
        """Particles of the belief about a target after a dwell, (n, 4), or of a track. All of them count from 1."""
        n_target, (at,) = self.scenario.n_target, np.nonzero(self.t == dwell)
        if target is not None and not 1 <= target <= n_target:
            raise BadInput(f"target = {target}: must be 1 .. {n_target}")
        if not at.size:
            raise BadInput(f"dwell = {dwell}: {self.run} has no such dwell")
        k = self._scores[1][at[0]]
        if target is not None:
            followed = self._column("track")[at[0], target - 1]
            track = None if np.isnan(followed) else int(followed)
        if track is None:
            raise BadInput(f"target = {target}: {self.run} has no track of it")
        try:
            for states in self._stored.states([track - 1], int(k)):
                if track - 1 in states and states[track - 1].k == k:
                    return states[track - 1].belief.sample()
        except PluginError as error:
            raise BadInput(str(error)) from None
        raise BadInput(f"dwell = {dwell}: {self.run} has no track {track} in it, or no scan of it")

    @cached_property
    def _scores(self) -> tuple[Ints, Ints, dict[str, Floats]]:
        """Dwells t and k, (T,), and the columns of `tracks`, (T, M) each; NaN: unknown."""
        return by_target(self._stored.scores() or self._stored.pictures(), self.scenario.n_target)

    def column(self, name: str) -> NDArray[Any]:
        """A column of the scores, (T, M). What is unknown is NaN, False, 0, or of bins -1."""
        (kind,) = (column.kind for column in SHOWN if column.name == name)
        values = self._column(name)
        return values if kind is REAL else np.nan_to_num(values, nan=kind.missing).astype(kind.python)

    def _column(self, name: str) -> Floats:
        t, _, columns = self._scores
        return columns[name] if columns else np.empty((t.size, self.scenario.n_target))

    def _states(self, *names: str) -> Floats:
        return np.stack([self._column(name) for name in names], axis=-1)

    def _known_truth(self) -> None:
        if not self.has_truth:
            raise BadInput(f"{self.run}: there is no truth to compare with")

    def _stored_of(self, *messages: type[Any]) -> list[Any]:
        """All stored messages of these kinds, by dwell. Raises BadInput if none are kept; a run may have no tracks."""
        topics = [BY_MESSAGE[message].name for message in messages]
        found = [decode(payload) for _, payloads in self._stored.messages(*topics) for payload in payloads]
        if not found and len(self.t) and next(self._stored.messages("scan"), None) is None:
            raise BadInput(f"{self.run}: no {' or '.join(topics)} is stored, as in the store of a campaign")
        return found

    @property
    def _dt_s(self) -> float:
        return self.scenario.radar.motion.dt_s

    @cached_property
    def _sent(self) -> dict[int, Waveform]:
        """What was radiated in each dwell k, as far as it is stored."""
        ks = [scan.k for scan in self._stored_of(Scan)]
        sent = sent_in(self._stored_of(Waveform, Truth, Scan), ks)
        return {k: one for k, one in zip(ks, sent, strict=True) if one is not None}

    @cached_property
    def _scans(self) -> ByBin:
        return ByBin.of(self._stored_of(Scan), self._scores[1].tolist(), self.scenario.radar.array.n_bin)

    @cached_property
    def _waveforms(self) -> tuple[Floats, NDArray[np.complex128]]:
        """What each dwell radiated; NaN where that is not stored."""
        return radiated(
            self._stored_of(Waveform, Truth, Scan), self._scores[1].tolist(), self.scenario.radar.array.n_tx
        )
