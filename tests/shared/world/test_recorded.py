"""A recorded disturbance in the world of an array: which data set a cell has, and scenarios that cannot have it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cogradar.services.emulator.front_end import FrontEndError
from cogradar.services.emulator.simulated import SimulatedFrontEnd
from cogradar.services.runs.in_process import play
from cogradar.shared.protocol.messages import EmulatorCheckpoint, RunStart
from cogradar.shared.scenario.document import ScenarioError
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.scenario.scenario import Scenario
from cogradar.shared.scenario.world_config import WorldEchoSection
from cogradar.shared.scoring.prospects import prospects, warnings
from cogradar.shared.signal.looks import Look
from cogradar.shared.signal.recording import read
from cogradar.shared.world.array_scene import ArrayScene
from tests.oracles.detection import literal_cell

FILE = """extends = "smoke"
dwells = 3
[radar.acquisition]
max_scans = 4
[world]
signal = "array"
[world.disturbance]
model = "recorded"
[world.disturbance.recording]
file = "iq.npy"
axes = ["time"]
"""
N_TX = N_RX = 16
N = N_TX * N_RX


def samples(n: int, seed: int = 1) -> NDArray[np.complex64]:
    rng = np.random.default_rng(seed)
    return (rng.standard_normal(n) + 1j * rng.standard_normal(n)).astype(np.complex64)


def saved(folder: Path, array: NDArray[Any], text: str = FILE) -> str:
    np.save(folder / "iq.npy", array)
    (folder / "sea.toml").write_text(text)
    return str(folder / "sea.toml")


def silent(scenario: Scenario) -> ArrayScene:
    nothing = WorldEchoSection.model_construct(amplitude_db=-300.0)
    return ArrayScene(scenario.simulated.model_copy(update={"echo": nothing}), scenario.radar, 1, 0)


def test_a_cell_is_tested_with_its_part_of_the_file(tmp_path: Path) -> None:
    y = samples(10 * N)
    y /= np.sqrt(np.mean(np.abs(y) ** 2))
    settings = ["radar.fidelity=best-range", "radar.receiver.range_cell_km=100.0"]  # two range cells from 0 km on
    scene = silent(load(saved(tmp_path, 7.0 * y), [*settings, "world.disturbance.recording.repeat=true"]))
    looks = [Look(nu, 0, (i,), 1e9) for i in range(2) for nu in (-0.2, 0.1)]
    for k in (0, 1, 5):
        for look, row in zip(looks, scene.observe(k, 1.0, np.empty((N_TX, 0), complex), looks), strict=True):
            cell = row.look.cells[0]
            block = y.reshape(-1, N)[(2 * k + cell) % 10].astype(np.complex128)
            v = np.exp(2j * np.pi * row.look.nu * np.add.outer(np.arange(N_TX), np.arange(N_RX))).ravel() / 4.0
            statistic = literal_cell(block, v.astype(np.complex128))[0]
            assert row.cell.statistic == pytest.approx(statistic, rel=1e-5), (k, look)


def test_a_run_has_the_digest_of_its_file(tmp_path: Path) -> None:
    def digest(array: NDArray[Any]) -> str:
        scenario = load(saved(tmp_path, array), ["world.echo.amplitude_db=90.0"])
        found = play(RunStart.of(scenario, Strategy.ORTHOGONAL, 1, 3))
        return f"{found.run['status']} {found.run['digest']}"

    one, same, other = digest(samples(7 * N)), digest(samples(7 * N)), digest(samples(7 * N, 2))
    assert one == same != other
    assert one.startswith("complete")


@pytest.mark.parametrize(
    ("settings", "n", "said"),
    [
        (
            [],
            6 * N,
            "has 6 dwells of 1 range cells, enough for 6 dwells of the radar with 1 range cells each",
        ),
        (["dwells=9", "radar.acquisition.max_scans=1"], 7 * N, "up to 10: give a longer one, or set repeat = true"),
        (["radar.fidelity=best-range"], 7 * N, "a dwell of the radar needs 390 range cells: give a longer one"),
        (["world.disturbance.recording.file=no.npy"], N, "no.npy: no such file"),
        (["world.disturbance.recording.axes=['time', 'time']"], N, "each name must be there once"),
        (["world.disturbance.recording.axes=['when']"], N, "must be one of dwell, range, tx, rx, channel, time, iq"),
        (['world.disturbance.recording.axes=["tx", "rx"]'], N, "the array has 1 axes, (256,), name each of them"),
        (["world.signal=cells"], 7 * N, 'disturbance.recording must be left out, or set world.signal = "array"'),
        (["world.disturbance.model=white"], 7 * N, 'leave recording out, which is for model = "recorded"'),
        (["world.disturbance.recording.sha256=" + 64 * "0"], 7 * N, "leave it out, or name the file that the run had"),
        (["world.disturbance.recording.scale=0"], 7 * N, "world.disturbance.recording.scale"),
    ],
)
def test_what_is_wrong_with_a_recording_is_said(settings: list[str], n: int, said: str, tmp_path: Path) -> None:
    file = saved(tmp_path, samples(n))
    with pytest.raises(ScenarioError) as raised:
        load(file, settings)
    assert said in "\n".join(raised.value.faults)
    assert "disturbance" in str(raised.value)


def test_a_recording_needs_its_table() -> None:
    with pytest.raises(ScenarioError, match='model = "recorded": needs a table recording'):
        load("smoke", ["world.signal=array", "world.disturbance.model=recorded"])


def test_check_says_how_often_a_recording_is_repeated(tmp_path: Path) -> None:
    file = saved(tmp_path, samples(3 * N + 5))
    scenario = load(file, ["world.disturbance.recording.repeat=true", "radar.receiver.separation=joint"])
    found = "\n".join(warnings(scenario, prospects(scenario)))
    assert "has data for 3 dwells with 1 range cells each, a run of up to 7 dwells has them 2.33 times" in found
    assert "its last 5 samples are not used" in found
    assert 'separation = "joint" with world.disturbance.recording: a dwell may take seconds' in found


def test_an_emulator_without_the_file_says_so(tmp_path: Path) -> None:
    scenario = load(saved(tmp_path, samples(7 * N)))
    settings = {"run": "r", "strategy": "orthogonal", "dwells": 3, "k": 0, "t": 0, "seed": 0, "world_seed": 1}
    document = {"radar": scenario.radar.model_dump(), "world": scenario.simulated.model_dump()}
    start = EmulatorCheckpoint.model_validate(settings | document)
    SimulatedFrontEnd.open(start).close()
    (tmp_path / "iq.npy").unlink()

    read.cache_clear()
    with pytest.raises(FrontEndError, match=r"world.disturbance.recording: .*iq\.npy: no such file"):
        SimulatedFrontEnd.open(start)
