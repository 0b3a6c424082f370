"""What is installed, what is missing, and the one line that installs it."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import asdict, dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from workbench.errors import MissingPartError

# Shared libraries that wheels expect of the system, and the Debian package of each.
SYSTEM_LIBRARIES = {
    "libusb-1.0.so": "libusb-1.0-0",
    "libGL.so": "libgl1",
    "libEGL.so": "libegl1",
    "libgomp.so": "libgomp1",
    "libX11.so": "libx11-6",
    "libglib-2.0.so": "libglib2.0-0",
}
APT_LINE = "sudo apt-get install -y " + " ".join(
    ("libusb-1.0-0", "libgl1", "libegl1", "libgomp1", "libx11-6")
)
PIP_LINE = "python -m pip install -e ."


@dataclass(frozen=True)
class Part:
    """One thing the workbench stands on."""

    name: str
    needed_for: str
    ok: bool
    version: str
    fix: str


_MODULES = (
    ("numpy", "numpy", "everything"),
    ("scipy", "scipy", "everything"),
    ("numba", "numba", "hot loops"),
    ("open3d", "open3d", "ray casting"),
    ("pymeshlab", "pymeshlab", "screened Poisson"),
    ("pye57", "pye57", "E57 scans"),
    ("distributed", "distributed", "several workers"),
    ("matplotlib", "matplotlib", "plots of the report"),
    ("trimesh", "trimesh", "OBJ, GLB and STL surfaces"),
    ("rawpy", "rawpy", "RAW photographs"),
)

# Python alone: where they are installed, they import.
_LISTED = (
    ("pydantic", "settings"),
    ("typer", "the command line"),
    ("rich", "tables"),
    ("dask", "several workers"),
    ("threadpoolctl", "the same result on any number of cores"),
    ("filelock", "one run at a time"),
    ("psutil", "memory and processes"),
    ("jinja2", "the report"),
    ("pillow", "pictures"),
)
# An import that takes longer hangs.
_IMPORT_SECONDS = 120.0


def installed_parts() -> list[Part]:
    """Import every part that can break, each in a process of its own, for it may crash."""
    parts = [Part("python", "everything", sys.version_info >= (3, 11), sys.version.split()[0], "")]
    script = "import sys, importlib; importlib.import_module(sys.argv[1])"
    running = [
        (
            entry,
            subprocess.Popen(
                [sys.executable, "-c", script, entry[0]],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
            ),
        )
        for entry in _MODULES
    ]
    for (_, distribution, purpose), process in running:
        try:
            trouble = process.communicate(timeout=_IMPORT_SECONDS)[1]
        except subprocess.TimeoutExpired:
            process.kill()
            trouble = process.communicate()[1]
        part = _installed(distribution, purpose)
        if part.ok and process.returncode != 0:
            part = replace(part, ok=False, fix=system_fix(trouble) or PIP_LINE)
        parts.append(part)
    return parts + [_installed(distribution, purpose) for distribution, purpose in _LISTED]


def _installed(distribution: str, purpose: str) -> Part:
    try:
        return Part(distribution, purpose, True, version(distribution), "")
    except PackageNotFoundError:
        return Part(distribution, purpose, False, "not installed", PIP_LINE)


def report() -> dict[str, Any]:
    """``ok`` and ``parts`` as plain data."""
    parts = installed_parts()
    return {"ok": all(part.ok for part in parts), "parts": [asdict(part) for part in parts]}


def system_fix(trouble: str) -> str | None:
    """The line that installs a shared library an import asked for; None for other trouble."""
    if "cannot open shared object file" not in trouble:
        return None
    missing = [package for name, package in SYSTEM_LIBRARIES.items() if name in trouble]
    return f"sudo apt-get install -y {missing[0]}" if missing else APT_LINE


def missing_part(error: ImportError | OSError) -> MissingPartError | None:
    """An import failure as the error the user can act on; None when it is another trouble."""
    if isinstance(error, ModuleNotFoundError) and error.name:
        if error.name.partition(".")[0] in ("workbench", "stages", "configs"):
            return None  # a module of ours that is not there is our own fault
        return MissingPartError(f"The Python package {error.name!r} is not installed", fix=PIP_LINE)
    fix = system_fix(str(error))
    return MissingPartError(str(error), fix=fix) if fix else None
