"""Recorded I/Q: formats, axes, which part a dwell has, and what is said of files that cannot be used."""

import json
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse
from scipy.io import savemat

from cogradar.shared.signal.recording import Layout, Recording, RecordingError, read, sha256

N_TX, N_RX = 3, 4
N = N_TX * N_RX
RNG = np.random.default_rng(5)
DATA = (RNG.standard_normal((5, 2, N)) + 1j * RNG.standard_normal((5, 2, N))).astype(np.complex64)
CUBE = DATA.reshape(5, 2, N_TX, N_RX)


def recorded(file: Path, *axes: str, variable: str | None = None, scale: float | None = 1.0) -> Recording:
    return read(file, sha256(file), Layout(variable, axes, scale, N_TX, N_RX))


def saved(folder: Path, array: NDArray[Any]) -> Path:
    np.save(folder / "iq.npy", array)
    return folder / "iq.npy"


def sigmf(folder: Path, samples: NDArray[Any], datatype: str, channels: int = 1) -> Path:
    samples.tofile(folder / "iq.sigmf-data")
    head = {"core:datatype": datatype, "core:num_channels": channels, "core:version": "1.0.0"}
    (folder / "iq.sigmf-meta").write_text(json.dumps({"global": head, "captures": [], "annotations": []}))
    return folder / "iq.sigmf-meta"


def pairs(array: NDArray[Any], kind: str, scale: float = 1.0) -> NDArray[Any]:
    """I and Q, one after the other."""
    return np.round(scale * np.stack((array.real, array.imag), axis=-1)).astype(kind)


@pytest.mark.parametrize(
    ("array", "axes"),
    [
        (CUBE, ("dwell", "range", "tx", "rx")),
        (DATA, ("dwell", "range", "channel")),
        (CUBE.transpose(1, 3, 0, 2), ("range", "rx", "dwell", "tx")),
        (CUBE.transpose(1, 0, 2, 3).reshape(2, 5 * N_TX, N_RX), ("range", "time", "rx")),
        (DATA.transpose(1, 0, 2).reshape(2, 5 * N), ("range", "time")),
        (np.stack((CUBE.real, CUBE.imag), axis=0), ("iq", "dwell", "range", "tx", "rx")),
    ],
)
def test_axes_have_any_order(array: NDArray[Any], axes: tuple[str, ...], tmp_path: Path) -> None:
    found = recorded(saved(tmp_path, array), *axes)
    np.testing.assert_array_equal(found.data, DATA)
    assert found.left_over == 0


def test_samples_one_after_another_are_cut_into_data_sets(tmp_path: Path) -> None:
    found = recorded(saved(tmp_path, DATA.ravel()[: 4 * N + 7]), "time")
    np.testing.assert_array_equal(found.data[:, 0], DATA.reshape(-1, N)[:4])
    assert found.left_over == 7
    assert recorded(saved(tmp_path, CUBE[0, 0]), "tx", "rx").data.shape == (1, 1, N)


def test_all_formats_say_the_same(tmp_path: Path) -> None:
    np.savez(tmp_path / "iq.npz", other=np.zeros(3), iq=DATA)
    savemat(tmp_path / "iq.mat", {"iq": DATA})
    for file, variable in (("iq.npz", "iq"), ("iq.mat", None)):
        found = recorded(tmp_path / file, "dwell", "range", "channel", variable=variable)
        np.testing.assert_array_equal(found.data, DATA)
    flat = DATA.ravel()
    for samples, datatype, scale in (
        (pairs(flat, "<i2", 1000.0), "ci16_le", 1000.0),
        (pairs(flat, ">i2", 1000.0), "ci16_be", 1000.0),
        (pairs(20.0 * flat + 128.0 * (1 + 1j), "u1"), "cu8", 20.0),
        (flat.astype("<c8"), "cf32_le", 1.0),
    ):
        found = recorded(sigmf(tmp_path, samples, datatype), "time", scale=1.0 / scale)
        np.testing.assert_allclose(found.data.ravel(), flat, atol=1.0 / scale if scale > 1.0 else 1e-6)
    of_channels = sigmf(tmp_path, DATA.reshape(-1, N_RX).astype("<c8"), "cf32_le", N_RX)
    np.testing.assert_array_equal(recorded(of_channels, "time", "rx").data[:, 0], DATA.reshape(-1, N))


def test_scaling(tmp_path: Path) -> None:
    file = saved(tmp_path, 40.0 * DATA)
    axes = ("dwell", "range", "channel")
    assert np.mean(np.abs(recorded(file, *axes, scale=None).data) ** 2) == pytest.approx(1.0, rel=1e-6)
    np.testing.assert_allclose(recorded(file, *axes, scale=0.025).data, DATA, rtol=1e-6)


@pytest.mark.parametrize(("n_cell", "dwells"), [(1, 5), (2, 5), (3, 2), (4, 2), (5, 1), (10, 1), (11, 0)])
def test_no_dwell_has_a_data_set_twice(n_cell: int, dwells: int, tmp_path: Path) -> None:
    found = recorded(saved(tmp_path, DATA), "dwell", "range", "channel")
    assert found.dwells(n_cell) == dwells
    for k in range(dwells):
        rows = {found.at(k, i, n_cell).tobytes() for i in range(n_cell)}
        assert len(rows) == n_cell
        assert found.at(k + dwells, n_cell - 1, n_cell).tobytes() in rows  # again, from the first dwell on
    if dwells:
        found.at(0, 0, n_cell)[:] = 0.0  # a copy
        np.testing.assert_array_equal(found.at(0, 0, n_cell), DATA[0, 0])


@pytest.mark.parametrize(
    ("array", "axes", "said"),
    [
        (DATA.real, ("dwell", "range", "channel"), "has real numbers (float32), must be complex, or have an axis 'iq'"),
        (CUBE[:, :, :, :3], ("dwell", "range", "tx", "rx"), "axis 'rx' has 3 values, must have radar.array.n_rx = 4"),
        (CUBE, ("dwell", "range", "channel"), "the array has 4 axes, (5, 2, 3, 4), name each of them"),
        (DATA.ravel()[:5], ("time",), "axis 'time' has 5 samples, too short: one data set takes 12"),
        (CUBE[0, 0, 0], ("rx",), "must have 'tx' and 'rx', or 'channel', or 'time' in which they are"),
        (
            np.where(DATA[3, 1, 2] == DATA, np.nan, DATA),
            ("dwell", "range", "channel"),
            "dwell 3, range cell 1, chan",
        ),
        (1e300 * CUBE.astype(complex), ("dwell", "range", "tx", "rx"), "must be finite, in single precision"),
        (np.full((5, 12, 2), 1e300), ("dwell", "channel", "iq"), "must be finite, in single precision"),
        (0 * DATA, ("dwell", "range", "channel"), "is 0 everywhere"),
        (np.array(["text"]), ("time",), "must have numbers"),
        (DATA, ("iq", "range", "channel"), "axis 'iq' must have 2 real numbers, has 5 of complex64"),
    ],
)
def test_arrays_that_cannot_be_used(array: NDArray[Any], axes: tuple[str, ...], said: str, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=re.escape(said)) as raised:
        recorded(saved(tmp_path, array), *axes)
    assert str(tmp_path / "iq.npy") in str(raised.value)


def test_files_that_cannot_be_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def said(name: str, content: bytes | None = None, variable: str | None = None) -> str:
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(RecordingError) as raised:
            recorded(tmp_path / name, "time", variable=variable)
        return str(raised.value)

    assert said("none.npy").endswith("none.npy: no such file")
    assert "must end with .npy, .npz, .mat, .sigmf-meta, .sigmf-data" in said("iq.wav", b"RIFF")
    for name in ("bad.npy", "bad.npz", "bad.mat"):
        assert f"{name}: no {Path(name).suffix} file: " in said(name, b"this is none" * 20)
    sigmf(tmp_path, DATA.ravel(), "cf99_le")
    assert "core:datatype = 'cf99_le': unknown, must be such as cf32_le" in said("iq.sigmf-meta")
    assert "no .sigmf-meta file" in said("iq.sigmf-meta", b"[1, 2]")
    np.savez(tmp_path / "two.npz", a=DATA, b=DATA)
    assert "has 2 arrays, set variable to one of: a, b" in said("two.npz")
    assert "variable = 'c': no such array, must be one of: a, b" in said("two.npz", variable="c")
    with zipfile.ZipFile(tmp_path / "text.npz", "w") as members:
        members.writestr("a", "text")
    assert "a is no array" in said("text.npz")
    with zipfile.ZipFile(tmp_path / "method.npz", "w") as members:
        members.writestr("a.npy", b"x" * 100)
    damaged = bytearray((tmp_path / "method.npz").read_bytes())
    damaged[8] = damaged[damaged.index(b"PK\x01\x02") + 10] = 77  # a method of compression that there is not
    assert "no .npz file" in said("method.npz", bytes(damaged))
    (tmp_path / "iq.npy").mkdir()
    assert "not a regular file" in said("iq.npy")
    savemat(tmp_path / "sparse.mat", {"a": sparse.eye_array(3)})
    assert "set variable to one of: none" in said("sparse.mat")
    sigmf(tmp_path, DATA.ravel(), "cf32_le")
    head = json.loads((tmp_path / "iq.sigmf-meta").read_text())
    for meta in (head | {"captures": [{"core:header_bytes": 4}]}, {"global": head["global"] | {"core:dataset": "x"}}):
        assert "samples must be all of" in said("iq.sigmf-meta", json.dumps(meta).encode())
    assert "no .sigmf-meta file" in said("iq.sigmf-meta", b"[" * 100_000)
    monkeypatch.setattr("cogradar.shared.signal.recording.MAX_BYTES", 1 << 20)
    np.savez_compressed(tmp_path / "bomb.npz", a=np.zeros(1 << 18, complex), b=np.ones(100, complex))
    assert "a takes 4 MiB of memory, must take 1 MiB at most" in said("bomb.npz", variable="a")
    assert recorded(tmp_path / "bomb.npz", "time", variable="b").data.shape == (8, 1, N)
    assert "larger than 1 MiB, too large" in said("large.npy", bytes(1 << 21))


@pytest.mark.parametrize("power", [1e-24, 1e25])
def test_power_is_scaled_however_small_or_large(power: float, tmp_path: Path) -> None:
    found = recorded(saved(tmp_path, DATA * np.float32(np.sqrt(power))), "dwell", "range", "channel", scale=None)
    assert np.mean(np.abs(found.data) ** 2) == pytest.approx(1.0, rel=1e-5)
    with pytest.raises(RecordingError, match=r"after scaling, must be 1e-20 \.\. 1e"):
        recorded(saved(tmp_path, DATA), "dwell", "range", "channel", scale=1e-12)


def test_a_file_that_has_changed_is_refused(tmp_path: Path) -> None:
    file = saved(tmp_path, DATA)
    before = sha256(file)
    saved(tmp_path, 2.0 * DATA)
    assert sha256(file) != before
    with pytest.raises(RecordingError, match="it is not the file of the run"):
        read(file, before, Layout(None, ("dwell", "range", "channel"), None, N_TX, N_RX))
