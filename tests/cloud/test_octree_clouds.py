"""COPC and Potree clouds: whole, spread evenly by level, read by others."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import laspy
import numpy as np
import pytest
from scipy.spatial import cKDTree

from tests.formats.point_fixtures import assert_same, check_damage, some_points
from workbench.cloud.point_export import export_points
from workbench.cloud.point_octree import LEAF_POINTS, StreamedOctree
from workbench.errors import InputError
from workbench.formats.las_layout import las_layout
from workbench.formats.las_reading import las_batches
from workbench.formats.octree_nodes import CELLS
from workbench.formats.point_stream import PointStream, slices_of, surveyed
from workbench.geometry.point_set import PointSet, joined

UTM = (431_000.0, 5_400_000.0, 320.0)
LITTLE_MEMORY = 1 << 20


def stream_of(points: PointSet) -> PointStream:
    return surveyed(slices_of(points))


def read_potree(folder: Path) -> tuple[PointSet, list[int]]:
    """All points and the level of each, as the published layout says, node by node."""
    about = json.loads((folder / "metadata.json").read_text())
    kinds = {"int32": "<i4", "uint16": "<u2", "float": "<f4"}
    dtype = np.dtype(
        [(a["name"], kinds[a["type"]], (a["numElements"],)) for a in about["attributes"]]
    )
    assert [a["size"] for a in about["attributes"]] == [dtype[n].itemsize for n in dtype.names]
    hierarchy = (folder / "hierarchy.bin").read_bytes()
    assert len(hierarchy) == about["hierarchy"]["firstChunkSize"]
    data = (folder / "octree.bin").read_bytes()
    box = np.array([about["boundingBox"]["min"], about["boundingBox"]["max"]])
    nodes, parts, levels, at = [("r", box)], [], [], 0
    for name, (low, high) in nodes:
        kind, mask = hierarchy[at], hierarchy[at + 1]
        count = int.from_bytes(hierarchy[at + 2 : at + 6], "little")
        start = int.from_bytes(hierarchy[at + 6 : at + 14], "little")
        size = int.from_bytes(hierarchy[at + 14 : at + 22], "little")
        at += 22
        assert kind == (0 if mask else 1)
        assert size == count * dtype.itemsize
        rows = np.frombuffer(data[start : start + size], dtype)
        points = rows["position"] * np.array(about["scale"]) + about["offset"]
        assert (points >= low - 1e-9).all()
        assert (points <= high + 1e-9).all()
        parts.append((points, rows))
        levels += [len(name) - 1] * count
        half = (high - low) / 2
        for child in range(8):
            if mask >> child & 1:
                corner = low + half * [child >> 2 & 1, child >> 1 & 1, child & 1]
                nodes.append((f"{name}{child}", (corner, corner + half)))
    assert at == len(hierarchy)
    assert len(levels) == about["points"]
    points = np.concatenate([p for p, _ in parts])
    rows = np.concatenate([r for _, r in parts])
    if "rgb" not in dtype.names:
        return PointSet(points), levels
    normals = np.concatenate([rows[f"Normal{axis}"] for axis in "XYZ"], axis=1)
    color = (rows["rgb"] // 256).astype(np.uint8)
    return PointSet(points, normals, color, rows["radius"][:, 0].copy()), levels


def _places(record) -> np.ndarray:
    return np.stack([np.array(record[axis], float) for axis in "xyz"], axis=1)


def read_copc(path: Path) -> tuple[PointSet, list[int]]:
    with laspy.CopcReader.open(path) as reader:
        assert reader.header.point_count == len(reader.query())
        found, levels = [], []
        for level in range(16):
            here = reader.query(level=level)
            levels += [level] * len(here)
            colored = "red" in here.point_format.dimension_names
            found.append(
                PointSet(
                    _places(here),
                    np.stack([here.NormalX, here.NormalY, here.NormalZ], axis=1),
                    (np.stack([here.red, here.green, here.blue], axis=1) // 256).astype(np.uint8),
                    np.array(here.radius),
                )
                if colored
                else PointSet(_places(here))
            )
    return joined(found), levels


def through(kind: str, folder: Path, points: PointSet, **options) -> tuple[PointSet, list, dict]:
    path = folder / ("cloud.copc.laz" if kind == "copc" else "cloud")
    told = export_points(points, path, kind, **options)
    read = read_copc if kind == "copc" else read_potree
    return *read(path), told


@pytest.mark.parametrize("kind", ["copc", "potree"])
@pytest.mark.parametrize("attributes", [True, False])
def test_every_point_is_in_one_level(tmp_path: Path, kind: str, attributes: bool) -> None:
    points = some_points(150_000, offset=UTM, attributes=attributes)
    found, levels, told = through(kind, tmp_path, points, precision=1e-3)
    assert_same(found, points, 0.5e-3 + 2e-9)
    assert told["levels"] == max(levels) + 1 > 1


@pytest.mark.parametrize("kind", ["copc", "potree"])
def test_memory_hardly_changes_levels(tmp_path: Path, kind: str) -> None:
    """Only where several points share the finest cell there is another choice."""
    points = some_points(300_000)
    found, levels, told = through(kind, tmp_path, points)
    again, levels_again, told_again = through(kind, tmp_path, points, memory_bytes=LITTLE_MEMORY)
    assert told_again["nodes"] == told["nodes"]
    one, other = (
        np.array(lev)[np.argsort(p.radius)] for lev, p in ((levels, found), (levels_again, again))
    )
    assert (one != other).mean() < 1e-3
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]


def test_same_points_same_bytes(tmp_path: Path) -> None:
    points = some_points(120_000)
    for name in ("a", "b"):
        export_points(points, tmp_path / f"{name}.copc.laz", "copc")
        export_points(points, tmp_path / name / "cloud", "potree")
    assert (tmp_path / "a.copc.laz").read_bytes() == (tmp_path / "b.copc.laz").read_bytes()
    for name in ("metadata.json", "hierarchy.bin", "octree.bin"):
        one, other = (tmp_path / n / "cloud" / name for n in "ab")
        assert one.read_bytes() == other.read_bytes()


@pytest.mark.parametrize("kind", ["copc", "potree"])
def test_levels_are_spread_evenly(tmp_path: Path, kind: str) -> None:
    """A dense plane with a hundredfold denser corner: coarse levels do not show the corner."""
    random = np.random.default_rng(3)
    plane = np.c_[random.uniform(0, 1, (300_000, 2)), np.full(300_000, 0.5)]
    plane[:150_000, :2] *= 0.1
    points = PointSet(plane)
    found, levels, _ = through(kind, tmp_path, points)
    levels = np.array(levels)
    for level in (0, 1):
        cell = 1 / (CELLS * 2**level)
        coarse = found.points[levels <= level]
        inside = (coarse[:, :2] < 0.1).all(axis=1).mean()
        assert inside == pytest.approx(0.01, rel=0.3)
        # One point to a cell: nowhere is a point farther than the diagonal of a cell ...
        far, _ = cKDTree(coarse).query(plane)
        assert far.max() < np.sqrt(2) * cell + 1e-6
        # ... and no two crowd: of points thrown at random one in 12 would have another
        # within 0.3 cells.
        nearest, _ = cKDTree(coarse).query(coarse, k=2)
        crowded = 1 - np.exp(-np.pi * 0.3**2)
        assert (nearest[:, 1] < 0.3 * cell).mean() < 0.2 * crowded


def check_nodes(points: PointSet, folder: Path, **options) -> dict[tuple[int, ...], int]:
    """Build a tree and compare each level with cells counted by NumPy; returns its counts."""
    tree = StreamedOctree(stream_of(points), folder, **options)
    nodes: dict[tuple[int, ...], np.ndarray] = {}
    for node in tree.nodes():
        key = (node.key.level, node.key.x, node.key.y, node.key.z)
        assert key not in nodes
        np.testing.assert_array_equal(node.points.points, tree.rounding.coordinates(node.whole))
        nodes[key] = node.whole.astype(np.int64) - tree.cube.low
    everything = tree.rounding.whole(points.points).astype(np.int64) - tree.cube.low
    side = tree.cube.side
    parents = {(level - 1, x // 2, y // 2, z // 2) for level, x, y, z in nodes if level}
    assert parents <= nodes.keys()
    for key, whole in nodes.items():
        assert ((whole << key[0]) // side == key[1:]).all()
    for level, *place in sorted(parents):
        held = np.concatenate([whole for key, whole in nodes.items() if key[0] <= level])
        (there, once), (expected, _) = (
            np.unique(
                (w[((w << level) // side == place).all(axis=1)] * (CELLS << level)) // side,
                axis=0,
                return_counts=True,
            )
            for w in (held, everything)
        )
        np.testing.assert_array_equal(there, expected)
        assert (once == 1).all()
    assert not list(folder.iterdir())
    return {key: len(whole) for key, whole in nodes.items()}


@pytest.mark.parametrize("memory_bytes", [1 << 30, 1 << 20])
def test_every_cell_of_a_node_has_one_point(tmp_path: Path, memory_bytes: int) -> None:
    points = some_points(120_000, attributes=False)
    counts = check_nodes(points, tmp_path, leaf_points=1_000, memory_bytes=memory_bytes)
    assert max(key[0] for key in counts) >= 3
    assert sum(counts.values()) == len(points)


@pytest.mark.parametrize("memory_bytes", [1 << 30, 1 << 20])
def test_two_far_clusters_pass_through_empty_nodes(tmp_path: Path, memory_bytes: int) -> None:
    random = np.random.default_rng(0)
    clusters = [random.normal(c, 1e-3, (20_000, 3)) for c in (0, 1000)]
    points = PointSet(np.concatenate(clusters))
    counts = check_nodes(points, tmp_path, leaf_points=1_000, memory_bytes=memory_bytes,
                         precision=1e-6)  # fmt: skip
    assert 0 in counts.values()
    assert sum(counts.values()) == 40_000


def both_clusters() -> PointSet:
    random = np.random.default_rng(0)
    return PointSet(np.concatenate([random.normal(c, 1e-3, (60_000, 3)) for c in (0, 1000)]))


@pytest.mark.parametrize("kind", ["copc", "potree"])
@pytest.mark.parametrize(
    "points",
    [
        PointSet(np.array([[1.5, -2.25, 3.0]])),
        PointSet(np.tile([[1.5, -2.25, 3.0]], (LEAF_POINTS + 10, 1))),
        both_clusters(),
    ],
    ids=["one", "coincident", "clusters"],
)
def test_odd_clouds(tmp_path: Path, kind: str, points: PointSet) -> None:
    found, _, told = through(kind, tmp_path, points)
    assert_same(found, points, told["rounding_error"] + 1e-9)


def test_coincident_points_beyond_memory(tmp_path: Path) -> None:
    place = PointSet(np.tile([[0.5, 0.5, 0.5]], (2 * LEAF_POINTS, 1)))
    with_far = joined([place, PointSet(np.array([[0.0, 0, 0], [1.0, 1, 1]]))])
    found, _, _ = through("copc", tmp_path, with_far, memory_bytes=LITTLE_MEMORY)
    assert len(found) == len(with_far)


def test_a_region_is_found(tmp_path: Path) -> None:
    points = some_points(150_000)
    path = tmp_path / "cloud.copc.laz"
    export_points(points, path, "copc", precision=1e-6)
    low, high = np.array([-1, -1, -9.0]), np.array([0, 0.5, 9.0])
    with laspy.CopcReader.open(path) as reader:
        found = reader.query(bounds=laspy.copc.Bounds(low, high))
        coarse = reader.query(resolution=4 / CELLS * 1.01)
    inside = ((points.points >= low) & (points.points <= high)).all(axis=1).sum()
    assert abs(len(found) - inside) <= 3
    assert 0 < len(coarse) < len(points) / 4


def test_other_files_are_left_alone(tmp_path: Path) -> None:
    points = some_points(10)
    export_points(points, tmp_path / "cloud", "potree")
    export_points(points, tmp_path / "cloud", "potree")
    (tmp_path / "cloud" / "notes.txt").write_text("mine")
    (tmp_path / "file").write_text("mine")
    for name in ("cloud", "file"):
        with pytest.raises(InputError) as told:
            export_points(points, tmp_path / name, "potree")
        assert told.value.file == str(tmp_path / name)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cloud", "file"]


def test_damaged_copc_is_told(tmp_path: Path) -> None:
    path = tmp_path / "cloud.copc.laz"
    export_points(some_points(400), path, "copc")
    assert len(joined(list(las_batches(path)))) == 400
    check_damage(path, las_batches, tries=250)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["laz", "copc", "potree", "ply", "e57", "layered"])
def test_memory_of_twenty_million_points(tmp_path: Path, kind: str) -> None:
    """Points of 780 MB take little more than the 256 MiB that they may, and all are written."""
    code = """
import sys
from pathlib import Path
from workbench.formats.ply_points import write_ply_points
from tests.benchmarks.bench_point_files import one, sheet

folder, kind = Path(sys.argv[1]), sys.argv[2]
one_batch = folder / "little.ply"
write_ply_points(one_batch, sheet(100_000))
one(one_batch, folder / "warm", kind)
source = folder / "sheet.ply"
write_ply_points(source, sheet(20_000_000))
told = one(source, folder / "out", kind)
assert told["items"] == 20_000_000
print(told["memory"])
"""
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path), kind], capture_output=True, text=True
    )
    assert not done.returncode, done.stderr
    assert int(done.stdout.split()[-1]) < 420e6
    if kind in ("laz", "copc"):
        with open(tmp_path / "out", "rb") as file:
            assert las_layout(file, tmp_path / "out").count == 20_000_000
