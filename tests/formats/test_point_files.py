"""Points of every kind of file through one door."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.formats.point_fixtures import assert_same, check_damage, some_points
from workbench.errors import InputError
from workbench.formats.las_writing import write_las
from workbench.formats.ply import PlyElement, write_ply
from workbench.formats.ply_points import is_streamed, ply_batches, write_ply_points
from workbench.formats.point_files import point_batches, point_stream, read_points
from workbench.formats.point_stream import BATCH_POINTS, slices_of, surveyed
from workbench.geometry.point_set import PointSet, joined


def test_ply_comes_back_to_the_bit(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    points = some_points(BATCH_POINTS + 3, offset=(4.3e5, 5.4e6, 0))
    told = write_ply_points(path, surveyed(slices_of(points)))
    assert told == {"bytes": path.stat().st_size, "rounding_error": 0.0}
    assert [len(batch) for batch in point_batches(path)] == [BATCH_POINTS, 3]
    assert_same(read_points(path), points, 0.0)
    bare = some_points(7, attributes=False)
    write_ply_points(path, surveyed(slices_of(bare)))
    assert_same(read_points(path), bare, 0.0)


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_colours_of_other_types_are_read_whole(tmp_path: Path, dtype: type) -> None:
    points = some_points(9)
    white = 65535 if dtype is np.uint16 else 1
    columns = dict(zip("xyz", points.points.T, strict=True))
    wide = (points.color * (white / 255)).astype(dtype)
    wide[0], points.color[0] = white, 255
    columns |= dict(zip(("red", "green", "blue"), wide.T, strict=True))
    path = tmp_path / "cloud.ply"
    write_ply(path, [PlyElement("vertex", 9, columns)])
    assert not is_streamed(path)
    np.testing.assert_array_equal(read_points(path).color, points.color)


def test_las_streams(tmp_path: Path) -> None:
    points = some_points(1000)
    write_las(tmp_path / "Cloud.LAZ", surveyed(slices_of(points)))
    stream = point_stream(tmp_path / "Cloud.LAZ")
    assert (stream.count, stream.attributes) == (1000, {"normals", "color", "radius"})
    np.testing.assert_allclose(stream.low, points.points.min(axis=0), atol=1e-5)
    assert len(joined(list(stream.batches()))) == len(joined(list(stream.batches()))) == 1000


@pytest.mark.parametrize("suffix", ["obj", "glb", "stl", "ply"])
def test_vertices_of_surfaces(tmp_path: Path, suffix: str) -> None:
    solid = trimesh.creation.icosphere(subdivisions=2)
    path = tmp_path / f"mesh.{suffix}"
    solid.export(path)
    found = read_points(path)
    assert len(found) == len(solid.vertices)
    nearest = np.linalg.norm(found.points[:, None] - solid.vertices[None], axis=2).min(axis=1)
    assert nearest.max() < 1e-6


def test_scans_are_put_where_they_stand(tmp_path: Path) -> None:
    """Two scans of a PTX, the second turned a quarter about z and moved."""
    head = "1\n2\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
    still = head + "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n1 2 3 0.5\n4 5 6 0.5\n"
    moved = head + "0 1 0 0\n-1 0 0 0\n0 0 1 0\n10 0 0 1\n1 2 3 0.5\n0 0 0 0.5\n"
    path = tmp_path / "two.ptx"
    path.write_text(still + moved)
    found = read_points(path)
    np.testing.assert_allclose(found.points, [[1, 2, 3], [4, 5, 6], [8, 1, 3]])


def test_text(tmp_path: Path) -> None:
    (tmp_path / "cloud.xyz").write_text("1 2 3 255 0 0\n4 5 6 0 255 0\n")
    found = read_points(tmp_path / "cloud.xyz")
    assert found.points.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert found.color.tolist() == [[255, 0, 0], [0, 255, 0]]


def test_points_that_are_not_finite_are_counted(tmp_path: Path) -> None:
    points = some_points(10)
    points.points[[2, 5], [0, 1]] = np.nan, np.inf
    path = tmp_path / "cloud.ply"
    write_ply(path, [PlyElement("vertex", 10, dict(zip("xyz", points.points.T, strict=True)))])
    with pytest.raises(InputError, match="2 of 10"):
        read_points(path)
    with pytest.raises(InputError, match="2 of 10"):
        surveyed(slices_of(points))


def test_what_has_no_points_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no points"):
        surveyed(slices_of(PointSet(np.empty((0, 3)))))
    for name in ("absent.laz", "absent.ply", "absent.e57", "picture.png", "nothing"):
        with pytest.raises(InputError) as told:
            read_points(tmp_path / name)
        assert told.value.fix
        assert told.value.file == str(tmp_path / name)


def test_damaged_ply_is_told(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    write_ply_points(path, surveyed(slices_of(some_points(50))))
    check_damage(path, ply_batches, tries=300, lengths=200)
