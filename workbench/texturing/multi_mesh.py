"""One photograph's depth mesh, labelled with all photographs that see it.

Source: Arikan et al., section 5.2; 7.4 for what a further photograph touches.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.labelled_mesh import NO_PHOTO, LabelledMesh
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.kernels.edge_colors import read_points
from workbench.texturing.candidates import Candidates, candidates_of
from workbench.texturing.cost_options import CostOptions
from workbench.texturing.depth_map import DepthMap
from workbench.texturing.depth_mesh import DepthMesh, depth_mesh
from workbench.texturing.expansion import expanded
from workbench.texturing.labelling import Labelling, by_photo
from workbench.texturing.texture_costs import texture_problem

_GREY = 0.5
_LEAST_PENALTY = 1e-6
# Points of a depth map that are tried before all of them are.
_FIRST_TRIED = 500


@dataclass(frozen=True)
class LabelledDepthMesh:
    """A depth mesh with its labels, and how it came by them.

    Attributes
    ----------
    labelled : the mesh; its foreground is what its own photograph textures.
    labelling : energies and moves.
    outer : triangles at outer borders, which their own photograph must not texture.
    photos : (k,) int32 photographs that are candidates of some triangle, rising.
    candidates : of all triangles together.
    cost_seconds, label_seconds : spent on candidates, costs and colours, and on the labelling.
    """

    labelled: LabelledMesh
    labelling: Labelling
    outer: int
    photos: NDArray[np.int32]
    candidates: int
    cost_seconds: float
    label_seconds: float

    def arrays(self) -> dict[str, NDArray[Any]]:
        """As stored beside the depth map, from which `labelled_again` makes the mesh."""
        return {
            "labels": self.labelled.labels,
            "penalties": self.labelled.penalties,
            "color": self.labelled.mesh.vertex_attributes["color"],
        }


def labelled_depth_mesh(
    photo: int,
    depth_maps: Mapping[int, DepthMap],
    cameras: Mapping[int, PhotoCamera],
    pictures: Callable[[int], NDArray[np.uint8]],
    options: CostOptions,
    max_cycles: int = 2,
    bound_sweeps: int = 0,
) -> LabelledDepthMesh:
    """Make and label the depth mesh of a photograph.

    Parameters
    ----------
    photo : its number.
    depth_maps : its own and those of all photographs that see its mesh; others change nothing.
    cameras : of the same photographs, of the size of their pictures.
    pictures : from a photograph's number to its texture picture; asked for candidates alone.
    max_cycles, bound_sweeps : of `expanded`.
    """
    start = perf_counter()
    made = depth_mesh(depth_maps[photo])
    candidates = candidates_of(made.mesh, depth_maps, options, {photo: made.outer})
    problem = texture_problem(made.mesh, cameras, candidates, pictures, options)
    color = vertex_colors(made.mesh, cameras, candidates, pictures)
    halfway = perf_counter()
    labelling = expanded(problem, max_cycles, bound_sweeps=bound_sweeps)
    chosen = problem.rows(labelling.labels)
    penalties = np.full(len(chosen), np.inf, np.float32)
    penalties[chosen >= 0] = candidates.penalties[chosen[chosen >= 0]]
    labelled = _labelled(photo, made, labelling.labels, penalties, color)
    return LabelledDepthMesh(
        labelled, labelling, int(made.outer.sum()), np.unique(candidates.labels),
        len(candidates.labels), halfway - start, perf_counter() - halfway,
    )  # fmt: skip


def labelled_again(
    photo: int, depth_map: DepthMap, arrays: Mapping[str, NDArray[Any]]
) -> LabelledMesh:
    """The labelled mesh of a photograph from its depth map and what was stored beside it."""
    return _labelled(
        photo, depth_mesh(depth_map), arrays["labels"], arrays["penalties"], arrays["color"]
    )


def vertex_colors(
    mesh: TriangleMesh,
    cameras: Mapping[int, PhotoCamera],
    candidates: Candidates,
    pictures: Callable[[int], NDArray[np.uint8]],
) -> NDArray[np.uint8]:
    """(n, 3) sRGB-encoded mean of what candidates show, by 1 / penalty; grey where none does."""
    n = len(mesh.vertices)
    totals, weights = np.zeros((n, 3)), np.zeros(n)
    owner = np.repeat(np.arange(len(mesh.triangles)), np.diff(candidates.starts))
    for photo, which in by_photo(candidates.labels).items():
        corners = mesh.triangles[owner[which]].ravel()
        worth = 1.0 / np.maximum(candidates.penalties[which], _LEAST_PENALTY)
        weight = np.bincount(corners, np.repeat(worth, 3), n)
        used = np.flatnonzero(weight)
        pixels, _ = cameras[photo].project(mesh.vertices[used])
        totals[used] += weight[used, None] * read_points(pixels, pictures(photo))
        weights[used] += weight[used]
    some = weights > 0.0
    colors = np.full((n, 3), _GREY)
    colors[some] = totals[some] / weights[some, None]
    return np.round(255.0 * colors).astype(np.uint8)


def which_see(depth_maps: Mapping[int, DepthMap]) -> dict[int, tuple[int, ...]]:
    """Of each photograph, those that see any of its depth map's points, itself among them.

    These are all that can be candidates of its mesh: a photograph that is added, or one whose
    depth map changed, concerns the meshes alone that it sees now or saw before.
    """
    seen_by: dict[int, tuple[int, ...]] = {}
    for photo, depth_map in depth_maps.items():
        pixels = np.flatnonzero(np.isfinite(depth_map.depth.ravel()))
        points = depth_map.places(pixels)
        # Most are decided by a few points; only a photograph that sees none of them is asked all.
        few = points[:: max(1, len(points) // _FIRST_TRIED)]
        seen_by[photo] = tuple(
            other
            for other, asked in depth_maps.items()
            if other == photo or asked.shows(few).any() or asked.shows(points).any()
        )
    return seen_by


def _labelled(
    photo: int,
    made: DepthMesh,
    labels: NDArray[np.int32],
    penalties: NDArray[np.float32],
    color: NDArray[np.uint8],
) -> LabelledMesh:
    foreground = (labels == photo) & (labels != NO_PHOTO)
    mesh = made.mesh.with_attributes(color=color)
    return LabelledMesh(mesh, labels, foreground, penalties, made.spacing)
