from __future__ import annotations

import numpy as np
import pytest

from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.transforms import rigid
from workbench.render.camera import Camera, orbit_camera
from workbench.render.raycast import NO_FACE, RayScene, open_sky, render_buffers

UTM = np.array([512_345.25, 5_403_210.5, 210.125])


def facing_camera(distance: float, size: int = 64, focal: float = 64.0) -> Camera:
    """Looks along +z from (0, 0, −distance)."""
    K = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1.0]])
    return Camera(size, size, K, rigid(np.eye(3), [0, 0, distance]))


def sphere_depth(camera: Camera, distance: float) -> np.ndarray:
    """Depth (h, w) of the unit sphere at the origin, by the quadratic formula."""
    u = (np.arange(camera.width) + 0.5 - camera.K[0, 2]) / camera.K[0, 0]
    rays = np.stack(np.broadcast_arrays(u[None], u[:, None], 1.0), axis=-1)
    a, b = (rays**2).sum(-1), -2 * distance * rays[..., 2]
    root = b * b - 4 * a * (distance**2 - 1)
    return np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / (2 * a), np.inf)


def test_depth_of_a_sphere_is_that_of_the_formula(sphere):
    camera = facing_camera(4.0)
    buffers = render_buffers(sphere(), camera)
    true = sphere_depth(camera, 4.0)
    # Facets lie inside the sphere by up to edge² / 8 ≈ 2e-4; at the rim depth is steep.
    both = buffers.hit & (true < 3.5)
    assert both.sum() > 400
    assert np.all(np.abs(buffers.depth[both] - true[both]) < 1e-3)
    assert np.isinf(buffers.depth[~buffers.hit]).all()


def test_buffers_agree_with_each_other(sphere):
    mesh = sphere()
    camera = facing_camera(4.0)
    buffers = render_buffers(mesh, camera)
    assert np.array_equal(buffers.hit, buffers.face != NO_FACE)
    corners = mesh.vertices[mesh.triangles[buffers.face[buffers.hit]]]
    points = np.einsum("ij,ijk->ik", buffers.barycentric[buffers.hit], corners)
    rows, columns = np.nonzero(buffers.hit)
    assert camera.project(points) == pytest.approx(np.stack([columns, rows], 1) + 0.5, abs=2e-3)
    assert points[:, 2] + 4 == pytest.approx(buffers.depth[buffers.hit], abs=1e-5)
    outward = points / np.linalg.norm(points, axis=1, keepdims=True)
    assert np.einsum("ij,ij->i", outward, buffers.normal[buffers.hit]).min() > 0.99


def test_a_mesh_far_from_the_origin_gives_the_same_picture(sphere):
    near, far = sphere(0.05), sphere(0.05, UTM)
    a = render_buffers(near, orbit_camera(near.vertices, 30, 20, 80, 80))
    b = render_buffers(far, orbit_camera(far.vertices, 30, 20, 80, 80))
    assert (a.hit != b.hit).mean() < 2e-3
    both = a.hit & b.hit
    assert np.abs(a.depth[both] - b.depth[both]).max() < 1e-5


def test_supersampled_buffers_have_more_rays_per_pixel(sphere):
    camera = facing_camera(4.0)
    fine = render_buffers(sphere(), camera, samples_per_side=2)
    coarse = render_buffers(sphere(), camera)
    assert fine.hit.shape == (128, 128)
    assert fine.hit.mean() == pytest.approx(coarse.hit.mean(), rel=0.03)


def test_an_empty_mesh_is_background():
    empty = TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    assert not render_buffers(empty, facing_camera(1.0)).hit.any()


def test_half_of_the_sky_is_open_beside_a_high_wall():
    wall = TriangleMesh(
        np.array([[0, -100, -100], [0, 100, -100], [0, 100, 100], [0, -100, 100]], float),
        np.array([[0, 1, 2], [0, 2, 3]], np.int32),
    )
    rng = np.random.default_rng(0)
    radius, angle = np.sqrt(rng.random(4000)), 2 * np.pi * rng.random(4000)
    directions = np.stack(
        [radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)], axis=1
    ).astype(np.float32)
    beside = np.array([[1.0, 0, 0], [1.0, 0, 0]], np.float32)
    normals = np.array([[0, 0, 1.0], [1.0, 0, 0]], np.float32)  # along the wall; away from it
    which = np.zeros(2, np.intp)
    sky = open_sky(RayScene.of(wall), beside, normals, directions[None], which, 1e4)
    assert sky == pytest.approx([0.5, 1.0], abs=0.03)
