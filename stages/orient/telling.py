"""What the stage has to say of the cameras it found."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from workbench.metrics import Metric
from workbench.pipeline.stage import Products

if TYPE_CHECKING:
    from workbench.formats.colmap import ColmapModel
    from workbench.geometry.mesh import TriangleMesh
    from workbench.orientation.alignment import Alignment

_SILHOUETTE_SIDE = 400


def alignment_metrics(found: Alignment) -> list[Metric]:
    """How sure the adjustment is of its cameras; nothing where there was none."""
    adjusted = found.adjustment
    if adjusted is None:
        return []
    centers = [float(np.linalg.norm(sigma)) for sigma in adjusted.center_sigma.values()]
    turns = list(adjusted.rotation_sigma_deg.values())
    return [
        Metric("adjusted_reprojection", adjusted.reprojection_sigma_px, "px",
               "Robust sigma of a coordinate after the adjustment to the surface."),
        Metric("surface_sigma", adjusted.surface_sigma, "m",
               "How far points lie from the surface beyond what triangulation explains."),
        Metric("tied_points", adjusted.tied, "",
               f"Points the surface holds, of {adjusted.points}."),
        Metric("center_sigma", float(np.median(centers)), "m",
               "Standard deviation of a camera's place, median; noise alone."),
        Metric("rotation_sigma", float(np.median(turns)), "deg",
               "Standard deviation of a camera's orientation, median; noise alone."),
    ]  # fmt: skip


def doubts(found: Alignment) -> list[str]:
    """What the user should know before the cameras are relied on."""
    from workbench.orientation.alignment import NOT_ASKED_FOR

    adjusted = found.adjustment
    if adjusted is not None and not adjusted.converged:
        return [f"the adjustment to the surface did not settle in {adjusted.rounds} rounds"]
    if found.why_not_refined and found.why_not_refined != NOT_ASKED_FOR:
        return [f"cameras were not adjusted to the surface: {found.why_not_refined}"]
    return []


def silhouette_agreement(
    products: Products, model: ColmapModel, surface: TriangleMesh
) -> dict[str, dict[str, float]]:
    """How each mask agrees with the surface as its camera sees it.

    Returns
    -------
    By photograph ``beside``, the share of the mask where there is no surface, which tells of a
    wrong camera, and ``hidden``, the share of the surface that is masked: supports before it
    and shadows are, too.
    """
    import cv2

    from workbench.geometry.surface_rays import SurfaceRays

    rays, found = SurfaceRays(surface), {}
    cameras = model.photo_cameras()
    for name in products.items("photo_masks"):
        if name not in cameras:
            continue
        camera = cameras[name]
        step_px = max(1, max(camera.width, camera.height) // _SILHOUETTE_SIDE)
        seen = rays.silhouette(camera, step_px)
        mask = cv2.resize(
            products.load("photo_masks", name), seen.shape[::-1], interpolation=cv2.INTER_AREA
        )
        kept = mask > 127
        found[name] = {
            "beside": float((kept & ~seen).sum() / max(1, kept.sum())),
            "hidden": float((seen & ~kept).sum() / max(1, seen.sum())),
        }
    return found


def told_poses(model: ColmapModel, alignment: Alignment | None) -> dict[str, Any]:
    """Pose, lens and uncertainty of every photograph by name."""
    adjusted = alignment.adjustment if alignment else None
    told = {}
    for number, image in sorted(model.images.items()):
        camera = model.cameras[image.camera_id]
        entry: dict[str, Any] = {
            "file": image.name,
            "camera_from_world": image.camera_from_world.tolist(),
            "model": camera.model,
            "size": [camera.width, camera.height],
            "params": list(camera.params),
            "points": int((image.point3d_ids >= 0).sum()),
        }
        if adjusted is not None:
            entry["center_sigma_m"] = adjusted.center_sigma[number].tolist()
            entry["rotation_sigma_deg"] = adjusted.rotation_sigma_deg[number]
        told[Path(image.name).stem] = entry
    return told
