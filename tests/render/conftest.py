from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from workbench.geometry.mesh import TriangleMesh


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
