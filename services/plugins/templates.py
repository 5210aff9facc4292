"""Files to begin with: one of each kind, which runs as it is."""

from pathlib import Path

from cogradar.services.errors import BadInput

# Beside this package, wherever it is installed; in a checkout it is a link to deploy/plugins.
FOLDER = Path(__file__).parents[2] / "templates"


def kinds() -> list[str]:
    """Kinds of which there is one."""
    return sorted(path.stem.replace("_", "-") for path in FOLDER.glob("*.py"))


def write(kind: str, file: Path, *, force: bool = False) -> str:
    """Write a file to begin with; returns what is in it, in words. Raises BadInput."""
    if kind not in kinds():
        raise BadInput(f"{kind}: must be one of {', '.join(kinds())}")
    if file.suffix != ".py":
        raise BadInput(f"{file}: must be a .py file")
    text = (FOLDER / f"{kind.replace('-', '_')}.py").read_text(encoding="utf-8").replace("FILE.py", file.name)
    try:
        with file.open("w" if force else "x", encoding="utf-8") as stream:
            stream.write(text)
    except FileExistsError:
        raise BadInput(f"{file}: is there already; --force replaces it") from None
    except OSError as error:
        raise BadInput(f"{file}: {error.strerror}") from None
    return text.partition('"""')[2].partition('"""')[0]
