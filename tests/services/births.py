"""Hand-made messages of a run whose radar is not told how many targets there are: tracks begin and end."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cogradar.shared.protocol.messages import Message, Plan, RunEnd, RunStart, Scan, Truth, Waveform
from cogradar.shared.protocol.roster import BIRTH, EXPECTED, Roster
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.signal.array import angle_bin, bin_centres, spatial_frequency

RUN = "r"
UNKNOWN = load("smoke", ["radar.fidelity=best-range", "radar.tracks=unknown", "radar.max_tracks=5"])
N_BIN, N_TX = UNKNOWN.radar.array.n_bin, UNKNOWN.radar.array.n_tx
HERE, THERE, FAR = ([x, 0.1, y, 0.0] for x, y in ((40.0, -30.0), (40.0, 20.0), (90.0, 5.0)))
States = Mapping[int, Sequence[float]]  # by track, or by target, from 0


def start_of(dwells: int, **changed: Any) -> RunStart:
    """Start of such a run."""
    return RunStart.of(UNKNOWN, Strategy.POWER_AWARE, 1, dwells).model_copy(update={"run": RUN, **changed})


def nu_of(state: Sequence[float]) -> float:
    return float(spatial_frequency(np.array(state)))


def roster(states: States, confirmed: Sequence[int] = (), born: Sequence[int] = (), born_k: int = 0) -> Roster:
    """The tracks with these states; of those in `born` the scan of `born_k` was the first."""
    ids = np.array(sorted(states), np.int32)
    expected = np.array([[nu_of(states[m]), 0.01, 50.0, 1.0, 0.99] for m in ids.tolist()]).reshape(-1, EXPECTED)
    return Roster(
        ids=ids,
        next_id=int(ids.max(initial=-1)) + 1,
        next_search=0,
        confirmed=np.isin(ids, confirmed).astype(np.int32),
        born_k=np.where(np.isin(ids, born), born_k, 0).astype(np.int32),
        births=np.array([_birth(states[m]) for m in sorted(born)]).reshape(-1, BIRTH),
        expected=expected,
        searched=np.array([-0.25, 0.25]),
        search_share=0.1,
    )


def _birth(state: Sequence[float]) -> list[float]:
    return [nu_of(state), 30.0, _range(state), nu_of(state), 0.01, 1.0, 1.0, 50.0]


def _beams(tracks: Roster) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    nus = tracks.expected[:, :1].copy()
    return angle_bin(nus, N_BIN).astype(np.int32).reshape(-1, 1), nus.reshape(-1, 1)


def scan(k: int, tracks: Roster, over: Sequence[Sequence[float]] = ()) -> Scan:
    """A scan of each track's beam and of the search, the first one of all bins; the states in `over` are detected."""
    beams, beam_nus = _beams(tracks)
    looks = bin_centres(N_BIN) if k == 0 else np.concatenate((beam_nus[:, 0], tracks.searched))
    rows = sorted([*((float(nu), 20.0, 1.0) for nu in looks), *((nu_of(s), _range(s), 100.0) for s in over)])
    nus, ranges, statistic = np.array(rows).T.copy()
    return Scan(
        run=RUN,
        k=k,
        t=k + 1,
        bins=angle_bin(nus, N_BIN).astype(np.int32),
        statistic=statistic,
        alpha_hat=np.ones(nus.size, np.complex64),
        sigma_hat=np.ones(nus.size),
        signature_power=np.full(nus.size, 50.0),
        beams=beams,
        nus=nus,
        limits=np.full(nus.size, 30.0),
        ranges_km=ranges,
        nu_hats=nus,
        nu_sigmas=np.full(nus.size, 0.01),
        beam_nus=beam_nus,
        gates=np.zeros((beams.shape[0], 2)),
        roster=tracks,
    )


def _range(state: Sequence[float]) -> float:
    return (int(float(np.hypot(state[0], state[2])) / 0.5) + 0.5) * 0.5


def plan(k: int, track: int, state: Sequence[float] = FAR, **changed: Any) -> Plan:
    """What a track asks for; `status` is "ended" of one that is given up."""
    judged: dict[str, Any] = {"existence": 0.9, "confirmed": True, "in_doubt": False, "estimate": np.array(state)}
    judged |= {"modes": np.array([0.8, 0.1, 0.1])} | changed
    if changed.get("status") == "ended":
        return Plan(run=RUN, k=k, t=k + 1, target=track, **judged)
    nu, bin_ = nu_of(state), int(angle_bin(nu_of(state), N_BIN))
    asked: dict[str, Any] = {"bins": np.array([bin_], np.int32), "nus": np.array([nu]), "gate": np.zeros(2)}
    asked |= {"status": "tracking", "best_bin": bin_, "chances": np.ones(1)} | judged
    return Plan(run=RUN, k=k, t=k + 1, target=track, **asked)


def waveform(k: int, tracks: Roster) -> Waveform:
    """What is radiated in dwell k+1."""
    beams, nus = _beams(tracks)
    return Waveform(
        run=RUN,
        k=k,
        tracking=True,
        isotropic=0.0,
        factor=np.ones((N_TX, 1), np.complex64),
        beams=beams,
        shares=np.full(beams.shape, 0.2),
        status="optimal",
        late=np.zeros(beams.shape[0], np.int32),
        nus=nus,
        gates=np.zeros((beams.shape[0], 2)),
        roster=tracks,
    )


def truth(k: int, states: States) -> Truth:
    """The targets that are there; those of the scenario that are not named are not."""
    n = UNKNOWN.n_target
    found = np.array([states.get(m, (0.0, 0.0, 0.0, 0.0)) for m in range(n)], dtype=np.float64)
    bins = np.array([angle_bin(nu_of(states[m]), N_BIN) if m in states else -1 for m in range(n)], np.int32)
    of_all = {"heights_km": np.zeros(n), "snr_db": np.full(n, -10.0)}
    return Truth(run=RUN, k=k, t=k + 1, states=found, bins=bins, waveform_k=k - 1, **of_all)


def end(dwells: int) -> Message:
    return RunEnd(run=RUN, k=dwells - 1, t=dwells, status="complete")
