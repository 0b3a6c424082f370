"""Fixtures every test may ask for."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from workbench.cli import run_cli
from workbench.geometry.mesh import TriangleMesh

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture
def cli(capsys):
    """Run a command that needs no stages; returns (exit code, the one JSON object)."""

    def call(*arguments):
        code = run_cli((), [*map(str, arguments), "--json"])
        out, _ = capsys.readouterr()
        assert out.count("\n") == 1, "one line on standard output"
        return code, json.loads(out)

    return call


@pytest.fixture(scope="session")
def chromium() -> Iterator[Callable[..., Any]]:
    """A function from command-line arguments to a Chromium without a window, closed in the end.

    Skips plainly where there is none. Playwright runs once in a process, so all tests share it.
    """
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    names = ("chromium", "chromium-browser", "google-chrome")
    found = next(filter(None, map(shutil.which, names)), None)
    if found is None:
        pytest.skip("no chromium on this machine")
    quiet = ("--no-sandbox", "--disable-background-networking", "--disable-component-update")
    with sync_api.sync_playwright() as playwright:
        launched = []

        def launch(*arguments: str) -> Any:
            launched.append(
                playwright.chromium.launch(executable_path=found, args=[*quiet, *arguments])
            )
            return launched[-1]

        yield launch
        for browser in launched:
            browser.close()


@pytest.fixture(scope="session")
def shared_data() -> Callable[..., Path]:
    """A function from path parts to a real data file; skips plainly where it is absent."""

    def locate(*parts: str) -> Path:
        path = SHARED_DATA.joinpath(*parts)
        if not path.exists():
            pytest.skip(f"real data not present: shared/data/{'/'.join(parts)}")
        return path

    return locate


@pytest.fixture(scope="session")
def sphere() -> Callable[..., TriangleMesh]:
    """Radius and centre to an icosphere with its vertices on the sphere."""

    def make(radius: float = 1.0, center=(0, 0, 0), subdivisions: int = 5) -> TriangleMesh:
        solid = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
        return TriangleMesh(np.asarray(solid.vertices) + center, solid.faces.astype(np.int32))

    return make


@pytest.fixture(scope="session")
def cube() -> TriangleMesh:
    """The cube from −1 to 1."""
    solid = trimesh.creation.box((2, 2, 2))
    return TriangleMesh(np.asarray(solid.vertices, float), solid.faces.astype(np.int32))
