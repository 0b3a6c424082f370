"""One mesh textured by photographs: the baseline beside many depth meshes.

Source: Lempitsky, Ivanov 2007, with the energy of Arikan et al., eq. 1, so that both are compared
at the same costs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.labelled_mesh import LabelledMesh
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.texturing.cost_options import CostOptions
from workbench.texturing.expansion import expanded
from workbench.texturing.labelling import Labelling
from workbench.texturing.shown_candidates import shown_candidates
from workbench.texturing.texture_costs import texture_problem


def labelled_surface(
    mesh: TriangleMesh,
    cameras: Mapping[int, PhotoCamera],
    pictures: Callable[[int], NDArray[np.uint8]],
    options: CostOptions,
    *,
    max_cycles: int = 2,
    threads: int = 1,
) -> tuple[LabelledMesh, Labelling]:
    """Label a surface with the photographs that show it.

    Parameters
    ----------
    mesh : with the vertex attribute ``color`` (n, 3) uint8, seen where no photograph is.
    cameras : of the photographs by their numbers, of their pictures' sizes.
    pictures : from a photograph's number to its texture picture (h, w, 4) uint8.
    max_cycles : of α-expansion.
    threads : photographs at once while the triangles they show are looked for.

    Raises
    ------
    InputError : a picture is not of its camera's size, or vertices are not finite.
    """
    candidates = shown_candidates(mesh, cameras, pictures, options, threads)
    problem = texture_problem(mesh, cameras, candidates, pictures, options)
    labelling = expanded(problem, max_cycles)
    rows = problem.rows(labelling.labels)
    penalties = np.zeros(len(mesh.triangles), np.float32)
    penalties[rows >= 0] = candidates.penalties[rows[rows >= 0]]
    foreground = np.ones(len(penalties), bool)
    return LabelledMesh(mesh, labelling.labels, foreground, penalties), labelling


def far_of_surface(
    mesh: TriangleMesh, cameras: Mapping[int, PhotoCamera], distances: float = 2.0
) -> float:
    """So many times the median distance between cameras and vertices: h of eq. 3.

    Raises
    ------
    InputError : there are no cameras or no vertices.
    """
    if not cameras or not len(mesh.vertices):
        raise InputError("texturing needs a surface and cameras around it")
    # The median of medians: as good here, and it needs no list of all distances.
    medians = [
        np.median(np.linalg.norm(mesh.vertices - camera.center, axis=1))
        for camera in cameras.values()
    ]
    return distances * float(np.median(medians))
