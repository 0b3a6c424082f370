"""`tests.fuzz.worker` with the readers instrumented, so that lines they reach are counted."""

from __future__ import annotations

import importlib
import pkgutil

import atheris

import workbench.kernels

# Already there, they stay as they are: Numba cannot compile what counts lines.
for module in pkgutil.iter_modules(workbench.kernels.__path__, "workbench.kernels."):
    importlib.import_module(module.name)
with atheris.instrument_imports(include=["workbench"]):
    from tests.fuzz.worker import main

if __name__ == "__main__":
    main()
