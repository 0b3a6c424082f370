"""Which pixels that a mask takes away no other photograph keeps.

Each missed pixel's place on the surface is looked for in every other photograph: in its
frame, in sight of its camera, and kept by its mask.

Source: Jaspe 2018, 3.4.7, table 3.2, "true false negatives".
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.masking.evaluation import MaskingErrors, joined_errors, masking_errors
from workbench.render.raycast import RayScene
from workbench.verification.mask_errors import CheckedMasks

# Embree computes in float32: a surface this much nearer, of the distance, is the same.
_SAME_DISTANCE = 1e-3


@dataclass(frozen=True)
class MaskedPhoto:
    """One photograph with its masks, all (h, w) uint8 with 255 = keep.

    Attributes
    ----------
    camera : where it was taken from.
    truth : 255 on the object.
    clutter : pixels that count as clutter, (h, w) bool; what is neither does not count.
    automatic, final : the mask as found, and the one that is used.
    """

    camera: PhotoCamera
    truth: NDArray[np.uint8]
    clutter: NDArray[np.bool_]
    automatic: NDArray[np.uint8]
    final: NDArray[np.uint8]


def checked_photo_masks(photos: Sequence[MaskedPhoto], surface: TriangleMesh) -> CheckedMasks:
    """Errors of photographs' masks.

    Parameters
    ----------
    surface : all that stands in the scene, clutter too, in the cameras' world.
    """
    scene = RayScene.of(surface)
    return CheckedMasks(
        *(
            joined_errors(_photo_errors(photos, [getattr(p, which) for p in photos], scene))
            for which in ("automatic", "final")
        )
    )


def _photo_errors(
    photos: Sequence[MaskedPhoto], masks: Sequence[NDArray[np.uint8]], scene: RayScene
) -> Iterable[MaskingErrors]:
    for photo, mask in zip(photos, masks, strict=True):
        missed = (photo.truth > 127) & (mask <= 127)
        covered = np.zeros(mask.shape, bool)
        rows, columns = np.nonzero(missed)
        places, found = _places(scene, photo.camera, rows, columns)
        seen = np.zeros(len(places), bool)
        for other, other_mask in zip(photos, masks, strict=True):
            if other is not photo:
                seen[~seen] = _kept_in(scene, other.camera, other_mask, places[~seen])
        covered[rows[found], columns[found]] = seen
        yield masking_errors(
            mask, photo.truth, covered=covered, samples=(photo.truth > 127) | photo.clutter
        )


def _places(
    scene: RayScene, camera: PhotoCamera, rows: NDArray[np.int64], columns: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Surface points (k, 3) behind pixels, and which of the pixels (k,) have one."""
    directions = camera.directions(np.column_stack([columns + 0.5, rows + 0.5]))
    distance = _first_hit(scene, camera.center, directions)
    found = np.flatnonzero(np.isfinite(distance))
    return camera.center + distance[found, None] * directions[found], found


def _kept_in(
    scene: RayScene, camera: PhotoCamera, mask: NDArray[np.uint8], places: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Which places (n, 3) a photograph shows and its mask keeps, (n,)."""
    kept = np.zeros(len(places), bool)
    pixels, _ = camera.project(places)
    size = np.array([camera.width, camera.height])
    inside = np.asarray(((pixels >= 0) & (pixels < size)).all(axis=1))
    column, row = np.floor(pixels[inside]).astype(int).T
    inside[inside] = mask[row, column] > 127
    towards = places[inside] - camera.center
    distance = np.linalg.norm(towards, axis=1)
    first = _first_hit(scene, camera.center, towards / distance[:, None])
    kept[inside] = first > (1.0 - _SAME_DISTANCE) * distance
    return kept


def _first_hit(
    scene: RayScene, center: NDArray[np.float64], directions: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distances (n,) along unit directions (n, 3) to the surface, infinite for a miss."""
    import open3d as o3d

    start = np.broadcast_to(center - scene.center, directions.shape)
    rays = np.hstack([start, directions]).astype(np.float32)
    answer = scene.embree.cast_rays(o3d.core.Tensor.from_numpy(rays))["t_hit"].numpy()
    return np.asarray(answer, np.float64)
