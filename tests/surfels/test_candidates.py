import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.textured_mesh import TexturedMesh
from workbench.surfels.candidates import surface_candidates
from workbench.surfels.corner_views import corner_views
from workbench.surfels.painted_surface import PaintedSurface


def candidates_of(mesh, resolution=96, **options):
    return surface_candidates(PaintedSurface.of(mesh), resolution, **options)


def directions(n=4000):
    found = np.random.default_rng(1).normal(size=(n, 3))
    return found / np.linalg.norm(found, axis=1, keepdims=True)


@pytest.mark.parametrize("views", [8, 14, 26])
def test_views_look_at_the_middle_from_outside_and_hold_the_box(views):
    lower, upper = np.array([1.0, 2.0, 3.0]), np.array([4.0, 4.0, 3.5])

    found = corner_views(lower, upper, 100, views)

    assert len(found) == views
    corners = np.array(np.meshgrid(*zip(lower, upper, strict=True))).reshape(3, -1).T
    for view in found:
        np.testing.assert_allclose(view.axes @ view.axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(view.axes) == pytest.approx(1.0)
        right, down, ahead = ((corners - view.corner) @ view.axes.T).T
        assert min(right.min(), down.min(), ahead.min()) > 0.0
        assert right.max() < view.width * view.pixel
        assert down.max() < view.height * view.pixel
        assert max(view.width, view.height) == 100
    assert len({tuple(np.round(view.axes[2], 9)) for view in found}) == views


def test_candidates_lie_on_the_surface_and_leave_no_gap(sphere):
    mesh = sphere(2.0, center=(5.4e6, -3e5, 100.0))

    points, gap = candidates_of(mesh)

    away = points.points - [5.4e6, -3e5, 100.0]
    radius = np.linalg.norm(away, axis=1)
    # Chords of an icosphere of 20480 triangles lie this deep.
    assert 2.0 * (1 - 1.2e-3) < radius.min() <= radius.max() < 2.0 + 1e-6
    cosines = np.einsum("ij,ij->i", away / radius[:, None], points.normals)
    assert cosines.min() > np.cos(np.radians(1.0))
    apart, _ = cKDTree(away).query(2.0 * directions())
    assert apart.max() < gap + 3e-3
    assert points.color is None


def test_what_is_inside_has_no_candidates(sphere):
    outer, inner = sphere(1.0, subdivisions=4), sphere(0.9, subdivisions=4)
    both = TriangleMesh(
        np.concatenate([outer.vertices, inner.vertices]),
        np.concatenate([outer.triangles, inner.triangles + len(outer.vertices)]),
    )

    points, _ = candidates_of(both)
    assert np.linalg.norm(points.points, axis=1).min() > 0.98

    inside = np.arange(len(outer.triangles), len(both.triangles))
    alone, _ = candidates_of(both, triangles=inside)
    assert np.linalg.norm(alone.points, axis=1).max() < 0.91


def test_normals_split_at_creases_and_face_the_viewer(cube):
    points, _ = candidates_of(cube)

    on_face = np.abs(points.points) > 1 - 1e-9
    np.testing.assert_allclose(np.abs(points.normals).max(axis=1), 1.0, atol=1e-6)
    axis = np.abs(points.normals).argmax(axis=1)
    rows = np.arange(len(axis))
    assert on_face[rows, axis].all()
    assert (points.normals[rows, axis] * points.points[rows, axis] > 0).all()


def test_an_open_sheet_is_seen_from_both_sides_whatever_its_winding():
    sheet = TriangleMesh(
        np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]]),
        np.array([[0, 1, 2], [0, 3, 2]], np.int32),
    )

    points, _ = candidates_of(sheet, 64)

    up = points.normals[:, 2] > 0
    assert 0.45 < up.mean() < 0.55
    np.testing.assert_allclose(np.abs(points.normals[:, 2]), 1.0, atol=1e-6)
    # Windings differ, yet each half of the sheet has both of its sides.
    half = points.points[:, 0] > points.points[:, 1]
    assert 0.45 < up[half].mean() < 0.55


def test_colors_are_those_of_the_place(sphere):
    mesh = sphere(1.0, subdivisions=5)
    color = np.rint(127.5 * (1 + mesh.vertices)).astype(np.uint8)

    points, _ = candidates_of(mesh.with_attributes(color=color))

    # Rounding, and chords inside the sphere.
    assert np.abs(points.color - 127.5 * (1 + points.points)).max() < 1.5


def test_a_texture_is_looked_up_at_the_place():
    picture = np.random.default_rng(2).integers(0, 256, (16, 32, 3), dtype=np.uint8)
    sheet = TriangleMesh(
        np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0.0]]),
        np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        {"color": np.zeros((4, 3), np.uint8)},
    )
    places = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    textured = TexturedMesh(sheet, places, np.zeros(2, np.int32), (picture,))

    points, _ = candidates_of(textured, 150)

    column, row = (points.points[:, 0] * 16).astype(int), (points.points[:, 1] * 16).astype(int)
    # A point on the border of a texel may fall to either side.
    inside = (np.abs(points.points[:, :2] * 16 % 1 - 0.5) < 0.49).all(axis=1)
    np.testing.assert_array_equal(points.color[inside], picture[row[inside], column[inside]])


def test_slivers_and_bad_meshes_are_refused_plainly(cube):
    with pytest.raises(InputError, match="no triangle with area"):
        PaintedSurface.of(TriangleMesh(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32)))
    with pytest.raises(InputError, match="no triangle with area"):
        PaintedSurface.of(TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)))
    broken = cube.vertices.copy()
    broken[0, 0] = np.nan
    with pytest.raises(InputError, match="not finite"):
        PaintedSurface.of(TriangleMesh(broken, cube.triangles))
    # Thinner than any pixel, along the axis of a view.
    needle = trimesh.creation.box((1e-9, 1e-9, 1.0))
    thin = TriangleMesh(np.asarray(needle.vertices), needle.faces.astype(np.int32))
    assert np.isfinite(candidates_of(thin, 64)[0].points).all()
