"""Readers of scans, points, poses and surfaces."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np

from tests.formats.conftest import (
    PLY_TEXT,
    PTX_SCAN,
    pcd_binary,
    pcd_compressed,
    pcd_text,
    ply_binary,
)
from tests.formats.point_fixtures import laz_in_chunks, some_points
from tests.fuzz.checksums import repaired_e57
from tests.fuzz.target import MIB, Reader, Seeds, Target, of_files
from workbench.cloud.point_export import export_points
from workbench.formats.e57 import read_e57
from workbench.formats.glb_container import read_glb_description
from workbench.formats.pcd import read_pcd
from workbench.formats.ply import read_ply
from workbench.formats.point_files import point_batches, read_points
from workbench.formats.poses import read_aln, read_conf, read_scan_poses_json
from workbench.formats.potree import HIERARCHY, METADATA, OCTREE
from workbench.formats.potree_reading import PotreeCloud
from workbench.formats.ptx import read_ptx
from workbench.formats.range_ply import read_range_ply, write_range_ply
from workbench.formats.scans import find_scans, read_scans
from workbench.formats.surface_files import (
    read_surface,
    write_surface_glb,
    write_surface_obj,
    write_surface_ply,
)
from workbench.formats.textured_gltf import write_textured_glb
from workbench.formats.textured_obj import write_textured_obj
from workbench.formats.textured_surface import read_textured_surface
from workbench.formats.xyz import read_xyz
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.rangemap import RangeMap
from workbench.geometry.textured_mesh import TexturedMesh

_CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.5]])
_FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], np.int32)


def _tetrahedron() -> TriangleMesh:
    normal = _CORNERS - _CORNERS.mean(axis=0)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return TriangleMesh(_CORNERS, _FACES).with_attributes(
        color=np.arange(12, dtype=np.uint8).reshape(4, 3) * 20,
        normal=normal,
        provenance=np.array([0, 1, 0, 1], np.uint8),
    )


def textured_tetrahedron() -> TexturedMesh:
    """A mesh with two pictures on it."""
    corners = _FACES.ravel()
    mesh = TriangleMesh(_CORNERS[corners], np.arange(12, dtype=np.int32).reshape(4, 3))
    places = np.random.default_rng(1).uniform(0.1, 0.9, (12, 2))
    picture = np.random.default_rng(2).integers(0, 256, (6, 8, 3), dtype=np.uint8)
    return TexturedMesh(mesh, places, np.array([0, 0, 1, 1], np.int32), (picture, 255 - picture))


def _range_map() -> RangeMap:
    rows, columns = np.mgrid[0:3, 0:4]
    points = np.stack([columns, rows, 2 + 0.1 * rows], axis=-1).reshape(-1, 3).astype(float)
    grid = np.arange(12, dtype=np.int32).reshape(3, 4)
    grid[1, 1], grid[grid > 5] = -1, grid[grid > 5] - 1
    kept = np.delete(points, 5, axis=0)
    return RangeMap(
        "scan",
        kept,
        grid,
        np.zeros(3),
        np.linspace(0, 1, 11, dtype=np.float32),
        np.arange(33, dtype=np.uint8).reshape(11, 3),
        np.eye(4),
    )


def _ply_seeds(folder: Path) -> list[tuple[bytes, ...]]:
    write_surface_ply(folder / "surface.ply", _tetrahedron())
    write_range_ply(folder / "scan.ply", _range_map())
    export_points(some_points(12), folder / "points.ply", "ply")
    made = [of_files(folder, name) for name in ("surface.ply", "scan.ply", "points.ply")]
    return [(PLY_TEXT,), (ply_binary("<"),), (ply_binary(">"),), *made]


def _e57_seeds(folder: Path) -> list[tuple[bytes, ...]]:
    from tests.formats.conftest import write_e57

    rng = np.random.default_rng(7)
    fields = {name: rng.random(8) + 1 for name in ("cartesianX", "cartesianY", "cartesianZ")}
    fields |= {
        "intensity": rng.random(8),
        "rowIndex": np.arange(8) // 4,
        "columnIndex": np.arange(8) % 4,
        "cartesianInvalidState": np.zeros(8, int),
    }
    fields |= {f"color{name}": rng.integers(0, 256, 8) for name in ("Red", "Green", "Blue")}
    spherical = {f"spherical{name}": rng.random(5) for name in ("Range", "Azimuth", "Elevation")}
    pose = {
        "rotation": [("w", 1), ("x", 0), ("y", 0), ("z", 0)],
        "translation": [("x", 1), ("y", 2), ("z", 3)],
    }
    write = write_e57.__wrapped__()
    write(folder / "scan.e57", [{"fields": fields, "pose": pose}])
    write(folder / "two.e57", [{"fields": spherical, "pose": pose}, {"fields": fields}])
    export_points(some_points(9), folder / "points.e57", "e57")
    return [of_files(folder, name) for name in ("scan.e57", "two.e57", "points.e57")]


def _las_seeds(file_format: str, suffix: str) -> Seeds:
    def made(folder: Path) -> list[tuple[bytes, ...]]:
        out = []
        for k, attributes in enumerate((True, False)):
            path = folder / f"{k}{suffix}"
            export_points(some_points(40, attributes=attributes), path, file_format)
            out.append((path.read_bytes(),))
        if file_format == "copc":  # its chunks may be of any size
            out.append((laz_in_chunks(path, 9),))
        if file_format == "laz":  # compressed by points, not by layers
            out.append((_older_laz(),))
        return out

    return made


def _older_laz() -> bytes:
    import laspy

    points = some_points(30)
    las = laspy.LasData(laspy.LasHeader(point_format=3, version="1.2"))
    las.x, las.y, las.z = points.points.T
    las.red, las.green, las.blue = 257 * points.color.T.astype(np.uint16)
    file = io.BytesIO()
    las.write(file, do_compress=True)
    return file.getvalue()


def _surface_seeds(suffix: str) -> Seeds:
    def made(folder: Path) -> list[tuple[bytes, ...]]:
        if suffix == ".glb":
            write_surface_glb(folder / "a.glb", _tetrahedron())
            write_textured_glb(folder / "b.glb", textured_tetrahedron())
            return [of_files(folder, "a.glb"), of_files(folder, "b.glb")]
        write_surface_obj(folder / "a.obj", _tetrahedron())
        other = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1\nl 1 2\ng a\n"
        return [of_files(folder, "a.obj"), (other,)]

    return made


def _textured_obj_seeds(folder: Path) -> list[tuple[bytes, ...]]:
    write_textured_obj(folder / "input.obj", textured_tetrahedron())
    return [of_files(folder, "input.obj", "input.mtl", "input_0.png", "input_1.png")]


def _gltf_seeds(folder: Path) -> list[tuple[bytes, ...]]:
    import trimesh

    trimesh.Trimesh(_CORNERS, _FACES).export(folder / "a.gltf")
    document = json.loads((folder / "a.gltf").read_text())
    parts = [(folder / buffer["uri"]).read_bytes() for buffer in document["buffers"]]
    starts = [sum(map(len, parts[:k])) for k in range(len(parts))]
    for view in document["bufferViews"]:
        view["byteOffset"] = view.get("byteOffset", 0) + starts[view["buffer"]]
        view["buffer"] = 0
    whole = b"".join(parts)
    document["buffers"] = [{"uri": "input.bin", "byteLength": len(whole)}]
    return [(json.dumps(document).encode(), whole)]


def _stl_seeds(folder: Path) -> list[tuple[bytes, ...]]:
    import trimesh

    solid = trimesh.Trimesh(_CORNERS, _FACES)
    return [(solid.export(file_type="stl"),), (solid.export(file_type="stl_ascii").encode(),)]


def _at(name: str, *readers: Reader) -> tuple[Reader, ...]:
    """The readers, of a file in the folder."""
    return tuple(lambda folder, read=reader: read(folder / name) for reader in readers)


def _drained(path: Path) -> int:
    return sum(len(batch) for batch in point_batches(path))


def _listed(path: Path) -> object:
    listing = find_scans([path.parent])
    return [read_scans(file, {}, name) for file, name in zip(listing.files, listing.names)]  # noqa: B905


def _potree_seeds(folder: Path) -> list[tuple[bytes, ...]]:
    for name, attributes in (("a", True), ("b", False)):
        export_points(some_points(30, attributes=attributes), folder / name, "potree")
    return [of_files(folder / name, *_POTREE) for name in ("a", "b")]


def _potree_whole(folder: Path) -> int:
    cloud = PotreeCloud(folder)
    return sum(len(batch) for batch in cloud.batches())


_POTREE = (METADATA, HIERARCHY, OCTREE)
_POSES = json.dumps(
    {"origin": [1, 2, 3], "scans": {"a": {"world_from_scan": np.eye(4).tolist()}}}
).encode()
_ALN = b"2\na.ply\n#\n1 0 0 5\n0 1 0 6\n0 0 1 7\n0 0 0 1\nb.ply\n#\n" + b"1 0 0 0\n0 1 0 0\n"
_ALN += b"0 0 1 0\n0 0 0 1\n0\n"
_CONF = b"camera 0 0 0 0 0 0 1\nbmesh a.ply 1 2 3 0 0 0.6 0.8\nbmesh b c.ply 0 0 0 0 0 0 1\n"
_XYZ = (
    (b"# x y z i\n1 2; 3 0.5\n4 5 6 0.25\n7 8;9 1e-2\n",),
    (b"2\n1 2 3 -100 1 2 3\n4 5 6 -200 4 5 6\n",),
    (b"x,y,z,red,green,blue\n1,2,3,1,2,3\n4.5,5,6,4,5,6\n",),
)

SCAN_TARGETS = (
    Target(
        "ply",
        ("input.ply",),
        _ply_seeds,
        _at("input.ply", read_ply, read_range_ply, read_surface, read_points, _listed),
    ),
    Target(
        "ptx",
        ("input.ptx",),
        lambda _: [(PTX_SCAN,), (PTX_SCAN + PTX_SCAN,)],
        _at("input.ptx", read_ptx, read_points),
    ),
    Target(
        "pcd",
        ("input.pcd",),
        lambda _: [(pcd_text(),), (pcd_binary(),), (pcd_compressed(),)],
        _at("input.pcd", read_pcd, read_points),
        # The longest copy of its compression makes 264 bytes of three.
        memory_multiple=88 * 8,
    ),
    Target("xyz", ("input.xyz",), lambda _: list(_XYZ), _at("input.xyz", read_xyz, _listed)),
    Target(
        "e57", ("input.e57",), _e57_seeds, _at("input.e57", read_e57, read_points), repaired_e57
    ),
    Target("las", ("input.las",), _las_seeds("las", ".las"), _at("input.las", _drained)),
    Target(
        "laz",
        ("input.laz",),
        _las_seeds("laz", ".laz"),
        _at("input.laz", _drained),
        memory_bytes=64 * MIB,
    ),
    Target(
        "copc",
        ("input.copc.laz",),
        _las_seeds("copc", ".copc.laz"),
        _at("input.copc.laz", _drained),
        memory_bytes=64 * MIB,
    ),
    # Eight children are told in one bit each.
    Target("potree", _POTREE, _potree_seeds, (_potree_whole,), memory_multiple=1024),
    Target("poses-conf", ("input.conf",), lambda _: [(_CONF,)], _at("input.conf", read_conf)),
    Target("poses-aln", ("input.aln",), lambda _: [(_ALN,)], _at("input.aln", read_aln)),
    Target(
        "poses-json",
        ("scan_poses.json",),
        lambda _: [(_POSES,)],
        _at("scan_poses.json", read_scan_poses_json),
    ),
    Target(
        "obj",
        ("input.obj",),
        _surface_seeds(".obj"),
        _at("input.obj", read_surface, read_textured_surface),
    ),
    Target(
        "textured-obj",
        ("input.obj", "input.mtl", "input_0.png", "input_1.png"),
        _textured_obj_seeds,
        _at("input.obj", read_textured_surface),
        memory_multiple=4096,
    ),
    Target(
        "glb",
        ("input.glb",),
        _surface_seeds(".glb"),
        _at("input.glb", read_surface, read_textured_surface, read_glb_description),
        memory_multiple=4096,
    ),
    Target(
        "gltf",
        ("input.gltf", "input.bin"),
        _gltf_seeds,
        _at("input.gltf", read_textured_surface),
    ),
    Target(
        "stl",
        ("input.stl",),
        _stl_seeds,
        _at("input.stl", read_surface),
    ),
)
