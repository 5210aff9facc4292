"""A run dwell by dwell, and its tables: the rows of the whole run, in any frame; kept, cancelled, drawn."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cogradar
from tests.skies import small_sky

DWELLS = 12


@pytest.fixture(scope="module")
def played() -> tuple[list[cogradar.Dwell], cogradar.Result]:
    with cogradar.play(small_sky(), seed=4, dwells=DWELLS) as player:
        dwells = list(player)
        return dwells, player.result


def test_dwells_add_up_to_the_run(played: tuple[list[cogradar.Dwell], cogradar.Result]) -> None:
    dwells, result = played
    assert result.digest == cogradar.run(small_sky(), seed=4, dwells=DWELLS).digest
    assert (result.status, len(dwells)) == ("complete", len(np.unique(result.truth()["k"])))
    for name in ("detections", "truth", "waveforms"):
        whole = getattr(result, name)()
        for dwell in dwells:
            ours, part = whole[whole["k"] == dwell.k], getattr(dwell, name)()
            for column in part.dtype.names:
                value = part[column]
                if column == "factor":  # its rank is the largest of the table
                    value = np.pad(value, ((0, 0), (0, 0), (0, ours[column].shape[2] - value.shape[2])))
                    value[np.isnan(ours["isotropic"])] = np.nan
                np.testing.assert_array_equal(value, ours[column], err_msg=f"{name} {column} {dwell.k}")
    tracks = result.tracks()
    assert np.array_equal(np.concatenate([dwell.tracks()["x_hat"] for dwell in dwells]), tracks["x_hat"])
    assert set(tracks["target"].tolist()) > {0}
    assert "target" not in (dwells[0].tracks().dtype.names or ())


def test_a_stored_run_has_the_dwells_that_were_played(played: tuple[list[cogradar.Dwell], cogradar.Result]) -> None:
    for live, stored in zip(played[0], played[1].dwells(), strict=True):
        for name in ("detections", "tracks", "requests", "truth", "waveforms"):
            ours, theirs = getattr(live, name)(), getattr(stored, name)()
            assert ours.dtype == theirs.dtype
            for column in ours.dtype.names:
                np.testing.assert_array_equal(ours[column], theirs[column], err_msg=f"{name} {column} {live.k}")
        assert (live.next is None) == (stored.next is None)


def test_tables_are_those_of_the_arrays(played: tuple[list[cogradar.Dwell], cogradar.Result]) -> None:
    _, result = played
    looks, over = result.detections(all_looks=True), result.detections()
    assert np.array_equal(looks[looks["is_over"]][list(over.dtype.names or ())], over)
    assert 0 < len(over) < len(looks)
    truth, tracks, sent = result.truth(), result.tracks(), result.waveforms()
    for t in result.t.tolist():
        now = truth[truth["t"] == t]
        states = result.true_states[t - 1, now["target"] - 1]
        assert np.array_equal(np.stack([now[name] for name in ("x", "vx", "y", "vy")], axis=-1), states)
        ours = tracks[(tracks["t"] == t) & (tracks["target"] > 0)]
        assert np.array_equal(ours["x_hat"], result.estimates[t - 1, ours["target"] - 1, 0])
        assert np.array_equal(ours["covariance"], result.covariance[t - 1, ours["target"] - 1])
        assert np.array_equal(ours["share"], result.shares[t - 1, ours["target"] - 1])
    assert np.array_equal(np.nan_to_num(sent["factor"][sent["t"] > 0]), np.nan_to_num(result.factors))


def test_any_frame_has_the_columns(played: tuple[list[cogradar.Dwell], cogradar.Result]) -> None:
    tracks, found = played[1].tracks(), played[1].detections()
    pandas, polars, xarray = tracks.to_pandas(), tracks.to_polars(), tracks.to_xarray()
    assert np.array_equal(pandas["covariance_0_2"], tracks["covariance"][:, 0, 2])
    assert polars["covariance_3_3"].to_numpy().tolist() == tracks["covariance"][:, 3, 3].tolist()
    assert xarray["covariance"].shape == (len(tracks), 4, 4)
    assert np.array_equal(found.to_pandas()["alpha_hat"], found["alpha_hat"])
    assert np.array_equal(found.to_polars()["alpha_hat_imag"].to_numpy(), found["alpha_hat"].imag)


def test_a_run_is_kept_and_cancelled(tmp_path: Path) -> None:
    file, copy = tmp_path / "runs.db", tmp_path / "copy.db"
    kept = cogradar.run("smoke", seed=2, dwells=3, store=file)
    with cogradar.play("smoke", seed=3, dwells=9, store=file) as player:
        left = next(player)
    assert (left.k, left.t) == (0, 0)
    with cogradar.open(file) as runs:
        assert {row["seed"]: row["status"] for row in runs.runs(run="all")} == {2: "complete", 3: "stopped"}
        assert runs.result(kept.run).digest == kept.digest
    with pytest.raises(cogradar.BadInput, match="is in a store already"):
        kept.save(copy)
    unkept = cogradar.run("smoke", seed=2, dwells=3)
    unkept.save(copy)
    with cogradar.open(copy) as runs:
        assert runs.result().digest == unkept.digest == kept.digest
    with pytest.raises(cogradar.BadInput, match=r"copy\.db"):
        unkept.save(copy)


def test_settings_are_those_of_the_command_line() -> None:
    settings = {"radar.array.n_tx": 12, "radar.planner.rule": "mode", "world.targets.2.state": [50, -0.05, 20.0, 0.1]}
    ours = cogradar.run("smoke", set=settings, dwells=2)
    told: list[int] = []
    theirs = cogradar.run(
        "smoke",
        set=["radar.array.n_tx=12", "world.targets.2.state=[50, -0.05, 20.0, 0.1]"],
        rule="mode",
        dwells=2,
        callback=lambda dwell: told.append(dwell.k),
    )
    assert ours.digest == theirs.digest
    assert told == [*range(theirs.acquisition_scans + 2)]
    assert ours.scenario.radar.array.n_tx == 12
    with pytest.raises(cogradar.BadInput, match="a Scenario has all its values"):
        cogradar.run(ours.scenario, set=settings)
    for typo, meant in (("seeds", "seed"), ("sets", "set"), ("stratgy", "strategy"), ("xyz", "")):
        guess, given = rf" \(did you mean {meant}\?\)" if meant else "", dict[str, Any]({typo: 3})
        with pytest.raises(cogradar.BadInput, match=rf"^{typo}: no argument{guess}, must be one of belief, dist"):
            cogradar.run("smoke", **given)
    assert cogradar.load("smoke", {"radar.array.n_tx": np.array(12)}).radar.array.n_tx == 12
    assert cogradar.load("smoke", "radar.array.n_tx=12").radar.array.n_tx == 12
    with pytest.raises(cogradar.BadInput, match="a setting is None"):
        cogradar.load("smoke", {"radar.array.n_tx": None})
    with pytest.raises(cogradar.BadInput, match=r"rule = .clairvoyant.: must be one of pomcp"):
        cogradar.run("smoke", rule="clairvoyant")
    with pytest.raises(cogradar.BadInput, match="No such file or directory"):
        cogradar.run("smoke", front_end="nowhere.py:None", dwells=2)


def test_a_receiver_of_your_own_is_played(tmp_path: Path) -> None:
    text, receiver = Path("deploy/scenarios/smoke.toml").read_text(), "cogradar/templates/front_end.py:Receiver"
    mine = tmp_path / "mine.toml"
    mine.write_text(text[: text.index("[world")])
    result = cogradar.run(mine, front_end=receiver, dwells=2)
    assert (result.status, result.has_truth, len(result.t)) == ("complete", False, 2)
    with cogradar.play(mine, front_end=receiver, rule="mode", dwells=2) as player:
        assert [dwell.has_truth for dwell in player] == [False] * (player.result.acquisition_scans + 2)
    assert player.result.scenario.radar.planner.rule == "mode"
    with pytest.raises(cogradar.BadInput, match=r"disturbance: smoke has no \[world\]"):
        cogradar.run(mine, front_end=receiver, disturbance="white")


def test_pictures_show_the_dwell(played: tuple[list[cogradar.Dwell], cogradar.Result]) -> None:
    result = played[1]
    (target, *_) = np.flatnonzero(~np.isnan(result.estimates[-1, :, 0])) + 1
    path = result.plot.track(int(target)).lines
    assert np.array_equal(path[0].get_xdata(), result.true_states[:, target - 1, 0], equal_nan=True)
    level = result.plot.beampattern(DWELLS).lines[0].get_ydata()
    expected = result.beampatterns(np.linspace(-0.5, 0.5, np.size(level)))[-1]
    np.testing.assert_allclose(10.0 ** (np.asarray(level) / 10.0), expected, rtol=1e-9)
    scope = result.plot.scope(DWELLS)
    confirmed = (result.by_track.alive & result.by_track.confirmed)[-1].sum()
    assert scope.get_title(loc="left").endswith(f"dwell {DWELLS}: {confirmed} confirmed tracks")
    with pytest.raises(cogradar.BadInput, match="has no such dwell"):
        result.plot.scope(DWELLS + 1)


def test_a_store_is_free_whatever_became_of_its_run(tmp_path: Path) -> None:
    """Without a `with`: after the last dwell, a failure, Ctrl-C, and when nobody has the player any more."""

    def raising(error: BaseException) -> Callable[..., Any]:
        def rule(*_: object) -> None:
            raise error

        return rule

    file = tmp_path / "runs.db"
    player = cogradar.play("smoke", seed=1, dwells=2, store=file)
    assert [dwell.t for dwell in player][-2:] == [1, 2]
    broken = cogradar.play("smoke", seed=2, dwells=2, store=file, rule=raising(SystemExit(3)))
    with pytest.raises(cogradar.RunFailed, match="SystemExit: 3"):
        list(broken)
    stopped = cogradar.play("smoke", seed=3, dwells=2, store=file, rule=raising(KeyboardInterrupt()))
    with pytest.raises(KeyboardInterrupt):
        list(stopped)
    next(cogradar.play("smoke", seed=4, dwells=2, store=file))
    with cogradar.open(file) as runs:
        found = {row["seed"]: row["status"] for row in runs.runs(run="all")}
    assert found == {1: "complete", 2: "failed", 3: "failed", 4: "stopped"}
    assert player.result.status == "complete"


def test_two_players_keep_their_objects_apart() -> None:
    def looks_at(bin_: int) -> Callable[..., Any]:
        return lambda *_: (bin_, 0)

    players = [cogradar.play("smoke", dwells=3, rule=looks_at(bin_)) for bin_ in (2, 9)]
    for dwells in zip(*players, strict=True):
        if dwells[0].t > 0:
            assert [plan.bins.tolist() for dwell in dwells for plan in dwell.plans] == [[2], [2], [9], [9]]


def test_a_waveform_that_cannot_be_radiated_is_bad_input() -> None:
    with cogradar.play("smoke", dwells=3) as player:
        first = next(player)
        while first.t == 0:
            first = next(player)
        assert first.next is not None
        for change, words in (
            ({"factor": 2.0 * first.next.factor}, "power 4, at most 1 is allowed"),
            ({"factor": first.next.factor.astype(np.complex128)}, "cannot be sent"),
            ({"k": 0}, "must be a copy of `next`"),
        ):
            with pytest.raises(cogradar.BadInput, match=words):
                player.send(first.next.model_copy(update=change))
        assert player.send(first.next).t == first.t + 1
