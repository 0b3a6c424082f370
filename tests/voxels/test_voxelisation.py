import hashlib
import itertools

import numpy as np
import open3d as o3d
import pytest

from workbench.errors import InputError
from workbench.formats.surface_files import read_surface
from workbench.geometry.mesh import TriangleMesh, face_normals_and_areas
from workbench.kernels.morton import morton_codes
from workbench.voxels.voxel_set import VoxelGrid, grid_of_mesh
from workbench.voxels.voxelisation import (
    VoxelisationOptions,
    triangle_census,
    voxel_parts,
    voxelise,
)


def linear_from_srgb(encoded: np.ndarray) -> np.ndarray:
    return np.where(
        encoded <= 0.04045, encoded / 12.92, ((np.maximum(encoded, 0) + 0.055) / 1.055) ** 2.4
    )


def random_mesh(seed: int, triangles: int, size: float, colored: bool = False) -> TriangleMesh:
    """Loose triangles in the unit cube."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(0, 1, (triangles, 1, 3)) + rng.normal(scale=size, size=(triangles, 3, 3))
    mesh = TriangleMesh(
        np.clip(corners, 0, 1).reshape(-1, 3),
        np.arange(3 * triangles, dtype=np.int32).reshape(-1, 3),
    )
    color = rng.integers(0, 256, (3 * triangles, 3)).astype(np.uint8)
    return mesh.with_attributes(color=color) if colored else mesh


def clipped(polygon: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The part of a polygon (n, 6) inside a box in its first three columns, plane by plane."""
    for axis in range(3):
        for sign, bound in ((1.0, high[axis]), (-1.0, -low[axis])):
            kept = []
            for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
                da, db = sign * a[axis] - bound, sign * b[axis] - bound
                if da <= 0:
                    kept.append(a)
                if (da < 0 < db) or (db < 0 < da):
                    kept.append(a + (b - a) * (da / (da - db)))
            polygon = np.array(kept).reshape(-1, polygon.shape[1])
            if not len(polygon):
                return polygon
    return polygon


def brute_force(mesh: TriangleMesh, grid: VoxelGrid) -> dict[int, np.ndarray]:
    """Area, area × normal and area × linear colour of every voxel, one clip per voxel."""
    found: dict[int, np.ndarray] = {}
    linear = linear_from_srgb(mesh.vertex_attributes["color"].astype(float) / 255)
    values = np.concatenate([mesh.vertices, linear], axis=1)
    for normal, triangle in zip(face_normals_and_areas(mesh)[0], mesh.triangles, strict=True):
        corners = values[triangle]
        box = (corners[:, :3] - grid.origin) / grid.voxel_size
        first, last = np.floor(box.min(axis=0)).astype(int), np.floor(box.max(axis=0)).astype(int)
        for cell in np.ndindex(*(last - first + 1)):
            low = grid.origin + (first + cell) * grid.voxel_size
            part = clipped(corners, low, low + grid.voxel_size)
            if not len(part):
                continue
            total = np.zeros(7)
            for b, c in itertools.pairwise(part[1:]):
                area = 0.5 * np.linalg.norm(np.cross(b[:3] - part[0, :3], c[:3] - part[0, :3]))
                color = (part[0, 3:] + b[3:] + c[3:]) / 3
                total += area * np.concatenate([[1], normal, color])
            code = int(morton_codes((first + np.array(cell))[None])[0])
            found[code] = found.get(code, 0) + total
    return found


@pytest.mark.parametrize(("level", "size"), [(2, 0.3), (4, 0.2), (7, 0.02)])
def test_voxels_areas_normals_and_colors_equal_a_clip_per_voxel(level, size):
    mesh = random_mesh(level, 40, size, colored=True)
    grid = grid_of_mesh(mesh.vertices, level)
    truth = brute_force(mesh, grid)

    voxels = voxelise(mesh, grid)

    assert voxels.codes.tolist() == sorted(truth)
    table = np.array([truth[code] for code in sorted(truth)])
    np.testing.assert_allclose(voxels.area, table[:, 0], rtol=1e-9, atol=1e-15)
    whole = voxels.area > 1e-6 * grid.voxel_size**2
    length = np.linalg.norm(table[:, 1:4], axis=1)
    sure = whole & (length > 1e-3 * table[:, 0])
    np.testing.assert_allclose(
        voxels.normal[sure], table[sure, 1:4] / length[sure, None], atol=2e-6
    )
    assert voxels.color is not None
    mean = table[:, 4:] / np.maximum(table[:, :1], 1e-300)
    low = linear_from_srgb((voxels.color.astype(float) - 0.501) / 255)
    high = linear_from_srgb((voxels.color.astype(float) + 0.501) / 255)
    assert ((mean >= low) & (mean <= high))[whole].all()


def test_areas_of_voxels_add_up_to_the_area_of_the_mesh(sphere):
    mesh = sphere(subdivisions=4)

    voxels = voxelise(mesh, grid_of_mesh(mesh.vertices, 8))

    assert voxels.area.sum() == pytest.approx(face_normals_and_areas(mesh)[1].sum(), rel=1e-12)


def test_pieces_in_a_plane_of_the_grid_count_half_on_either_side():
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    mesh = TriangleMesh(square, np.array([[0, 1, 2], [0, 2, 3]], np.int32))

    voxels = voxelise(mesh, VoxelGrid(np.full(3, -2.0), 4.0, 2))

    inner = np.array([1, 2])
    inside = np.isin(voxels.cells, inner).all(axis=1)
    np.testing.assert_allclose(voxels.area[inside], 0.5)
    # Closed voxels: those around the rim touch it without area.
    assert inside.sum() == 8
    assert len(voxels) == 32
    assert (voxels.area[~inside] == 0).all()
    assert (voxels.normal == [0, 0, 1]).all()
    assert (voxels.faces == 0b100000).all()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_mirror_image_has_the_mirrored_voxels_bit_for_bit(axis, sphere):
    sign = np.where(np.arange(3) == axis, -1.0, 1.0)
    rng = np.random.default_rng(5)
    mesh = sphere(subdivisions=3, center=(3.3, -0.2, 100.7))
    mesh = mesh.with_attributes(color=rng.integers(0, 256, (len(mesh.vertices), 3), np.uint8))
    mirrored = TriangleMesh(mesh.vertices * sign, mesh.triangles, mesh.vertex_attributes)

    one = voxelise(mesh, grid_of_mesh(mesh.vertices, 7))
    two = voxelise(mirrored, grid_of_mesh(mirrored.vertices, 7))

    cells = np.where(sign < 0, 127 - two.cells, two.cells)
    order = np.argsort(morton_codes(cells))
    np.testing.assert_array_equal(morton_codes(cells)[order], one.codes)
    np.testing.assert_array_equal(two.area[order], one.area)
    np.testing.assert_array_equal(two.color[order], one.color)
    np.testing.assert_array_equal(two.separating[order], one.separating)
    # The triangles keep the order of their corners, so their normals turn where they are
    # mirrored: along the axis they stay, across it they change sign.
    np.testing.assert_array_equal(two.normal[order] * -sign, one.normal)


def fingerprint(mesh: TriangleMesh, grid: VoxelGrid, options: VoxelisationOptions) -> str:
    voxels = voxelise(mesh, grid, options)
    digest = hashlib.sha256()
    for values in (voxels.codes, voxels.area, voxels.normal, voxels.color, voxels.faces,
                   voxels.separating, voxels.sided.index, voxels.sided.normal):  # fmt: skip
        digest.update(values.tobytes())
    return digest.hexdigest()


def test_workers_and_lists_do_not_change_a_byte():
    mesh = random_mesh(1, 300, 0.1, colored=True)
    grid = grid_of_mesh(mesh.vertices, 8)

    prints = {
        fingerprint(mesh, grid, VoxelisationOptions(workers=workers, pairs_at_once=pairs))
        for workers, pairs in ((1, 1 << 20), (2, 1 << 20), (3, 50), (1, 1))
    }

    assert len(prints) == 1


def test_parts_are_aligned_cubes_in_morton_order(sphere):
    mesh = sphere(subdivisions=3)
    grid = grid_of_mesh(mesh.vertices, 8)

    parts = list(voxel_parts(mesh, grid, part_level=7))

    assert [len(set((part.codes >> np.uint64(21)).tolist())) for part in parts] == [1] * 8
    np.testing.assert_array_equal(
        np.concatenate([part.codes for part in parts]), voxelise(mesh, grid).codes
    )


def reached(blocked: np.ndarray) -> np.ndarray:
    """Cells (n, n, n) that a 6-connected flood from the corner reaches."""
    seen = np.zeros_like(blocked)
    seen[0, 0, 0] = True
    while True:
        grown = seen.copy()
        for axis in range(3):
            for a, b in ((slice(1, None), slice(None, -1)), (slice(None, -1), slice(1, None))):
                to = tuple(a if k == axis else slice(None) for k in range(3))
                at = tuple(b if k == axis else slice(None) for k in range(3))
                grown[to] |= seen[at]
        grown &= ~blocked
        if (grown == seen).all():
            return seen
        seen = grown


def test_the_separating_subset_is_closed_and_thin(sphere):
    mesh = sphere(subdivisions=4)
    grid = grid_of_mesh(mesh.vertices * 1.1, 6)

    voxels = voxelise(mesh, grid)

    subset = voxels.subset(voxels.separating)
    blocked = np.zeros((64, 64, 64), bool)
    blocked[tuple(subset.cells.T)] = True
    outside = reached(blocked)
    assert not outside[32, 32, 32]
    # A plane meets the crosses of max |n| voxels per voxel's face and touches |n|₁ of them;
    # over all directions 0.831 and 1.5.
    area = voxels.area.sum() / grid.voxel_size**2
    mean = 6 / (np.pi * np.sqrt(2)) * np.arctan(1 / np.sqrt(2))
    assert len(subset) == pytest.approx(mean * area, rel=0.01)
    assert len(voxels) == pytest.approx(1.5 * area, rel=0.01)
    # Thin: each of its voxels has an empty neighbour outside and one inside.
    inside = ~outside & ~blocked
    for side in (outside, inside):
        near = np.zeros_like(side)
        for axis in range(3):
            near |= np.roll(side, 1, axis) | np.roll(side, -1, axis)
        assert near[tuple(subset.cells.T)].mean() > 0.9


def test_both_colors_of_a_thin_wall_survive():
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    front = np.column_stack([square, np.full(4, 0.501)])
    back = np.column_stack([square[::-1], np.full(4, 0.499)])
    frame = np.array([[0, 0, 0], [1, 1, 1], [1, 1, 1]], float)
    mesh = TriangleMesh(
        np.concatenate([front, back, frame]),
        np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7], [8, 9, 10]], np.int32),
        {"color": np.array([[255, 0, 0]] * 4 + [[0, 0, 255]] * 4 + [[9, 9, 9]] * 3, np.uint8)},
    )
    grid = VoxelGrid(np.array([-0.1, -0.1, -0.25]), 1.3, 4)

    voxels = voxelise(mesh, grid)

    assert len(voxels.sided.index) == len(voxels)
    assert (voxels.faces == 0b110000).all()
    assert (voxels.sided.color[:, 4] == [0, 0, 255]).all()
    assert (voxels.sided.color[:, 5] == [255, 0, 0]).all()
    assert (voxels.sided.normal[:, 4] == [0, 0, -1]).all()
    assert (voxels.sided.normal[:, 5] == [0, 0, 1]).all()


def test_one_color_needs_no_attributes_face_by_face(sphere):
    mesh = sphere(subdivisions=4)
    mesh = mesh.with_attributes(color=np.full((len(mesh.vertices), 3), 99, np.uint8))

    voxels = voxelise(mesh, grid_of_mesh(mesh.vertices, 6))

    assert not len(voxels.sided.index)
    assert (voxels.color == 99).all()


def test_outward_faces_and_shells(sphere):
    mesh = sphere(subdivisions=4)
    grid = grid_of_mesh(mesh.vertices, 6)

    voxels = voxelise(mesh, grid)
    shell = voxelise(mesh, grid, VoxelisationOptions(shell=True))

    away = voxels.centers > 4 * grid.voxel_size
    for axis in range(3):
        plus = (voxels.faces >> (2 * axis + 1) & 1).astype(bool)
        minus = (voxels.faces >> (2 * axis) & 1).astype(bool)
        assert plus[away[:, axis]].all()
        assert not minus[away[:, axis]].any()
        both = (shell.faces >> (2 * axis) & 3) == 3
        np.testing.assert_array_equal(both, plus | minus)


def test_triangles_without_area_and_repeated_ones_are_counted():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [0, 0, 1]], float)
    triangles = np.array(
        [[0, 1, 2], [0, 1, 3], [1, 2, 0], [2, 1, 0], [1, 1, 2], [0, 1, 4]], np.int32
    )
    mesh = TriangleMesh(vertices, triangles)

    census = triangle_census(mesh)
    voxels = voxelise(mesh, grid_of_mesh(vertices, 5))

    assert (census.triangles, census.degenerate, census.duplicate) == (6, 2, 2)
    assert voxels.area.sum() == pytest.approx(4 * 0.5)


def test_a_mesh_without_surface_has_no_voxels():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]], float)
    mesh = TriangleMesh(vertices, np.array([[0, 1, 2]], np.int32))

    assert len(voxelise(mesh, grid_of_mesh(vertices, 5))) == 0


def test_vertices_that_are_not_finite_or_outside_are_refused(sphere):
    mesh = sphere(subdivisions=2)
    grid = grid_of_mesh(mesh.vertices, 5)
    broken = mesh.vertices.copy()
    broken[7, 1] = np.nan

    with pytest.raises(InputError, match="not finite"):
        grid_of_mesh(broken, 5)
    with pytest.raises(InputError, match="not finite or lies outside"):
        voxelise(TriangleMesh(broken, mesh.triangles), grid)
    with pytest.raises(InputError, match="outside"):
        voxelise(TriangleMesh(mesh.vertices * 1.5, mesh.triangles), grid)
    with pytest.raises(InputError, match="resolution"):
        voxelise(mesh, grid.at_level(15))


def test_far_coordinates_keep_the_grid_tight():
    vertices = np.random.default_rng(2).uniform(0, 1, (100, 3)) + np.array([5.4e6, 4e5, 100])

    grid = grid_of_mesh(vertices, 10)

    extent = np.ptp(vertices, axis=0).max()
    assert extent < grid.size < extent * (1 + 1e-5)
    assert (grid.origin < vertices.min(axis=0)).all()
    assert (grid.origin + grid.size > vertices.max(axis=0)).all()


def test_a_scanned_surface_keeps_its_area_and_its_shape(shared_data):
    mesh = read_surface(shared_data("stanford-bunny", "reference", "bun_zipper.ply"))
    grid = grid_of_mesh(mesh.vertices, 8)

    voxels = voxelise(mesh, grid)

    assert voxels.area.sum() == pytest.approx(face_normals_and_areas(mesh)[1].sum(), rel=1e-12)
    used = mesh.vertices[np.unique(mesh.triangles)]
    inside = np.floor((used - grid.origin) / grid.voxel_size).astype(np.int64)
    assert np.isin(morton_codes(inside), voxels.codes).all()


def test_a_scanned_surface_has_the_voxels_that_another_program_finds(shared_data):
    mesh = read_surface(shared_data("stanford-bunny", "reference", "bun_zipper.ply"))
    grid = grid_of_mesh(mesh.vertices, 6)
    given = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices), o3d.utility.Vector3iVector(mesh.triangles)
    )
    other = o3d.geometry.VoxelGrid.create_from_triangle_mesh_within_bounds(
        given, grid.voxel_size, grid.origin, grid.origin + grid.size
    )

    voxels = voxelise(mesh, grid)

    cells = np.array([voxel.grid_index for voxel in other.get_voxels()])
    np.testing.assert_array_equal(np.sort(morton_codes(cells)), voxels.codes)
