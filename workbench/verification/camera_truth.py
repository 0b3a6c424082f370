"""How far the photographs' cameras are from where a simulation had them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.surface_rays import SurfaceRays
from workbench.geometry.transforms import Matrix4, inverse, rotation_angle_deg
from workbench.metrics import Metric


@dataclass(frozen=True)
class CameraComparison:
    """Estimated against true cameras of the same photographs.

    Attributes
    ----------
    names : (n) photographs that were placed, in their order.
    center_m : (n,) how far each camera's centre is from the true one.
    rotation_deg : (n,) angle between its orientation and the true one.
    """

    names: tuple[str, ...]
    center_m: NDArray[np.float64]
    rotation_deg: NDArray[np.float64]

    def metrics(self) -> list[Metric]:
        """Median and worst errors."""
        return [
            Metric("camera_center_error_median", float(np.median(self.center_m)), "m",
                   "Median distance of cameras from the true ones, in the scans' frame."),
            Metric("camera_center_error_worst", float(self.center_m.max()), "m",
                   "Largest distance of a camera from the true one."),
            Metric("camera_rotation_error_median", float(np.median(self.rotation_deg)), "deg",
                   "Median angle between cameras and the true ones."),
            Metric("camera_rotation_error_worst", float(self.rotation_deg.max()), "deg",
                   "Largest angle between a camera and the true one."),
        ]  # fmt: skip


def compare_cameras(
    estimate: Mapping[str, Matrix4], truth: Mapping[str, Matrix4], estimate_from_truth: Matrix4
) -> CameraComparison:
    """Compare camera_from_world of the photographs that have one.

    Parameters
    ----------
    estimate, truth : by the photographs' names; those of ``truth`` in its own world.
    estimate_from_truth : 4×4 rigid, from the world of ``truth`` to that of ``estimate``, as
        the scans tell it: what is off in common counts as error.
    """
    names = tuple(sorted(set(estimate) & set(truth)))
    center, rotation = [], []
    for name in names:
        expected = truth[name] @ inverse(estimate_from_truth)
        center.append(
            float(np.linalg.norm(inverse(estimate[name])[:3, 3] - inverse(expected)[:3, 3]))
        )
        rotation.append(rotation_angle_deg(estimate[name] @ inverse(expected)))
    return CameraComparison(names, np.array(center), np.array(rotation))


def silhouette_iou(
    surface: SurfaceRays,
    camera: PhotoCamera,
    object_mask: NDArray[np.uint8],
    support_mask: NDArray[np.uint8],
) -> float:
    """Agreement of a surface as a camera sees it with where the object truly shows.

    Parameters
    ----------
    surface, camera : in one frame; the masks have the camera's size.
    object_mask, support_mask : (h, w) uint8, 255 where the object, or something before or
        beside it, shows. What a support hides is not counted.

    Returns
    -------
    Intersection over union in [0, 1]; NaN where nothing of either shows.
    """
    open_view = support_mask <= 127
    seen = surface.silhouette(camera) & open_view
    true = (object_mask > 127) & open_view
    either = int((seen | true).sum())
    return float((seen & true).sum() / either) if either else float("nan")
