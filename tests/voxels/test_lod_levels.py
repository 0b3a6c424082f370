import numpy as np
import pytest
import trimesh

from workbench.geometry.mesh import TriangleMesh
from workbench.kernels.morton import morton_codes
from workbench.voxels.lod_levels import LodChunk, capped, coarser_voxels, lod_chunks, thin_part
from workbench.voxels.voxel_set import VoxelGrid, VoxelSet, grid_of_mesh
from workbench.voxels.voxelisation import VoxelisationOptions, voxel_parts, voxelise


def painted(mesh: TriangleMesh, seed: int = 0) -> TriangleMesh:
    rng = np.random.default_rng(seed)
    return mesh.with_attributes(color=rng.integers(0, 256, (len(mesh.vertices), 3), np.uint8))


def torus(turned: float = 0.7) -> TriangleMesh:
    solid = trimesh.creation.torus(1.0, 0.35, 60, 40)
    turn = trimesh.transformations.rotation_matrix(turned, [1, 2, 3])[:3, :3]
    return TriangleMesh(np.asarray(solid.vertices) @ turn.T, solid.faces.astype(np.int32))


def plate() -> TriangleMesh:
    """A tilted slab far thinner than the voxels of the tests."""
    solid = trimesh.creation.box((2.0, 1.3, 0.004))
    turn = trimesh.transformations.rotation_matrix(0.4, [3, 1, 2])[:3, :3]
    return TriangleMesh(np.asarray(solid.vertices) @ turn.T, solid.faces.astype(np.int32))


def box() -> TriangleMesh:
    """A box whose edges let in light where voxels are left out carelessly."""
    solid = trimesh.creation.box((2.0, 1.3, 0.6))
    turn = trimesh.transformations.rotation_matrix(1.5, [0.126, -0.132, 0.64])[:3, :3]
    return TriangleMesh(np.asarray(solid.vertices) @ turn.T, solid.faces.astype(np.int32))


def linear(color: np.ndarray) -> np.ndarray:
    value = color.astype(float) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def test_coarser_voxels_enclose_the_finer_ones_and_average_them(sphere):
    mesh = painted(sphere(subdivisions=4))
    options = VoxelisationOptions(face_color_step=255, least_coherence=0.0)
    fine = voxelise(mesh, grid_of_mesh(mesh.vertices, 7), options)

    coarse = coarser_voxels(fine, 255, 0.0)

    parents, index = np.unique(fine.codes >> np.uint64(3), return_inverse=True)
    np.testing.assert_array_equal(coarse.codes, parents)
    np.testing.assert_allclose(coarse.area, np.bincount(index, fine.area), rtol=1e-12)
    faces = np.zeros(len(parents), np.uint8)
    np.bitwise_or.at(faces, index, fine.faces)
    np.testing.assert_array_equal(coarse.faces, faces)
    weight = np.maximum(fine.area, 1e-12)
    for k in range(3):
        mean = np.bincount(index, weight * linear(fine.color[:, k])) / np.bincount(index, weight)
        low, high = (linear(coarse.color[:, k] + shift) for shift in (-0.501, 0.501))
        assert ((mean >= low) & (mean <= high)).all()
    assert coarse.grid.resolution == 64


def test_a_level_of_levels_is_close_to_the_level_made_of_triangles(sphere):
    mesh = sphere(subdivisions=5)
    grid = grid_of_mesh(mesh.vertices, 8)

    coarse = coarser_voxels(coarser_voxels(voxelise(mesh, grid)))
    direct = voxelise(mesh, grid.at_level(6))

    np.testing.assert_array_equal(coarse.codes, direct.codes)
    np.testing.assert_allclose(coarse.area, direct.area, rtol=1e-9, atol=1e-15)
    sure = direct.area > 1e-9
    assert (np.einsum("nk,nk->n", coarse.normal, direct.normal)[sure] > 0.9999).all()
    np.testing.assert_array_equal(coarse.faces, direct.faces)


def test_sides_that_differ_stay_apart_in_coarser_levels():
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    vertices = np.concatenate(
        [
            np.column_stack([square, np.full(4, 0.501)]),
            np.column_stack([square[::-1], np.full(4, 0.499)]),
        ]
    )
    triangles = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], np.int32)
    color = np.repeat(np.array([[200, 0, 0], [0, 0, 200]], np.uint8), 4, axis=0)
    mesh = TriangleMesh(vertices, triangles, {"color": color})
    voxels = voxelise(mesh, VoxelGrid(np.array([-0.1, -0.1, -0.13]), 1.2, 7))

    for _ in range(5):
        voxels = coarser_voxels(voxels)

        # The two sides are 0.002 apart; no voxel boundary of these levels lies between them.
        assert len(voxels.sided.index) == len(voxels)
        assert (voxels.sided.color[:, 4] == [0, 0, 200]).all()
        assert (voxels.sided.color[:, 5] == [200, 0, 0]).all()
        np.testing.assert_allclose(voxels.sided.normal[:, 5], [[0, 0, 1]] * len(voxels))


def chunks_of(mesh: TriangleMesh, level: int, chunk_level: int, thin: bool) -> list[LodChunk]:
    grid = grid_of_mesh(mesh.vertices * 1.05, level)
    parts = voxel_parts(mesh, grid, part_level=chunk_level)
    chosen = (thin_part(part, chunk_level) for part in parts) if thin else parts
    return list(lod_chunks(chosen, chunk_level=chunk_level))


def test_chunks_of_all_levels_hold_every_voxel_once_children_first():
    mesh = torus()

    chunks = chunks_of(mesh, 7, 4, thin=False)

    codes = voxelise(mesh, grid_of_mesh(mesh.vertices * 1.05, 7)).codes
    for level in range(7, 3, -1):
        found = [chunk for chunk in chunks if chunk.level == level]
        together = np.concatenate([chunk.voxels.codes for chunk in found])
        np.testing.assert_array_equal(together, np.unique(codes >> np.uint64(3 * (7 - level))))
        numbers = [chunk.number for chunk in found]
        assert numbers == sorted(set(numbers))
    place = {(chunk.level, chunk.number): at for at, chunk in enumerate(chunks)}
    assert place[4, 0] == len(chunks) - 1
    for chunk in chunks:
        for child in range(8):
            below = (chunk.level + 1, 8 * chunk.number + child)
            assert (below in place) == bool(chunk.children >> child & 1)
            assert place.get(below, -1) < place[chunk.level, chunk.number]


def expanded(voxels: VoxelSet, level: int, solid: np.ndarray, masks: np.ndarray) -> None:
    """Draw voxels into the grid of a finer level; inner faces of what they become are set."""
    scale = 1 << (level - voxels.grid.level)
    cells = voxels.cells * scale
    for step in np.ndindex(scale, scale, scale):
        at = tuple((cells + step).T)
        mask = np.full(len(cells), 63, np.uint8)
        for axis in range(3):
            if step[axis] == 0:
                mask &= ~np.uint8(1 << 2 * axis) | voxels.faces
            if step[axis] == scale - 1:
                mask &= ~np.uint8(2 << 2 * axis) | voxels.faces
        solid[at] = True
        masks[at] = mask


def flooded(solid: np.ndarray) -> np.ndarray:
    """Empty cells connected through faces with the outermost layer, which must be empty."""
    seen = np.zeros_like(solid)
    seen[0, 0, 0] = True
    count = 0
    while seen.sum() > count:
        count = seen.sum()
        for axis in range(3):
            view, blocked = np.moveaxis(seen, axis, 0), np.moveaxis(solid, axis, 0)
            for order in (range(1, len(view)), range(len(view) - 2, -1, -1)):
                before = -1 if order.step > 0 else 1
                for k in order:
                    view[k] |= view[k + before] & ~blocked[k]
    return seen


@pytest.mark.parametrize("thin", [True, False])
@pytest.mark.parametrize("make", [torus, plate, box])
def test_no_hole_opens_where_levels_meet(make, thin):
    mesh, level, chunk_level = make(), 6, 3
    chunks = chunks_of(mesh, level, chunk_level, thin)
    by_place = {(chunk.level, chunk.number): chunk for chunk in chunks}
    rng = np.random.default_rng(3)
    solid = np.zeros((64, 64, 64), bool)
    masks = np.zeros((64, 64, 64), np.uint8)
    shown = []

    def show(chunk: LodChunk) -> None:
        if chunk.children and (chunk.level == chunk_level or rng.random() < 0.6):
            for child in range(8):
                if chunk.children >> child & 1:
                    show(by_place[chunk.level + 1, 8 * chunk.number + child])
        else:
            shown.append(chunk.level)
            expanded(capped(chunk.voxels, chunk_level), level, solid, masks)

    show(by_place[chunk_level, 0])
    outside = flooded(np.pad(solid, 1))[1:-1, 1:-1, 1:-1]

    assert len(set(shown)) > 1
    # Inside of the torus, on the circle in the middle of its tube, no flood arrives.
    if make is torus:
        angles = np.linspace(0, 2 * np.pi, 40)
        turn = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])[:3, :3]
        ring = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles]) @ turn.T
        grid = grid_of_mesh(mesh.vertices * 1.05, level)
        cells = np.floor((ring - grid.origin) / grid.voxel_size).astype(int)
        assert not solid[tuple(cells.T)].all()
        assert not outside[tuple(cells.T)].any()
    # Whatever can be seen from outside is a face that is shown.
    for axis in range(3):
        for bit, step in ((1 << 2 * axis, 1), (2 << 2 * axis, -1)):
            free = np.roll(np.pad(outside, 1, constant_values=True), step, axis)
            seen = solid & free[1:-1, 1:-1, 1:-1]
            assert (masks[seen] & bit).all()


@pytest.mark.parametrize("level", [4, 5, 7])
def test_needles_and_specks_do_not_vanish_from_the_thin_subset(level):
    rng = np.random.default_rng(level)
    needle = trimesh.creation.cylinder(0.002, segment=[[0.1, 0.2, 0.3], [0.9, 0.7, 0.75]])
    specks = [
        trimesh.creation.icosphere(1, 0.001).apply_translation(p) for p in rng.uniform(0, 1, (9, 3))
    ]
    solid = trimesh.util.concatenate([needle, *specks])
    mesh = TriangleMesh(np.asarray(solid.vertices), solid.faces.astype(np.int32))
    whole = voxelise(mesh, grid_of_mesh(mesh.vertices, level))

    thin = thin_part(whole, 7)

    # Every voxel that was left out has a neighbour, across a corner at most, that stays.
    steps = np.array(list(np.ndindex(3, 3, 3))) - 1
    near = np.clip(thin.cells[:, None] + steps, 0, whole.grid.resolution - 1).reshape(-1, 3)
    assert np.isin(whole.codes, morton_codes(near)).all()
    assert len(thin) > 0.5 * len(whole)
