"""What is to be said of the photographs' cameras, gathered from the project."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from workbench.geometry.mesh import TriangleMesh
from workbench.pipeline.stage import Products
from workbench.project.mask_subjects import photos_by_name
from workbench.verification.photo_sections import evenly_chosen

if TYPE_CHECKING:
    from workbench.verification.report_content import Section

_SHOWN = 4
_OUTLINE_SIDE = 800


def orientation_chapter(products: Products, surface: TriangleMesh) -> tuple[Section, ...]:
    """The section on cameras, where photographs were oriented."""
    from workbench.formats.colmap import read_colmap_text
    from workbench.formats.photo_reading import read_photo
    from workbench.geometry.surface_rays import SurfaceRays
    from workbench.verification.orient_sections import OutlinedPhoto, orientation_section

    poses = products.load_if_there("photo_poses")
    if poses is None:
        return ()
    shown = []
    if poses["frame"] == "world":
        cameras = read_colmap_text(Path(products.load("oriented_images")).parent).photo_cameras()
        photos, rays = photos_by_name(products.input_paths("photo_files")), SurfaceRays(surface)
        for name in evenly_chosen(sorted(cameras), _SHOWN):
            camera = cameras[name]
            step_px = max(1, max(camera.width, camera.height) // _OUTLINE_SIDE)
            seen = rays.silhouette(camera, step_px)
            shown.append(OutlinedPhoto(name, read_photo(photos[name]), seen))
    return (orientation_section(poses, shown),)
