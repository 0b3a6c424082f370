"""Screened Poisson reconstruction (Kazhdan and Hoppe 2013) through PyMeshLab."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError, WorkbenchError
from workbench.geometry.mesh import TriangleMesh

# The solver works in a cube this much larger than the samples' box.
CUBE_SCALE = 1.1
MIN_DEPTH, MAX_DEPTH = 5, 12


@dataclass(frozen=True)
class PoissonSettings:
    """How the indicator function is solved for.

    Attributes
    ----------
    depth : octree depth; the finest cell is the cube's edge over 2^depth.
    point_weight : pull of the samples against smoothness (4 in the paper).
    samples_per_node : samples wanted per finest cell; more for noisy data.
    threads : one is bit-reproducible, more are not.
    cube_scale : edge of the solver's cube over that of the samples' box.
    """

    depth: int
    point_weight: float = 4.0
    samples_per_node: float = 1.5
    threads: int = 1
    cube_scale: float = CUBE_SCALE


def depth_for_spacing(low: NDArray[np.float64], high: NDArray[np.float64], spacing_m: float) -> int:
    """The depth whose finest cell is about one sample spacing, 5 or more.

    ``low``, ``high`` (3,) are the corners of the samples' box. One solution takes no more than
    ``MAX_DEPTH``.
    """
    return max(MIN_DEPTH, math.ceil(math.log2(_cube_edge_m(low, high) / spacing_m) - 0.2))


def cell_size_m(low: NDArray[np.float64], high: NDArray[np.float64], depth: int) -> float:
    """Edge of the finest octree cell over a box of samples."""
    return _cube_edge_m(low, high) / float(2**depth)


def _cube_edge_m(low: NDArray[np.float64], high: NDArray[np.float64]) -> float:
    return CUBE_SCALE * float((high - low).max())


def reconstruct(
    points: NDArray[np.float64], normals: NDArray[np.float64], settings: PoissonSettings
) -> TriangleMesh:
    """The zero set of the screened Poisson indicator.

    Parameters
    ----------
    points, normals : (n, 3) float64; normals unit and outwards.

    Returns
    -------
    A mesh whose triangles are counter-clockwise from outside.

    Raises
    ------
    InputError
        With too few samples, non-finite values or samples of no extent.
    WorkbenchError
        When the solver gives nothing.
    """
    import pymeshlab

    if len(points) < 10 or not np.isfinite(points).all() or not np.isfinite(normals).all():
        raise InputError(
            "There are too few usable samples for a surface",
            expected="at least 10 finite samples with normals",
            found=f"{len(points)} samples",
        )
    extent = float((points.max(axis=0) - points.min(axis=0)).max())
    if not extent > 0.0:
        raise InputError("All samples lie in one place", found=f"{len(points)} equal samples")
    # Solved in a unit-sized frame at the origin: the solver computes in single precision.
    centre = 0.5 * (points.max(axis=0) + points.min(axis=0))
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(
        pymeshlab.Mesh(vertex_matrix=(points - centre) / extent, v_normals_matrix=normals)
    )
    try:
        meshes.generate_surface_reconstruction_screened_poisson(
            depth=settings.depth,
            pointweight=settings.point_weight,
            samplespernode=settings.samples_per_node,
            scale=settings.cube_scale,
            threads=settings.threads,
            preclean=False,
        )
    except pymeshlab.PyMeshLabException as error:
        raise WorkbenchError(
            "Screened Poisson failed", found=str(error), fix="try another infill.depth"
        ) from error
    solved = meshes.current_mesh()
    if solved.face_number() == 0:
        raise WorkbenchError(
            "Screened Poisson gave no surface",
            found=f"{len(points)} samples at depth {settings.depth}",
            fix="check that the normals point outwards, or lower infill.depth",
        )
    return TriangleMesh(
        solved.vertex_matrix() * extent + centre, solved.face_matrix().astype(np.int32)
    )
