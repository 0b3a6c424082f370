"""How far the scene is at each pixel of a small copy of a photograph.

Source: Arikan et al., section 5.1; Botsch et al. 2005 for scenes of samples.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.photo_view import Block, reduced_camera, view_of_samples
from workbench.geometry.surface_rays import SurfaceRays
from workbench.geometry.transforms import apply, rotate
from workbench.kernels.depth_cells import depth_cells, joints, lie_on_cells
from workbench.kernels.gauss_splats import blend_splats, draw_fronts

# A step: so many pixels' widths beyond what the slope on either side foretells.
_STEP_PX = 4.0
# A surface that recedes by more pixels' widths per pixel is a step, or of no use.
_STEEPEST_PX = 10.0
# How far from a depth map's surface a place on it may be, pixels' widths.
_NEAR_PX = 2.0
_REACH = 1.05
# Discs of samples, of their distance, and how thick a surface of them is, of their radius.
_DISC = 1.0
_THICKNESS = 2.0


@dataclass(frozen=True)
class DepthMap:
    """The depths of one photograph, and which of its pixels can tell colours.

    Attributes
    ----------
    camera : of the size of the map.
    depth : (h, w) float32 along the camera's axis, infinite where nothing is seen.
    usable : (h, w) whether all that the photograph has in this pixel may be used.
    closed : whether the scene has no holes of its own: where nothing is seen, nothing is.
    flatness_px : its mesh has fewer triangles where leaving some out moves the surface by no more
        than so many pixels' widths at each vertex left out; 0 leaves out none.
    """

    camera: PhotoCamera
    depth: NDArray[np.float32]
    usable: NDArray[np.bool_]
    closed: bool
    flatness_px: float = 0.0

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        if self.depth.shape != size or self.usable.shape != size:
            raise InputError(
                "a depth map is not of its camera's size", expected=str(size),
                found=f"{self.depth.shape} and {self.usable.shape}",
            )  # fmt: skip

    @cached_property
    def nearness(self) -> NDArray[np.float64]:
        """(h, w) 1 / depth, 0 where nothing is seen."""
        depth = self.depth.astype(np.float64)
        seen = np.isfinite(depth) & (depth > 0.0)
        return np.where(seen, 1.0 / np.where(seen, depth, 1.0), 0.0)

    @cached_property
    def joints(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Where the surface goes on, to the right (h, w − 1) and down (h − 1, w)."""
        focal = self.camera.params[0]
        right, down = joints(self.nearness, _STEP_PX / focal, _STEEPEST_PX / focal)
        return right, down

    @cached_property
    def cells(self) -> NDArray[np.uint8]:
        """(h − 1, w − 1) codes of the squares between pixels, of `kernels.depth_cells`."""
        return np.asarray(depth_cells(self.nearness, *self.joints))

    @cached_property
    def fitted(self) -> NDArray[np.float64]:
        """(h, w) depths of vertices whose triangles lie nearest to what is seen between them.

        Triangles between places of a surface lie on its hollow side throughout: on average by a
        twelfth of the second difference, each way. Vertices moved by that much leave two fifths
        of the error.
        """
        right, down = self.joints
        near = self.nearness
        bent = np.zeros_like(near)
        across = right[:, 1:] & right[:, :-1]
        along = down[1:] & down[:-1]
        bent[:, 1:-1] += np.where(across, near[:, 2:] + near[:, :-2] - 2.0 * near[:, 1:-1], 0.0)
        bent[1:-1] += np.where(along, near[2:] + near[:-2] - 2.0 * near[1:-1], 0.0)
        fitted = near - bent / 12.0
        seen = near > 0.0
        return np.where(seen, 1.0 / np.where(seen, fitted, 1.0), np.inf)

    def places(
        self, which: NDArray[np.int64], depth: NDArray[np.floating] | None = None
    ) -> NDArray[np.float64]:
        """(n, 3) in the world at pixels (n,), numbered row by row, at the depth seen or another."""
        row, column = np.divmod(which, self.camera.width)
        ways = self.camera.directions(np.column_stack([column, row]) + 0.5)
        forward = ways @ self.camera.camera_from_world[2, :3]
        at = (self.depth if depth is None else depth).ravel()[which].astype(np.float64)
        return np.asarray(self.camera.center + ways * (at / forward)[:, None])

    def shows(self, points_in_world: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(n,) whether points (n, 3) lie on the depth mesh, where the photograph can be used."""
        ahead = apply(self.camera.camera_from_world, points_in_world)
        known = ahead[:, 2] > 0.0
        known &= np.hypot(ahead[:, 0], ahead[:, 1]) <= self._reach * ahead[:, 2]
        shown = np.zeros(len(known), bool)
        pixels, depths = self.camera.project(points_in_world[known])
        near = _NEAR_PX / self.camera.params[0]
        shown[known] = lie_on_cells(
            pixels, depths, self.nearness, *self.joints, self.cells, self.usable, near
        )
        return shown

    @cached_property
    def _reach(self) -> float:
        """How far from the axis, per forward, the picture's own rays go, and a little more.

        Models of lenses know nothing beyond, and may fold it back into the picture.
        """
        width, height = self.camera.width, self.camera.height
        columns, rows = np.linspace(0.0, width, 9), np.linspace(0.0, height, 9)
        border = np.concatenate(
            [
                np.stack(np.meshgrid(columns, [0.0, height]), axis=-1).reshape(-1, 2),
                np.stack(np.meshgrid([0.0, width], rows), axis=-1).reshape(-1, 2),
            ]
        )
        ways = rotate(self.camera.camera_from_world, self.camera.directions(border))
        return _REACH * float((np.hypot(ways[:, 0], ways[:, 1]) / ways[:, 2]).max())

    def arrays(self) -> dict[str, NDArray[Any]]:
        """As stored, without the camera."""
        return {
            "depth": self.depth,
            "usable": np.packbits(self.usable),
            "closed": np.array(self.closed),
            "flatness_px": np.array(self.flatness_px),
        }

    @classmethod
    def from_arrays(cls, camera: PhotoCamera, arrays: Mapping[str, NDArray[Any]]) -> DepthMap:
        """What `arrays` told, of a camera of any size."""
        depth = arrays["depth"]
        height, width = depth.shape
        usable = np.unpackbits(arrays["usable"], count=depth.size).astype(bool)
        small = reduced_camera(camera, width, height)
        return cls(
            small,
            depth,
            usable.reshape(depth.shape),
            bool(arrays["closed"]),
            # Maps of earlier projects tell none: their meshes have all triangles.
            float(arrays["flatness_px"]) if "flatness_px" in arrays else 0.0,
        )


def small_camera(camera: PhotoCamera, long_side: int) -> PhotoCamera:
    """The camera with a picture of which the longer side has so many pixels, never more than it.

    Raises
    ------
    InputError : a side would have less than two pixels.
    """
    share = min(1.0, long_side / max(camera.width, camera.height))
    width, height = round(share * camera.width), round(share * camera.height)
    if min(width, height) < 2:
        raise InputError(
            "a depth map needs two pixels a side", found=f"{width} × {height}",
            fix="make texture's depth maps larger",
        )  # fmt: skip
    return reduced_camera(camera, width, height)


def usable_pixels(alpha: NDArray[np.uint8], camera: PhotoCamera) -> NDArray[np.bool_]:
    """(h, w) pixels of a small camera in which all of a picture's alpha (H, W) is 255."""
    whole = (alpha == 255).astype(np.float32)
    share = cv2.resize(whole, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return np.asarray(share > 1.0 - 1e-4)


def depth_map_of_surface(
    rays: SurfaceRays, camera: PhotoCamera, usable: NDArray[np.bool_], closed: bool
) -> DepthMap:
    """By one ray through the middle of each pixel of a small camera."""
    met = rays.seen_by(camera)
    axis = camera.camera_from_world[2]
    depth = np.where(met.found, met.points @ axis[:3] + axis[3], np.inf)
    size = (camera.height, camera.width)
    return DepthMap(camera, depth.reshape(size).astype(np.float32), usable, closed)


def depth_map_of_samples(
    blocks: Callable[[], Iterable[Block]], camera: PhotoCamera, usable: NDArray[np.bool_]
) -> DepthMap:
    """By Gauss splatting of samples; ``blocks`` is asked twice for all of them, in one order."""
    slopes = view_of_samples((), camera).slopes
    focal = camera.params[0]
    fronts = np.full(slopes.shape[:2], np.inf)
    for block in blocks():
        draw_fronts(*_splats(block, camera), focal, slopes, fronts)
    totals = np.zeros((*fronts.shape, 5))
    for block in blocks():
        blend_splats(*_splats(block, camera), focal, slopes, fronts, _THICKNESS, totals)
    drawn = totals[..., 0] > 0.0
    depth = np.where(drawn, totals[..., 1] / np.where(drawn, totals[..., 0], 1.0), np.inf)
    return DepthMap(camera, depth.astype(np.float32), usable, closed=False)


def _splats(
    block: Block, camera: PhotoCamera
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    pixels, _ = camera.project(block.points)
    places = apply(camera.camera_from_world, block.points)
    normals = rotate(camera.camera_from_world, block.normals)
    return pixels, places, normals, _DISC * np.asarray(block.spacing, np.float64)
