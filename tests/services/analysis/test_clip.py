"""Moving pictures of runs: a frame a dwell, with what is known and no more."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from cogradar.services.cli.app import app
from cogradar.services.errors import BadInput

UNKNOWN = ("radar.fidelity=best-range", 'radar.tracks="unknown"', "radar.search.beams=2")


@pytest.fixture(scope="module")
def stores(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """A store with a run of each kind."""
    folder = tmp_path_factory.mktemp("runs")
    files = {name: str(folder / f"{name}.db") for name in ("known", "unknown")}
    for name, settings in (("known", ()), ("unknown", UNKNOWN)):
        changed = [word for setting in settings for word in ("--set", setting)]
        command = ["run", "smoke", "--in-process", "--dwells", "12", "--store", files[name], *changed]
        assert CliRunner().invoke(app, command).exit_code == 0
    return files


def _export(store: str, file: Path, *options: str) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["export", "--store", store, "--what", "clip", "--out", str(file), *options])
    return done.exit_code, done.output


@pytest.mark.parametrize("kind", ["known", "unknown"])
def test_a_frame_for_each_dwell(kind: str, stores: dict[str, str], tmp_path: Path) -> None:
    file = tmp_path / "clip.gif"
    assert _export(stores[kind], file, "--dwells", "3:8", "--rate", "5")[0] == 0
    with Image.open(file) as clip:
        assert (getattr(clip, "n_frames", 1), clip.info["duration"]) == (6, 200)
        frames = []
        for i in range(6):
            clip.seek(i)
            frames.append(np.asarray(clip.convert("RGB")))
    changes = [int((a != b).any(axis=-1).sum()) for a, b in pairwise(frames)]
    assert min(changes) > 20  # the title at least
    coloured = (np.ptp(frames[-1].astype(int), axis=-1) > 60).sum()
    assert coloured > 30  # tracks


def test_what_cannot_be_is_refused(stores: dict[str, str], tmp_path: Path) -> None:
    there = tmp_path / "there.gif"
    there.write_bytes(b"mine")
    for file, options, words in (
        (there, (), "is there already; --force replaces it"),
        (tmp_path / "clip.mp4", (), "format must be one of"),
        (tmp_path / "clip.gif", ("--dwells", "40:50"), "--dwells 40:50"),
        (tmp_path / "clip.gif", ("--dwells", "5"), "must be a:b"),
    ):
        code, said = _export(stores["known"], file, *options)
        assert code == BadInput.exit_code
        assert words in " ".join(said.split())
    assert there.read_bytes() == b"mine"
    assert [path.name for path in tmp_path.iterdir()] == ["there.gif"]  # and no part of another
