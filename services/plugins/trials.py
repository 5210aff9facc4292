"""What a thing of somebody else is tried with, by its kind: arguments, and the built-in one whose cost is shown, too.

Each call gets arguments of its own, made anew, so that what it does to them is seen.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cogradar.services.emulator.cycle import compared, scan_message, transmission
from cogradar.services.emulator.front_end import FrontEnd, Settings, Transmission, told
from cogradar.services.emulator.own_thread import FIRST_S, InOwnThread
from cogradar.services.errors import RunFailed
from cogradar.services.feed import feed
from cogradar.services.feed.cost import pictures_of
from cogradar.services.feed.picture import Picture
from cogradar.services.planner.owned_track import snapshot_of
from cogradar.shared.numerics.seeds import Purpose, generator
from cogradar.shared.planning.radar_pomdp import problem_of
from cogradar.shared.power.rules import Requests
from cogradar.shared.protocol.messages import Scan, Waveform
from cogradar.shared.protocol.recovery import Snapshot
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.plugins.kinds import BELIEF, DISTURBANCE, FEED, FRONT_END, OBJECTIVE, RULE, STRATEGY, Kind
from cogradar.shared.scenario.plugins.names import PluginFailed
from cogradar.shared.scenario.radar_config import RadarConfig, Strategy
from cogradar.shared.signal.array import angle_bin, bin_centres, spatial_frequency, steering_vector
from cogradar.shared.signal.radar_equation import amplitude, amplitude_at_1_km
from cogradar.shared.signal.response import FAR_KM
from cogradar.shared.signal.scan import Detections
from cogradar.shared.tracking.belief.likelihood import found_look, missed_looks
from cogradar.shared.tracking.filters import Dwell, Filter
from cogradar.shared.tracking.model import TrackerModel, TrackState
from cogradar.shared.tracking.track import start
from cogradar.shared.wire.codec import decode, encode

DWELLS, ACQUISITION = 20, 5  # of a front end: the first may load much, and some faults come with beams, or later
N_DRAW = 4000  # cells of which the mean power of a disturbance is estimated
POWER_WITHIN = 0.1  # of 1; heavy tails make the mean uncertain
_SIGMA_HAT = 0.02
_LOOKED = "++-+++..+-+---+++"  # a track's dwells: detected, missed, not looked for
Case = Callable[[], tuple[Any, ...]]  # arguments of a call, made anew


@dataclass(frozen=True)
class Trial:
    """How a kind is tried."""

    cases: Sequence[tuple[str, Case]]  # in words, and the arguments
    beside: str  # the built-in one whose cost is shown; "": there is none to be called so
    call: Callable[..., Any] = lambda thing, *arguments: thing(*arguments)
    more: Callable[[Any], tuple[str, bool]] | None = None  # what else is found, and whether it is as it should be
    called: str = "level"  # Its row.
    copies: bool = False  # It gets copies in a run, too, and may change its arguments.
    repeats: bool = True  # the same answer to the same arguments; no measurement does


def trial_of(kind: Kind) -> Trial:
    """How a kind is tried."""
    tried: dict[Kind, Callable[[], Trial]] = {
        RULE: _rule,
        BELIEF: _belief,
        STRATEGY: partial(_power, "power-aware"),
        OBJECTIVE: partial(_power, "max-min"),
        DISTURBANCE: _disturbance,
        FRONT_END: _front_end,
        FEED: _feed,
    }
    return tried[kind]()


def _rule() -> Trial:
    radar = load("smoke").radar
    model = TrackerModel.of(radar, Strategy.POWER_AWARE, seed=1)

    def case(spread_km: float, apart_km: float, i: int, time: Callable[[], bool] | None) -> Case:
        def made() -> tuple[Any, ...]:
            rng = generator(1, Purpose.INITIATION, 0, i)
            centre, beside = np.array([50.0, -0.05, 20.0, 0.1]), np.array([0.0, 0.0, apart_km, 0.0])
            states = (
                centre
                + beside * rng.choice(2, (3000, 1))
                + np.array([spread_km, 0.02, spread_km, 0.02]) * rng.standard_normal((3000, 4))
            )
            problem = problem_of(states, _SIGMA_HAT, model.sensor, model.motion)
            return problem, radar, generator(1, Purpose.SEARCH, 0, i), time

        return made

    return Trial(
        (
            ("a target in one bin", case(0.5, 0.0, 0, None)),
            ("a target in two bins", case(0.5, -12.0, 1, None)),
            ("a target anywhere", case(30.0, 0.0, 2, None)),
            ("no time left", case(0.5, -12.0, 3, lambda: False)),
        ),
        "pomcp",
        copies=True,
    )


def _belief() -> Trial:
    models = [
        TrackerModel.of(load("smoke", [f"radar.fidelity={fidelity}"]).radar, Strategy.POWER_AWARE, seed=1)
        for fidelity in ("robust", "best-range")
    ]

    def case(looked: str, i: int) -> Case:
        return lambda: (looked, generator(1, Purpose.BELIEF, i, 0))

    def call(filter_: Filter, looked: str, rng: np.random.Generator) -> Any:
        return [
            (state.belief.rows, state.belief.sample(), state.log_evidence)
            for model in models
            for state in _followed(filter_, model, looked, rng)
        ]

    def restored(filter_: Filter) -> tuple[str, bool]:
        """Whether a track goes on from a snapshot's numbers, whatever other tracks the filter has seen meanwhile."""
        for model in models:
            tracks = [_followed(filter_, model, _LOOKED, generator(1, Purpose.BELIEF, i, 1)) for i in (0, 0, 1)]
            for one, (other, _) in zip(tracks[0], zip(*tracks[1:], strict=True), strict=True):
                sent = decode(encode(snapshot_of("check", one)))
                back = filter_.restored(model, sent.belief) if isinstance(sent, Snapshot) else one.belief
                beliefs = one.belief, other.belief, back
                if len({(belief.rows.tobytes(), belief.sample().tobytes()) for belief in beliefs}) > 1:
                    return f"goes on otherwise from a snapshot, or beside another track, after dwell {one.k}", False
        return "goes on from a snapshot, and beside another track, bit for bit", True

    cases = (("a miss", "-"), ("a detection", "+"), (f"{len(_LOOKED)} dwells", _LOOKED))
    tried = [(words, case(looked, i)) for i, (words, looked) in enumerate(cases)]
    return Trial(tried, "likelihood", call, restored, "snapshot", copies=True)


def _followed(filter_: Filter, model: TrackerModel, looked: str, rng: np.random.Generator) -> Iterator[TrackState]:
    """A track after each dwell: detected (+), missed (-), not looked for (.); the target flies along the array."""
    place, dt = np.array([40.0, 0.0, 5.0, 0.2]), model.motion.dt
    scan = Detections.of(
        {
            "k": 0,
            "bins": np.arange(model.sensor.n_bin, dtype=np.int32),
            "statistic": np.full(model.sensor.n_bin, 2.0 * model.sensor.threshold),
            "alpha_hat": np.full(model.sensor.n_bin, 0.1, dtype=np.complex64),
            "sigma_hat": np.full(model.sensor.n_bin, _SIGMA_HAT),
            "signature_power": np.ones(model.sensor.n_bin),
            "beams": np.full((model.n_track, 1), -1, dtype=np.int32),
        },
        model.sensor.n_bin,
        model.sensor.threshold,
    )
    bin_ = int(angle_bin(spatial_frequency(place[np.newaxis])[0], model.sensor.n_bin))
    begun = place + np.array([1.0, 0.05, 1.0, 0.05]) * rng.standard_normal((model.belief.n_particle, 4))
    state = start(model, 0, bin_, [scan])._replace(belief=filter_.begun(model, begun, rng))
    for k, kind in enumerate(looked, 1):
        place = place + dt * np.array([place[1], 0.0, place[3], 0.0])
        nu, range_km = float(spatial_frequency(place[np.newaxis])[0]), float(np.hypot(place[0], place[2]))
        if model.response.is_box:
            nu = float(bin_centres(model.sensor.n_bin)[angle_bin(nu, model.sensor.n_bin)])
        if kind == ".":
            state = filter_.coasted(model, state, lambda: rng)
        else:
            looks = missed_looks(model.response, np.array([nu]), np.array([0.1]), model.sensor.threshold, (0.0, FAR_KM))
            if kind == "+":
                cell_km = model.response.range_cell_km
                is_measured = model.response.measures_range
                measured = (nu, 1e-3, (range_km // cell_km + 0.5) * cell_km) if is_measured else (0.0, 0.0, 0.0)
                r = float(amplitude(amplitude_at_1_km(model.sensor.amplitude_db), range_km**2)) / _SIGMA_HAT
                looks = found_look(model.response, nu, _SIGMA_HAT, model.sensor.threshold, max(r, 4.0), measured)
            state = filter_.observed(model, state, Dwell(looks, lambda: rng, None)).state
        state = state._replace(k=k)
        yield state


def _power(beside: str) -> Trial:
    radar = load("smoke").radar

    def case(n_track: int, n_cell: int, i: int) -> Case:
        def made() -> tuple[Any, ...]:
            rng = generator(1, Purpose.INITIATION, 1, i)
            centres = bin_centres(radar.array.n_bin)
            nus = centres[np.array([rng.choice(centres.size, n_cell, replace=False) for _ in range(n_track)])]
            chances = rng.dirichlet(np.ones(n_cell), n_track)
            ranges = rng.uniform(10.0, 90.0, n_track)
            return radar, Requests(nus, chances, ranges, 1e9 * ranges**-4.0, rng.random(n_track))

        return made

    cases = ((1, 1, "one track"), (2, 1, "two tracks"), (5, 3, "five tracks of three cells each"))
    return Trial([(name, case(m, n, i)) for i, (m, n, name) in enumerate(cases)], beside, copies=True)


def _disturbance() -> Trial:
    def case(n: int, i: int) -> Case:
        return lambda: (n, generator(1, Purpose.DISTURBANCE, 3, i))

    def power(model: Any) -> tuple[str, bool]:
        spectrum = float(np.mean(model.power_spectrum(np.arange(64) / 64.0 - 0.5)))
        drawn: list[NDArray[np.complex128]] = [
            model.draw(64, generator(1, Purpose.DISTURBANCE, 4, i)) for i in range(N_DRAW)
        ]
        mean = float(np.mean(np.abs(drawn) ** 2))
        is_one = abs(mean - 1.0) < POWER_WITHIN and abs(spectrum - 1.0) < POWER_WITHIN
        return f"mean power {mean:.3f}, of the spectrum {spectrum:.3f}; both must be 1", is_one

    return Trial(
        (("256 samples", case(256, 0)), ("10 000 samples", case(10_000, 1))),
        "ar6-t",
        lambda model, n, rng: model.draw(n, rng),
        power,
    )


def _feed() -> Trial:
    pictures, _ = pictures_of(20, 3)

    def call(kind: feed.Kind, shown: Sequence[Picture]) -> Any:
        try:
            form = kind.make(feed.Options())
            return [form.greeting(), *(form.encode(picture) for picture in shown)]
        except RunFailed as error:
            raise PluginFailed(str(error)) from error

    ended = [*pictures, pictures[-1].without_tracks()]
    cases = (("a picture", lambda: (pictures[:1],)), ("four pictures", lambda: (ended,)))
    return Trial(cases, "", call)


def _front_end() -> Trial:
    settings = Settings("check", load("smoke").radar, Strategy.POWER_AWARE, dwells=DWELLS, rate_hz=0.0)
    dwell_ms = 1e3 * settings.radar.motion.dt_s

    def call(make: Callable[[Settings], FrontEnd], asked: Transmission) -> Any:
        return _driven(make, settings, [asked])[0][-1:]

    def dwells(make: Callable[[Settings], FrontEnd]) -> tuple[str, bool]:
        scans, taken_ms = _driven(make, settings, [_asked(settings.radar, k) for k in range(DWELLS)])
        n, (first_ms, *later_ms) = len(taken_ms), taken_ms or [0.0]
        k = int(np.argmax(later_ms)) + 1 if later_ms else 0
        slowest = f"the slowest, dwell {k}, in {max(later_ms, default=0.0):.3g} ms of {dwell_ms:g} ms"
        if n == 0:
            return "none: transmit returned None at the first one, which ends a run", False
        ended = "" if n == DWELLS else "; then there are no more"
        silent, measures = _silent(scans)
        said = f"{n} of acquisition and beams{ended}{silent}; the first in {first_ms:.3g} ms, {slowest}"
        return said, measures and max(later_ms, default=0.0) < dwell_ms

    def everywhere() -> tuple[Any, ...]:
        return (transmission(settings.radar, None),)

    cases = (("a dwell of the acquisition", everywhere),)
    return Trial(cases, "", call, dwells, "dwells", repeats=False)


def _silent(scans: Sequence[Scan]) -> tuple[str, bool]:
    """In which dwells nothing or not all was measured, and whether something was with each kind of waveform."""
    nothing = [scan for scan in scans if not scan.bins.size]
    partly = sum(scan.unmeasured is not None and scan.bins.size > 0 for scan in scans)
    said = f"; not all was measured in {partly} of them" if partly else ""
    kinds = (("power everywhere", scans[:ACQUISITION]), ("beams", scans[ACQUISITION:]))
    deaf = [name for name, of in kinds if of and not any(scan.bins.size for scan in of)]
    if nothing:
        why = next((f", {scan.fault}" for scan in nothing if scan.fault), "")
        said += f"; nothing was measured in {len(nothing)} of them{why}"
    if deaf:
        said += f"; with {' and '.join(deaf)} nothing is ever measured: a run would find or keep no target"
    return said, not deaf


def _driven(
    make: Callable[[Settings], FrontEnd], settings: Settings, asked: Sequence[Transmission]
) -> tuple[list[Scan], list[float]]:
    """The scans of a front end that is opened for these dwells, and how long each took, ms. Raises PluginFailed."""
    scans, taken_ms, where = list[Scan](), list[float](), ""
    try:
        front_end = InOwnThread(make, settings, FIRST_S, [], first_s=FIRST_S, opening_s=FIRST_S)
        try:
            for k, one in enumerate(asked):
                t = max(0, k + 1 - ACQUISITION)
                where, began = f"dwell {k}: ", time.perf_counter()
                if (measured := front_end.transmit(k, t, one)) is None:
                    break
                taken_ms.append(1e3 * (time.perf_counter() - began))
                scans.append(scan_message(settings, k, t, compared(settings.radar, one, measured), None))
        finally:
            front_end.close()
    except Exception as error:
        raise PluginFailed(f"{where if len(asked) > 1 else ''}{told(error)}") from error
    return scans, taken_ms


def _asked(radar: RadarConfig, k: int) -> Transmission:
    """What a radar asks for that acquires, and then turns two beams from bin to bin."""
    if k < ACQUISITION:
        return transmission(radar, None)
    array = radar.array
    bins = np.array([[k % array.n_bin], [(k + array.n_bin // 2) % array.n_bin]], np.int32)
    share = array.power / len(bins)
    steered = steering_vector(bin_centres(array.n_bin)[bins[:, 0]], array.n_tx)
    beams = Waveform(
        run="check",
        k=k - 1,
        tracking=True,
        isotropic=0.0,
        factor=(np.sqrt(share / array.n_tx) * steered.T).astype(np.complex64),
        beams=bins,
        shares=np.full(bins.shape, share),
        status="fixed",
        late=np.zeros(len(bins), np.int32),
    )
    return transmission(radar, beams)
