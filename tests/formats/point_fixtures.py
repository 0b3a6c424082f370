"""Points for tests of point files, and files with damage."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path

import lazrs
import numpy as np
from scipy.spatial import cKDTree

from workbench.errors import InputError
from workbench.formats.las_layout import LasLayout, las_layout
from workbench.geometry.point_set import PointSet, joined


def some_points(n: int, seed: int = 0, offset=(0.0, 0.0, 0.0), attributes: bool = True) -> PointSet:
    """Points on a wavy sheet of some metres, with everything a point can have."""
    random = np.random.default_rng(seed)
    points = random.uniform(-2, 2, (n, 3))
    points[:, 2] = 0.3 * np.sin(3 * points[:, 0]) + 0.001 * points[:, 2]
    if not attributes:
        return PointSet(points + offset)
    normals = random.normal(size=(n, 3)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    color = random.integers(0, 256, (n, 3), dtype=np.uint8)
    radius = random.permutation(n) / 1024
    return PointSet(points + offset, normals, color, radius.astype(np.float32))


def laz_in_chunks(path: Path, points: int, padding: int = 0) -> bytes:
    """A COPC file with so many points in a chunk, and bytes of no meaning behind the first."""
    with open(path, "rb") as file:
        layout = las_layout(file, path)
        file.seek(0)
        head = file.read(layout.points_start)
        data = bytearray(layout.count * layout.point_bytes)
        lazrs.LasZipDecompressor(file, layout.laszip).decompress_many(data)
    vlr, whole, step = lazrs.LazVlr(layout.laszip), BytesIO(), points * layout.point_bytes
    whole.write(head)
    zipper = lazrs.LasZipCompressor(whole, vlr)
    for at in range(0, len(data), step):
        zipper.compress_many(data[at : at + step])
        zipper.finish_current_chunk()
    zipper.done()
    whole.seek(len(head))
    chunks = lazrs.read_chunk_table(whole, vlr)
    start, first = len(head) + 8, chunks[0][1]
    packed = whole.getvalue()[start : start + sum(size for _, size in chunks)]
    chunks[0] = points, first + padding
    return laz_of(layout, head, packed[:first] + b"\xee" * padding + packed[first:], chunks)


def laz_of(layout: LasLayout, head: bytes, packed: bytes, chunks: list[tuple[int, int]]) -> bytes:
    """A LAZ file of what stands before its points, these, and a table of points and bytes."""
    out = BytesIO()
    out.write(head + struct.pack("<q", len(head) + 8 + len(packed)) + packed)
    lazrs.write_chunk_table(out, chunks, lazrs.LazVlr(layout.laszip))
    return out.getvalue()


def assert_same(found: PointSet, expected: PointSet, tolerance: float) -> None:
    """The same points in whatever order; attributes to the bit.

    Points are paired by their radius, different for each of ``some_points``; where they have
    none, each must have one of the others beside it.
    """
    assert len(found) == len(expected)
    assert found.arrays().keys() == expected.arrays().keys()
    if expected.radius is None:
        for one, other in ((found, expected), (expected, found)):
            tree = cKDTree(np.unique(one.points, axis=0))
            far, _ = tree.query(np.unique(other.points, axis=0), p=np.inf)
            assert far.max() <= tolerance
        return
    a, b = np.argsort(found.radius), np.argsort(expected.radius)
    for name, values in expected.arrays().items():
        if name == "points":
            assert np.abs(found.points[a] - values[b]).max() <= tolerance
        else:
            np.testing.assert_array_equal(found.arrays()[name][a], values[b])


def check_damage(
    path: Path,
    read: Callable[[Path], Iterator[PointSet]],
    *,
    tries: int,
    seed: int = 5,
    lengths: int = 40,
) -> int:
    """Cut a file short and flip its bits; returns how often that went unnoticed.

    Reading must end in an InputError that names the file, or in points.
    """
    data = path.read_bytes()
    random = np.random.default_rng(seed)
    damaged = path.with_name("damaged-" + path.name)
    cases = [data[: int(n)] for n in np.linspace(0, len(data) - 1, lengths)]
    for k in range(tries):
        broken = bytearray(data)
        # Half of the flips hit the head, where sizes and counts are.
        end = min(len(data), 1200) if k % 2 else len(data)
        for at in random.integers(0, end, random.integers(1, 4)):
            broken[at] ^= 1 << int(random.integers(8))
        cases.append(bytes(broken))
    unnoticed = 0
    for case in cases:
        damaged.write_bytes(case)
        refusal = _refusal(read, damaged)
        unnoticed += refusal is None
        if isinstance(refusal, InputError):
            assert refusal.file == str(damaged)
            assert refusal.fix
        elif refusal is not None:
            assert "no points" in str(refusal)
    return unnoticed


def _refusal(read: Callable[[Path], Iterator[PointSet]], path: Path) -> Exception | None:
    try:
        joined([*read(path)])
    except (InputError, ValueError) as error:
        return error
    return None
