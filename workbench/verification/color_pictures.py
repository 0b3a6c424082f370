"""Pictures of a coloured model for reports: from its sides, and as one photograph sees it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.color.blending_display import encoded_srgb
from workbench.color.spaces import SpaceName
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.surface_rays import SurfaceRays
from workbench.render import palette, shading
from workbench.render.palette import ColorScale, linear_from_srgb, srgb_from_linear
from workbench.render.shading import View
from workbench.surface.provenance import INPAINTED, PHOTOGRAPHED
from workbench.verification.distances import closest_barycentric
from workbench.verification.figures import color_bar_figure
from workbench.verification.quantities import round_up_125
from workbench.verification.report_content import LegendEntry, Picture, PictureRow

_SIDE_PX, _SUBPIXELS = 640, 2
_LOOKED_AT_PX, _TALL = 400, 1.5
# Of what a row shows, so much may be lighter than white.
_LIGHTEST = 99.5
_MAT_COLOR = (52, 51, 49)
_TOLD = {
    PHOTOGRAPHED: (palette.PROVENANCE_COLORS[palette.MEASURED], "photographed"),
    INPAINTED: (palette.PROVENANCE_COLORS[palette.INFILLED], "inpainted"),
}


def albedo_row(views: Mapping[str, View], colors: NDArray[np.uint8]) -> PictureRow:
    """Colours of vertices (n, 3) sRGB, each view as they are and then lit."""
    pictures = []
    for side, view in views.items():
        plain = replace(view, light=np.ones_like(view.light))
        for shown, how in ((plain, "colours alone"), (view, "lit anew")):
            pixels = shading.vertex_colored(shown, colors)
            pictures.append(Picture(pixels, f"{side}, {how}", f"The {side} of the model: {how}"))
    caption = (
        "The recovered colours as they are exported, without any light, and beside them the same "
        "in a light that was not there: from the upper left. Where neither photographs nor "
        "inpainting give a colour, the model is grey."
    )
    return PictureRow(_capitalised(pictures), caption, most_beside=4)


def told_row(
    views: Mapping[str, View], provenance: NDArray[np.uint8], photos: NDArray[np.integer]
) -> PictureRow:
    """Where colours come from, and how many photographs tell each place.

    Parameters
    ----------
    provenance : (n,) of the colours, as `workbench.surface.provenance` numbers it.
    photos : (n,) photographs that see a vertex.
    """
    table = np.array([palette.UNKNOWN_COLOR] * 256, np.uint8)
    for number, (color, _) in _TOLD.items():
        table[number] = color
    counts = np.where(photos > 0, photos, np.nan)
    # A bar of whole photographs at its five marks.
    most = 4 * int(np.ceil(max(np.nanpercentile(counts, 99.0) if (photos > 0).any() else 1, 1) / 4))
    scale = ColorScale.sequential(float(most), "Photographs that tell a place")
    pictures = []
    for side, view in views.items():
        whence, many = "origin of the colours", "photographs per place"
        pixels = shading.vertex_colored(view, table[provenance])
        pictures.append(Picture(pixels, f"{side}, origin", f"The {side} of the model: {whence}"))
        pixels = shading.scalar(view, counts, scale)
        pictures.append(Picture(pixels, f"{side}, number", f"The {side} of the model: {many}"))
    legend = [LegendEntry(color, label) for color, label in _TOLD.values()]
    legend.append(LegendEntry(palette.UNKNOWN_COLOR, "no photograph, or no colour"))
    caption = (
        "Where the colours come from, and how many photographs tell each place. Orange parts are "
        "spread from around, not observed."
    )
    bar = color_bar_figure("color-photographs", scale, f"Colour scale: {scale.label}")
    return PictureRow(_capitalised(pictures), caption, tuple(legend), bar, most_beside=4)


def difference_row(
    views: Mapping[str, View], differences: Mapping[str, NDArray[np.float64]]
) -> PictureRow:
    """ΔE2000 (n,) of some ways to blend, all views of each on one scale."""
    known = [d[np.isfinite(d)] for d in differences.values()]
    largest = max((float(np.percentile(d, 95)) for d in known if len(d)), default=1.0)
    scale = ColorScale.sequential(round_up_125(max(largest, 1.0)), "ΔE2000 from the true albedo")
    pictures = [
        Picture(
            shading.scalar(view, d, scale), f"{how}, {side}", f"The {side}: {scale.label}, {how}"
        )
        for how, d in differences.items()
        for side, view in views.items()
    ]
    caption = "Where colours differ from the truth, and by how much: pale is right."
    legend = (LegendEntry(palette.UNKNOWN_COLOR, "not photographed"),)
    bar = color_bar_figure("color-differences", scale, f"Colour scale: {scale.label}")
    return PictureRow(_capitalised(pictures), caption, legend, bar, most_beside=4)


@dataclass(frozen=True)
class ModelInPhoto:
    """What of a mesh a photograph shows, at a moderate size and cropped to it.

    Attributes
    ----------
    box : (left, top, right, bottom) of the crop, pixels of the photograph.
    height, width : of the picture.
    pixel : (k,) flat number of the picture's pixel that each ray is part of.
    corners : (k, 3) int32 vertices of the triangle that the ray meets.
    weights : (k, 3) barycentric.
    """

    box: tuple[float, float, float, float]
    height: int
    width: int
    pixel: NDArray[np.int64]
    corners: NDArray[np.int32]
    weights: NDArray[np.float64]

    @classmethod
    def of(
        cls, rays: SurfaceRays, camera: PhotoCamera, side_px: int = _SIDE_PX
    ) -> ModelInPhoto | None:
        """Cast the rays, four for each pixel; None where the camera does not see the mesh."""
        step = max(1, max(camera.width, camera.height) // _LOOKED_AT_PX)
        rows, columns = np.nonzero(rays.silhouette(camera, step))
        if not len(rows):
            return None
        # A margin, so that one sees where the model ends.
        margin = step + 0.04 * step * max(np.ptp(rows), np.ptp(columns))
        left, top = (max(0.0, step * side.min() - margin) for side in (columns, rows))
        right = min(float(camera.width), step * (columns.max() + 1.0) + margin)
        bottom = min(float(camera.height), step * (rows.max() + 1.0) + margin)
        share = min(1.0, side_px / max(right - left, bottom - top))
        height, width = (max(1, round(share * s)) for s in (bottom - top, right - left))
        across = left + (np.arange(_SUBPIXELS * width) + 0.5) * (right - left) / width / _SUBPIXELS
        down = top + (np.arange(_SUBPIXELS * height) + 0.5) * (bottom - top) / height / _SUBPIXELS
        asked = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
        met = rays.first_met(camera.center, camera.directions(asked))
        number = np.flatnonzero(met.found)
        row, column = np.divmod(number, len(across))
        corners = rays.mesh.triangles[met.triangles[number]]
        weights = closest_barycentric(met.points[number], rays.mesh.vertices[corners])
        pixel = (row // _SUBPIXELS) * width + column // _SUBPIXELS
        return cls((left, top, right, bottom), height, width, pixel, corners, weights)

    def painted(self, colors: NDArray[np.floating]) -> NDArray[np.float64]:
        """Linear picture (h, w, 3) of the mesh in the colours (n, 3) of its vertices.

        NaN where only what has no colour is seen, or nothing.
        """
        seen = np.einsum("ij,ijk->ik", self.weights, colors[self.corners].astype(np.float64))
        told = np.isfinite(seen).all(axis=1)
        size = self.height * self.width
        count = np.bincount(self.pixel[told], minlength=size)
        sums = [np.bincount(self.pixel[told], seen[told, k], size) for k in range(3)]
        mean = np.stack(sums, axis=1) / np.where(count > 0, count, np.nan)[:, None]
        return np.asarray(mean.reshape(self.height, self.width, 3))

    def of_photo(
        self, picture: NDArray[np.float32], photo_size: tuple[int, int]
    ) -> NDArray[np.float64]:
        """The photograph (h', w', 3), perhaps developed smaller, cropped and reduced alike."""
        share = np.divide(picture.shape[1::-1], photo_size)
        left, top, right, bottom = np.rint(np.array(self.box) * np.tile(share, 2)).astype(int)
        part = picture[top : max(bottom, top + 1), left : max(right, left + 1)]
        size = (self.width, self.height)
        return np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA), np.float64)

    @property
    def cover(self) -> NDArray[np.float64]:
        """(h, w) share of each pixel that the mesh covers."""
        count = np.bincount(self.pixel, minlength=self.height * self.width)
        return count.reshape(self.height, self.width) / _SUBPIXELS**2


def same_camera_row(
    name: str,
    seen: ModelInPhoto,
    photograph: NDArray[np.float64],
    blends: Sequence[tuple[str, NDArray[np.floating]]],
    space: SpaceName,
) -> PictureRow:
    """One photograph as taken, and the model from the same camera in several colours.

    Parameters
    ----------
    photograph : (h, w, 3) linear, of ``seen``.
    blends : caption and colours (n, 3) linear of the vertices.
    """
    cover = seen.cover
    painted = [(caption, seen.painted(colors)) for caption, colors in blends]
    lights = np.concatenate([p[cover > 0.0].max(axis=1) for _, p in (("", photograph), *painted)])
    lights = lights[np.isfinite(lights)]
    lightest = float(np.percentile(lights, _LIGHTEST)) if len(lights) else 1.0
    exposure = 1.0 / lightest if lightest > 0.0 else 1.0
    pictures = [Picture(_encoded(exposure * photograph, space), "As taken", f"{name} as taken")]
    for caption, picture in painted:
        pixels = _on_mat(_encoded(exposure * picture, space), picture, cover)
        pictures.append(Picture(pixels, caption, f"The model as {name} sees it: {caption}"))
    text = (
        f"{name} as it was taken, and the model from the same camera, in no light but what its "
        f"colours keep. All are linear light × {exposure:.3g}, encoded as sRGB: one exposure for "
        "the whole row."
    )
    # Tall pictures stand in one row; wide ones would be too small in it.
    beside = len(pictures) if seen.height >= _TALL * seen.width else 3
    photographs = tuple(replace(p, is_photograph=True) for p in pictures)
    return PictureRow(photographs, text, most_beside=beside)


def _encoded(picture: NDArray[np.float64], space: SpaceName) -> NDArray[np.uint8]:
    flat = np.nan_to_num(picture, nan=0.0).reshape(-1, 3)
    return encoded_srgb(flat, space).reshape(picture.shape)


def _on_mat(
    encoded: NDArray[np.uint8], picture: NDArray[np.float64], cover: NDArray[np.float64]
) -> NDArray[np.uint8]:
    """The model on a dark mat; grey where it has no colour."""
    shown = np.array(encoded)
    shown[~np.isfinite(picture).all(axis=2)] = palette.UNKNOWN_COLOR
    mat = linear_from_srgb(np.array(_MAT_COLOR, np.uint8))
    part = cover[..., None].astype(np.float32)
    return srgb_from_linear(linear_from_srgb(shown) * part + mat * (1 - part))


def _capitalised(pictures: Sequence[Picture]) -> tuple[Picture, ...]:
    return tuple(replace(p, caption=p.caption[0].upper() + p.caption[1:]) for p in pictures)
