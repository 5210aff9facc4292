"""What does not change in a run: what the page needs before the first dwell, and every view of it."""

import json
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from cogradar.services.metrics.queries import run_row
from cogradar.services.metrics.selection import ALL
from cogradar.services.metrics.store import Store
from cogradar.services.web.maps.surroundings import surroundings
from cogradar.services.web.problem_documents import bad, missing
from cogradar.services.web.run_answers import Question, about_run, core_of
from cogradar.shared.scenario.limits import NO_END
from cogradar.shared.scenario.radar_config import RadarConfig
from cogradar.shared.scenario.scenario import Scenario, SiteSection
from cogradar.shared.scenario.world_config import WorldConfig
from cogradar.shared.scoring.scan_rows import ScanRows
from cogradar.shared.signal.array import bin_centres

_Document = tuple[RadarConfig, WorldConfig | None, ScanRows, NDArray[np.float64], SiteSection | None]


class Facts(NamedTuple):
    """A run as it was begun, and how far it is."""

    row: dict[str, Any]  # of the table `run`, without the scenario
    radar: RadarConfig
    world: WorldConfig | None  # None without truth
    scan_rows: ScanRows  # of its scans
    centres: NDArray[np.float64]  # of the bins, spatial frequency
    site: SiteSection | None  # None: x and y have no place on the earth

    @property
    def threshold(self) -> float:
        """Of the statistic, for one cell."""
        return self.scan_rows.threshold

    @property
    def newest(self) -> int:
        """The newest dwell that is durable; 0: none yet."""
        return int(self.row["acknowledged_t"])

    @property
    def oldest(self) -> int:
        """The oldest dwell that is kept of a run without an end; else 1."""
        return max(1, int(self.row["kept_k"]) - int(self.row["acquisition_scans"] or 0) + 1)

    def dwells(self, text: str) -> tuple[int, int]:
        """First and last dwell that there are of a range a:b."""
        first, _, last = text.partition(":")
        return max(self.oldest, int(first or 1)), min(self.newest, int(last or self.newest))

    def target(self, text: str) -> int:
        """A target of the run. Raises Problem."""
        if int(text) > self.row["n_target"]:
            raise missing(f"target = {text}: run {self.row['run']} has {self.row['n_target']} targets")
        return int(text)

    def track(self, text: str) -> int:
        """A track of the run, whose number is unknown. Raises Problem."""
        if not self.radar.is_unknown:
            raise missing(f"track = {text}: run {self.row['run']} was told of its targets; ask for one of them")
        return int(text)


def facts(store: Store, run: str, *, is_scored: bool = True) -> Facts:
    """What is known of a run, all of which `is_scored` afterwards. Raises Problem if there is none."""
    if run == ALL:
        raise bad(f"run = {ALL!r}: this view is of one run")
    row = run_row(store, run)
    if row is None:
        raise missing(f"run = {run!r}: no such run")
    if is_scored:
        store.derive([run])
    return Facts(row, *_of_document(row.pop("document")))


@lru_cache(maxsize=64)
def _of_document(document: str) -> _Document:
    scenario = Scenario.model_validate(json.loads(document))
    centres = bin_centres(scenario.radar.array.n_bin)
    return scenario.radar, scenario.world, ScanRows.of(scenario.radar), centres, scenario.site


def angles_deg(nu: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angle from the array's normal at which a wave has this spatial frequency, degrees."""
    return np.asarray(np.degrees(np.arcsin(2.0 * nu)))


@about_run()
def radar(request: Request, question: Question) -> Response:
    """What does not change in a run."""
    known = facts(question.store, question.run, is_scored=False)
    has_processes = core_of(request).gather is not None
    return JSONResponse(_of_run(known) | {"has_processes": has_processes}, headers=question.headers)


def _around(site: SiteSection, range_km: float) -> dict[str, Any] | None:
    """Airports and lines of a map; a scope that is wider than high shows some of what is beyond the range."""
    found = surroundings(site.latitude_deg, site.longitude_deg, 2.0 * range_km)
    return None if found is None else {"airports": [one._asdict() for one in found.airports], "lines": found.lines}


def _of_run(known: Facts) -> dict[str, Any]:
    row, radar = known.row, known.radar
    inner = 0.5 * (known.centres[1:] + known.centres[:-1])
    ranges = [
        np.hypot(x, y)
        for target in (known.world.targets if known.world is not None else ())
        for x, y in (np.array(target.trajectory)[:, 1:3] if target.trajectory is not None else [target.begin[::2]])
        if x >= 0.0
    ]
    return {
        **{name: row[name] for name in ("run", "scenario", "strategy", "seed", "status", "rate_hz")},
        "dwells": row["dwells"] if row["dwells"] < NO_END else None,
        "acquisition_scans": row["acquisition_scans"],
        "targets": row["n_target"],
        "is_unknown": radar.is_unknown,
        "dt_s": radar.motion.dt_s,
        "n_bin": len(known.centres),
        "bin_edges_deg": angles_deg(np.array([-0.5, *inner, 0.5])).tolist(),
        "max_range_km": float(max([radar.acquisition.range_max_km, *ranges])),
        "has_truth": bool(row["has_truth"]),
        "threshold": known.threshold,
        "p_fa": radar.detector.p_fa,
        "fidelity": radar.fidelity,
        "jammers": [
            {
                "angle_deg": float(angles_deg(np.array(jammer.nu))),
                **jammer.model_dump(include={"jnr_db", "on_s", "off_s"}),
            }
            for jammer in (known.world.jammers if known.world is not None else ())
        ],
        "rule": radar.planner.rule,
        "site": known.site.model_dump() if known.site is not None else None,
        "surroundings": None if known.site is None else _around(known.site, radar.acquisition.range_max_km),
    }
