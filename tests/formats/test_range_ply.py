from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from workbench.errors import InputError
from workbench.formats.poses import read_conf
from workbench.formats.range_ply import range_ply_reading, read_range_ply, write_range_ply
from workbench.formats.surface_files import read_surface
from workbench.geometry.mesh import vertex_normals
from workbench.geometry.rangemap import RangeMap
from workbench.geometry.transforms import apply, from_twist


def test_grid_color_and_reflectance(tmp_path, valid_files):
    path = tmp_path / "scan 1.ply"
    path.write_bytes(valid_files["text.ply"])
    scan = read_range_ply(path)
    assert scan.name == "scan_1"
    assert scan.grid is not None
    assert scan.grid.tolist() == [[0, 1, -1], [3, -1, 2]]
    assert scan.color is not None
    assert scan.color.tolist()[3] == [13, 23, 33]
    assert scan.reflectance is not None
    assert scan.reflectance.tolist() == [0.5, 0.25, np.float32(1e-3), -4]


def test_what_is_not_finite_is_left_out_counted_and_the_grid_follows(tmp_path, valid_files):
    path = tmp_path / "a.ply"
    path.write_bytes(valid_files["text.ply"].replace(b"1 0 1 11", b"nan 0 1 11"))
    reading = range_ply_reading(path)
    assert reading.dropped_nonfinite == 1
    assert any("1 samples" in note for note in reading.notes)
    scan = reading.range_map
    assert scan.points_in_scan.tolist() == [[0, 0, 1], [2, 1, 1], [0, 1, 1]]
    assert scan.grid is not None
    assert scan.grid.tolist() == [[0, -1, -1], [2, -1, 1]]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"1 3\n0", b"1 4\n0", "does not name one vertex"),
        (b"1 3\n0", b"2 3 1\n0", "does not name one vertex"),
        (b"num_cols 3", b"num_cols 4", "contradicts itself"),
        (b"obj_info num_rows 2\n", b"", "contradicts itself"),
        (b"property float z", b"property float w", "no vertices with x, y and z"),
        (b"num_cols 3", b"num_cols 3\nobj_info viewpoint 1 2", "viewpoint"),
        (b"num_cols 3", b"num_cols 3\nobj_info world_from_scan" + b" 1" * 16, "not rigid"),
    ],
)
def test_contradictions_are_refused(tmp_path, valid_files, old, new, message):
    path = tmp_path / "a.ply"
    path.write_bytes(valid_files["text.ply"].replace(old, new))
    with pytest.raises(InputError, match=message):
        read_range_ply(path)


def cloud(tmp_path, rows, extra="", info=""):
    path = tmp_path / "cloud.ply"
    names = "".join(f"property float {name}\n" for name in f"x y z {extra}".split())
    path.write_text(
        f"ply\nformat ascii 1.0\n{info}element vertex {len(rows)}\n{names}end_header\n"
        + "".join(" ".join(map(str, row)) + "\n" for row in rows)
    )
    return range_ply_reading(path)


def test_the_viewpoint_is_the_origin_unless_the_points_surround_it(tmp_path):
    ahead, around = [[1, 1, 1], [2, -1, 1]], [[1, 1, 1], [-1, -1, -1]]
    assert cloud(tmp_path, ahead).range_map.viewpoint_in_scan.tolist() == [0, 0, 0]
    assert cloud(tmp_path, around).range_map.viewpoint_in_scan is None
    told = cloud(tmp_path, around, info="obj_info viewpoint 1 2 3.5\n").range_map
    assert told.viewpoint_in_scan.tolist() == [1, 2, 3.5]
    far = cloud(tmp_path, [[0, 0, 0], [3, 0, 4]], info="obj_info is_cyberware_data 1\n").range_map
    assert far.viewpoint_in_scan.tolist() == [1.5, 0, 2 + 50]


def test_the_property_taken_for_the_reflectance_is_said(tmp_path):
    reading = cloud(tmp_path, [[1, 2, 3, 9, 0.5]], "scalar_Time scalar_Intensity")
    assert reading.range_map.reflectance.tolist() == [0.5]
    assert any("scalar_Intensity" in note for note in reading.notes)


def test_projector_columns_make_a_grid_and_shared_cells_are_said(tmp_path):
    rows = [[1, 0, 1, 5, 9], [2, 0, 1, 6, 9], [3, 0, 1, 6, 9], [4, 0, 1, 7, 11]]
    reading = cloud(tmp_path, rows, "proj_row proj_col")
    assert reading.range_map.grid.tolist() == [[0, -1, -1], [1, -1, -1], [-1, -1, 3]]
    assert any("1 samples share" in note for note in reading.notes)
    sparse = cloud(tmp_path, [[1, 0, 1, 0, 0], [2, 0, 1, 10**6, 10**6]], "proj_row proj_col")
    assert sparse.range_map.grid is None
    assert any("too large" in note for note in sparse.notes)


def test_a_cloud_without_a_finite_point_is_refused(tmp_path):
    with pytest.raises(InputError, match="finite coordinates"):
        cloud(tmp_path, [["nan", 0, 0], [1e38, 0, 0]])
    with pytest.raises(InputError, match="no points"):
        cloud(tmp_path, [])


@given(seed=st.integers(0, 2**32), gridded=st.booleans(), dressed=st.booleans())
@settings(max_examples=25, deadline=None)
def test_float64_round_trip_is_exact_and_the_bytes_are_the_same(
    tmp_path_factory, seed, gridded, dressed
):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 40))
    grid = np.full((5, 8), -1, np.int32)
    grid.reshape(-1)[rng.permutation(40)[: n // 2]] = rng.permutation(n)[: n // 2]
    scan = RangeMap(
        "exact",
        rng.standard_normal((n, 3)) * 10.0 ** rng.integers(-3, 7),
        grid if gridded else None,
        rng.standard_normal(3) if dressed else None,
        rng.random(n).astype(np.float32) if dressed else None,
        rng.integers(0, 256, (n, 3)).astype(np.uint8) if dressed else None,
        from_twist(rng.standard_normal(6)) if dressed else None,
    )
    path = tmp_path_factory.getbasetemp() / "exact.ply"
    write_range_ply(path, scan)
    first = path.read_bytes()
    back = read_range_ply(path)
    write_range_ply(path, back)
    assert path.read_bytes() == first
    assert back.name == "exact"
    for name in (
        "points_in_scan", "grid", "viewpoint_in_scan", "reflectance", "color", "world_from_scan"
    ):  # fmt: skip
        written, read = getattr(scan, name), getattr(back, name)
        assert (read is None) == (written is None), name
        if written is not None:
            assert read.dtype == written.dtype
            assert np.array_equal(read, written), name
    write_range_ply(path, scan, float_type="float32")
    assert np.array_equal(
        read_range_ply(path).points_in_scan, scan.points_in_scan.astype(np.float32)
    )


def test_the_bunny_lies_on_its_reference_and_is_seen_from_outside(shared_data):
    folder = shared_data("stanford-bunny", "bun.conf").parent
    poses = read_conf(folder / "bun.conf")
    reference = read_surface(folder / "reference" / "bun_zipper.ply")
    normals = vertex_normals(reference)
    tree = cKDTree(reference.vertices)
    spacing = np.mean(tree.query(reference.vertices, k=2)[0][:, 1])
    total, elapsed = 0, 0.0
    distances, heights = [], []
    assert len(poses) == 10
    for name, world_from_scan in poses.items():
        start = time.perf_counter()
        scan = read_range_ply(folder / name)
        elapsed += time.perf_counter() - start
        total += len(scan)
        assert scan.grid is not None
        assert scan.grid.shape == (400, 512)
        points = apply(world_from_scan, scan.points_in_scan)[::7]
        distance, nearest = tree.query(points)
        near = distance < 2 * spacing
        distances.append(distance)
        # A scanner sees the outside: the surface looks back at the viewpoint.
        to_scanner = apply(world_from_scan, scan.viewpoint_in_scan) - points[near]
        facing = np.einsum("ij,ij->i", to_scanner, normals[nearest[near]]) > 0
        assert facing.mean() > 0.95, name
        offset = points - reference.vertices[nearest]
        heights.append(np.abs(np.einsum("ij,ij->i", offset, normals[nearest])))
        # Neighbours in a row of the grid are neighbours in space.
        left, right = scan.grid[:, :-1], scan.grid[:, 1:]
        both = (left >= 0) & (right >= 0)
        steps = scan.points_in_scan[left[both]] - scan.points_in_scan[right[both]]
        steps = np.linalg.norm(steps, axis=1)
        assert np.median(steps) < 0.002
    assert total == 362_272
    assert elapsed < 4
    # The nearest vertex of a mesh with this spacing is about half of it away, sideways; off
    # the surface itself the range maps are a tenth of that.
    assert 0.3 * spacing < np.concatenate(distances).mean() < 0.6 * spacing
    assert np.concatenate(heights).mean() < 0.1 * spacing
    assert 0.1 * spacing < 0.00011


def test_the_bust_has_its_projector_grid(shared_data):
    scan = read_range_ply(shared_data("bust-reflectance", "alexander_range_refl.ply"))
    assert len(scan) == 156_920
    assert scan.grid is not None
    assert (scan.grid >= 0).sum() == 156_920
    assert scan.reflectance is not None
    assert scan.reflectance.max() == 255
    # The bust surrounds its own origin, so nothing is known of the camera.
    assert scan.viewpoint_in_scan is None
    row = scan.grid[300]
    pairs = np.flatnonzero((row[:-1] >= 0) & (row[1:] >= 0))
    steps = scan.points_in_scan[row[pairs]] - scan.points_in_scan[row[pairs + 1]]
    assert np.median(np.linalg.norm(steps, axis=1)) < 1.0
