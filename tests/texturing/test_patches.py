"""Patches: connected, of one photograph, where it shows them, none covering itself."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tests.texturing.scenes import camera_at, ring, sheet, together
from workbench.errors import InputError
from workbench.geometry.labelled_mesh import NO_PHOTO, LabelledMesh
from workbench.kernels.patch_drawing import SUBTEXELS
from workbench.texturing.patches import patches_of
from workbench.texturing.texture_costs import side_by_side


def labelled(mesh, labels) -> LabelledMesh:
    m = len(mesh.triangles)
    return LabelledMesh(
        mesh, np.asarray(labels, np.int32), np.ones(m, bool), np.zeros(m, np.float32)
    )


def owners(patches, p) -> np.ndarray:
    """How many triangles of a patch own each texel's middle, by cross products in float64."""
    left, top, width, height = patches.rects[p]
    rows = slice(patches.starts[p], patches.starts[p + 1])
    corners = patches.corners[rows] / SUBTEXELS - [left, top]
    middles = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)
    count = np.zeros((height, width), int)
    for corner in corners:
        cross = []
        for k in range(3):
            along = corner[(k + 1) % 3] - corner[k]
            way = middles - corner[k]
            cross.append(along[0] * way[..., 1] - along[1] * way[..., 0])
        cross = np.array(cross)
        count += (cross > 1e-9).all(axis=0) | (cross < -1e-9).all(axis=0)
    return count


def nearest_photo(mesh, cameras) -> np.ndarray:
    centers = np.array([camera.center for camera in cameras.values()])
    middles = mesh.vertices[mesh.triangles].mean(axis=1)
    return np.linalg.norm(middles[:, None] - centers, axis=2).argmin(axis=1)


def test_patches_of_a_ball(sphere):
    cameras, mesh = ring(5), sphere(0.8, subdivisions=3)
    labels = nearest_photo(mesh, cameras)
    labels[np.abs(mesh.vertices[mesh.triangles].mean(axis=1)[:, 2]) > 0.5] = NO_PHOTO
    patches = patches_of(labelled(mesh, labels), cameras, padding=3)
    assert sorted(patches.triangles) == list(range(len(labels)))
    np.testing.assert_array_equal(patches.labels[patches.patch_of], labels[patches.triangles])
    edges, _ = side_by_side(mesh.triangles)
    patch = np.empty(len(labels), int)
    patch[patches.triangles] = patches.patch_of
    joined = edges[patch[edges[:, 0]] == patch[edges[:, 1]]]
    parts, _ = connected_components(
        coo_array((np.ones(len(joined)), joined.T), (len(labels), len(labels)))
    )
    assert parts == patches.count
    # Photographs' patches are as few as the labelling has: nothing on a ball covers itself.
    joined = edges[labels[edges[:, 0]] == labels[edges[:, 1]]]
    _, by_label = connected_components(
        coo_array((np.ones(len(joined)), joined.T), (len(labels), len(labels)))
    )
    photographed = len(set(by_label[labels != NO_PHOTO].tolist()))
    assert (patches.labels != NO_PHOTO).sum() == photographed
    for p in range(patches.count):
        assert owners(patches, p).max(initial=0) <= 1
        rows = slice(patches.starts[p], patches.starts[p + 1])
        corners = patches.corners[rows] / SUBTEXELS
        left, top, width, height = patches.rects[p]
        assert (corners >= [left + 3, top + 3]).all()
        assert (corners <= [left + width - 3, top + height - 3]).all()
        if patches.labels[p] != NO_PHOTO:
            points = mesh.vertices[mesh.triangles[patches.triangles[rows]]]
            pixels, _ = cameras[int(patches.labels[p])].project(points.reshape(-1, 3))
            assert np.abs(corners.reshape(-1, 2) - pixels).max() <= 0.5 / SUBTEXELS + 1e-9


def test_a_patch_that_would_cover_itself_is_cut():
    # A sheet folded back over itself: the photograph is said to show both halves.
    near = sheet((-1, 0, -1), (2, 0, 0), (0, 0, 2), 6)
    far = sheet((-1, 0.5, -1), (2, 0, 0), (0, 0, 2), 6)
    mesh = together(near, far)
    # Joined along an edge, so that only the folding parts them.
    last = len(near.vertices)
    triangles = mesh.triangles.copy()
    triangles[triangles == last] = 0
    triangles[triangles == last + 1] = 1
    mesh = type(mesh)(mesh.vertices, triangles)
    cameras = {0: camera_at((0, -4, 0))}
    patches = patches_of(labelled(mesh, np.zeros(len(triangles))), cameras)
    assert 2 <= patches.count <= 6
    assert all(owners(patches, p).max() <= 1 for p in range(patches.count))


def test_patches_too_large_for_a_page_are_cut():
    mesh = sheet((-1, 0, -1), (2, 0, 0), (0, 0, 2), 24)
    cameras = {0: camera_at((0, -4, 0), size=(600, 600), focal=1000.0)}
    whole = patches_of(labelled(mesh, np.zeros(len(mesh.triangles))), cameras)
    assert whole.count == 1
    assert whole.rects[0, 2] > 400
    cut = patches_of(labelled(mesh, np.zeros(len(mesh.triangles))), cameras, largest=200)
    assert cut.count >= 9
    assert cut.rects[:, 2:].max() <= 200
    assert sorted(cut.triangles) == list(range(len(mesh.triangles)))


def test_bare_triangles_lie_without_distortion_at_two_texels_to_the_edge():
    mesh = sheet((-1, 0, -1), (2, 0, 0), (0, 0, 2), 4)
    patches = patches_of(labelled(mesh, np.full(32, NO_PHOTO)), {})
    assert patches.count == 1
    sides = patches.corners - np.roll(patches.corners, 1, axis=1)
    lengths = np.sort(np.linalg.norm(sides, axis=2) / SUBTEXELS, axis=1)
    np.testing.assert_allclose(lengths, [[2, 2, 2 * 2**0.5]] * 32, atol=0.01)


def test_triangles_their_photograph_cannot_show_are_refused():
    mesh = sheet((-1, 0, -1), (2, 0, 0), (0, 0, 2), 2)
    cameras = {0: camera_at((0, -4, 0), target=(0, -8, 0))}
    with pytest.raises(InputError, match="cannot show"):
        patches_of(labelled(mesh, np.zeros(8)), cameras)
    with pytest.raises(InputError, match="too large"):
        patches_of(labelled(mesh, np.zeros(8)), {0: camera_at((0, -4, 0))}, largest=64)
