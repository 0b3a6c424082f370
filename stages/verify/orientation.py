"""What is to be said of the photographs' cameras, gathered from the project."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.transforms import Matrix4
from workbench.metrics import Metric
from workbench.pipeline.stage import Products
from workbench.project.mask_subjects import photos_by_name
from workbench.verification.photo_sections import evenly_chosen

if TYPE_CHECKING:
    from workbench.geometry.surface_rays import SurfaceRays
    from workbench.verification.camera_truth import CameraComparison
    from workbench.verification.orient_sections import OutlinedPhoto
    from workbench.verification.report_content import Section

_SHOWN = 4
_OUTLINE_SIDE = 800


def orientation_chapter(
    products: Products, surface: TriangleMesh, model_from_local: Matrix4 | None
) -> tuple[tuple[Section, ...], list[Metric]]:
    """The section on cameras, where photographs were oriented, and their errors where known.

    Parameters
    ----------
    model_from_local : 4×4 from the local frame of the simulation to the model's.
    """
    from workbench.formats.colmap import read_colmap_text
    from workbench.formats.photo_reading import read_photo
    from workbench.geometry.surface_rays import SurfaceRays
    from workbench.verification.orient_sections import OutlinedPhoto, orientation_section

    poses = products.load_if_there("photo_poses")
    if poses is None:
        return (), []
    shown: list[OutlinedPhoto] = []
    truth, metrics = None, []
    if poses["frame"] == "world":
        cameras = read_colmap_text(Path(products.load("oriented_images")).parent).photo_cameras()
        rays = SurfaceRays(surface)
        if model_from_local is not None and products.load_if_there("truth_cameras") is not None:
            truth = _against_truth(products, cameras, model_from_local)
            metrics = [*truth.metrics(), *_silhouettes(products, cameras, rays)]
        photos = photos_by_name(products.input_paths("photo_files"))
        for name in evenly_chosen(sorted(cameras), _SHOWN):
            camera = cameras[name]
            step_px = max(1, max(camera.width, camera.height) // _OUTLINE_SIDE)
            seen = rays.silhouette(camera, step_px)
            shown.append(OutlinedPhoto(name, read_photo(photos[name]), seen))
    return (orientation_section(poses, shown, truth),), metrics


def _against_truth(
    products: Products, cameras: Mapping[str, PhotoCamera], model_from_local: Matrix4
) -> CameraComparison:
    from workbench.formats.colmap import read_colmap_text
    from workbench.verification.camera_truth import compare_cameras

    known = read_colmap_text(Path(products.load("truth_cameras")).parent).photo_cameras()
    return compare_cameras(
        {name: camera.camera_from_world for name, camera in cameras.items()},
        {name: camera.camera_from_world for name, camera in known.items()},
        model_from_local,
    )


def _silhouettes(
    products: Products, cameras: Mapping[str, PhotoCamera], rays: SurfaceRays
) -> list[Metric]:
    """How the surface's outlines agree with the true object's."""
    import cv2

    from workbench.verification.camera_truth import silhouette_iou

    found = []
    for name in products.items("truth_object"):
        if name in cameras:
            object_mask, support_mask = (
                np.asarray(cv2.imread(str(products.load(kind, name)), cv2.IMREAD_GRAYSCALE))
                for kind in ("truth_object", "truth_support")
            )
            found.append(silhouette_iou(rays, cameras[name], object_mask, support_mask))
    told = "Outlines of the surface against the true object's, where no support hides them, mean."
    return [Metric("silhouette_iou", float(np.mean(found)), "", told)] if found else []
