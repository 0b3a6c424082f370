"""Small valid files of every format, made without the code under test."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pye57 import libe57

E57Writer = Callable[..., Path]


@pytest.fixture(scope="session")
def write_e57() -> E57Writer:
    """Write scans with libE57 itself: ``write_e57(path, [{"fields": {...}, "pose": ...}])``."""

    def write(path: Path, scans: Sequence[Mapping[str, Any]]) -> Path:
        image = libe57.ImageFile(str(path), "w")
        image.extensionsAdd("", libe57.E57_V1_0_URI)
        root = image.root()
        root.set("formatName", libe57.StringNode(image, "ASTM E57 3D Imaging Data File"))
        root.set("guid", libe57.StringNode(image, "{0}"))
        root.set("versionMajor", libe57.IntegerNode(image, 1))
        root.set("versionMinor", libe57.IntegerNode(image, 0))
        data3d = libe57.VectorNode(image, True)
        root.set("data3D", data3d)
        root.set("images2D", libe57.VectorNode(image, True))
        for scan in scans:
            node = libe57.StructureNode(image)
            node.set("guid", libe57.StringNode(image, "{1}"))
            if "pose" in scan:
                pose = libe57.StructureNode(image)
                node.set("pose", pose)
                for part, values in scan["pose"].items():
                    inner = libe57.StructureNode(image)
                    for key, value in values:
                        inner.set(key, libe57.FloatNode(image, float(value)))
                    pose.set(part, inner)
            prototype = libe57.StructureNode(image)
            buffers = libe57.VectorSourceDestBuffer()
            arrays = {}
            for name, values in scan["fields"].items():
                array = np.ascontiguousarray(values)
                if array.dtype.kind == "f":
                    field = libe57.FloatNode(image, 0.0, libe57.E57_DOUBLE, -1e300, 1e300)
                else:
                    top = int(scan.get("largest", {}).get(name, max(1, array.max(initial=1))))
                    field = libe57.IntegerNode(image, 0, 0, top)
                prototype.set(name, field)
                arrays[name] = array.astype(np.float64)
                buffers.append(
                    libe57.SourceDestBuffer(
                        image, name, arrays[name], len(array), True, array.dtype.kind == "f"
                    )
                )
            points = libe57.CompressedVectorNode(image, prototype, libe57.VectorNode(image, True))
            node.set("points", points)
            data3d.append(node)
            writer = points.writer(buffers)
            writer.write(len(array))
            writer.close()
        image.close()
        return path

    return write


PLY_TEXT = b"""ply
format ascii 1.0
comment made by hand
obj_info num_cols 3
obj_info num_rows 2
element vertex 4
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
property float intensity
element range_grid 6
property list uchar int vertex_indices
end_header
0 0 1 10 20 30 0.5
1 0 1 11 21 31 0.25
2 1 1 12 22 32 1e-3
0 1 1 13 23 33 -4
1 0
1 1
0
1 3
0
1 2
"""


def ply_binary(order: str) -> bytes:
    name = {"<": "little", ">": "big"}[order]
    header = (
        f"ply\nformat binary_{name}_endian 1.0\nelement vertex 3\nproperty double x\n"
        "property float y\nproperty short z\nelement face 3\nproperty list uchar int "
        "vertex_indices\nproperty uchar flag\nend_header\n"
    ).encode()
    rows = [
        struct.pack(order + "dfh", x, y, z) for x, y, z in [(0.1, 0.5, -1), (1, 0, 2), (0, 1, 3)]
    ]
    faces = [[0, 1, 2], [2, 1, 0, 1], [1, 2, 0]]
    body = [struct.pack(f"{order}B{len(f)}iB", len(f), *f, 7 + k) for k, f in enumerate(faces)]
    return header + b"".join(rows) + b"".join(body)


PTX_SCAN = b"""2
3
10 20 30
0 1 0
-1 0 0
0 0 1
0 1 0 0
-1 0 0 0
0 0 1 0
10 20 30 1
1 0 5 0.1 255 0 0
1 1 5 0.2 0 255 0
0 0 0 0 0 0 0
2 0 5 0.4 0 0 255
2 1 5 0.5 1 2 3
2 2 5 0.6 4 5 6
"""

PCD_HEADER = """# .PCD v0.7
VERSION 0.7
FIELDS x y z rgb intensity
SIZE 4 4 4 4 4
TYPE F F F U F
COUNT 1 1 1 1 1
WIDTH 3
HEIGHT 2
VIEWPOINT 0 0 9 1 0 0 0
POINTS 6
DATA {}
"""
PCD_ROWS = [(k % 3, k // 3, 1.5, 0x0A1400 + k, 0.1 * k) for k in range(6)]


def pcd_text() -> bytes:
    rows = ["nan nan nan 0 0" if k == 4 else " ".join(map(str, r)) for k, r in enumerate(PCD_ROWS)]
    return (PCD_HEADER.format("ascii") + "\n".join(rows) + "\n").encode()


def pcd_binary() -> bytes:
    body = b"".join(struct.pack("<fffIf", *row) for row in PCD_ROWS)
    return PCD_HEADER.format("binary").encode() + body


def pcd_compressed() -> bytes:
    columns = list(zip(*PCD_ROWS, strict=True))
    raw = b"".join(
        struct.pack("<6" + kind, *column) for kind, column in zip("fffIf", columns, strict=True)
    )
    # LZF of 120 bytes: literal runs of at most 32, then the z column as a copy of itself.
    literal = lambda part: bytes([len(part) - 1]) + part  # noqa: E731
    z = raw[48:72]
    copy = bytes([(7 << 5) | 0, len(z) - 4 - 2 - 7, 3])
    packed = literal(raw[:32]) + literal(raw[32:48]) + literal(z[:4]) + copy
    packed += literal(raw[72:104]) + literal(raw[104:])
    return (
        PCD_HEADER.format("binary_compressed").encode()
        + struct.pack("<II", len(packed), len(raw))
        + packed
    )


@pytest.fixture(scope="session")
def valid_files(tmp_path_factory: pytest.TempPathFactory, write_e57: E57Writer) -> dict[str, bytes]:
    """File name → content of a small valid file; the extension says which reader is meant."""
    folder = tmp_path_factory.mktemp("valid")
    rng = np.random.default_rng(7)
    fields = {
        "cartesianX": rng.random(20) + 1,
        "cartesianY": rng.random(20),
        "cartesianZ": rng.random(20),
        "intensity": rng.random(20),
        "rowIndex": np.arange(20) // 5,
        "columnIndex": np.arange(20) % 5,
    }
    pose = {
        "rotation": [("w", 1), ("x", 0), ("y", 0), ("z", 0)],
        "translation": [("x", 1), ("y", 2), ("z", 3)],
    }
    write_e57(folder / "a.e57", [{"fields": fields, "pose": pose}])
    corner = [[1.0, 0, 0, 5], [0, 1.0, 0, 6], [0, 0, 1.0, 7], [0, 0, 0, 1.0]]
    stl = b"\0" * 80 + struct.pack("<I", 1) + struct.pack("<12fH", *([0.0] * 3), *range(9), 0)
    return {
        "text.ply": PLY_TEXT,
        "little.ply": ply_binary("<"),
        "big.ply": ply_binary(">"),
        "one.ptx": PTX_SCAN,
        "two.ptx": PTX_SCAN + PTX_SCAN,
        "text.pcd": pcd_text(),
        "binary.pcd": pcd_binary(),
        "packed.pcd": pcd_compressed(),
        "plain.xyz": b"# x y z i\n1 2; 3 0.5\n4 5 6 0.25\n7 8;9 1e-2\n",
        "count.pts": b"2\n1 2 3 -100 1 2 3\n4 5 6 -200 4 5 6\n",
        "scan.e57": (folder / "a.e57").read_bytes(),
        "poses.conf": b"camera 0 0 0 0 0 0 1\nbmesh a.ply 1 2 3 0 0 0.6 0.8\n"
        b"bmesh b c.ply 0 0 0 0 0 0 1\n",
        "poses.aln": b"1\na.ply\n#\n1 0 0 5\n0 1 0 6\n0 0 1 7\n0 0 0 1\n0\n",
        "scan_poses.json": json.dumps(
            {"origin": [1, 2, 3], "scans": {"a": {"world_from_scan": corner}}}
        ).encode(),
        "triangle.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1\n",
        "triangle.stl": stl,
    }
