"""Meshes end at steps in depth, and know which of their borders are the scene's."""

import numpy as np
import pytest

from tests.texturing.scenes import camera_at
from workbench.geometry.mesh import edge_census, face_normals_and_areas
from workbench.texturing.depth_map import DepthMap
from workbench.texturing.depth_mesh import depth_mesh

SIZE = (60, 40)
CAMERA = camera_at((0, -4, 0), size=SIZE, focal=80.0, bend=0.0)


def mesh_of(depth, closed=False, flatness_px=0.0, usable=None):
    usable = np.ones(depth.shape, bool) if usable is None else usable
    told = DepthMap(CAMERA, np.asarray(depth, np.float32), usable, closed, flatness_px)
    return depth_mesh(told)


def flat(depth=4.0):
    return np.full((SIZE[1], SIZE[0]), depth)


def test_a_flat_map_is_two_triangles_a_square():
    made = mesh_of(flat())
    w, h = SIZE
    assert len(made.mesh.triangles) == 2 * (w - 1) * (h - 1)
    census = edge_census(made.mesh.triangles)
    assert (census.boundary_edges, census.nonmanifold_edges) == (2 * (w - 1) + 2 * (h - 1), 0)
    assert census.misoriented_edges == 0
    normals, _ = face_normals_and_areas(made.mesh)
    # The camera looks along +y: outside is towards it.
    np.testing.assert_allclose(normals, np.tile([0, -1, 0], (len(normals), 1)), atol=1e-5)
    # One triangle for each edge at the border, but two corners' have two such edges.
    assert made.outer.sum() == 2 * (w - 1) + 2 * (h - 1) - 2


def test_nothing_spans_a_step():
    depth = flat()
    depth[10:30, 20:40] = 3.0
    made = mesh_of(depth)
    of_triangles = (made.mesh.vertices[:, 1] + 4.0)[made.mesh.triangles]
    assert np.ptp(of_triangles, axis=1).max() < 1e-6
    assert set(np.round(of_triangles[:, 0], 5)) == {3.0, 4.0}
    # Squares across the step are open, but four of them have three corners on the sheet behind.
    assert len(made.mesh.triangles) == 2 * 59 * 39 - 2 * (21 * 21 - 19 * 19) + 4
    # Both sides of the step are outer: the square's rim and that of the gap around it.
    near = of_triangles[:, 0] < 3.5
    assert made.outer[near].sum() == 4 * 19 - 2
    assert made.outer[~near].sum() == 2 * 59 + 2 * 39 - 2 + 4 * 19 + 4


def test_a_hole_in_the_data_is_inner():
    depth = flat()
    depth[10:15, 20:26] = np.inf
    made = mesh_of(depth)
    frame = mesh_of(flat()).outer.sum()
    assert made.outer.sum() == frame
    # Its rim: 2 · 5 and 2 · 4 legs, and a diagonal at each corner.
    assert edge_census(made.mesh.triangles).boundary_edges == 2 * 59 + 2 * 39 + 22
    # In a scene without holes it is air, and its rim is a silhouette.
    assert mesh_of(depth, closed=True).outer.sum() == frame + 22


def test_a_hole_in_a_slanted_or_curved_surface_is_inner():
    column = np.arange(SIZE[0]) + 0.5 - 0.5 * SIZE[0]
    row = (np.arange(SIZE[1]) + 0.5 - 0.5 * SIZE[1])[:, None]
    slanted = 1.0 / (0.25 + column / 80.0 * 0.25 + 0.0 * row)
    curved = 4.0 + 0.001 * (column**2 + row**2)
    for depth in (slanted, curved):
        whole = mesh_of(depth)
        depth = depth.copy()
        depth[18:23, 27:34] = np.inf
        assert mesh_of(depth).outer.sum() == whole.outer.sum()


def test_a_hole_whose_rim_turns_away_is_a_silhouette():
    """Between two round columns nothing is seen: a gap, though the mesh is all around it."""
    column = np.arange(SIZE[0]) + 0.5 - 0.5 * SIZE[0]
    away = np.abs(np.abs(column) - 15.0)
    depth = np.tile(4.0 - 0.05 * np.sqrt(np.maximum(12.5**2 - away**2, 0.0)), (SIZE[1], 1))
    depth[:, np.abs(column) < 3] = np.inf
    depth[:4] = depth[-4:] = 4.0 - 0.05 * 5.0
    inside = mesh_of(depth)
    row, column_of = np.divmod(inside.pixels, SIZE[0])
    middles_row = row[inside.mesh.triangles].mean(axis=1)
    middles_column = column_of[inside.mesh.triangles].mean(axis=1)
    at_gap = (np.abs(middles_row - 20) < 10) & (np.abs(middles_column - 29.5) < 4.5)
    assert at_gap.sum() > 20
    assert inside.outer[at_gap].mean() > 0.4


def test_a_hole_with_a_step_in_its_rim_is_outer():
    depth = flat()
    depth[:, :23] = 3.0
    depth[10:15, 20:26] = np.inf
    made = mesh_of(depth)
    row, column = np.divmod(made.pixels, SIZE[0])
    right_of_hole = (column[made.mesh.triangles].min(axis=1) == 26) & (
        np.abs(row[made.mesh.triangles].mean(axis=1) - 12) < 2
    )
    assert made.outer[right_of_hole].sum() >= 3


@pytest.mark.parametrize("depth", [np.inf, np.nan, 0.0, -2.0])
def test_nothing_seen_is_an_empty_mesh(depth):
    made = mesh_of(flat(depth))
    assert made.mesh.vertices.shape == (0, 3)
    assert made.mesh.triangles.shape == (0, 3)
    assert made.outer.shape == (0,)


def test_lonely_pixels_make_no_triangles():
    depth = flat(np.inf)
    depth[5, 5] = depth[20, 20:40] = 4.0
    depth[30, 30] = depth[31, 30] = depth[31, 31] = 4.0
    made = mesh_of(depth)
    assert len(made.mesh.triangles) == 1
    assert made.pixels.tolist() == [30 * 60 + 30, 31 * 60 + 30, 31 * 60 + 31]
    assert made.outer.tolist() == [True]
    normals, _ = face_normals_and_areas(made.mesh)
    assert normals[0, 1] < -0.99


def test_flat_parts_take_fewer_triangles_and_borders_stay():
    depth = flat()
    depth[10:30, 20:40] = 3.0
    depth[2:5, 50:53] = np.inf
    every, fewer = mesh_of(depth), mesh_of(depth, flatness_px=0.5)
    assert len(fewer.mesh.triangles) < 0.5 * len(every.mesh.triangles)
    # The same borders, edge by edge, the same triangles at outer ones, the same area.
    assert edge_census(fewer.mesh.triangles).misoriented_edges == 0
    assert borders(fewer) == borders(every)
    assert outer_ones(fewer) == outer_ones(every)
    (normals, areas), (_, all_areas) = (face_normals_and_areas(m.mesh) for m in (fewer, every))
    assert areas.sum() == pytest.approx(all_areas.sum())
    np.testing.assert_allclose(normals, np.tile([0, -1, 0], (len(normals), 1)), atol=1e-5)
    # Larger triangles are of as many samples, not of coarser ones: a pixel is 1/80 wide at 1.
    np.testing.assert_allclose(np.unique(fewer.spacing.round(5)), [3.0 / 80.0, 4.0 / 80.0])


def test_what_may_be_used_and_what_not_share_no_merged_triangle():
    usable = np.ones((SIZE[1], SIZE[0]), bool)
    usable[:, 33:] = False
    made = mesh_of(flat(), flatness_px=0.5, usable=usable)
    of_triangles = usable.ravel()[made.pixels[made.mesh.triangles]]
    mixed = of_triangles.any(axis=1) & ~of_triangles.all(axis=1)
    column = made.pixels[made.mesh.triangles] % SIZE[0]
    assert mixed.sum() == 2 * (SIZE[1] - 1)
    assert set(column[mixed].ravel()) == {32, 33}


def test_a_curved_part_keeps_its_triangles_and_the_mesh_stays_near_it():
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    depth = 4.0 + 0.3 * np.sin(x / 4.0) * (y > 20)
    made = mesh_of(depth, flatness_px=0.5)
    counts = [len(mesh_of(depth, flatness_px=f).mesh.triangles) for f in (0.0, 0.1, 0.5, 2.0)]
    assert counts == sorted(counts, reverse=True)
    assert counts[-1] < counts[0]
    careful = mesh_of(depth, flatness_px=0.05)
    assert (careful.pixels[careful.mesh.triangles].min(axis=1) // SIZE[0] > 20).mean() > 0.65
    rows = made.pixels[made.mesh.triangles].min(axis=1) // SIZE[0]
    middles = made.mesh.vertices[made.mesh.triangles].mean(axis=1)
    pixels, _ = CAMERA.project(middles)
    seen = 4.0 + 0.3 * np.sin((pixels[:, 0] - 0.5) / 4.0) * (pixels[:, 1] - 0.5 > 20)
    below = rows > 21
    off = np.abs(middles[below, 1] + 4.0 - seen[below])
    # A pixel is a twentieth wide at 4.
    assert off.max() < 2.0 * 0.5 * 0.05


def borders(made):
    """Edges of one triangle, as pixels."""
    corners = made.pixels[made.mesh.triangles]
    edges = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]))
    once, count = np.unique(edges, axis=0, return_counts=True)
    return set(map(tuple, once[count == 1].tolist()))


def outer_ones(made):
    return set(map(tuple, made.pixels[made.mesh.triangles[made.outer]].tolist()))
