"""Surfaces with a formula, on which registration is free to slide or to confuse two sides."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.mesh import TriangleMesh
from workbench.synthetic import solids

PLANE_HALF_SIZE_M = 2.0
SPHERE_RADIUS_M = 0.3
CYLINDER_RADIUS_M = 0.15
CYLINDER_HALF_LENGTH_M = 2.0
SHEET_SIZE_M = (0.6, 0.4)
SHEET_THICKNESS_M = 0.004
SHEET_RELIEF_M = 0.03


def plane_mesh() -> TriangleMesh:
    """The top of a slab at z = 0, wider than any scan: slides along x and y, turns about z."""
    half = PLANE_HALF_SIZE_M
    return solids.box((-half, -half, -0.1), (half, half, 0.0))


def sphere_mesh() -> TriangleMesh:
    """A sphere about the origin: free to turn. Facets lie within 6 µm of the sphere."""
    return solids.geodesic_sphere((0.0, 0.0, 0.0), SPHERE_RADIUS_M, 7)


def cylinder_mesh() -> TriangleMesh:
    """A cylinder about z, longer than any scan: slides along and turns about its axis."""
    half = CYLINDER_HALF_LENGTH_M
    return solids.lathed([(CYLINDER_RADIUS_M, -half), (CYLINDER_RADIUS_M, half)], 1024)


def sheet_height(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Height of the middle of the thin sheet, metres, broadcast over x and y."""
    wave: NDArray[np.float64] = np.sin(2 * np.pi * x / SHEET_SIZE_M[0]) * np.cos(
        2 * np.pi * y / SHEET_SIZE_M[1]
    )
    return SHEET_RELIEF_M * wave


def thin_sheet_mesh() -> TriangleMesh:
    """A wavy sheet 4 mm thick (measured along z), seen from both sides."""
    x = np.linspace(-0.5, 0.5, 401) * SHEET_SIZE_M[0]
    y = np.linspace(-0.5, 0.5, 301) * SHEET_SIZE_M[1]
    height = sheet_height(x[:, None], y[None, :])
    return solids.height_field_slab(x, y, height, SHEET_THICKNESS_M)
