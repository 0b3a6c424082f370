import hashlib
from pathlib import Path

import numpy as np
import pytest
import trimesh

from workbench.errors import InputError, SettingsError
from workbench.formats.surface_files import write_surface_ply
from workbench.geometry.mesh import TriangleMesh, face_normals_and_areas
from workbench.kernels.morton import morton_codes
from workbench.voxels.chunk_bytes import packed_normals, unpacked_normals
from workbench.voxels.lod_export import LodOptions, export_voxel_lod, write_voxel_lod
from workbench.voxels.lod_file import LodFile
from workbench.voxels.lod_layout import HEADER, NODE
from workbench.voxels.lod_levels import capped
from workbench.voxels.voxel_set import grid_of_mesh
from workbench.voxels.voxelisation import voxelise


def two_colored_plate() -> TriangleMesh:
    """A tilted slab, thinner than voxels, red on one side and blue on the other."""
    solid = trimesh.creation.box((2.0, 1.3, 0.002))
    turn = trimesh.transformations.rotation_matrix(0.4, [3, 1, 2])[:3, :3]
    # Loose corners, so that neighbouring faces do not share colours.
    vertices = np.asarray(solid.vertices)[solid.faces].reshape(-1, 3)
    color = np.where(vertices[:, 2:] > 0, [[255, 0, 0]], [[0, 0, 255]]).astype(np.uint8)
    triangles = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
    return TriangleMesh(vertices @ turn.T, triangles, {"color": color})


@pytest.fixture(scope="module")
def plate_file(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("lod") / "plate.vlod"
    write_voxel_lod(two_colored_plate(), path, LodOptions(resolution=64, chunk_level=4))
    return path


def test_packed_normals_keep_a_tenth_of_a_degree_and_zero():
    normal = np.random.default_rng(0).normal(size=(2000, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal[0], normal[1] = 0, [0, 0, -1]

    back = unpacked_normals(packed_normals(normal.astype(np.float32)))

    # Half a step of 1/511 on each axis.
    assert np.linalg.norm(back - normal, axis=1).max() < 2 * np.sqrt(3) * 0.5 / 511
    assert (back[0] == 0).all()
    np.testing.assert_array_equal(back[1], normal[1])


@pytest.mark.parametrize("compressed", [True, False])
def test_a_file_gives_back_its_voxels_chunk_by_chunk(tmp_path, sphere, compressed):
    mesh = sphere(subdivisions=4, center=(10, 20, 30))
    options = LodOptions(resolution=64, subset="conservative", chunk_level=4, compressed=compressed)

    figures = write_voxel_lod(mesh, tmp_path / "a.vlod", options)

    file = LodFile(tmp_path / "a.vlod")
    whole = voxelise(mesh, grid_of_mesh(mesh.vertices, 6))
    whole = capped(whole, 4)
    finest = np.flatnonzero(file.nodes["level"] == 6)
    chunks = [file.chunk(node) for node in finest]
    cells = [
        chunk.cells + 16 * file.nodes["place"][node].astype(np.int64)
        for chunk, node in zip(chunks, finest, strict=True)
    ]
    np.testing.assert_array_equal(morton_codes(np.concatenate(cells)), whole.codes)
    np.testing.assert_array_equal(np.concatenate([c.faces for c in chunks]), whole.faces)
    np.testing.assert_array_equal(np.concatenate([c.separating for c in chunks]), whole.separating)
    normal = np.concatenate([c.normal for c in chunks])
    # Half a step of an axis, and what making the length one again moves.
    assert np.abs(normal - whole.normal).max() < 2.1 / 511
    assert all(chunk.color is None for chunk in chunks)
    assert figures["voxels"] == len(whole)
    assert figures["bytes"] == (tmp_path / "a.vlod").stat().st_size
    if not compressed:
        assert figures["voxel_bytes"] == 8 * figures["voxels_of_all_levels"]


def test_the_index_is_an_octree_with_bounds(plate_file):
    file = LodFile(plate_file)
    nodes = file.nodes

    seen = [0]
    for row, node in enumerate(nodes):
        children = [child for child in range(8) if node["children"] >> child & 1]
        assert bool(children) == (node["level"] < 6)
        for k, child in enumerate(children):
            at = int(node["first_child"]) + k
            seen.append(at)
            step = np.array([child & 1, child >> 1 & 1, child >> 2])
            np.testing.assert_array_equal(nodes[at]["place"], 2 * node["place"] + step)
            assert nodes[at]["level"] == node["level"] + 1
        cells = file.chunk(row).cells
        np.testing.assert_array_equal(node["low"], cells.min(axis=0))
        np.testing.assert_array_equal(node["high"], cells.max(axis=0))
    assert sorted(seen) == list(range(len(nodes)))


def test_both_sides_of_a_thin_wall_keep_their_colors_at_all_levels(plate_file):
    file = LodFile(plate_file)
    checked = 0
    for level in np.unique(file.nodes["level"]):
        chunks = [file.chunk(row) for row in np.flatnonzero(file.nodes["level"] == level)]
        # The slab lies flatter than its rim: voxels with both flat faces show both sides.
        walls = [(c.side >= 0) & ((c.faces & 0b110000) == 0b110000) for c in chunks]
        color = np.concatenate(
            [c.face_color[c.side[wall]] for c, wall in zip(chunks, walls, strict=True)]
        ).astype(int)
        checked += len(color)
        assert (color[:, 5, 0] > color[:, 5, 2]).mean() > 0.95
        assert (color[:, 4, 2] > color[:, 4, 0]).mean() > 0.95
        assert len(color) > 0.5 * sum(len(c.cells) for c in chunks)
    assert checked > 3000


def test_leaves_hold_the_original_surface_that_touches_them(plate_file):
    mesh = two_colored_plate()
    file = LodFile(plate_file)
    area = face_normals_and_areas(mesh)[1].sum()
    side = 16 * file.grid.voxel_size

    for row, node in enumerate(file.nodes):
        surface = file.geometry(row)
        assert (surface is None) == (node["level"] < 6)
        if surface is not None:
            low = file.grid.origin + node["place"] * side
            corners = surface.vertices[surface.triangles]
            assert (corners.min(axis=1) <= low + side + 1e-6).all()
            assert (corners.max(axis=1) >= low - 1e-6).all()
            assert face_normals_and_areas(surface)[1].sum() <= area * (1 + 1e-6)
            distance = np.linalg.norm(surface.vertices[:, None] - mesh.vertices, axis=2)
            nearest = distance.argmin(axis=1)
            assert distance.min() < 1e-6
            # Loose corners lie in one place with one colour on each side of the slab.
            np.testing.assert_array_equal(
                surface.vertex_attributes["color"], mesh.vertex_attributes["color"][nearest]
            )


def test_the_same_bytes_whatever_the_workers(tmp_path, sphere):
    prints = set()
    for workers in (1, 2, 3):
        path = tmp_path / f"{workers}.vlod"
        options = LodOptions(resolution=128, chunk_level=4, workers=workers)
        write_voxel_lod(sphere(subdivisions=3), path, options)
        prints.add(hashlib.sha256(path.read_bytes()).hexdigest())

    assert len(prints) == 1


def read_all(path: Path) -> None:
    file = LodFile(path)
    for row in range(len(file.nodes)):
        file.chunk(row)
        file.geometry(row)


def test_damage_anywhere_is_noticed(tmp_path, plate_file):
    whole = plate_file.read_bytes()
    broken = tmp_path / "broken.vlod"
    rng = np.random.default_rng(7)
    places = [*range(HEADER.itemsize), *rng.integers(HEADER.itemsize, len(whole), 60)]

    for place in places:
        data = bytearray(whole)
        data[place] ^= 1 << rng.integers(0, 8)
        broken.write_bytes(data)
        with pytest.raises(InputError):
            read_all(broken)


@pytest.mark.parametrize("length", [0, 7, HEADER.itemsize, -NODE.itemsize, -1])
def test_a_file_cut_short_is_refused(tmp_path, plate_file, length):
    whole = plate_file.read_bytes()
    short = tmp_path / "short.vlod"
    short.write_bytes(whole[:length])

    with pytest.raises(InputError, match=r"cut short|no voxel levels"):
        LodFile(short)


def test_a_missing_file_is_told_as_such(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        LodFile(tmp_path / "none.vlod")


def test_a_mesh_file_becomes_a_folder_with_its_voxels(tmp_path, sphere):
    write_surface_ply(tmp_path / "ball.ply", sphere(subdivisions=3))

    figures = export_voxel_lod(
        tmp_path / "ball.ply", tmp_path / "out", LodOptions(resolution=512, geometry=False)
    )

    file = LodFile(tmp_path / "out" / "voxels.vlod")
    assert (figures["resolution"], figures["levels"], figures["triangles"]) == (512, 2, 1280)
    assert figures["chunks"] == len(file.nodes) == 9
    # A plane meets the crosses of max |n| voxels per voxel's face: 0.831 over all directions.
    mean = 6 / (np.pi * np.sqrt(2)) * np.arctan(1 / np.sqrt(2))
    area = face_normals_and_areas(sphere(subdivisions=3))[1].sum()
    assert figures["voxels"] == pytest.approx(mean * area / figures["voxel_size"] ** 2, rel=0.005)
    assert figures["geometry_bytes"] == 0


@pytest.mark.parametrize("resolution", [0, 1, 100, 1 << 15])
def test_other_resolutions_are_refused_before_the_mesh_is_read(tmp_path, resolution):
    with pytest.raises(SettingsError, match="resolution"):
        export_voxel_lod(tmp_path / "none.ply", tmp_path, LodOptions(resolution=resolution))


def test_a_mesh_without_area_is_refused(tmp_path):
    flat = TriangleMesh(np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0.0]]), np.array([[0, 1, 2]], "i4"))

    with pytest.raises(InputError, match="no triangle with area"):
        write_voxel_lod(flat, tmp_path / "flat.vlod", LodOptions(resolution=16))
    assert not list(tmp_path.iterdir())
