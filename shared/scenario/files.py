"""Scenario files: found by name or path, read, checked."""

import errno
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from shared.scenario.faults import explain, explain_all, printable
from shared.scenario.radar_config import RadarConfig
from shared.scenario.scenario import Scenario
from shared.scenario.section import Section
from shared.scenario.world_config import WorldConfig

# Beside this package, wherever it is installed; in a checkout it is a link to deploy/scenarios.
SCENARIO_DIR = (Path(__file__).resolve().parents[2] / "cogradar" / "scenarios").resolve()
MAX_FILE_BYTES = 1 << 20
T = TypeVar("T", bound=Section)


class ScenarioError(ValueError):
    """A scenario file that cannot be used; the text is one line: file, key, value, allowed.

    `faults` has such a line for each thing that is wrong.
    """

    def __init__(self, text: str, faults: Sequence[str] = ()) -> None:
        super().__init__(text)
        self.faults = tuple(faults) or (text,)


def load(name_or_path: str) -> Scenario:
    """Read and check a scenario: the name of a built-in one, or the path of a TOML file.

    Raises ScenarioError with a one-line text that names the file, the key, the value and what is allowed.
    """
    path = Path(name_or_path)
    if path.suffix != ".toml":
        path = SCENARIO_DIR / f"{name_or_path}.toml"
    try:
        document = tomllib.loads(_text(path))
    except FileNotFoundError:
        known = ", ".join(sorted(p.stem for p in SCENARIO_DIR.glob("*.toml")))
        text = f"{name_or_path}: no such scenario or .toml file; the built-in ones are: {known}"
        raise ScenarioError(printable(text)) from None
    except OSError as error:
        raise ScenarioError(printable(f"{path}: {error.strerror}")) from None
    except RecursionError:
        raise ScenarioError(printable(f"{path}: not valid TOML: nested too deeply")) from None
    except ValueError as error:  # also of decoding, and of integers with thousands of digits
        raise ScenarioError(printable(f"{path}: not valid TOML: {error}")) from None
    return parse(document, source=str(path))


def parse(document: dict[str, Any], source: str) -> Scenario:
    """Check a decoded scenario; `source` is named in the error."""
    return _checked(document, source, Scenario)


def parse_radar(document: dict[str, Any], source: str) -> RadarConfig:
    """Check a decoded table `[radar]`."""
    return _checked(document, source, RadarConfig)


def parse_world(document: dict[str, Any], source: str) -> WorldConfig:
    """Check a decoded table `[world]`."""
    return _checked(document, source, WorldConfig)


def _checked(document: dict[str, Any], source: str, kind: type[T]) -> T:
    try:
        return kind.model_validate(document)
    except ValidationError as error:
        faults = [printable(f"{source}: {fault}") for fault in explain_all(error, kind)]
        raise ScenarioError(printable(f"{source}: {explain(error, kind)}"), faults) from None


def _text(path: Path) -> str:
    if not path.is_file():
        raise OSError(errno.EINVAL, "not a regular file") if path.exists() else FileNotFoundError
    if path.stat().st_size > MAX_FILE_BYTES:
        raise OSError(errno.EFBIG, f"larger than {MAX_FILE_BYTES} bytes, too large for a scenario")
    return path.read_text(encoding="utf-8")
