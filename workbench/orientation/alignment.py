"""Oriented photographs brought onto the scans' surface, scale included, and adjusted to it.

Where photographs belong is taken from the user's own correspondences where there are some, from
the cameras as they come where these already fit, else found by shape. Then lenses, cameras and
points are adjusted together: first with the features of the photographs, then with patches
that the surface itself allows to follow from photograph to photograph.

Source: Pintus and Gobbetti 2015; Furukawa and Ponce 2009.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from workbench.formats.colmap import ColmapCamera, ColmapModel
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.similarity import Similarity
from workbench.geometry.surface_rays import SurfaceRays
from workbench.orientation.picks import NoPicks, Pick, similarity_of_picks
from workbench.orientation.sparse_points import SparsePoints, well_seen
from workbench.orientation.surface_adjustment import (
    NotAdjusted,
    SurfaceAdjustment,
    SurfaceAdjustmentOptions,
    adjusted_to_surface,
    surface_size,
)
from workbench.orientation.surface_patches import PatchOptions, with_surface_patches
from workbench.orientation.surface_search import ShapeFit, fit_by_shape

Way = Literal["as given", "picks", "shape"]
# Of the surface's size: points this near to it in the median need not be brought there.
_IN_PLACE = 0.005
NOT_ASKED_FOR = "not asked for"
_SEARCH_OF_FIT = 3.0
_SEARCH_OF_PATCHES = 10.0
# Plain lenses as COLMAP's OPENCV, where a surface is there to tell more of them.
_PLAIN = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL")


@dataclass(frozen=True)
class AlignmentOptions:
    """How photographs are brought onto a surface.

    Attributes
    ----------
    refine : adjust cameras to the surface; else they are moved and scaled alone.
    patch_rounds : how often patches are followed over the surface anew; 0 keeps to features.
    patches : how they are found.
    most_points, most_patches : that take part in an adjustment, by features and by patches.
    """

    refine: bool = True
    patch_rounds: int = 2
    patches: PatchOptions = field(default_factory=PatchOptions)
    most_points: int = 30_000
    most_patches: int = 100_000


@dataclass(frozen=True)
class Alignment:
    """Photographs in the frame of the surface.

    Attributes
    ----------
    model : with the points the photographs were adjusted by.
    way : how the place was found.
    fit : what the search by shape says of it, where there was one.
    adjustment : the last joint adjustment; None where nothing was refined.
    why_not_refined : the reason, where nothing was; empty else.
    """

    model: ColmapModel
    way: Way
    fit: ShapeFit | None
    adjustment: SurfaceAdjustment | None
    why_not_refined: str = ""


@dataclass(frozen=True)
class NotAligned:
    """Why the photographs could not be brought onto the surface; falsy."""

    reason: str

    def __bool__(self) -> bool:
        return False


def aligned(
    model: ColmapModel,
    mesh: TriangleMesh,
    pictures: Mapping[int, NDArray[np.uint8]],
    masks: Mapping[int, NDArray[np.uint8]],
    picks: tuple[Pick, ...] = (),
    options: AlignmentOptions | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Alignment | NotAligned:
    """Bring a model of unknown frame and scale onto a surface.

    Parameters
    ----------
    model : with points and observations; without them only picks, or cameras that are in
        the surface's frame already, can be used.
    mesh : the surface, in the frame and unit wanted.
    pictures, masks : image id → (h, w) uint8, grey and 255 = keep; for patches.
    picks : the user's correspondences; they go before everything else.
    """
    options = options or AlignmentOptions()
    surface = SurfaceRays(mesh)
    points = well_seen(model)
    progress("looking for the place of the photographs")
    placed = _placed(model, points, surface, picks)
    if isinstance(placed, NotAligned):
        return placed
    way, similarity, fit, search = placed
    moved = model if similarity is None else transformed(model, similarity)
    if not options.refine:
        return Alignment(moved, way, fit, None, NOT_ASKED_FOR)
    if not model.points:
        return Alignment(moved, way, fit, None, "the orientation came without points")
    progress("adjusting cameras to the surface")
    settings = SurfaceAdjustmentOptions(search, most_points=options.most_points)
    adjustment = adjusted_to_surface(with_full_lenses(moved), surface, settings)
    if isinstance(adjustment, NotAdjusted):
        return Alignment(moved, way, fit, None, adjustment.reason)
    for turn in range(options.patch_rounds):
        progress(f"following patches over the surface, {turn + 1} of {options.patch_rounds}")
        patched = with_surface_patches(adjustment.model, pictures, masks, surface, options.patches)
        near = replace(
            settings,
            search=_SEARCH_OF_PATCHES * adjustment.surface_sigma,
            most_points=options.most_patches,
            overlap=patched.overlap,
        )
        again = adjusted_to_surface(patched.model, surface, near, information=patched.information)
        if isinstance(again, NotAdjusted):
            break
        adjustment = again
    return Alignment(adjustment.model, way, fit, adjustment)


def transformed(model: ColmapModel, to_from_model: Similarity) -> ColmapModel:
    """The model in another frame."""
    return replace(
        model,
        images={
            number: replace(
                image, camera_from_world=to_from_model.camera_from_b(image.camera_from_world)
            )
            for number, image in model.images.items()
        },
        points={
            number: replace(point, xyz=to_from_model.apply(point.xyz))
            for number, point in model.points.items()
        },
    )


def with_full_lenses(model: ColmapModel) -> ColmapModel:
    """The same model; lenses of few parameters are told by more, which change nothing yet."""
    return replace(model, cameras={n: _full(camera) for n, camera in model.cameras.items()})


def _full(camera: ColmapCamera) -> ColmapCamera:
    if camera.model not in _PLAIN:
        return camera
    single = camera.model != "PINHOLE"
    focal = (camera.params[0],) * 2 if single else camera.params[:2]
    rest = camera.params[1:] if single else camera.params[2:]
    radial = (*rest[2:], 0.0, 0.0)[:2]
    return replace(camera, model="OPENCV", params=(*focal, *rest[:2], *radial, 0.0, 0.0))


def _placed(
    model: ColmapModel, points: SparsePoints, surface: SurfaceRays, picks: tuple[Pick, ...]
) -> tuple[Way, Similarity | None, ShapeFit | None, float] | NotAligned:
    """How the place was found, the similarity to it, and how far points may be off it."""
    size = surface_size(surface)
    if picks:
        found = similarity_of_picks(model, picks)
        if isinstance(found, NoPicks):
            return NotAligned(found.reason)
        return "picks", found.surface_from_model, None, max(3.0 * found.error, 0.01 * size)
    if not len(points):
        seen = any(
            surface.seen_by(camera, max(1, camera.width // 64)).found.any()
            for camera in model.photo_cameras().values()
        )
        if seen:
            return "as given", None, None, 0.01 * size
        return NotAligned("the cameras see nothing of the surface, and came without points")
    near = np.linalg.norm(surface.nearest(points.points).points - points.points, axis=1)
    if float(np.median(near)) < _IN_PLACE * size:
        return "as given", None, None, 0.01 * size
    fit = fit_by_shape(points, surface.mesh)
    if not isinstance(fit, ShapeFit):
        return NotAligned(fit.reason)
    return "shape", fit.surface_from_model, fit, _SEARCH_OF_FIT * fit.error
