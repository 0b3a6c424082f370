"""Readers of voxels, graphs, surfels, cubes of points and layered clouds."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.formats.point_fixtures import some_points
from tests.fuzz.checksums import repaired_cubes, repaired_graph, repaired_indexed
from tests.fuzz.target import MIB, Target, of_files
from tests.pointcodecs.test_cube_file import painted
from tests.surfels.test_surfel_file import written
from tests.voxels.test_dag_file import voxel_graph
from tests.voxels.test_lod_file import two_colored_plate
from workbench.cloud.layered_cloud import LayeredCloud
from workbench.cloud.point_export import export_points
from workbench.pointcodecs import cube_layout
from workbench.pointcodecs.codecs import CODECS
from workbench.pointcodecs.cube_file import read_point_cubes, write_point_cubes
from workbench.surfels import surfel_layout
from workbench.surfels.surfel_export import export_surfels
from workbench.surfels.surfel_file import SurfelFile, surfel_points
from workbench.surfels.surfel_options import SurfelOptions
from workbench.voxels import lod_layout
from workbench.voxels.dag_decoding import DagWalk
from workbench.voxels.dag_encoding import ENCODINGS
from workbench.voxels.dag_file import read_voxel_graph, write_voxel_graph
from workbench.voxels.dag_reading import dag_of
from workbench.voxels.lod_export import LodOptions, write_voxel_lod
from workbench.voxels.lod_file import LodFile
from workbench.voxels.voxel_points import voxel_points

_VOXEL_PARTS = (
    ("offset", "stored", "crc"),
    ("geometry_offset", "geometry_stored", "geometry_crc"),
)


def _lod_seeds(folder: Path) -> list[tuple[bytes, ...]]:
    for name, compressed in (("a", True), ("b", False)):
        options = LodOptions(resolution=16, chunk_level=3, compressed=compressed, workers=1)
        write_voxel_lod(two_colored_plate(), folder / name, options)
    return [of_files(folder, "a"), of_files(folder, "b")]


def _lod_whole(folder: Path) -> object:
    file = LodFile(folder / "input.vlod")
    return [(file.chunk(k), file.geometry(k)) for k in range(min(len(file.nodes), 100))]


def _graph_seeds(folder: Path) -> list[tuple[bytes, ...]]:
    seeds = []
    for encoding, colors in zip(ENCODINGS, (None, 2, 10, 256, None, 10), strict=True):
        write_voxel_graph(folder / encoding, voxel_graph(encoding, colors))
        seeds.append(of_files(folder, encoding))
    return seeds


def _graph_whole(folder: Path) -> object:
    graph = read_voxel_graph(folder / "input.voxgraph")
    walk = DagWalk(dag_of(graph.graph))
    # More voxels than this are a small file by design; who asks for all of them makes room.
    return walk.codes() if walk.voxel_count < 100_000 else walk.voxel_count


def _surfel_seeds(folder: Path) -> list[tuple[bytes, ...]]:
    written(folder / "one", count=80)
    written(folder / "exact", count=40, colored=False, exact=True)
    options = SurfelOptions(
        count=30, candidates_resolution=24, views=8, split_above=1000, memory_mib=64, workers=1
    )
    export_surfels(some_points(1500), folder / "tree", options)
    return [of_files(folder, name) for name in ("one", "exact", "tree")]


def _surfels_whole(folder: Path) -> object:
    file = SurfelFile(folder / "input.surfels")
    return [
        (file.node(k).prefix(5), file.bounds(k), file.spacing(k), file.children(k))
        for k in range(len(file.nodes))
    ]


def _cube_seeds(folder: Path) -> list[tuple[bytes, ...]]:
    cells = np.unique(np.random.default_rng(3).integers(0, 128, (60, 3)), axis=0).astype(np.int32)
    cells[:30] //= 4
    cells = np.unique(cells, axis=0)
    for codec in CODECS:
        write_point_cubes(folder / codec, painted(cells), codec)
    return [of_files(folder, codec) for codec in CODECS]


def _cloud_seeds(folder: Path) -> list[tuple[bytes, ...]]:
    export_points(some_points(60), folder / "a.cloud", "layered")
    return [of_files(folder, "a.cloud")]


def _cloud_whole(folder: Path) -> object:
    with LayeredCloud(folder / "input.cloud", read_ahead=False) as cloud:
        return [cloud.read(int(chunk)) for chunk in cloud.chunks()]


LOD_TARGETS = (
    Target(
        "voxel-lod",
        ("input.vlod",),
        _lod_seeds,
        (_lod_whole, lambda folder: voxel_points(folder / "input.vlod")),
        repaired_indexed(lod_layout.HEADER, lod_layout.NODE, _VOXEL_PARTS),
    ),
    Target(
        "voxel-graph",
        ("input.voxgraph",),
        _graph_seeds,
        (_graph_whole, lambda folder: voxel_points(folder / "input.voxgraph").centers),
        repaired_graph,
    ),
    Target(
        "surfels",
        ("input.surfels",),
        _surfel_seeds,
        (_surfels_whole, lambda folder: surfel_points(folder / "input.surfels")),
        repaired_indexed(surfel_layout.HEADER, surfel_layout.NODE, (("offset", "bytes", "crc"),)),
    ),
    Target(
        "point-cubes",
        ("input.pcube",),
        _cube_seeds,
        (lambda folder: read_point_cubes(folder / "input.pcube").point_set(),),
        repaired_cubes(cube_layout.HEADER, cube_layout.CUBE),
        # A bit of the surest context says nearly nothing: 2¹⁴ points may fit a byte.
        memory_multiple=float(1 << 20),
        memory_bytes=64 * MIB,
    ),
    Target("layered-cloud", ("input.cloud",), _cloud_seeds, (_cloud_whole,)),
)
