"""Fixtures every test may ask for."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from workbench.geometry.mesh import TriangleMesh

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


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
