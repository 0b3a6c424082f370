"""Cameras and outlines held against what was simulated."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.surface_rays import SurfaceRays
from workbench.geometry.transforms import from_twist, inverse
from workbench.verification.camera_truth import compare_cameras, silhouette_iou


def test_a_known_error_is_told_and_the_common_motion_is_not():
    common = from_twist([0.3, -0.2, 0.5, 1.0, 2.0, -3.0])
    truth = {f"p{k}": from_twist([0.1 * k, 0.2, 0.0, k, 0.0, 2.0]) for k in range(4)}
    estimate = {name: pose @ inverse(common) for name, pose in truth.items()}
    exact = compare_cameras(estimate, truth, common)
    assert exact.center_m.max() < 1e-12
    assert exact.rotation_deg.max() < 1e-5
    # In the camera's own frame: a turn of 0.2 degrees, then 3 mm to the side.
    off = from_twist([0.0, np.radians(0.2), 0.0, 0.0, 0.0, 0.0])
    off[0, 3] = 3e-3
    estimate["p2"] = off @ estimate["p2"]
    estimate["not simulated"] = np.eye(4)
    found = compare_cameras(estimate, truth, common)
    assert found.names == ("p0", "p1", "p2", "p3")
    assert found.center_m == pytest.approx([0, 0, 3e-3, 0], abs=1e-9)
    assert found.rotation_deg == pytest.approx([0, 0, 0.2, 0], abs=1e-5)
    told = {metric.name: metric.value for metric in found.metrics()}
    assert told["camera_center_error_worst"] == pytest.approx(3e-3)
    assert told["camera_rotation_error_median"] < 1e-5


def test_outlines_agree_but_for_what_the_support_hides():
    square = TriangleMesh(
        np.array([[-1, -1, 4.0], [1, -1, 4], [1, 1, 4], [-1, 1, 4]]),
        np.array([[0, 1, 2], [0, 2, 3]]),
    )
    camera = PhotoCamera("PINHOLE", 80, 80, (80.0, 80.0, 40.0, 40.0), np.eye(4))
    rays, shown = SurfaceRays(square), np.zeros((80, 80), np.uint8)
    shown[20:60, 20:60] = 255
    nothing = np.zeros_like(shown)
    assert silhouette_iou(rays, camera, shown, nothing) == 1.0
    hidden, support = shown.copy(), nothing.copy()
    hidden[:, :30], support[:, :30] = 0, 255
    assert silhouette_iou(rays, camera, hidden, support) == 1.0
    assert silhouette_iou(rays, camera, hidden, nothing) == pytest.approx(0.75)
    assert np.isnan(silhouette_iou(rays, camera, nothing, np.full_like(shown, 255)))
