"""What the page asks of a run: the same numbers as everywhere else, and all that it draws."""

import json
from typing import Any

import httpx
import numpy as np
import pytest

from cogradar.services.skies.place import Place
from cogradar.services.web.views import dwells
from cogradar.shared.protocol.messages import Message, Plan, Scan, Truth, Waveform
from cogradar.shared.signal.array import angle_bin
from cogradar.shared.signal.waveform import antenna_powers
from tests.services.loop import smoke_start
from tests.services.web.conftest import DWELLS, LATE, SITE

RUNS = "/api/v1/runs"


def get(web: httpx.Client, path: str, **parameters: Any) -> dict[str, Any]:
    found = web.get(f"{RUNS}/{path}", params=parameters)
    assert found.status_code == 200, found.text
    document: dict[str, Any] = found.json()
    return document


def test_what_does_not_change_in_a_run_is_its_scenario(web: httpx.Client, sent: list[Message]) -> None:
    start, found = smoke_start(dwells=DWELLS), get(web, "whole/radar")
    radar = start.scenario["radar"]
    assert {name: found[name] for name in ("scenario", "seed", "dwells", "targets", "status")} == {
        "scenario": "smoke",
        "seed": start.seed,
        "dwells": DWELLS,
        "targets": radar["tracks"],
        "status": "complete",
    }
    assert (found["dt_s"], found["p_fa"]) == (radar["motion"]["dt_s"], radar["detector"]["p_fa"])
    edges, n = np.array(found["bin_edges_deg"]), radar["array"]["n_bin"]
    inside = 0.5 * np.sin(np.radians(0.5 * (edges[1:] + edges[:-1])))
    assert (edges[0], edges[-1], found["n_bin"]) == (-90.0, 90.0, n)
    assert angle_bin(inside, n).tolist() == list(range(n))
    ranges = [np.hypot(state[0], state[2]) for truth in sent if isinstance(truth, Truth) for state in truth.states]
    assert found["max_range_km"] >= max(ranges)
    assert (found["has_truth"], get(web, "blind/radar")["has_truth"]) == (True, False)
    assert found["has_processes"]


def test_a_dwell_is_what_was_sent_in_it(web: httpx.Client, sent: list[Message]) -> None:
    scan = next(m for m in sent if isinstance(m, Scan) and m.t == 5)
    plans = {m.target + 1: m for m in sent if isinstance(m, Plan) and m.k == scan.k}
    truth = next(m for m in sent if isinstance(m, Truth) and m.k == scan.k)
    waveform = next(m for m in sent if isinstance(m, Waveform) and m.k == truth.waveform_k)
    radar, (dwell,) = get(web, "whole/radar"), get(web, "whole/dwells", dwells="5:5")["dwells"]
    assert (dwell["t"], dwell["k"], dwell["isotropic"]) == (5, scan.k, waveform.isotropic)
    for target in dwell["targets"]:
        plan = plans[target["track"]]
        assert target["covariance"] == [plan.covariance[0, 0], plan.covariance[0, 2], plan.covariance[2, 2]]
        assert target["covariance"][0] > 0.0
        off = truth.states[target["target"] - 1] - plan.estimate
        assert target["error_km"] == pytest.approx(np.hypot(off[0], off[2]))
        edges = radar["bin_edges_deg"][target["bin"] :][:2]
        assert edges[0] < target["beam_deg"] < edges[1]
    over = [b for b, value in zip(scan.bins.tolist(), scan.statistic, strict=True) if value >= dwell["threshold"]]
    assert dwell["false_alarms"] == [b for b in over if b not in truth.bins]


def test_with_a_site_a_dwell_says_where_on_the_earth_and_when(web: httpx.Client) -> None:
    radar, (dwell,) = get(web, "sited/radar"), get(web, "sited/dwells", dwells="5:5")["dwells"]
    assert radar["site"] == SITE
    assert dwell["utc_s"] == 1767225600.0 + 5.0
    for target in dwell["targets"]:
        for suffix in ("", "_hat"):
            at = target[f"latitude{suffix}_deg"], target[f"longitude{suffix}_deg"]
            assert Place(48.0, 11.0, 30.0).seen(*at) == pytest.approx((target[f"x{suffix}"], target[f"y{suffix}"]))
    (elsewhere,) = get(web, "whole/dwells", dwells="5:5")["dwells"]
    assert (elsewhere["utc_s"], get(web, "whole/radar")["site"]) == (None, None)
    assert {target["latitude_hat_deg"] for target in elsewhere["targets"]} == {None}
    (timed,) = get(web, "timed/dwells", dwells="5:5")["dwells"]
    assert timed["utc_s"] == 1e9 + timed["k"]


def test_dwells_are_those_of_the_stream(web: httpx.Client) -> None:
    with web.stream("GET", f"{RUNS}/whole/events") as answered:
        lines = [line.removeprefix("data: ") for line in answered.iter_lines() if line.startswith("data: ")]
    assert get(web, "whole/dwells", dwells="1:")["dwells"] == [json.loads(line) for line in lines[:-1]]
    assert [dwell["t"] for dwell in get(web, "whole/dwells")["dwells"]] == [DWELLS]
    assert [dwell["t"] for dwell in get(web, "whole/dwells", dwells="7:1000")["dwells"]] == [7, 8]
    assert get(web, "whole/dwells", dwells="9:9") == {"dwells": [], "next": None}


def test_many_dwells_are_told_in_parts(web: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = get(web, "whole/dwells", dwells="2:7")
    assert whole["next"] is None
    monkeypatch.setattr(dwells, "MAX_DWELLS", 3)
    first = get(web, "whole/dwells", dwells="2:7")
    assert first["next"] == f"{RUNS}/whole/dwells?dwells=5:7"
    rest = web.get(first["next"]).json()
    assert rest["next"] is None
    assert first["dwells"] + rest["dwells"] == whole["dwells"]


def test_a_dwell_without_truth_says_what_is_known(web: httpx.Client) -> None:
    for dwell in get(web, "blind/dwells", dwells=":")["dwells"]:
        assert dwell["false_alarms"] is None
        assert dwell["isotropic"] is not None
        for target in dwell["targets"]:
            assert (target["error_km"], target["true_bin"], target["lost"]) == (None, None, None)
            assert len(target["covariance"]) == 3


@pytest.mark.parametrize("run", ["timed", "blind"])
def test_a_dwell_shows_the_waveform_that_was_radiated(web: httpx.Client, sent: list[Message], run: str) -> None:
    """With truth and without, for the scan says which waveform it was."""
    told = get(web, f"{run}/dwells", dwells=":")["dwells"]
    assert [dwell["t"] for dwell in told if dwell["stale"]] == [LATE]
    waveforms = {message.k: message for message in sent if isinstance(message, Waveform)}
    for dwell in told[1:]:
        radiated = waveforms[dwell["k"] - (2 if dwell["t"] == LATE else 1)]
        antennas = get(web, f"{run}/beampattern", dwell=dwell["t"])["antennas"]
        expected = antenna_powers(radiated.isotropic, radiated.factor.astype(np.complex128))
        assert [one["power"] for one in antennas] == pytest.approx(expected.tolist())
        for target in dwell["targets"]:
            if radiated.beams[target["track"] - 1].tolist()[: len(target["cells"])] == [b for b, _ in target["cells"]]:
                expected = radiated.shares[target["track"] - 1].sum()
                assert sum(share for _, share in target["cells"]) == pytest.approx(expected)
