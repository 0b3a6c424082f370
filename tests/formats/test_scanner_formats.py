"""PTX, E57, PCD and plain text."""

from __future__ import annotations

import numpy as np
import open3d
import pytest
from scipy.spatial.transform import Rotation

from workbench.errors import InputError
from workbench.formats.e57 import e57_readings, read_e57
from workbench.formats.pcd import pcd_reading, read_pcd
from workbench.formats.ptx import ptx_readings, read_ptx
from workbench.formats.xyz import read_xyz, xyz_reading
from workbench.geometry.transforms import apply


def saved(tmp_path, name: str, data: bytes | str):
    path = tmp_path / name
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return path


# PTX


def test_ptx_runs_down_columns_and_its_matrix_is_for_row_vectors(tmp_path, valid_files):
    (scan,) = read_ptx(saved(tmp_path, "a.ptx", valid_files["one.ptx"]))
    assert scan.grid is not None
    assert scan.grid.tolist() == [[0, 2], [1, 3], [-1, 4]]
    assert scan.color is not None
    assert scan.color.tolist()[2] == [0, 0, 255]
    assert scan.viewpoint_in_scan is not None
    assert scan.viewpoint_in_scan.tolist() == [0, 0, 0]
    assert scan.world_from_scan is not None
    # [1 0 5 1] · M with rows (0 1 0), (−1 0 0), (0 0 1), (10 20 30).
    assert apply(scan.world_from_scan, [1, 0, 5]).tolist() == [10, 21, 35]


def test_ptx_agrees_with_a_published_transform(tmp_path):
    # The sample of rapidlasso's article on PTX in LAStools, transformed there by two programs.
    text = (
        "3\n3\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n-0.955179 0.296021 -0.002106 0\n"
        "-0.296023 -0.955180 0.001152 0\n-0.001670 0.001724 0.999997 0\n"
        "3.847211 12.235314 -0.425777 1\n1.111111 2.111111 3.111 0.111\n"
        "1.222222 2.222222 3.222 0.212\n0 0 0 0\n0 0 0 0\n1.333333 2.333333 3.333 0.312\n"
        "1.444444 2.444444 3.444 0.423\n0 0 0 0\n1.555555 2.555555 3.555 0.534\n"
        "1.666666 2.666666 3.666 0.678\n"
    )
    (scan,) = read_ptx(saved(tmp_path, "a.ptx", text))
    world = apply(scan.world_from_scan, scan.points_in_scan)
    assert np.abs(world[:2] - [[2.156, 10.553, 2.685], [2.017, 10.480, 2.796]]).max() < 6e-4


def test_ptx_with_several_scans_numbers_them(tmp_path, valid_files):
    scans = read_ptx(saved(tmp_path, "hall.ptx", valid_files["two.ptx"]))
    assert [scan.name for scan in scans] == ["hall_000", "hall_001"]
    assert [len(scan) for scan in scans] == [5, 5]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"2 2 5 0.6 4 5 6\n", b"", "ends early"),
        (b"2 1 5 0.5", b"2 x 5 0.5", "line 15"),
        (b"2 1 5 0.5 1 2 3", b"2 1 5 0.5", "line 15"),
        (b"2\n3\n", b"2000000000\n3\n", "more cells"),
        (b"2\n3\n", b"-2\n3\n", "impossible grid"),
        (b"2\n3\n", b"nan\n3\n", "header"),
        (b"0 1 0 0\n", b"0 2 0 0\n", "not rigid"),
        (b"0 0 1 0\n10", b"0 0 nan 0\n10", "header"),
        (b"10 20 30 1\n", b"10 20 30\n", "header"),
    ],
)
def test_ptx_damage_is_placed(tmp_path, valid_files, old, new, message):
    with pytest.raises(InputError) as caught:
        read_ptx(saved(tmp_path, "a.ptx", valid_files["one.ptx"].replace(old, new, 1)))
    assert message in str(caught.value)


def test_a_real_ptx(shared_data):
    (reading,) = ptx_readings(shared_data("formats", "ptx", "with-color.ptx"))
    scan = reading.range_map
    assert len(scan) == 1065
    assert scan.grid is not None
    assert scan.grid.shape == (71, 15)
    assert scan.points_in_scan[0].tolist() == [637012.24, 849028.31, 431.66]
    assert scan.color is not None
    assert scan.color[0].tolist() == [68, 77, 88]
    assert any("identity" in note for note in reading.notes)


# E57


def test_e57_in_spherical_coordinates_with_everything(tmp_path, write_e57):
    rng = np.random.default_rng(2)
    n = 30
    distance, azimuth = rng.uniform(2, 9, n), rng.uniform(-3, 3, n)
    elevation = rng.uniform(-1.4, 1.4, n)
    turn = Rotation.from_rotvec([0.3, -0.2, 1.1])
    x, y, z, w = turn.as_quat()
    fields = {
        "sphericalRange": distance,
        "sphericalAzimuth": azimuth,
        "sphericalElevation": elevation,
        "sphericalInvalidState": (np.arange(n) == 4) * 2,
        "rowIndex": 70_000 + np.arange(n) // 6,
        "columnIndex": np.arange(n) % 6,
        "colorRed": np.arange(n) * 2000,
        "colorGreen": np.full(n, 65535),
        "colorBlue": np.zeros(n, int),
    }
    # The components stand in another order than libraries write them.
    pose = {
        "rotation": [("x", x), ("y", y), ("z", z), ("w", w)],
        "translation": [("x", 5.4e6), ("y", 3e5), ("z", 77)],
    }
    colors = dict.fromkeys(("colorRed", "colorGreen", "colorBlue"), 65535)
    path = write_e57(tmp_path / "a.e57", [{"fields": fields, "pose": pose, "largest": colors}])
    (reading,) = e57_readings(path)
    scan = reading.range_map
    assert len(scan) == n - 1
    assert any("1 samples are flagged invalid" in note for note in reading.notes)
    assert np.allclose(
        np.linalg.norm(scan.points_in_scan, axis=1), np.delete(distance, 4), rtol=1e-14
    )
    assert np.allclose(
        np.arctan2(*scan.points_in_scan[:, [1, 0]].T), np.delete(azimuth, 4), atol=1e-14
    )
    assert np.allclose(
        scan.points_in_scan[:, 2], np.delete(distance * np.sin(elevation), 4), atol=1e-14
    )
    assert scan.grid is not None
    assert scan.grid.shape == (5, 6)
    assert scan.grid[0, 4] == -1
    assert scan.grid[4, 5] == n - 2
    assert scan.color is not None
    assert scan.color[1].tolist() == [round(2000 * 255 / 65535), 255, 0]
    assert scan.world_from_scan is not None
    assert np.allclose(scan.world_from_scan[:3, :3], turn.as_matrix(), atol=1e-15)
    assert scan.world_from_scan[:3, 3].tolist() == [5.4e6, 3e5, 77]
    assert scan.viewpoint_in_scan is not None


def test_e57_keeps_huge_coordinates_and_names_several_scans(tmp_path, write_e57):
    xyz = np.array([[5412345.678901, 512345.123456, 234.5], [5412346.0, 512345.0, 235.0]])
    scan = {"fields": {f"cartesian{axis}": xyz[:, k] for k, axis in enumerate("XYZ")}}
    scans = read_e57(write_e57(tmp_path / "tile.e57", [scan, scan]))
    assert [scan.name for scan in scans] == ["tile_000", "tile_001"]
    assert np.array_equal(scans[1].points_in_scan, xyz)
    assert scans[0].world_from_scan is None


def test_e57_with_an_impossible_pose_is_refused(tmp_path, write_e57):
    fields = {f"cartesian{axis}": np.ones(2) for axis in "XYZ"}
    pose = {"rotation": [("w", 0), ("x", 0), ("y", 0), ("z", 0)]}
    path = write_e57(tmp_path / "a.e57", [{"fields": fields, "pose": pose}])
    with pytest.raises(InputError, match="pose of the scan"):
        read_e57(path)


def test_the_real_terrestrial_scan(shared_data):
    (scan,) = read_e57(shared_data("formats", "e57", "pumpA.e57"))
    assert len(scan) == 155_201
    assert scan.grid is not None
    assert scan.grid.shape == (1074, 345)
    assert (scan.grid >= 0).sum() == 155_201
    assert scan.reflectance is not None
    assert scan.color is not None
    assert scan.world_from_scan is None
    assert scan.viewpoint_in_scan is not None
    # The grid is one of angles: along a column only the elevation changes.
    column = scan.grid[:, 170]
    points = scan.points_in_scan[column[column >= 0]]
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    assert np.ptp(azimuth) < np.radians(0.5)


@pytest.mark.parametrize(
    ("name", "points"),
    [
        ("bunnyDouble", 30_571),
        ("bunnyInt32", 30_571),
        ("ColouredCubeDouble", 7_680),
        ("ColouredCubeFloat", 7_680),
        ("ColourRepresentation", 153),
        ("testWithNormals", 2),
        ("translationWithoutRotation", 4),
    ],
)
def test_small_real_e57(shared_data, name, points):
    (scan,) = read_e57(shared_data("formats", "e57", f"{name}.e57"))
    assert len(scan) == points
    if name == "bunnyInt32":
        (double,) = read_e57(shared_data("formats", "e57", "bunnyDouble.e57"))
        assert np.abs(scan.points_in_scan - double.points_in_scan).max() < 1e-6
    if name == "ColourRepresentation":
        # 16-bit channels on a cube: corners are dark and bright.
        assert scan.color is not None
        assert scan.color.min() == 0
        assert scan.color.max() > 250
    if name == "translationWithoutRotation":
        assert scan.world_from_scan is not None
        assert scan.world_from_scan[:3].tolist() == [[1, 0, 0, 4], [0, 1, 0, 5], [0, 0, 1, 6]]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("bad-crc", "checksum"),
        ("InvalidCVHeader", "has no points"),
        ("ZeroPoints", "has no points"),
        ("ZeroPointsInvalid", "has no points"),
        ("empty", "holds no scans"),
        ("PinholeImageWithDistortionParameters", "holds no scans"),
    ],
)
def test_broken_real_e57(shared_data, name, message):
    path = shared_data("formats", "e57", f"{name}.e57")
    with pytest.raises(InputError) as caught:
        read_e57(path)
    assert message in str(caught.value)
    assert caught.value.fix
    assert path.exists()


# PCD


@pytest.mark.parametrize("name", ["text.pcd", "binary.pcd", "packed.pcd"])
def test_pcd_of_every_kind(tmp_path, valid_files, name):
    reading = pcd_reading(saved(tmp_path, name, valid_files[name]))
    scan = reading.range_map
    hole = name == "text.pcd"
    assert reading.dropped_nonfinite == 0
    assert scan.grid is not None
    assert scan.grid.tolist() == [[0, 1, 2], [3, -1, 4] if hole else [3, 4, 5]]
    assert scan.points_in_scan[2].tolist() == [2, 0, 1.5]
    assert scan.color is not None
    assert scan.color[1].tolist() == [0x0A, 0x14, 1]
    assert scan.reflectance is not None
    assert np.allclose(scan.reflectance[:4], [0, 0.1, 0.2, 0.3])
    assert scan.viewpoint_in_scan is not None
    assert scan.viewpoint_in_scan.tolist() == [0, 0, 9]


@pytest.mark.parametrize("options", [{"write_ascii": True}, {}, {"compressed": True}])
def test_pcd_from_another_program(tmp_path, options):
    rng = np.random.default_rng(5)
    cloud = open3d.geometry.PointCloud()
    # Repetition gives the compressor something to copy.
    cloud.points = open3d.utility.Vector3dVector(np.round(rng.random((3000, 3)) + 1, 1))
    colors = rng.integers(0, 256, (3000, 3))
    cloud.colors = open3d.utility.Vector3dVector(colors / 255)
    cloud.normals = open3d.utility.Vector3dVector(rng.random((3000, 3)))
    path = tmp_path / "a.pcd"
    open3d.io.write_point_cloud(str(path), cloud, **options)
    scan = read_pcd(path)
    assert np.abs(scan.points_in_scan - np.asarray(cloud.points)).max() < 1e-6
    assert scan.grid is None
    assert scan.color is not None
    assert np.abs(scan.color.astype(int) - colors).max() <= 1
    assert scan.viewpoint_in_scan is not None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"FIELDS x y z", b"FIELDS x y w", "no single field 'z'"),
        (b"SIZE 4 4", b"SIZE 4", "do not fit each other"),
        (b"TYPE F F F", b"TYPE F Q F", "type that does not exist"),
        (b"POINTS 6", b"POINTS 7", "contradicts"),
        (b"WIDTH 3", b"WIDTH 99999999999999", "no usable number"),
        (b"DATA binary", b"DATA zip", "Unknown kind"),
        (b"VIEWPOINT 0 0 9 1 0 0 0", b"VIEWPOINT 0 0 9", "seven numbers"),
    ],
)
def test_pcd_headers_that_cannot_be(tmp_path, valid_files, old, new, message):
    with pytest.raises(InputError, match=message):
        read_pcd(saved(tmp_path, "a.pcd", valid_files["binary.pcd"].replace(old, new)))


def test_pcd_bodies_that_do_not_fit(tmp_path, valid_files):
    with pytest.raises(InputError, match="shorter") as caught:
        read_pcd(saved(tmp_path, "a.pcd", valid_files["binary.pcd"][:-1]))
    assert "point 5" in (caught.value.where or "")
    for data in (valid_files["packed.pcd"][:-1], valid_files["packed.pcd"] + b""):
        broken = bytearray(data)
        broken[-30] = 0xFF
        with pytest.raises(InputError, match=r"damaged|does not fit"):
            read_pcd(saved(tmp_path, "a.pcd", bytes(broken[: len(data) - 2])))


# Text


@pytest.mark.parametrize(
    ("text", "points", "reflectance", "color"),
    [
        ("1 2 3\n4 5 6\n", [[1, 2, 3], [4, 5, 6]], None, None),
        ("// X Y Z\r\n1, 2;3\r\n\r\n4;5\t,6", [[1, 2, 3], [4, 5, 6]], None, None),
        ("2\n1 2 3 -9 255 0 7\n4 5 6 8 1 2 3\n", [[1, 2, 3], [4, 5, 6]], [-9, 8], [255, 0, 7]),
        ("1 2 3 0.5 1 0\n4 5 6 0 0 0\n", [[1, 2, 3], [4, 5, 6]], None, [128, 255, 0]),
        ("1 2 3 -0.6 0 0.8\n", [[1, 2, 3]], None, None),
        ("i,z,y,x\n9,3,2,1\n", [[1, 2, 3]], [9], None),
        ("#x y z nx ny nz r g b\n1 2 3 0 0 -1 10 20 30", [[1, 2, 3]], None, [10, 20, 30]),
        ("1 2 3 4 5\n", [[1, 2, 3]], None, None),
        ("1,2,3 # first\n4,5,6 // last\n", [[1, 2, 3], [4, 5, 6]], None, None),
        ("637012.2400001 849028.3100001 1\n", [[637012.2400001, 849028.3100001, 1]], None, None),
    ],
)
def test_text_columns(tmp_path, text, points, reflectance, color):
    scan = read_xyz(saved(tmp_path, "a.xyz", text))
    assert scan.points_in_scan.tolist() == points
    assert (scan.reflectance is None) == (reflectance is None)
    if reflectance is not None:
        assert scan.reflectance is not None
        assert scan.reflectance.tolist() == reflectance
    assert (scan.color is None) == (color is None)
    if color is not None:
        assert scan.color is not None
        assert scan.color[0].tolist() == color


def test_text_reports_lines_without_coordinates(tmp_path):
    reading = xyz_reading(saved(tmp_path, "a.txt", "1 2 3\nnan nan nan\n4 5 6\n"))
    assert reading.dropped_nonfinite == 1
    assert len(reading.range_map) == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2 3\n4 5\n6 7 8 9\n", "line 2"),
        ("1 2 3\n4 5 six\n", "line 2"),
        ("1 2 three\n4 5 6\n", "line 1"),
        ("3\n1 2 3\n4 5 6\n", "3 points"),
        ("name of nothing\n", "No line of points"),
        ("1,5 2,5 3,5\n", "decimal comma"),
        ("1,5;2,5;3,5\n", "decimal comma"),
        ("1 2 3\n4,5 5,5 6\n", "line 2"),
        ("\0\0\0\0", "No line of points"),
        ("# only\n# comments\n", "No line of points"),
    ],
)
def test_text_that_holds_no_points(tmp_path, text, message):
    with pytest.raises(InputError) as caught:
        read_xyz(saved(tmp_path, "a.xyz", text))
    assert message in str(caught.value)
