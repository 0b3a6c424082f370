"""How far surfels of a prefix are from the surface they were chosen from, and how even they lie."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
from numpy.typing import NDArray

from workbench.formats.gltf import srgb_from_linear
from workbench.geometry.mesh import TriangleMesh, vertex_normals
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.surface_rays import SurfaceRays
from workbench.geometry.transforms import inverse, looking_at
from workbench.kernels.barycentric import shares_of_corners
from workbench.surfels.candidates import surface_candidates
from workbench.surfels.drawing import disc_picture, lit
from workbench.surfels.node_surfels import Candidates, chosen_surfels
from workbench.surfels.painted_surface import PaintedSurface
from workbench.surfels.surfel_file import SurfelFile
from workbench.surfels.surfel_options import SurfelOptions
from workbench.verification.image_quality import ssim

# Surfels are meant for discs so wide, of pictures of an object that fills them.
_SIZE_PX, _SMALLEST_PX, _LARGEST_PX = 2.0, 24, 1400
_FROM = np.array([0.5, -0.8, 0.35])
_FOV_RAD = np.radians(30.0)
# What surfels without a colour are drawn in.
_STONE = np.array([[206, 200, 190]], np.uint8)


@dataclass(frozen=True)
class PrefixFigures:
    """One prefix of the surfels of a whole object.

    Attributes
    ----------
    count : surfels.
    kilobytes : of the file for them.
    radius : of discs that cover the object, in the unit of the surface.
    picture_px : side of the picture in which such a disc is two pixels wide.
    similarity : SSIM of that picture to one of the surface.
    holes : share of the surface's pixels that show no surfel.
    drawn_s : processor time to draw it.
    """

    count: int
    kilobytes: float
    radius: float
    picture_px: int
    similarity: float
    holes: float
    drawn_s: float


@dataclass(frozen=True)
class ChoiceFigures:
    """Surfels chosen from candidates of one resolution.

    Attributes
    ----------
    resolution_px : of the pictures that candidates come from.
    candidates : how many.
    seconds : to find them, and to choose from them.
    gap_share : how far the surface is from the surfels, relative to the finest choice.
    """

    resolution_px: int
    candidates: int
    seconds: float
    gap_share: float


def prefix_figures(surface: TriangleMesh, path: Path, counts: list[int]) -> list[PrefixFigures]:
    """Prefixes of a file's root held against its surface.

    Parameters
    ----------
    surface : in the frame of the file; with the attribute ``color`` or without.
    path : of the file.
    counts : prefixes; those longer than the root are left out.
    """
    file = SurfelFile(path)
    root, rays = file.node(0), SurfaceRays(surface)
    bounds = np.asarray(file.bounds(0))
    each = int(file.nodes[0]["bytes"]) / max(len(root.surfels), 1)
    figures: list[PrefixFigures] = []
    for count in counts:
        if count > len(root.surfels):
            continue
        radius = root.spacing.radius_for(count)
        camera = _camera(bounds, radius)
        surfels = root.prefix(count)
        if not figures:
            disc_picture(surfels, radius, camera)  # Compiled before the clock counts.
        start = process_time()
        picture = disc_picture(surfels, radius, camera)
        drawn_s = process_time() - start
        truth, met = _picture_of(rays, camera)
        holes = float((met & (picture[..., 3] == 0)).sum() / met.sum())
        likeness = ssim(picture[..., :3] / 255.0, truth, met)
        figures.append(
            PrefixFigures(
                count, 1e-3 * each * count, radius, camera.width, likeness, holes, drawn_s
            )
        )  # fmt: skip
    return figures


def choice_figures(
    surface: TriangleMesh, count: int, resolutions_px: tuple[int, ...]
) -> list[ChoiceFigures]:
    """What the pictures' resolution costs and buys for so many surfels."""
    painted = PaintedSurface.of(surface)
    options = SurfelOptions(count=count)
    size = float(np.linalg.norm(np.ptp(surface.vertices, axis=0)))
    found = []
    # The coarsest first and once more: what compiles has no part in it.
    for resolution in (min(resolutions_px), *sorted(resolutions_px)):
        start = perf_counter()
        points, gap = surface_candidates(painted, resolution, views=options.views)
        node = chosen_surfels(
            Candidates(points, gap, len(surface.triangles), options.opposite_share * size),
            options, options.seed,
        )  # fmt: skip
        found.append((resolution, len(points), perf_counter() - start, node.radius))
    finest = found[-1][3]
    return [ChoiceFigures(*row[:3], row[3] / finest) for row in found[1:]]


def _camera(bounds: NDArray[np.float64], radius: float) -> PhotoCamera:
    """Of a picture that the object fills, in which a disc at its middle is two pixels wide."""
    middle = bounds.mean(axis=0)
    half = 0.5 * float(np.linalg.norm(np.ptp(bounds, axis=0)))
    away = half / np.sin(0.5 * _FOV_RAD)
    focal = 0.5 * _SIZE_PX * away / radius
    side = int(min(max(_SMALLEST_PX, np.ceil(2.0 * focal * np.tan(0.5 * _FOV_RAD))), _LARGEST_PX))
    focal = 0.5 * side / np.tan(0.5 * _FOV_RAD)
    pose = looking_at(middle + away * _FROM / np.linalg.norm(_FROM), middle)
    lens = (focal, focal, side / 2, side / 2)
    return PhotoCamera("PINHOLE", side, side, lens, inverse(pose))


def _picture_of(
    rays: SurfaceRays, camera: PhotoCamera
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """A surface as a camera sees it, (h, w, 3) in [0, 1], and where it is, lit as surfels are."""
    surface, seen = rays.mesh, rays.seen_by(camera)
    corners = surface.triangles[seen.triangles[seen.found]]
    weights = shares_of_corners(seen.points[seen.found], surface.vertices, corners)[..., None]
    normals = (vertex_normals(surface)[corners] * weights).sum(axis=1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    color = surface.vertex_attributes.get("color")
    colors = _STONE if color is None else (color[corners] * weights).sum(axis=1)
    truth = np.ones((camera.height, camera.width, 3))
    met = seen.found.reshape(camera.height, camera.width)
    light = lit(np.rint(colors).astype(np.uint8), normals, camera)
    truth[met] = srgb_from_linear(light) / 255.0
    return truth, met
