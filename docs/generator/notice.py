"""Writes NOTICE: the libraries that cogradar needs at run time, with their versions and the licences that they state.

`make notice` calls it. Run it again after each change of requirements.lock.
"""

import re
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

REPOSITORY = Path(__file__).resolve().parents[2]
FILE = REPOSITORY / "NOTICE"
HEAD = """\
cogradar
Copyright 2026 the cogradar developers

Licensed under the Apache License, Version 2.0 (SPDX: Apache-2.0); see LICENSE.

At run time cogradar needs the libraries below. They are not part of it: each is installed as a package of its own,
under its own licence. The versions are from requirements.lock, for Linux and Python 3.11; the licences are as the
packages state them. `make notice` writes this list, `make sbom` writes the same as CycloneDX.
"""
SHORT = 60  # characters of a stated licence; a longer one is the licence's whole text


def needed() -> dict[str, Distribution]:
    """Installed distributions that cogradar needs at run time, direct and indirect, by canonical name."""
    found: dict[str, Distribution] = {}
    waiting = [Requirement(text) for text in distribution("cogradar").requires or []]
    waiting = [wanted for wanted in waiting if wanted.marker is None or wanted.marker.evaluate({"extra": ""})]
    while waiting:
        wanted = waiting.pop()
        name = canonicalize_name(wanted.name)
        if name in found:
            continue
        try:
            found[name] = distribution(name)
        except PackageNotFoundError:
            raise SystemExit(f"{name} is not installed: make setup") from None
        for text in found[name].requires or []:
            further = Requirement(text)
            extras = {"", *wanted.extras}
            if further.marker is None or any(further.marker.evaluate({"extra": extra}) for extra in extras):
                waiting.append(further)
    return dict(sorted(found.items()))


def licence(package: Distribution) -> str:
    """The licence that a package states: its SPDX expression, else its classifiers, else its field."""
    if expression := _field(package, "License-Expression"):
        return expression
    classifiers = package.metadata.get_all("Classifier") or []
    stated = [text.split(" :: ")[-1] for text in classifiers if text.startswith("License :: ")]
    stated = [text for text in stated if text != "OSI Approved"]
    field = _field(package, "License")
    if re.fullmatch(rf"[^\n]{{1,{SHORT}}}", field) and "Copyright" not in field:
        return field
    return " OR ".join(stated) if stated else "not stated"


def _field(package: Distribution, name: str) -> str:
    return " ".join(package.metadata.get_all(name) or []).strip()


def text() -> str:
    """What NOTICE has to be, in an environment as requirements.lock makes it."""
    rows = [f"{name} {package.version}: {licence(package)}" for name, package in needed().items()]
    return "\n".join([HEAD, *rows]) + "\n"


if __name__ == "__main__":
    FILE.write_text(text(), encoding="utf-8")
