"""The belief about a target after a dwell, as particles: worked out from the scans, one request at a time.

A belief follows from the one before and a scan, at the cost of a planner's update. So the nearest one is sought before
the dwell: one that was worked out before, the planners' snapshot of a run that goes on, or the acquisition.
"""

from collections import OrderedDict
from collections.abc import Iterator, Mapping
from functools import lru_cache
from http import HTTPStatus

from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from cogradar.services.delivery.pacing import pacing_at
from cogradar.services.metrics import queries
from cogradar.services.metrics.store import Store
from cogradar.services.planner.owned_track import state_of
from cogradar.services.planner.track_source import follow, source_of
from cogradar.services.web.parameters import one_of
from cogradar.services.web.problem_documents import Problem, missing
from cogradar.services.web.run_answers import Question, about_run
from cogradar.services.web.views.radar import Facts, facts
from cogradar.shared.numerics.seeds import radar_seed
from cogradar.shared.protocol.messages import Scan, roster_of
from cogradar.shared.protocol.recovery import Snapshot
from cogradar.shared.scenario.limits import n_state
from cogradar.shared.scenario.plugins.names import PluginError
from cogradar.shared.scenario.radar_config import RadarConfig, Strategy
from cogradar.shared.scoring.scan_rows import row_of_track
from cogradar.shared.tracking.model import TrackerModel, TrackState
from cogradar.shared.wire.codec import decode

MAX_PARTICLES = 1500  # of an answer
MAX_DWELLS = 1000  # that are followed for an answer,
MAX_UPDATES = 12_000_000  # ... times particles; 2 s
AT_ONCE = 64  # scans that are read together
KEPT_BYTES = 64_000_000  # of beliefs; some 80 at the paper's size
KEEP_EVERY = 128  # dwells on the way


@about_run("target", "track", "dwell")
def particles(request: Request, question: Question) -> Response:
    """Some particles of a belief, the same ones for each request."""
    name, parameters, store, headers = question
    known = facts(store, name)
    t = int(parameters.get("dwell", known.newest))
    target, track, k = _whose(store, known, parameters, t)
    beliefs: Beliefs = request.app.state.beliefs
    try:
        belief = beliefs.of(store, known, track - 1, k)
        states = None if belief is None else belief.belief.sample()
    except PluginError as error:  # this process need not have a belief of somebody's own
        raise Problem(HTTPStatus.UNPROCESSABLE_ENTITY, str(error)) from None
    if states is None:
        of_track = f", track={track}" if target is None else ""
        raise Problem(
            HTTPStatus.UNPROCESSABLE_ENTITY,
            f"dwell {t} is more than {reach(known)} dwells from the nearest belief that is known. In Python:"
            f" cogradar.open(FILE).result({name!r}).particles({target}, {t}{of_track})",
        )
    x, _, y, _ = states[:: -(-len(states) // MAX_PARTICLES)].T
    document = {"run": name, "target": target, "track": track, "t": t, "x": x.tolist(), "y": y.tolist()}
    return JSONResponse(document, headers=headers)


def _whose(store: Store, known: Facts, parameters: Mapping[str, str], t: int) -> tuple[int | None, int, int]:
    """The target that is asked about, if one is, its track, and dwell k. Raises Problem."""
    run = known.row["run"]
    kind = one_of(parameters, "target", "track")
    dwells = queries.pictures(store, run, t, t)
    if not dwells:
        raise missing(f"run = {run!r}: no dwell {t}")
    if kind == "track":
        return None, known.track(parameters["track"]), dwells[0]["k"]
    target = known.target(parameters["target"])
    track = queries.track_of(store, run, target, t)
    if track is None:
        raise missing(f"run = {run!r}: no track of target {target}")
    return target, track, dwells[0]["k"]


def reach(known: Facts) -> int:
    """How many dwells are followed for an answer about this run."""
    return min(MAX_DWELLS, MAX_UPDATES // n_state(known.radar.belief))


class Beliefs:
    """The beliefs that were worked out last. For one thread at a time."""

    def __init__(self) -> None:
        self._store: Store | None = None
        self._kept: OrderedDict[tuple[str, int, int], TrackState] = OrderedDict()  # by run, track and dwell k

    def of(self, store: Store, known: Facts, track: int, k: int) -> TrackState | None:
        """What a track, counted from 0, was after dwell k; None if that is too far. Raises Problem without scans."""
        run = known.row["run"]
        if store is not self._store:
            self._store, self._kept = store, OrderedDict()
        nearest = self._nearest(store, known, track, k)
        begun = _before_first(store, known, track, k) if nearest is None else nearest.k
        if k - begun > reach(known):
            return None
        if begun < k:
            model, states = _model(known), {} if nearest is None else {track: nearest}
            source = source_of(run, known.radar, model, pacing_at(known.row["rate_hz"]))
            for followed in follow(source, model, _messages(store, run, begun + 1, k), [track], states):
                nearest = followed.get(track)
                if nearest is not None and nearest.k % KEEP_EVERY == 0:
                    self._keep(run, nearest)
        if nearest is None or nearest.k != k:
            raise missing(f"run = {run!r}: the scans before dwell k = {k} are not stored")
        self._keep(run, nearest)
        return nearest

    def _nearest(self, store: Store, of: Facts, track: int, k: int) -> TrackState | None:
        run = of.row["run"]
        ks = [key[2] for key in self._kept if key[:2] == (run, track) and key[2] <= k]
        known = self._kept[run, track, max(ks)] if ks else None
        payload = queries.snapshot(store, run, track + 1, 0 if known is None else known.k + 1, k)
        message = None if payload is None else decode(payload)
        return state_of(_model(of), message) if isinstance(message, Snapshot) else known

    def _keep(self, run: str, state: TrackState) -> None:
        self._kept[run, state.target, state.k] = state
        self._kept.move_to_end((run, state.target, state.k))
        while len(self._kept) > 1 and sum(map(_bytes, self._kept.values())) > KEPT_BYTES:
            self._kept.popitem(last=False)


def _before_first(store: Store, known: Facts, track: int, k: int) -> int:
    """The dwell before the first scan that a track depends on. Raises Problem if the track is not in dwell k."""
    if not known.radar.is_unknown:
        return -1
    run = known.row["run"]
    for scan in _messages(store, run, k, k):
        row = row_of_track(vars(scan), track)
        if row >= 0:
            return int(roster_of(scan).born_k[row])
    raise missing(f"run = {run!r}: no track {track + 1} in dwell k = {k}, or the scans before it are not stored")


def _bytes(state: TrackState) -> int:
    return state.belief.rows.nbytes + state.remembered.nbytes + state.looked.nbytes


def _model(known: Facts) -> TrackerModel:
    return _model_of(known.radar, Strategy(known.row["strategy"]), known.row["seed"])


@lru_cache(maxsize=8)
def _model_of(radar: RadarConfig, strategy: Strategy, seed: int) -> TrackerModel:
    return TrackerModel.of(radar, strategy, radar_seed(seed))


def _messages(store: Store, run: str, first: int, last: int) -> Iterator[Scan]:
    for k in range(first, last + 1, AT_ONCE):
        for _, _, payload in store.messages(run, ("scan",), k, min(last, k + AT_ONCE - 1)):
            message = decode(payload)
            if isinstance(message, Scan):
                yield message
