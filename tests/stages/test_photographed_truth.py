"""A surface made of photographs alone is held against the truth through the cameras' places."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from stages.verify.frames import OBJECT
from stages.verify.photographed import photographed_truth
from workbench.formats.colmap import ColmapCamera, ColmapImage, ColmapModel, write_colmap_text
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.surface_rays import SurfaceRays
from workbench.geometry.transforms import inverse, looking_at

# Steps of four pixels do not divide it.
SIZE, FOCAL, COUNT = (151, 149), 250.0, 6
SCALE, SHIFT = 2.0, np.array([5.0, -1.0, 3.0])


class Products:
    """What a simulation and an orientation without a scale left."""

    def __init__(self, values: dict[str, Any], masks: dict[str, Path]) -> None:
        self.values, self.masks = values, masks

    def load(self, name: str, item: str | None = None, only: Any = None) -> Any:
        return self.masks[item] if item else self.values[name]

    def items(self, name: str) -> list[str]:
        assert name == "truth_object"
        return sorted(self.masks)


def cameras(folder: Path, scale: float, shift: np.ndarray) -> ColmapModel:
    """Cameras in a ring, written as text, in a world that is larger and elsewhere."""
    lens = ColmapCamera(1, "SIMPLE_PINHOLE", *SIZE, (FOCAL, 0.5 * SIZE[0], 0.5 * SIZE[1]))
    images = {}
    for k in range(COUNT):
        turn = 2.0 * np.pi * k / COUNT
        place = np.array([5.0 * np.cos(turn), 1.5 * (-1) ** k, 5.0 * np.sin(turn)])
        pose = inverse(looking_at(place, np.zeros(3)))
        pose[:3, 3] = scale * pose[:3, 3] - pose[:3, :3] @ shift
        images[k + 1] = ColmapImage(k + 1, pose, 1, f"photo_{k}.png")
    model = ColmapModel({1: lens}, images)
    write_colmap_text(folder, model)
    return model


@pytest.mark.parametrize("swollen", [1.0, 1.01])
def test_sizes_that_steps_do_not_divide(tmp_path, sphere, swollen: float):
    truth = sphere(subdivisions=5)
    known = cameras(tmp_path / "true", 1.0, np.zeros(3)).photo_cameras()
    cameras(tmp_path / "found", SCALE, SHIFT)
    masks = {}
    for name, camera in known.items():
        masks[name] = tmp_path / f"{name}.png"
        cv2.imwrite(str(masks[name]), 255 * SurfaceRays(truth).silhouette(camera).astype(np.uint8))
    products = Products(
        {
            "truth_cameras": tmp_path / "true" / "images.txt",
            "oriented_images": tmp_path / "found" / "images.txt",
            "photo_poses": {"scale": {"way": "none"}},
            "truth_surface": {
                "vertices": truth.vertices,
                "triangles": truth.triangles,
                "material": np.full(len(truth.vertices), OBJECT),
                "origin": np.zeros(3),
            },
        },
        masks,
    )
    made = TriangleMesh(SCALE * swollen * truth.vertices + SHIFT, truth.triangles)
    found = photographed_truth(products, made, 20_000)
    assert found is not None
    told = {metric.name: metric.value for metric in found.metrics}
    # In the unit of the model, which is twice as large.
    assert told["accuracy_measured_rms"] == pytest.approx(SCALE * (swollen - 1.0), abs=4e-4)
    near, far = (value for name, value in told.items() if name.startswith("photographed_within"))
    assert (near > 99.0 and far > 99.0) if swollen == 1.0 else near < 1.0
