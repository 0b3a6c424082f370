"""Which pixels that a mask takes away no other photograph keeps.

Each missed pixel's place on the surface is looked for in every other photograph: in its
frame, in sight of its camera, and kept by its mask.

Source: Jaspe 2018, 3.4.7, table 3.2, "true false negatives".
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

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

    @property
    def masks(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """The two masks that are checked."""
        return self.automatic, self.final


def checked_photo_masks(photos: Iterable[MaskedPhoto], surface: TriangleMesh) -> CheckedMasks:
    """Errors of photographs' masks.

    Parameters
    ----------
    photos : gone through twice, one at a time: they need not all be held at once.
    surface : all that stands in the scene, clutter too, in the cameras' world.
    """
    scene = RayScene.of(surface)
    looks = [(_errors(photo), _missed(scene, photo, k)) for k, photo in enumerate(photos)]
    if not looks:
        return CheckedMasks(joined_errors([]), joined_errors([]))
    each, found = zip(*looks, strict=True)
    missed = _Missed(*map(np.concatenate, zip(*found, strict=True)))
    covered = missed.by.sum(axis=0) - _nowhere_kept(scene, photos, missed).sum(axis=0)
    totals = [joined_errors(errors) for errors in zip(*each, strict=True)]
    return CheckedMasks(
        *(
            replace(total, true_false_negatives=total.false_negatives - int(count))
            for total, count in zip(totals, covered, strict=True)
        )
    )


class _Missed(NamedTuple):
    """Places (n, 3) that a mask takes away, their photographs (n,), and which masks do (n, 2)."""

    places: NDArray[np.float64]
    photo: NDArray[np.int64]
    by: NDArray[np.bool_]


def _errors(photo: MaskedPhoto) -> list[MaskingErrors]:
    samples = (photo.truth > 127) | photo.clutter
    return [masking_errors(mask, photo.truth, samples=samples) for mask in photo.masks]


def _missed(scene: RayScene, photo: MaskedPhoto, number: int) -> _Missed:
    lost = np.stack([(photo.truth > 127) & (mask <= 127) for mask in photo.masks], axis=-1)
    rows, columns = np.nonzero(lost.any(axis=-1))
    places, found = _places(scene, photo.camera, rows, columns)
    return _Missed(places, np.full(len(found), number), lost[rows[found], columns[found]])


def _nowhere_kept(
    scene: RayScene, photos: Iterable[MaskedPhoto], missed: _Missed
) -> NDArray[np.bool_]:
    """(n, 2) which of the missed places no other photograph's mask of the same kind keeps."""
    sought = missed.by.copy()
    for number, photo in enumerate(photos):
        asked = np.flatnonzero((missed.photo != number) & sought.any(axis=1))
        shown, rows, columns = _shown_in(scene, photo.camera, missed.places[asked])
        for which, mask in enumerate(photo.masks):
            sought[asked[shown], which] &= mask[rows, columns] <= 127
    return sought


def _places(
    scene: RayScene, camera: PhotoCamera, rows: NDArray[np.int64], columns: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Surface points (k, 3) behind pixels, and which of the pixels (k,) have one."""
    directions = camera.directions(np.column_stack([columns + 0.5, rows + 0.5]))
    distance = _first_hit(scene, camera.center, directions)
    found = np.flatnonzero(np.isfinite(distance))
    return camera.center + distance[found, None] * directions[found], found


def _shown_in(
    scene: RayScene, camera: PhotoCamera, places: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Which places (n, 3) a photograph shows, and in which rows and columns, (k,) each."""
    pixels, _ = camera.project(places)
    size = np.array([camera.width, camera.height])
    inside = np.flatnonzero(((pixels >= 0) & (pixels < size)).all(axis=1))
    towards = places[inside] - camera.center
    distance = np.linalg.norm(towards, axis=1)
    first = _first_hit(scene, camera.center, towards / distance[:, None])
    shown = inside[first > (1.0 - _SAME_DISTANCE) * distance]
    columns, rows = np.floor(pixels[shown]).astype(int).T
    return shown, rows, columns


def _first_hit(
    scene: RayScene, center: NDArray[np.float64], directions: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distances (n,) along unit directions (n, 3) to the surface, infinite for a miss."""
    import open3d as o3d

    start = np.broadcast_to(center - scene.center, directions.shape)
    rays = np.hstack([start, directions]).astype(np.float32)
    answer = scene.embree.cast_rays(o3d.core.Tensor.from_numpy(rays))["t_hit"].numpy()
    return np.asarray(answer, np.float64)
