"""Beliefs as particles: those of the planners, from wherever they are worked out, and never for longer than a while."""

from pathlib import Path

import httpx
import numpy as np
import pytest

from cogradar import open as open_store
from cogradar.services.metrics.core import MetricsCore
from cogradar.services.planner.owned_track import snapshot_of
from cogradar.services.recorder.journal import Journal
from cogradar.services.web.app import create
from cogradar.services.web.problem_documents import Problem
from cogradar.services.web.views import particles
from cogradar.services.web.views.radar import facts
from cogradar.shared.protocol.messages import Message, Plan
from cogradar.shared.wire.codec import encode
from tests.services.stored import seal
from tests.services.web.conftest import DWELLS, FAST_S, ask
from tests.services.web.test_views import get


def test_a_cloud_is_the_belief_that_the_plan_was_made_of(web: httpx.Client, journal: Path, sent: list[Message]) -> None:
    with open_store(journal) as store:
        result = store.result("whole")
        for target, t in ((1, 6), (2, 3), (1, DWELLS)):
            cloud, whole = get(web, "whole/particles", target=target, dwell=t), result.particles(target, t)
            step = -(-len(whole) // particles.MAX_PARTICLES)
            assert (cloud["x"], cloud["y"]) == (whole[::step, 0].tolist(), whole[::step, 2].tolist())
            assert 100 < len(cloud["x"]) <= particles.MAX_PARTICLES
            plans = [m for m in sent if isinstance(m, Plan) and m.t == t]
            nearest = min(
                np.hypot(p.estimate[0] - whole[:, 0].mean(), p.estimate[2] - whole[:, 2].mean()) for p in plans
            )
            assert nearest < 1e-9
    assert get(web, "whole/particles", target=1)["t"] == DWELLS


def test_what_cannot_be_known_is_a_problem_that_says_so(
    web: httpx.Client, core: MetricsCore, monkeypatch: pytest.MonkeyPatch
) -> None:
    for query, status, words in (
        ("", 404, "target, track"),
        ("?target=1&track=1", 404, "target, track"),
        ("?track=1", 404, "was told of its targets"),
        ("?target=3", 404, "2 targets"),
        ("?target=1&dwell=9", 404, "no dwell 9"),
    ):
        found = web.get(f"/api/v1/runs/whole/particles{query}")
        assert (found.status_code, words in found.json()["detail"]) == (status, True)
    monkeypatch.setattr(particles, "MAX_DWELLS", 2)
    found = ask(create(core, None, FAST_S), "/api/v1/runs/whole/particles?target=1&dwell=5")
    assert found.status_code == 422
    assert "result('whole').particles(1, 5)" in found.json()["detail"]


def test_the_nearest_belief_is_where_it_is_worked_out_from(
    core: MetricsCore, journal: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    beliefs, known = particles.Beliefs(), facts(core.store, "whole")
    first_k = known.row["acquisition_scans"]
    expected = particles.Beliefs().of(core.store, known, 0, first_k + 4)
    assert expected is not None
    monkeypatch.setattr(particles, "KEPT_BYTES", 2.5 * (expected.belief.rows.nbytes + expected.remembered.nbytes))
    states = [beliefs.of(core.store, known, 0, first_k + t) for t in range(4)]
    monkeypatch.setattr(particles, "MAX_DWELLS", 2)
    assert beliefs.of(core.store, known, 0, first_k + 3) is states[3]
    assert beliefs.of(core.store, known, 0, first_k + 5) is not None  # from the last
    assert beliefs.of(core.store, known, 0, first_k + 2) is None  # it was forgotten, and the acquisition is too far
    assert beliefs.of(core.store, known, 1, first_k + 5) is None
    # The planners' snapshot of a run that goes on.
    path = tmp_path / "runs.db"
    path.write_bytes(journal.read_bytes())
    newest = states[3]
    assert newest is not None
    of_planner = Journal(str(path))
    of_planner.set_snapshot("whole", 1, newest.k, encode(snapshot_of("whole", newest)))
    of_planner.close()
    other = MetricsCore(str(path))
    other.store.derive(["whole"])
    again = particles.Beliefs().of(other.store, known, 0, newest.k + 1)
    other.close()
    assert again is not None
    assert (again.belief.rows == expected.belief.rows).all()


def test_work_and_memory_are_bounded_however_many_particles_there_are(
    core: MetricsCore, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = facts(core.store, "whole")
    for n, most in ((10, 1000), (12_000, 1000), (100_000, 120), (1_000_000, 12)):
        belief = known.radar.belief.model_copy(update={"n_particle": n})
        many = known._replace(radar=known.radar.model_copy(update={"belief": belief}))
        assert particles.reach(many) == most
        gaussian = belief.model_copy(update={"filter": "gaussian"})
        assert particles.reach(known._replace(radar=known.radar.model_copy(update={"belief": gaussian}))) == 1000
    monkeypatch.setattr(particles, "MAX_UPDATES", 3 * known.radar.belief.n_particle)
    assert particles.Beliefs().of(core.store, known, 0, 5) is None
    monkeypatch.undo()
    monkeypatch.setattr(particles, "KEPT_BYTES", 1)  # less than one belief: the newest is kept
    beliefs, k = particles.Beliefs(), known.row["acquisition_scans"]
    first, second = (beliefs.of(core.store, known, 0, k + i) for i in (1, 2))
    assert beliefs.of(core.store, known, 0, k + 2) is second
    assert beliefs.of(core.store, known, 0, k + 1) is not first


def test_without_scans_there_is_no_belief(core: MetricsCore, journal: Path, tmp_path: Path) -> None:
    path = tmp_path / "runs.db"
    path.write_bytes(journal.read_bytes())
    theirs = Journal(str(path))
    theirs.write("DELETE FROM message WHERE run = 'whole' AND topic = 'scan' AND k > 6")
    seal(theirs)
    theirs.close()
    other = MetricsCore(str(path))
    known = facts(core.store, "whole")
    with pytest.raises(Problem, match="not stored"):
        particles.Beliefs().of(other.store, known, 0, 9)
    other.close()
