"""What labelling many depth meshes takes beside labelling one mesh, by the number of triangles.

Source: Arikan et al., figure 8.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.mesh import TriangleMesh, edge_census
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.simplification import simplified
from workbench.geometry.surface_rays import SurfaceRays
from workbench.texturing.cost_options import CostOptions
from workbench.texturing.depth_map import (
    DepthMap,
    depth_map_of_surface,
    small_camera,
    usable_pixels,
)
from workbench.texturing.multi_mesh import labelled_depth_mesh, which_see
from workbench.texturing.single_mesh import labelled_surface

Pictures = Callable[[int], NDArray[np.uint8]]


@dataclass(frozen=True)
class ScalingPoint:
    """One size of depth maps.

    Attributes
    ----------
    size_px : longer side of the depth maps.
    triangles : of all depth meshes that their own photographs texture; the one mesh has as many.
    depth_meshes_s, one_mesh_s : wall time of candidates, costs and labels, on one thread,
        photographs in memory.
    """

    size_px: int
    triangles: int
    depth_meshes_s: float
    one_mesh_s: float


def scaling_points(
    surface: TriangleMesh,
    cameras: Sequence[PhotoCamera],
    pictures: Pictures,
    costs: CostOptions,
    cycles: int,
    sizes_px: Sequence[int],
) -> list[ScalingPoint]:
    """Label in both ways at each size of depth maps.

    Parameters
    ----------
    surface : with the attribute ``color`` (n, 3) uint8.
    cameras : of the photographs that texture, of their pictures' sizes.
    pictures : number of a photograph → (h, w, 4) uint8, held in memory where that is possible.
    costs, cycles : of labelling.
    sizes_px : longer sides of depth maps; none gives none.
    """
    if not sizes_px:
        return []
    rays = SurfaceRays(surface)
    closed = edge_census(surface.triangles).watertight
    points = []
    # The first one compiles, and is thrown away.
    for size in (min(sizes_px), *sorted(sizes_px)):
        maps = {}
        for number, camera in enumerate(cameras):
            small = small_camera(camera, size)
            usable = usable_pixels(pictures(number)[..., 3], small)
            maps[number] = depth_map_of_surface(rays, small, usable, closed=closed)
        points.append(_point(surface, maps, cameras, pictures, costs, cycles, size))
    return points[1:]


def _point(
    surface: TriangleMesh,
    maps: dict[int, DepthMap],
    cameras: Sequence[PhotoCamera],
    pictures: Pictures,
    costs: CostOptions,
    cycles: int,
    size: int,
) -> ScalingPoint:
    start = perf_counter()
    triangles = 0
    for photo, others in which_see(maps).items():
        made = labelled_depth_mesh(
            photo, {k: maps[k] for k in others}, {k: cameras[k] for k in others},
            pictures, costs, cycles,
        )  # fmt: skip
        triangles += int(made.labelled.foreground.sum())
    depth_meshes_s = perf_counter() - start
    one = simplified(surface, triangles)
    start = perf_counter()
    labelled_surface(one, dict(enumerate(cameras)), pictures, costs, max_cycles=cycles)
    return ScalingPoint(size, triangles, depth_meshes_s, perf_counter() - start)
