"""The command about recorded data: calibrate."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cogradar.services.cli.console import (
    JsonOption,
    ScenarioArgument,
    SetOption,
    command,
    out,
    print_json,
)
from cogradar.services.errors import BadInput, RunFailed
from cogradar.shared.scenario.files import ScenarioError, load

if TYPE_CHECKING:
    import numpy as np

    from cogradar.shared.signal.detector.calibration import Antennas, Calibration

NUMPY = (".npy", ".npz")
KEYS = ("snapshots", "isotropic", "factor")  # of an .npz file


def calibrate(
    file: Annotated[Path, typer.Argument(help="Snapshots after matched filtering, (K, n_tx, n_rx): .npy or .npz.")],
    scenario: ScenarioArgument,
    settings: SetOption = None,
    bearing: Annotated[
        float | None,
        typer.Option(min=-90.0, max=90.0, metavar="DEG", help="Bearing of the recorded target; left out: noise alone."),
    ] = None,
    range_km: Annotated[
        float | None,
        typer.Option("--range", min=0.001, max=10_000.0, metavar="KM", help="Range of the recorded target."),
    ] = None,
    bins: Annotated[bool, typer.Option("--bins", help="Print the noise of each bin.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Test recorded data against a scenario: signs, order, gains, noise. Exit code 1 if something is suspicious."""
    from cogradar.services.kernels import interpret_unless_compiled

    with command(at_once=True):
        if range_km is not None and bearing is None:
            raise BadInput("--range: belongs to --bearing")
        try:
            radar = load(scenario, settings or ()).radar
        except ScenarioError as error:
            raise BadInput("\n".join(error.faults)) from None
        snapshots, waveform = _read(file)
        interpret_unless_compiled()  # before what follows imports some
        from cogradar.services.emulator import front_end

        try:
            found = front_end.calibrate(snapshots, radar, bearing_deg=bearing, range_km=range_km, waveform=waveform)
        except ValueError as error:
            raise BadInput(f"{file}: {error}") from None
    if as_json:
        print_json(_as_json(found))
    else:
        _print(file, found, snapshots.shape, bearing, bins=bins)
    if found.findings:
        raise typer.Exit(RunFailed.exit_code)


def _read(
    file: Path,
) -> "tuple[np.ndarray[Any, np.dtype[Any]], tuple[float, np.ndarray[Any, np.dtype[np.complex128]]] | None]":
    """Snapshots, and the waveform if the file has one. Raises BadInput."""
    import numpy as np

    from cogradar.shared.signal.recording import RecordingError, arrays_in

    if file.suffix not in NUMPY:
        raise BadInput(f"{file}: must end with {' or '.join(NUMPY)}; numpy.save writes one")
    try:
        found = arrays_in(file, every=True)
    except RecordingError as error:
        raise BadInput(f"{error}; numpy.save writes one") from None
    arrays = {name or "snapshots": array for name, array in found.items() if array is not None}
    if unknown := sorted(arrays.keys() - set(KEYS)):
        raise BadInput(f"{file}: {unknown[0]}: must be one of {', '.join(KEYS)}")
    if "snapshots" not in arrays or ("isotropic" in arrays) != ("factor" in arrays):
        raise BadInput(f"{file}: must have snapshots, and both or neither of isotropic and factor")
    snapshots = arrays["snapshots"]
    if snapshots.ndim == 2:
        snapshots = snapshots[np.newaxis]
    if "factor" not in arrays:
        return snapshots, None
    try:
        return snapshots, (float(arrays["isotropic"]), np.asarray(arrays["factor"], dtype=np.complex128))
    except (TypeError, ValueError):
        raise BadInput(f"{file}: isotropic must be a number, and factor an array of complex numbers") from None


def _print(file: Path, found: "Calibration", shape: tuple[int, ...], bearing: float | None, *, bins: bool) -> None:
    import numpy as np

    from cogradar.services.analysis.tables import Column, Table
    from cogradar.services.cli.terminal import print_tables

    what = "noise alone" if bearing is None else f"a target at {bearing:g} degrees"
    k, n_tx, n_rx = shape
    lines = [f"{file}: {k} snapshot{'s' if k != 1 else ''} of {n_tx} x {n_rx}, {what}"]
    for name, side in (("transmit", found.transmit), ("receive", found.receive)):
        if side is not None:
            lines.append(f"{name}: {_errors(side)}")
    if found.amplitude_db is not None:
        lines.append(f"amplitude: {found.amplitude_db:.1f} dB")
    noise = found.noise
    text = f"noise: {noise.power_db:+.1f} dB in an element"
    if np.isfinite(noise.levels_db).any():
        low, high = int(np.nanargmin(noise.levels_db)), int(np.nanargmax(noise.levels_db))
        text += f", by bin {noise.levels_db[low]:.1f} dB (bin {low}) to {noise.levels_db[high]:.1f} dB (bin {high})"
    lines.append(text)
    for line in lines:
        out.print(line, soft_wrap=True)
    if bins:
        columns = (
            *(Column("bin", "{bin}"), Column("degrees", "{angle_deg:.1f}"), Column("noise, dB", "{level_db:.1f}")),
            Column("blind, %", "{blind_percent:.0f}"),
        )
        print_tables(out, [Table("", columns, _rows(found))])
    for one in found.findings:
        out.print(f"suspicious: {one.what} {one.cure}", soft_wrap=True)
    if not found.findings:
        out.print("nothing is suspicious", soft_wrap=True)
    for note in found.notes:
        out.print(f"not known: {note}", soft_wrap=True)


def _errors(side: "Antennas") -> str:
    import numpy as np

    alive = side.gains[np.abs(side.gains) > 0.0]
    gain_db = float(np.abs(20.0 * np.log10(np.abs(alive))).max())
    phase = float(np.abs(np.degrees(np.angle(alive))).max())
    return f"{_degrees(side.nu):.1f} degrees, gains within {gain_db:.1f} dB and {phase:.0f} degrees"


def _degrees(nu: float) -> float:
    return math.degrees(math.asin(min(max(2.0 * nu, -1.0), 1.0)))


def _rows(found: "Calibration") -> list[dict[str, Any]]:
    """A row for each bin."""
    noise = found.noise
    columns = zip(noise.nus.tolist(), noise.levels_db.tolist(), noise.blind.tolist(), strict=True)
    return [
        {
            "bin": i,
            "angle_deg": _degrees(nu),
            "level_db": level if math.isfinite(level) else None,
            "blind_percent": 100.0 * blind,
        }
        for i, (nu, level, blind) in enumerate(columns)
    ]


def _as_json(found: "Calibration") -> dict[str, Any]:
    sides = {
        name: None
        if side is None
        else {
            "angle_deg": _degrees(side.nu),
            "gains": [[gain.real, gain.imag] for gain in side.gains.tolist()],
            "sigma": side.sigma,
        }
        for name, side in (("transmit", found.transmit), ("receive", found.receive))
    }
    return {
        "snapshots": found.snapshots,
        "findings": [one._asdict() for one in found.findings],
        "notes": found.notes,
        **sides,
        "amplitude_db": found.amplitude_db,
        "noise_db": found.noise.power_db,
        "alarms": found.noise.alarms,
        "bins": _rows(found),
    }
