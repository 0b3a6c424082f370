"""Files of point cubes: all comes back, cube by cube, and damage is noticed."""

from __future__ import annotations

import struct
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from tests.pointcodecs.cubes import shell
from workbench.errors import InputError, SettingsError
from workbench.kernels.morton import morton_codes
from workbench.pointcodecs.attribute_bytes import normal_bytes, normals_of
from workbench.pointcodecs.codecs import CODECS, PointCodec
from workbench.pointcodecs.cube_file import PointCubeFile, read_point_cubes, write_point_cubes
from workbench.pointcodecs.cube_layout import HEADER, index_bytes
from workbench.pointcodecs.point_cells import CellFrame, PointCells

FRAME = CellFrame(np.array([482_000.0, 5_412_000.0, -7.25]), 0.001, 7)


def painted(cells: np.ndarray, frame: CellFrame = FRAME) -> PointCells:
    """Cells with a colour and a normal that tell them apart."""
    color = (cells * [2, 3, 5] % 256).astype(np.uint8)
    normals = (cells - cells.mean(axis=0)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return PointCells(frame, cells, normals, color)


def in_morton_order(cells: PointCells) -> PointCells:
    return cells.chosen(np.argsort(morton_codes(cells.cells)))


@pytest.fixture(scope="module")
def surface() -> PointCells:
    return painted(shell(7, thick=True))


@pytest.fixture(scope="module", params=list(CODECS))
def small_file(request, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("cubes") / f"{request.param}.pcube"
    sparse = shell(6, thick=False)[::40]
    write_point_cubes(path, painted(sparse), request.param)
    return path


@pytest.mark.parametrize("codec", list(CODECS))
def test_a_file_gives_back_cells_colors_and_normals(tmp_path, surface, codec):
    figures = write_point_cubes(tmp_path / "a.pcube", surface, codec)
    back = read_point_cubes(tmp_path / "a.pcube")

    back, given = in_morton_order(back), in_morton_order(surface)
    np.testing.assert_array_equal(back.cells, given.cells)
    np.testing.assert_array_equal(back.color, given.color)
    # Half of 4094 steps across the octahedron, on two axes, where it is stretched most, in the
    # middle of a side: (h, h, −2 h), of a vector of 1/√3.
    most = 6**0.5 * (1 / 4094) * 3**0.5
    assert np.linalg.norm(back.normals.astype(float) - given.normals, axis=1).max() < most + 1e-6
    np.testing.assert_array_equal(back.frame.origin, FRAME.origin)
    assert (back.frame.cell_size, back.frame.level) == (0.001, 7)
    points = back.point_set().points
    np.testing.assert_allclose(points - FRAME.origin, (given.cells + 0.5) * 0.001, atol=2e-9)
    assert figures["points"] == len(surface)
    assert figures["bytes"] == (tmp_path / "a.pcube").stat().st_size
    sections = ("geometry_bytes", "color_bytes", "normal_bytes", "index_bytes")
    assert figures["bytes"] == HEADER.itemsize + sum(figures[name] for name in sections)
    assert figures["bits_per_point"] == 8 * figures["geometry_bytes"] / len(surface)


@pytest.mark.parametrize("codec", list(CODECS))
def test_the_order_of_cells_does_not_change_a_byte(tmp_path, surface, codec):
    order = np.random.default_rng(1).permutation(len(surface))
    write_point_cubes(tmp_path / "a.pcube", surface, codec)
    write_point_cubes(tmp_path / "b.pcube", surface.chosen(order), codec)

    assert (tmp_path / "a.pcube").read_bytes() == (tmp_path / "b.pcube").read_bytes()


@pytest.mark.parametrize("codec", list(CODECS))
def test_a_file_need_not_have_colors_or_normals(tmp_path, codec):
    frame = CellFrame(np.zeros(3), 2.0, 21)
    # A grid of 2²¹ cells a side, and cubes in its far corners.
    cells = np.array([[0, 0, 0], [(1 << 21) - 1] * 3, [5, 1 << 20, 9]], np.int32)
    bare = write_point_cubes(tmp_path / "a.pcube", PointCells(frame, cells), codec)
    back = read_point_cubes(tmp_path / "a.pcube")

    assert {tuple(c) for c in back.cells.tolist()} == {tuple(c) for c in cells.tolist()}
    assert back.color is None
    assert back.normals is None
    assert bare["color_bytes"] == bare["normal_bytes"] == 0
    assert bare["cubes"] == 3


def test_cubes_are_read_alone_from_their_own_bytes(tmp_path, surface):
    path = tmp_path / "a.pcube"
    write_point_cubes(path, surface, "ci")
    file = PointCubeFile(path)
    low, high = FRAME.origin + 0.02, FRAME.origin + np.array([0.05, 0.03, 0.07])

    rows = file.cubes_in(low, high)
    part = in_morton_order(file.read(rows))

    expected = {(x, y, z) for x in (0, 1) for y in (0,) for z in (0, 1, 2)}
    there = {tuple(c) for c in (surface.cells >> 5).tolist()}
    assert {tuple(p) for p in (file.places[rows] >> 5).tolist()} == expected & there
    inside = [tuple(c) in expected for c in (surface.cells >> 5).tolist()]
    given = in_morton_order(surface.chosen(np.array(inside)))
    np.testing.assert_array_equal(part.cells, given.cells)
    np.testing.assert_array_equal(part.color, given.color)
    mask = np.isin(np.arange(len(file)), rows)
    np.testing.assert_array_equal(in_morton_order(file.read(mask)).cells, part.cells)
    nothing = file.read(np.zeros(len(file), bool))
    assert (len(nothing), nothing.color.shape, nothing.normals.shape) == (0, (0, 3), (0, 3))
    # All other bytes of the geometry may be anything.
    data = bytearray(path.read_bytes())
    offsets = file.layout.offsets("geometry")
    for row in np.setdiff1d(np.arange(len(file)), rows):
        data[offsets[row] : offsets[row + 1]] = bytes(offsets[row + 1] - offsets[row])
    path.write_bytes(data)
    np.testing.assert_array_equal(in_morton_order(PointCubeFile(path).read(rows)).cells, part.cells)
    with pytest.raises(InputError, match="damaged"):
        read_point_cubes(path)


def test_threads_may_read_cubes_side_by_side(tmp_path):
    corners = 256 * np.argwhere(np.ones((2, 2, 2), bool))
    copies = (shell(6, thick=False) + corners[:, None]).reshape(-1, 3).astype(np.int32)
    frame = CellFrame(np.zeros(3), 1.0, 9)
    write_point_cubes(tmp_path / "a.pcube", painted(copies, frame), "context")
    file = PointCubeFile(tmp_path / "a.pcube")

    with ThreadPoolExecutor(4) as pool:
        parts = list(pool.map(file.read, np.arange(len(file))[:, None]))

    whole = file.read()
    assert len(file) == 8
    for name in ("cells", "color", "normals"):
        joined = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_array_equal(joined, getattr(whole, name))


def test_more_points_than_fit_the_memory_are_told(small_file, monkeypatch):
    def no_room(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(PointCodec, "decoded", no_room)

    with pytest.raises(InputError, match="memory") as caught:
        read_point_cubes(small_file)
    assert caught.value.fix == "Read fewer cubes at a time."


def test_a_header_is_laid_out_as_told(small_file):
    data = small_file.read_bytes()
    file = PointCubeFile(small_file)

    head = struct.unpack("<8sI4B3dd3QII", data[:80])
    assert head[:2] == (b"WBPCUBES", 1)
    codec = CODECS[small_file.stem]
    assert head[2:6] == (codec.number, 7, min(codec.cube_level, 7), 3)
    assert head[6:10] == (*FRAME.origin, 0.001)
    assert head[10:12] == (len(file.read()), len(file))
    assert head[13] == zlib.crc32(data[head[12] :])
    assert head[14] == zlib.crc32(data[:76])


def test_damage_anywhere_is_noticed(tmp_path, small_file):
    whole = small_file.read_bytes()
    broken = tmp_path / "broken.pcube"
    rng = np.random.default_rng(7)

    for place in [*range(HEADER.itemsize), *rng.integers(HEADER.itemsize, len(whole), 150)]:
        data = bytearray(whole)
        data[place] ^= 1 << rng.integers(8)
        broken.write_bytes(data)
        with pytest.raises(InputError):
            read_point_cubes(broken)


def test_a_file_cut_short_anywhere_is_refused(tmp_path, small_file):
    whole = small_file.read_bytes()
    short = tmp_path / "short.pcube"

    for length in [*range(HEADER.itemsize + 2), *range(90, len(whole), 97), len(whole) - 1]:
        short.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"cut short|no point cubes"):
            read_point_cubes(short)


def forged(path: Path, small_file: Path, **fields: object) -> None:
    """The file with other numbers in its header or first cube, and checksums that fit."""
    data = small_file.read_bytes()
    header = np.frombuffer(data[:80], HEADER).copy()
    cubes = PointCubeFile(small_file).layout.cubes.copy()
    start = int(header["index_offset"][0])
    for name, value in fields.items():
        (header if name in HEADER.names else cubes)[name][0] = value
    index = index_bytes(cubes)
    header["index_crc"] = zlib.crc32(index)
    header["header_crc"] = zlib.crc32(header.tobytes()[:-4])
    path.write_bytes(header.tobytes() + data[80:start] + index)


@pytest.mark.parametrize(
    "fields",
    [
        {"version": 2},
        {"codec": 9},
        {"level": 0},
        {"level": 22},
        {"cube_level": 9},
        {"flags": 4},
        {"cell_size": np.nan},
        {"cell_size": 0.0},
        {"origin": np.inf},
        {"cubes": 0},
        {"cubes": 2**60},
        {"points": 2**60},
        {"index_offset": 2**63},
        {"points": 1},
        {"geometry_bytes": 2**32 - 1},
        {"color_bytes": 2**32 - 1},
        {"normal_bytes": 0},
        {"code": 2**63},
    ],
    ids=str,
)
def test_numbers_that_lie_are_refused_before_room_is_made(tmp_path, small_file, fields):
    forged(tmp_path / "forged.pcube", small_file, **fields)

    with pytest.raises(InputError):
        read_point_cubes(tmp_path / "forged.pcube")


def test_another_count_of_points_does_not_get_past_the_codec(tmp_path, small_file):
    cubes = PointCubeFile(small_file).layout.cubes
    total = int(cubes["points"].sum())
    for more in (-1, 1):
        path = tmp_path / "forged.pcube"
        forged(path, small_file)
        data = path.read_bytes()
        header = np.frombuffer(data[:80], HEADER).copy()
        changed = cubes.copy()
        changed["points"][0] = int(cubes["points"][0]) + more
        index = index_bytes(changed)
        header["points"], header["index_crc"] = total + more, zlib.crc32(index)
        header["header_crc"] = zlib.crc32(header.tobytes()[:-4])
        path.write_bytes(header.tobytes() + data[88 : int(header["index_offset"][0])] + index)
        with pytest.raises(InputError, match="damaged"):
            read_point_cubes(path)


def test_other_files_are_told_as_such(tmp_path):
    (tmp_path / "other.pcube").write_bytes(b"ply\nformat ascii 1.0\n" * 10)

    with pytest.raises(InputError, match="no point cubes"):
        read_point_cubes(tmp_path / "other.pcube")
    with pytest.raises(InputError, match="cannot be read"):
        read_point_cubes(tmp_path / "none.pcube")


@pytest.mark.parametrize(
    ("cells", "message"),
    [
        (np.zeros((0, 3), np.int32), "no cells"),
        (np.array([[0, 0, 128]], np.int32), "outside"),
        (np.array([[0, -1, 0]], np.int32), "outside"),
        (np.array([[1, 2, 3], [4, 5, 6], [1, 2, 3]], np.int32), "twice"),
    ],
    ids=["none", "beyond", "before", "twice"],
)
def test_cells_that_cannot_be_written_leave_no_file(tmp_path, cells, message):
    with pytest.raises(InputError, match=message):
        write_point_cubes(tmp_path / "a.pcube", PointCells(FRAME, cells), "ci")

    assert not list(tmp_path.iterdir())


def test_codecs_are_known_by_name(tmp_path, surface):
    with pytest.raises(SettingsError, match="no such codec") as caught:
        write_point_cubes(tmp_path / "a.pcube", surface, "zip")

    assert caught.value.expected == "ci, eci, context"


def test_packed_normals_keep_axes_exactly_and_none_as_none():
    axes = np.concatenate([np.eye(3), -np.eye(3), np.zeros((1, 3))]).astype(np.float32)
    rng = np.random.default_rng(2)
    random = rng.normal(size=(5000, 3))
    random = (random / np.linalg.norm(random, axis=1, keepdims=True)).astype(np.float32)

    np.testing.assert_array_equal(normals_of(normal_bytes(axes), 7), axes)
    back = normals_of(normal_bytes(random), 5000)
    np.testing.assert_allclose(np.linalg.norm(back, axis=1), 1, atol=1e-6)
    assert np.degrees(np.linalg.norm(back - random, axis=1).max()) < 0.0595
