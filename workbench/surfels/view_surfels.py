"""The surfels that a view of a file needs: of every part a prefix, or its parts' instead."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.point_set import PointSet, joined
from workbench.surfels.drawing import surfel_radius
from workbench.surfels.surfel_file import SurfelFile
from workbench.surfels.surfel_size import FoveaZones


@dataclass(frozen=True)
class ShownPrefix:
    """What is shown of a node.

    Attributes
    ----------
    row : of the node in the index.
    count : the first so many of its surfels.
    radius : of their discs, in the unit of the file.
    """

    row: int
    count: int
    radius: float


def shown_prefixes(
    file: SurfelFile, camera: PhotoCamera, size_px: float = 2.0, zones: FoveaZones | None = None
) -> list[ShownPrefix]:
    """The nodes of a view and their prefixes (Brandt 2019, 4 and 4.1).

    A node is shown when its surfels suffice for discs of the wanted size; otherwise its children
    are. Leaves that do not suffice are shown with larger discs. Nodes behind the camera are left
    out.

    Parameters
    ----------
    file
        The file.
    camera
        A pinhole camera in its frame.
    size_px
        Across surfels at the place of a node that is nearest to the camera, pixels.
    zones
        Where one looks, to have larger surfels elsewhere; the size goes by the middle of each
        node.
    """
    shown: list[ShownPrefix] = []
    waiting = [0]
    while waiting:
        row = waiting.pop()
        bounds = file.bounds(row)
        if _behind(bounds, camera):
            continue
        size = size_px * (1.0 if zones is None else _factor(bounds, camera, zones))
        radius = surfel_radius(bounds, camera, size)
        spacing, surfels = file.spacing(row), int(file.nodes["surfels"][row])
        wanted = spacing.prefix_for(radius) if radius > 0.0 else surfels + 1
        children = file.children(row)
        if wanted > surfels and len(children):
            waiting.extend(reversed(children))
            continue
        count = min(wanted, surfels)
        if wanted > surfels:
            radius = max(spacing.radius_for(surfels), float(file.nodes["radius"][row]))
        shown.append(ShownPrefix(row, count, radius))
    return shown


def view_surfels(file: SurfelFile, shown: Sequence[ShownPrefix]) -> PointSet:
    """The surfels of `shown_prefixes` with the radii to draw them with.

    Raises
    ------
    InputError
        The file is damaged.
    """
    parts = []
    for part in shown:
        chosen = file.node(part.row).prefix(part.count)
        radius = np.full(part.count, part.radius, np.float32)
        parts.append(PointSet(chosen.points, chosen.normals, chosen.color, radius))
    if not parts:
        none = np.zeros((0, 3))
        return PointSet(none, none.astype(np.float32), None, np.zeros(0, np.float32))
    return joined(parts)


def _behind(bounds: NDArray[np.float64], camera: PhotoCamera) -> bool:
    """Whether all of a box is behind the camera."""
    forward = camera.camera_from_world[2, :3]
    farthest = np.where(forward > 0.0, bounds[1], bounds[0])
    return bool((farthest - camera.center) @ forward <= 0.0)


def _factor(bounds: NDArray[np.float64], camera: PhotoCamera, zones: FoveaZones) -> float:
    pixel, depth = camera.project(bounds.mean(axis=0)[None])
    # Next to the camera there is no telling where in the picture a box is: it is seen sharply.
    return float(zones.factor(pixel)[0]) if depth[0] > 0.0 else 1.0
