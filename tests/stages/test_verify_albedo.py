"""What perfect photographs would tell of a painted surface."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from stages.verify.albedo import photographed_albedo
from tests.color.blending_scene import ball, paint, photographed, ring
from workbench.color.flash_light import FlashLight
from workbench.formats.colmap import ColmapCamera, ColmapImage, ColmapModel, write_colmap_text
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.transforms import Matrix4, apply, rigid, rotate

OPTIONS = {"feather": 0.01, "angle_power": 1.0, "sharpness_power": 1.0, "normal_px": 5}
# Light that is the same everywhere: nothing of it depends on distance or incidence.
EVEN = FlashLight(np.zeros(3), reference_distance=1e-9, epsilon=1.0, indirect=1.0)
MODEL_FROM_WORLD = rigid([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]], [3.0, -1.0, 0.5])


class Truth:
    """A simulation's pictures in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def items(self, name: str) -> list[str]:
        return [path.stem for path in (self.folder / name).glob("*.png")]

    def load(self, name: str, item: str | None = None) -> Any:
        return self.folder / "images.txt" if item is None else self.folder / name / f"{item}.png"

    def load_if_there(self, name: str) -> Any:
        return self.load(name) if (self.folder / "images.txt").exists() else None


@pytest.fixture(scope="module")
def truth(tmp_path_factory) -> Truth:
    folder = tmp_path_factory.mktemp("truth")
    cameras, images = {}, {}
    for number, camera in enumerate(ring(10)):
        picture, mask = photographed(camera, EVEN)
        for kind, shown in (
            ("truth_albedo", (picture[..., ::-1] * 65535.0).round().astype(np.uint16)),
            ("truth_object", np.where(mask, 255, 0).astype(np.uint8)),
        ):
            (folder / kind).mkdir(exist_ok=True)
            cv2.imwrite(str(folder / kind / f"p{number}.png"), shown)
        cameras[1] = ColmapCamera(1, camera.model, camera.width, camera.height, camera.params)
        images[number + 1] = ColmapImage(number + 1, camera.camera_from_world, 1, f"p{number}.png")
    write_colmap_text(folder, ColmapModel(cameras, images))
    return Truth(folder)


def moved(mesh: TriangleMesh, motion: Matrix4) -> TriangleMesh:
    vertices = apply(motion, mesh.vertices)
    return replace(mesh, vertices=vertices).with_attributes(
        normal=rotate(motion, mesh.vertex_attributes["normal"])
    )


@pytest.mark.parametrize("image_px", [240, 120])
def test_the_paint_comes_back_in_the_models_own_frame(truth, image_px):
    mesh = ball(4)
    options = OPTIONS | {"image_px": image_px}
    names = truth.items("truth_albedo")
    found = photographed_albedo(
        truth, moved(mesh, MODEL_FROM_WORLD), MODEL_FROM_WORLD, names, options
    )
    assert found is not None
    told = np.isfinite(found).all(axis=1)
    assert told.mean() > 0.9
    off = np.abs(found - paint(mesh.vertices))[told]
    assert np.quantile(off, 0.99) < 0.01 * 240 / image_px
    assert np.median(off) < 0.002 * 240 / image_px


def test_only_what_was_blended_and_written_tells(truth, tmp_path):
    mesh = ball(3)
    options = OPTIONS | {"image_px": 240}
    one = photographed_albedo(truth, mesh, np.eye(4), ["p0", "unknown"], options)
    assert one is not None
    assert 0.1 < np.isfinite(one).all(axis=1).mean() < 0.5
    assert photographed_albedo(truth, mesh, np.eye(4), ["unknown"], options) is None
    assert photographed_albedo(Truth(tmp_path), mesh, np.eye(4), ["p0"], options) is None
