"""Recorded data from the command line: exit codes, JSON, files that are none."""

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cogradar.shared.signal.waveform import beam_factor
from tests.services.cli.here import here


@pytest.fixture
def noise(tmp_path: Path) -> Path:
    """A file of white noise for the smoke scenario."""
    file = tmp_path / "noise.npy"
    np.save(file, np.random.default_rng(1).standard_normal((8, 16, 32)).view(np.complex128) * np.sqrt(0.5))
    return file


def test_exit_codes_say_whether_something_is_suspicious(noise: Path) -> None:
    done = here("calibrate", str(noise), "smoke")
    assert (done.returncode, done.stdout.splitlines()[-1]) == (0, "nothing is suspicious")
    np.save(noise, 3.0 * np.load(noise))
    done = here("calibrate", str(noise), "smoke", "--bins")
    assert done.returncode == 1
    assert "suspicious: The noise has a power of +9.6 dB in an element of Y, must be 0 dB. Divide Y by" in done.stdout
    assert sum(line.split()[:1] == [str(i)] for i, line in zip(range(16), done.stdout.splitlines()[4:], strict=False))


def test_json_has_gains_and_bins(noise: Path) -> None:
    y, i = np.load(noise), np.arange(16)
    a = np.exp(2j * np.pi * 0.17 * i)
    np.save(noise, y + 20.0 * np.outer(a, a))
    bearing = np.degrees(np.arcsin(0.34))
    done = here("calibrate", str(noise), "smoke", "--bearing", f"{bearing}", "--json")
    found = json.loads(done.stdout)
    assert (done.returncode, found["findings"], found["snapshots"]) == (0, [], 8)
    assert np.array(found["receive"]["gains"]).shape == (16, 2)
    assert found["transmit"]["angle_deg"] == pytest.approx(bearing, abs=0.5)
    assert [row["bin"] for row in found["bins"]] == list(range(16))


def test_a_waveform_with_beams_comes_with_its_snapshots(noise: Path) -> None:
    y, file = np.load(noise), noise.with_suffix(".npz")
    np.savez(file, snapshots=y, isotropic=0.5, factor=beam_factor([0.1], [0.5], 16))
    assert here("calibrate", str(file), "smoke").returncode == 0
    np.savez(file, snapshots=y, isotropic=0.5)
    done = here("calibrate", str(file), "smoke")
    assert (done.returncode, done.stdout) == (2, "")
    assert "both or neither of isotropic and factor" in done.stderr
    np.savez(file, snapshots=y, isotropic=0.5, factor=beam_factor([0.1], [0.5], 8))
    assert "factor of shape (8, 1), (16, beams) is needed" in here("calibrate", str(file), "smoke").stderr
    np.savez(file, y=y)
    assert "y: must be one of snapshots, isotropic, factor" in here("calibrate", str(file), "smoke").stderr


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "no such file"),
        (b"", "no .npy file"),
        (b"time,x,y\n", "no .npy file"),
        (b"PK\x03\x04", "no .npy file"),
        (b"\x93NUMPY\x01\x00v\x00{'descr': '|O', 'fortran_order': False, 'shape': (1,), }", "no .npy file"),
        (np.zeros((3, 8, 8)), "snapshots of shape (3, 8, 8), (K, 16, 16) are needed"),
        (np.zeros((3, 16, 16)), "all values are 0"),
        (np.full((3, 16, 16), np.inf), "NaN or infinite"),
        (np.full((3, 16, 16), "x"), "of type <U1"),
    ],
)
def test_bad_files_are_a_sentence(content: Any, words: str, tmp_path: Path) -> None:
    file = tmp_path / "bad.npy"
    if isinstance(content, bytes):
        file.write_bytes(content)
    elif content is not None:
        np.save(file, content)
    done = here("calibrate", str(file), "smoke")
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert str(file) in line
    assert words in line


def test_damaged_archives_are_a_sentence(tmp_path: Path) -> None:
    file = tmp_path / "bad.npz"
    np.savez_compressed(file, snapshots=np.random.default_rng(1).standard_normal((3, 16, 16)) + 0j)
    damaged = bytearray(file.read_bytes())
    damaged[200:400] = bytes(200)
    file.write_bytes(damaged)
    for content in (bytes(damaged), _with_text("snapshots")):
        file.write_bytes(content)
        done = here("calibrate", str(file), "smoke")
        assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, "", 1)
        assert str(file) in done.stderr


def _with_text(name: str) -> bytes:
    """An .npz archive whose member is no array."""
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w") as members:
        members.writestr(name, "text")
    return whole.getvalue()


def test_a_range_needs_a_bearing(noise: Path) -> None:
    done = here("calibrate", str(noise), "smoke", "--range", "20")
    assert done.returncode == 2
    assert "--range: belongs to --bearing" in done.stderr
