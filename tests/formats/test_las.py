"""LAS and LAZ files, against laspy and against damage."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest

from tests.formats.point_fixtures import (
    assert_same,
    check_damage,
    laz_in_chunks,
    laz_of,
    some_points,
)
from workbench.cloud.point_export import export_points
from workbench.errors import InputError, SettingsError
from workbench.formats import laz_decompression, laz_process
from workbench.formats.las_layout import LasLayout, las_layout
from workbench.formats.las_reading import las_batches
from workbench.formats.las_writing import write_las
from workbench.formats.point_stream import BATCH_POINTS, slices_of, surveyed
from workbench.geometry.point_set import PointSet, joined

_KINDS = [(0, "1.2"), (2, "1.2"), (3, "1.2"), (5, "1.3"), (6, "1.4"), (8, "1.4")]
UTM = (431_000.0, 5_400_000.0, 320.0)


def written(path: Path, points: PointSet, **options) -> dict:
    return write_las(path, surveyed(slices_of(points)), **options)


@pytest.mark.parametrize("compressed", [True, False])
@pytest.mark.parametrize("attributes", [True, False])
def test_points_come_back(tmp_path: Path, compressed: bool, attributes: bool) -> None:
    points = some_points(BATCH_POINTS + 5, offset=UTM, attributes=attributes)
    path = tmp_path / "cloud.laz"
    told = written(path, points, compressed=compressed, precision=1e-3)
    assert told["precision"] == 1e-3
    assert told["bytes"] == path.stat().st_size
    assert_same(joined(list(las_batches(path))), points, 0.5e-3 + 2e-9)
    theirs = laspy.read(path)
    np.testing.assert_allclose(theirs.xyz, points.points, atol=0.5e-3 + 2e-9)
    np.testing.assert_allclose(theirs.header.mins, np.min(theirs.xyz, axis=0), atol=1e-9)
    np.testing.assert_allclose(theirs.header.maxs, np.max(theirs.xyz, axis=0), atol=1e-9)
    if attributes:
        np.testing.assert_array_equal(theirs.NormalY, points.normals[:, 1])
        np.testing.assert_array_equal(theirs.radius, points.radius)
        np.testing.assert_array_equal(theirs.green, points.color[:, 1] * np.uint16(257))
    again = tmp_path / "again.laz"
    written(again, points, compressed=compressed, precision=1e-3)
    assert again.read_bytes() == path.read_bytes()


def test_millimetres_of_utm_stay_by_default(tmp_path: Path) -> None:
    points = some_points(1000, offset=UTM)
    told = written(tmp_path / "cloud.laz", points)
    assert told["rounding_error"] <= 0.5e-4
    found = joined(list(las_batches(tmp_path / "cloud.laz")))
    assert np.abs(found.points - points.points).max() <= told["rounding_error"] + 2e-9


@pytest.mark.parametrize("n", [1, 500])
def test_one_place(tmp_path: Path, n: int) -> None:
    points = PointSet(np.tile([[1.25, -7.5, 0.125]], (n, 1)))
    written(tmp_path / "cloud.laz", points)
    assert_same(joined(list(las_batches(tmp_path / "cloud.laz"))), points, 1e-6)


@pytest.mark.parametrize("suffix", ["las", "laz"])
@pytest.mark.parametrize(("kind", "version"), _KINDS)
def test_what_others_write(tmp_path: Path, kind: int, version: str, suffix: str) -> None:
    """Every layout with colours, compressed by layers or by points."""
    points = some_points(3000, offset=UTM)
    header = laspy.LasHeader(point_format=kind, version=version)
    header.scales, header.offsets = [1e-3] * 3, np.floor(UTM)
    header.add_extra_dims(
        [
            laspy.ExtraBytesParams("quality", "u2"),
            laspy.ExtraBytesParams("nx", "i2", scales=[1e-4], offsets=[0.0]),
            laspy.ExtraBytesParams("ny", "f8"),
            laspy.ExtraBytesParams("nz", "f4"),
        ]
    )
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.points.T
    las.nx, las.ny, las.nz = points.normals.T
    if kind in (2, 3, 5, 8):
        las.red, las.green, las.blue = points.color.T.astype(np.uint16) * 257
    path = tmp_path / f"cloud.{suffix}"
    las.write(path)
    found = joined(list(las_batches(path)))
    np.testing.assert_allclose(found.points, points.points, atol=0.5e-3 + 2e-9)
    np.testing.assert_allclose(found.normals, points.normals, atol=1e-4)
    if kind in (2, 3, 5, 8):
        np.testing.assert_array_equal(found.color, points.color)
    else:
        assert found.color is None


@pytest.mark.parametrize("late", [0, BATCH_POINTS])
def test_eight_bits_in_sixteen(tmp_path: Path, late: int) -> None:
    """Whether colours have 8 bits or 16 is a matter of the whole file."""
    n = late + 10
    las = laspy.LasData(laspy.LasHeader(point_format=7, version="1.4"))
    las.x = las.y = las.z = np.zeros(n)
    las.red = las.green = las.blue = np.full(n, 200, np.uint16)
    las.write(tmp_path / "dim.las")
    assert (joined(list(las_batches(tmp_path / "dim.las"))).color == 200).all()
    las.red[late] = 51_400
    las.write(tmp_path / "bright.las")
    found = joined(list(las_batches(tmp_path / "bright.las")))
    assert found.color[late].tolist() == [200, 1, 1]
    assert (np.delete(found.color, late, axis=0) == 1).all()


def test_a_precision_that_does_not_fit(tmp_path: Path) -> None:
    far = PointSet(np.array([[0.0, 0, 0], [1e6, 0, 0]]))
    with pytest.raises(SettingsError, match="too fine"):
        written(tmp_path / "cloud.laz", far, precision=1e-4)
    assert written(tmp_path / "cloud.laz", far)["precision"] == 1e-3
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize("compressed", [True, False])
def test_damage_is_told(tmp_path: Path, compressed: bool) -> None:
    path = tmp_path / "cloud.laz"
    written(path, some_points(400), compressed=compressed)
    check_damage(path, las_batches, tries=250)


def test_huge_numbers_in_a_small_file(tmp_path: Path) -> None:
    path = tmp_path / "cloud.laz"
    written(path, some_points(100))
    data = path.read_bytes()
    # Points, records, size of the first layer: each the largest there can be.
    start = int.from_bytes(data[96:100], "little")
    for at, size in ((247, 8), (100, 4), (start, 8), (start + 8 + 52 + 4, 4)):
        broken = data[:at] + b"\xff" * (size - 1) + b"\x7f" + data[at + size :]
        path.write_bytes(broken)
        with pytest.raises(InputError) as told:
            list(las_batches(path))
        assert told.value.file == str(path)


def test_chunks_of_any_size(tmp_path: Path) -> None:
    """Where the table and the layers of a chunk disagree, the decompressor would go by the layers:
    what follows it would take for sizes, of gigabytes."""
    points = some_points(40)
    export_points(points, tmp_path / "cloud.copc.laz", "copc", precision=1e-3)
    for each in (1, 7, 40):
        (tmp_path / "chunks.laz").write_bytes(laz_in_chunks(tmp_path / "cloud.copc.laz", each))
        assert_same(joined(list(las_batches(tmp_path / "chunks.laz"))), points, 0.5e-3 + 2e-9)
    for padding in (1, 500):
        padded = laz_in_chunks(tmp_path / "cloud.copc.laz", 20, padding)
        (tmp_path / "padded.laz").write_bytes(padded)
        with pytest.raises(InputError, match="do not fill it"):
            list(las_batches(tmp_path / "padded.laz"))


def with_chunks(
    path: Path, change: Callable[[LasLayout, bytes], bytes], sizes: tuple[int, ...] = ()
) -> None:
    """Change the compressed points of a LAZ file, one chunk unless its table has other sizes."""
    with open(path, "rb") as file:
        layout = las_layout(file, path)
    data, start = path.read_bytes(), layout.points_start
    end = int.from_bytes(data[start : start + 8], "little")
    packed = change(layout, data[start + 8 : end])
    chunks = [(50_000, size) for size in sizes or (len(packed),)]
    path.write_bytes(laz_of(layout, data[:start], packed, chunks))


@pytest.mark.parametrize("sizes", [(0, 0), (0, 900)])
def test_an_empty_chunk_that_is_to_hold_points(tmp_path: Path, sizes: tuple[int, int]) -> None:
    path = tmp_path / "cloud.laz"
    written(path, some_points(100))
    with_chunks(path, lambda _, packed: packed, sizes)
    with pytest.raises(InputError, match="do not fill it"):
        list(las_batches(path))


def of_others(path: Path, points: PointSet, kind: int) -> None:
    las = laspy.LasData(laspy.LasHeader(point_format=kind, version="1.4"))
    las.header.scales = [1e-3] * 3
    las.x, las.y, las.z = points.points.T
    las.gps_time = np.random.default_rng(0).uniform(size=len(points))
    las.write(path)


# A symbol of a time may say: look at the next one. The decompressor then calls itself, thousands
# of times for each byte of likely ones, until there is no stack left.
NEXT = b"\xff"


def test_layers_of_times_are_passed_by(tmp_path: Path) -> None:
    def chunk(layout: LasLayout, data: bytes) -> bytes:
        head = layout.point_bytes + 4
        sizes = np.frombuffer(data, "<u4", 9, head).copy()
        others = data[head + 36 : head + 36 + int(sizes[:8].sum())]
        sizes[8] = 100_000
        return data[:head] + sizes.tobytes() + others + NEXT * 100_000

    path, points = tmp_path / "cloud.laz", some_points(40, attributes=False)
    of_others(path, points, 6)
    with_chunks(path, chunk)
    assert_same(joined(list(las_batches(path))), points, 0.5e-3 + 2e-9)


def test_times_without_end(tmp_path: Path) -> None:
    path, points = tmp_path / "cloud.laz", some_points(40, attributes=False)
    of_others(path, points, 1)
    whole = path.read_bytes()
    damage = bytes(range(8)) + NEXT * 10_000
    for _ in range(2):
        with_chunks(path, lambda layout, data: data[: layout.point_bytes] + damage)
        with pytest.raises(InputError, match="ended its process") as told:
            list(las_batches(path))
        assert told.value.file == str(path)
        path.write_bytes(whole)
        assert_same(joined(list(las_batches(path))), points, 0.5e-3 + 2e-9)


@pytest.mark.parametrize("kind", [0, 6])
def test_wide_points_are_read_some_at_a_time(tmp_path: Path, kind: int) -> None:
    """Alike they are next to nothing in the file, and 140 MB of a batch as large as others."""
    header = laspy.LasHeader(point_format=kind, version="1.4")
    for k in range(100):
        header.add_extra_dim(laspy.ExtraBytesParams(f"of 24 bytes {k}", "3f8"))
    las = laspy.LasData(header)
    las.x = las.y = las.z = np.zeros(60_000)
    path = tmp_path / "wide.laz"
    las.write(path)
    tracemalloc.start()
    try:
        assert sum(map(len, las_batches(path))) == 60_000
        assert tracemalloc.get_traced_memory()[1] < 220e6
    finally:
        tracemalloc.stop()


def test_points_one_by_one_of_two_files_at_once(tmp_path: Path) -> None:
    """Each has a process of its own while it is read, also after one that was not read whole."""
    paths, clouds = [], [some_points(BATCH_POINTS + n, n, attributes=False) for n in (3, 8)]
    for n, points in enumerate(clouds):
        paths.append(tmp_path / f"{n}.laz")
        of_others(paths[-1], points, 3)
    assert len(next(las_batches(paths[0]))) == BATCH_POINTS
    read = [np.concatenate([b.points for b in pair]) for pair in _side_by_side(paths)]
    for found, points in zip(read, clouds, strict=True):
        np.testing.assert_allclose(found, points.points, atol=0.5e-3 + 2e-9)


def test_a_process_that_ended_by_itself_is_not_asked(tmp_path: Path) -> None:
    path, points = tmp_path / "cloud.laz", some_points(40, attributes=False)
    of_others(path, points, 3)
    assert len(joined(list(las_batches(path)))) == 40
    for process in laz_decompression._idle:
        process._process.kill()
        process._process.wait()
    assert len(joined(list(las_batches(path)))) == 40


def test_a_process_that_is_ended_when_all_is_read_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, points = tmp_path / "cloud.laz", some_points(40, attributes=False)
    of_others(path, points, 3)
    ask, ended = laz_decompression._Process.ask, []

    def ended_before_it_is_closed(self: Any, order: dict[str, Any]) -> bytes:
        if order == laz_process.CLOSE:
            self._process.kill()
            self._process.wait()
            ended.append(self)
        return ask(self, order)

    monkeypatch.setattr(laz_decompression._Process, "ask", ended_before_it_is_closed)
    assert len(joined(list(las_batches(path)))) == 40
    assert ended
    assert not set(ended) & set(laz_decompression._idle)


def _side_by_side(paths: list[Path]) -> list[tuple[PointSet, ...]]:
    """The batches of files, one of each in turn."""
    return list(zip(*zip(*map(las_batches, paths), strict=True), strict=True))


def test_a_part_of_points_of_a_wrong_size(tmp_path: Path) -> None:
    """A kind of part with a size that it never has would be decompressed as something else."""
    path = tmp_path / "cloud.laz"
    written(path, some_points(100))
    data = path.read_bytes()
    parts = data.index(b"laszip encoded") - 2 + 54 + 34
    assert data[parts : parts + 4] == b"\x0a\x00\x1e\x00"
    # The last one is compressed by points, where the others are by layers.
    wrong = ((parts, 6), (parts + 6, 12), (parts + 12, 12), (parts + 12, 99), (parts + 12, 0))
    for at, value in wrong:
        path.write_bytes(data[:at] + bytes([value]) + data[at + 1 :])
        with pytest.raises(InputError, match="unknown part"):
            list(las_batches(path))
