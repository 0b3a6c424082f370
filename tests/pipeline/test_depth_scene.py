"""Depth meshes as stored, each with a numbering of its own, back in the project's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from tests.texturing.scenes import camera_at, sheet
from workbench.geometry.surface_rays import SurfaceRays
from workbench.pipeline.depth_scene import depth_scene
from workbench.texturing.depth_map import depth_map_of_surface, small_camera
from workbench.texturing.depth_mesh import depth_mesh

WALL = sheet((-2, 0, -1), (4, 0, 0), (0, 0, 2), 8)
NAMES = ("a", "b", "c", "d")
# Who is a candidate of whose mesh, by the meshes' own numbers.
OWN = {"a": ("a", "b"), "b": ("a", "b", "d"), "c": ("c",), "d": ("b", "d")}
PAINTED = (200, 10, 30)


@dataclass
class Stored:
    """What a project would load."""

    values: dict[Any, Any]

    def load(self, name: str, item: str | None = None) -> Any:
        return self.values[name, item]


def stored() -> Stored:
    """Four photographs of a wall; labels go round through what is there, none among them."""
    rays, values, poses = SurfaceRays(WALL), {}, {}
    for k, name in enumerate(NAMES):
        camera = camera_at((0.4 * k, -3, 0), (0.4 * k, 0, 0))
        poses[name] = {
            "model": camera.model,
            "size": [camera.width, camera.height],
            "params": list(camera.params),
            "camera_from_world": camera.camera_from_world.tolist(),
        }
        small = small_camera(camera, 24)
        found = depth_map_of_surface(rays, small, np.ones((small.height, small.width), bool), False)
        mesh = depth_mesh(found).mesh
        numbers = np.array([*range(len(OWN[name])), -1], np.int32)
        labels = numbers[np.arange(len(mesh.triangles)) * len(numbers) // len(mesh.triangles)]
        penalties = np.where(labels < 0, np.inf, 0.5).astype(np.float32)
        values["depth_maps", name] = found.arrays()
        values["depth_meshes", name] = {
            "labels": labels,
            "penalties": penalties,
            "color": np.full((len(mesh.vertices), 3), 90, np.uint8),
            "photos": np.array(OWN[name]),
        }
        values["texture_photos", name] = np.full((2, 2, 4), k, np.uint8)
    values["texturing", None] = {"photographs": list(NAMES), "image_px": 120}
    values["photo_poses", None] = {"photos": poses}
    return Stored(values)


def painted():
    return WALL.with_attributes(color=np.full((len(WALL.vertices), 3), PAINTED, np.uint8))


@pytest.fixture(scope="module")
def scene():
    return depth_scene(stored(), painted())  # type: ignore[arg-type]


def test_labels_count_through_the_projects_photographs(scene):
    raw = stored()
    assert scene.names == NAMES
    for name, mesh in zip(NAMES, scene.meshes, strict=True):
        labels = raw.load("depth_meshes", name)["labels"]
        told = [NAMES[label] if label >= 0 else None for label in mesh.labels]
        assert told == [OWN[name][label] if label >= 0 else None for label in labels]
        assert np.array_equal(mesh.foreground, [other == name for other in told])
    assert scene.foreground == sum(int(mesh.foreground.sum()) for mesh in scene.meshes)
    assert 0 < scene.foreground < sum(len(mesh.labels) for mesh in scene.meshes)


def test_cameras_are_of_the_pictures_size_and_pictures_go_by_number(scene):
    assert {(camera.width, camera.height) for camera in scene.cameras} == {(120, 90)}
    assert [int(scene.picture(k)[0, 0, 0]) for k in range(4)] == [0, 1, 2, 3]


def test_what_no_photograph_shows_loses_and_has_the_models_colours(scene):
    for mesh in scene.meshes:
        unseen = mesh.labels < 0
        assert np.isfinite(mesh.penalties).all()
        assert mesh.penalties[unseen].min() > 1000 * mesh.penalties[~unseen].max()
        shown = np.zeros(len(mesh.mesh.vertices), bool)
        shown[mesh.mesh.triangles[~unseen]] = True
        assert shown.any()
        assert not shown.all()
        colors = mesh.mesh.vertex_attributes["color"]
        assert (colors[shown] == 90).all()
        assert (colors[~shown] == PAINTED).all()


def test_without_a_model_colours_stay_as_stored():
    empty = sheet((0, 0, 0), (1, 0, 0), (0, 0, 1), 1)
    none = type(empty)(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    scene = depth_scene(stored(), none)  # type: ignore[arg-type]
    assert all((m.mesh.vertex_attributes["color"] == 90).all() for m in scene.meshes)
