"""OBJ files are written in pieces: the same text as in one, and little memory for it."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from workbench.formats import obj_text
from workbench.formats.obj_text import obj_faces, obj_rows
from workbench.formats.surface_files import write_surface_obj
from workbench.formats.textured_obj import write_textured_obj
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.textured_mesh import TexturedMesh


@pytest.mark.parametrize("rows", [0, 1, 6, 7, 8, 20])
def test_pieces_are_the_whole(monkeypatch: pytest.MonkeyPatch, rows: int) -> None:
    monkeypatch.setattr(obj_text, "_ROWS", 7)
    rng = np.random.default_rng(2)
    places = rng.normal(size=(rows, 3)) * [1e-300, 1.0, 5.4e6]
    shades = rng.random((rows, 2)).astype(np.float32)
    told = b"".join(obj_rows("v %r %r %r %.6g %.6g", places, shades)).decode()
    assert told == "".join(
        f"v {x!r} {y!r} {z!r} {a:.6g} {b:.6g}\n"
        for (x, y, z), (a, b) in zip(places.tolist(), shades.tolist(), strict=True)
    )
    triangles = rng.integers(0, 1 << 31 - 2, (rows, 3)).astype(np.int32)
    for corner in ("%d", "%d//%d", "%d/%d", "%d/%d/%d"):
        told = b"".join(obj_faces(corner, triangles)).decode()
        assert told == "".join(
            "f " + " ".join(corner.replace("%d", str(v + 1)) for v in row) + "\n"
            for row in triangles.tolist()
        )


@pytest.mark.parametrize("kind", ["surface", "textured"])
def test_memory_does_not_grow_with_the_text(tmp_path, kind: str) -> None:
    n = 60_000
    rng = np.random.default_rng(0)
    mesh = TriangleMesh(
        rng.random((n, 3)), rng.integers(0, n, (2 * n, 3)).astype(np.int32)
    ).with_attributes(normal=rng.random((n, 3)), color=rng.integers(0, 256, (n, 3)).astype("u1"))
    path, page = tmp_path / "a.obj", np.zeros((8, 8, 3), np.uint8)
    textured = TexturedMesh(mesh, rng.random((n, 2)), np.zeros(2 * n, np.int32), (page,))
    tracemalloc.start()
    try:
        if kind == "surface":
            write_surface_obj(path, mesh)
        else:
            write_textured_obj(path, textured)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert path.stat().st_size > 11 << 20
    assert peak < 16 << 20
