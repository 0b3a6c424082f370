"""Rays and nearest places, near and far from the origin."""

import numpy as np
import pytest

from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.surface_rays import NO_TRIANGLE, SurfaceRays
from workbench.geometry.transforms import rigid

UTM = np.array([5e5, 5.2e6, 120.0])


def wall(offset: np.ndarray) -> TriangleMesh:
    """The square x, y in ±1 at z = 2, its outside towards −z."""
    corners = np.array([[-1, -1, 2], [1, -1, 2], [1, 1, 2], [-1, 1, 2]], float)
    return TriangleMesh(corners + offset, np.array([[0, 2, 1], [0, 3, 2]], np.int32))


@pytest.mark.parametrize("offset", [np.zeros(3), UTM], ids=["near", "far"])
def test_nearest_places_and_rays(offset):
    surface = SurfaceRays(wall(offset))
    asked = np.array([[0.25, -0.5, 1.7], [3.0, 0.0, 2.0]]) + offset
    near = surface.nearest(asked)
    assert near.points - offset == pytest.approx(np.array([[0.25, -0.5, 2], [1, 0, 2]]), abs=1e-6)
    assert near.normals == pytest.approx(np.array([[0, 0, -1.0]] * 2), abs=1e-6)
    ways = np.array([[0, 0, 1.0], [1.0, 0, 0], [0.6, 0, 0.8]])
    met = surface.first_met(offset, ways)
    assert met.found.tolist() == [True, False, False]
    assert met.points[0] - offset == pytest.approx([0, 0, 2], abs=1e-6)
    assert met.triangles[1] == NO_TRIANGLE
    assert np.isnan(met.points[1]).all()
    assert np.isnan(met.normals[1]).all()


def test_a_camera_sees_its_pixels_row_by_row():
    surface = SurfaceRays(wall(np.zeros(3)))
    camera = PhotoCamera("PINHOLE", 40, 30, (20.0, 20.0, 20.0, 15.0), rigid(np.eye(3), np.zeros(3)))
    seen = surface.seen_by(camera, 2)
    shown = seen.points.reshape(15, 20, 3)
    # ±1 at two metres and f = 20 are ten pixels either way of the middle.
    assert seen.found.reshape(15, 20)[3:12].sum() == 9 * 10
    assert np.array_equal(surface.silhouette(camera, 2), seen.found.reshape(15, 20))
    assert shown[7, 10] == pytest.approx([0.1, 0.0, 2.0], abs=1e-6)


def test_an_empty_surface_is_refused():
    with pytest.raises(InputError, match="triangles"):
        SurfaceRays(TriangleMesh(np.zeros((3, 3)), np.zeros((0, 3), np.int32)))


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e30])
def test_surfaces_out_of_range_are_refused(value):
    mesh = wall(np.zeros(3))
    mesh.vertices[2, 0] = value
    with pytest.raises(InputError, match="no rays"):
        SurfaceRays(mesh)


def test_nothing_is_nearest_to_what_is_no_place():
    asked = np.array([[0.25, -0.5, 1.7], [np.nan, 0, 0], [0, np.inf, 0]])
    near = SurfaceRays(wall(np.zeros(3))).nearest(asked)
    assert near.found.tolist() == [True, False, False]
    assert np.isnan(near.points[1:]).all()
    assert np.isnan(near.normals[1:]).all()
