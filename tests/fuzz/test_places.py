"""Names in files that lead elsewhere, things that are no files, and pictures that are bombs."""

from __future__ import annotations

import base64
import io
import json
import os
import pickle
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.fuzz.checksums import stored_zip
from tests.fuzz.scan_targets import textured_tetrahedron
from workbench.errors import InputError
from workbench.formats.las_reading import las_batches
from workbench.formats.photo_reading import photo_size, read_photo
from workbench.formats.picture_file import opened_picture
from workbench.formats.scans import read_scans
from workbench.formats.textured_obj import write_textured_obj
from workbench.formats.textured_surface import read_textured_surface
from workbench.project.hashing import FileHashes
from workbench.project.store import ProductStore
from workbench.surfels.surfel_file import SurfelFile


@pytest.fixture
def shared_picture(tmp_path: Path) -> Path:
    """A red picture that belongs to nobody's model."""
    path = tmp_path / "private" / "red.png"
    path.parent.mkdir()
    Image.new("RGB", (4, 4), (255, 0, 0)).save(path)
    return path


@pytest.mark.parametrize("kind", ["above", "absolute", "link", "windows"])
def test_an_obj_shows_no_picture_from_elsewhere(tmp_path, shared_picture, kind):
    folder = tmp_path / "model"
    folder.mkdir()
    write_textured_obj(folder / "a.obj", textured_tetrahedron())
    assert read_textured_surface(folder / "a.obj")[1] is not None
    name = {
        "above": "../private/red.png",
        "absolute": str(shared_picture),
        "link": "link.png",
        "windows": "..\\private\\red.png",
    }[kind]
    (folder / "link.png").symlink_to(shared_picture)
    material = (folder / "a.mtl").read_text()
    for page in ("a_0.png", "a_1.png"):
        material = material.replace(page, name)
    (folder / "a.mtl").write_text(material)
    try:
        _, texture = read_textured_surface(folder / "a.obj")
    except InputError:
        return
    shown = [] if texture is None else [picture.tolist() for picture in texture.pictures]
    assert [255, 0, 0] not in [pixel for picture in shown for row in picture for pixel in row]


@pytest.mark.parametrize("uri", ["../private/a.bin", "{}", "link.bin", "file://{}"])
def test_a_gltf_reads_no_buffer_from_elsewhere(tmp_path, uri):
    corners = np.eye(3, dtype="<f4").tobytes() + np.arange(3, dtype="<u4").tobytes()
    private, folder = tmp_path / "private", tmp_path / "model"
    private.mkdir()
    folder.mkdir()
    (private / "a.bin").write_bytes(corners)
    (folder / "a.bin").write_bytes(corners)
    (folder / "link.bin").symlink_to(private / "a.bin")

    def told(name: str) -> bytes:
        views = [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 12}]
        return json.dumps(
            {
                "asset": {"version": "2.0"},
                "scenes": [{"nodes": [0]}],
                "nodes": [{"mesh": 0}],
                "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
                "accessors": [
                    {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
                    {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"},
                ],
                "bufferViews": views,
                "buffers": [{"uri": name, "byteLength": 48}],
            }
        ).encode()

    inside = "data:application/octet-stream;base64," + base64.b64encode(corners).decode()
    for name in ("a.bin", inside):
        (folder / "a.gltf").write_bytes(told(name))
        assert len(read_textured_surface(folder / "a.gltf")[0].triangles) == 1
    (folder / "a.gltf").write_bytes(told(uri.format(private / "a.bin")))
    with pytest.raises(InputError, match="cannot be read"):
        read_textured_surface(folder / "a.gltf")


@pytest.mark.parametrize("name", ["a.ply", "a.ptx", "a.xyz", "a.e57", "a.pcd"])
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_what_never_ends_is_not_begun(tmp_path, name, kind):
    path = tmp_path / name
    os.mkfifo(path) if kind == "pipe" else path.symlink_to("/dev/zero")
    with pytest.raises(InputError, match="pipe or a device"):
        read_scans(path, {})


@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_pictures_clouds_and_surfels_are_files_too(tmp_path, kind):
    for name, read in (
        ("a.png", read_photo),
        ("a.jpg", photo_size),
        ("a.dng", photo_size),
        ("a.laz", lambda path: list(las_batches(path))),
        ("a.surfels", SurfelFile),
        ("a.txt", FileHashes(tmp_path / "hashes.json", tmp_path).of_file),
    ):
        path = tmp_path / name
        os.mkfifo(path) if kind == "pipe" else path.symlink_to("/dev/zero")
        with pytest.raises(InputError):
            read(path)


def png(width: int, height: int, rows: bytes, depth: int = 8) -> bytes:
    def chunk(kind: bytes, content: bytes) -> bytes:
        crc = struct.pack(">I", zlib.crc32(kind + content))
        return struct.pack(">I", len(content)) + kind + content + crc

    head = struct.pack(">IIBBBBB", width, height, depth, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


def test_a_picture_of_more_pixels_than_bytes_can_hold_is_refused(tmp_path):
    path = tmp_path / "a.png"
    path.write_bytes(png(13_000, 13_000, zlib.compress(bytes(1000))))
    for read in (read_photo, photo_size):
        with pytest.raises(InputError, match="cannot be read") as caught:
            read(path)
        assert "cannot hold the 169000000 pixels" in str(caught.value.found)


def test_a_blank_picture_of_a_good_camera_is_no_bomb(tmp_path):
    # 24 million pixels without a mark: as little as a mask that keeps all can take.
    path = tmp_path / "a.png"
    path.write_bytes(png(6000, 4000, zlib.compress((bytes(1) + bytes(750)) * 4000, 9), depth=1))
    assert path.stat().st_size < 5000
    assert photo_size(path) == (6000, 4000)
    Image.new("RGB", (6000, 4000)).save(tmp_path / "b.jpg", quality=50, progressive=True)
    with opened_picture(tmp_path / "b.jpg") as opened:
        assert opened.size == (6000, 4000)


class _Trap:
    """Leaves a mark when it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self):
        return (os.mkdir, (str(self.mark),))


@pytest.mark.parametrize("product", ["registration", "surface", "range_maps"])
def test_a_product_runs_no_code(tmp_path, product):
    mark = tmp_path / "ran"
    store = ProductStore(tmp_path)
    item = "a" if product == "range_maps" else None
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        head, {"descr": "|O", "fortran_order": False, "shape": (1,)}
    )
    trap = head.getvalue() + pickle.dumps([_Trap(mark)])
    path = store.path(product, item)
    path.parent.mkdir(parents=True)
    for content in (stored_zip({"vertices.npy": trap, "points_in_scan.npy": trap}), trap):
        path.write_bytes(content)
        with pytest.raises(InputError, match="damaged"):
            store.load(product, item)
    assert not mark.exists()


def written(store: ProductStore, name: str) -> None:
    with store.writing(name) as path:
        path.write_bytes(b"x")


@pytest.mark.parametrize("folder", ["work", "work/infill", "exports"])
def test_a_link_takes_no_product_out_of_the_project(tmp_path, folder):
    elsewhere, root = tmp_path / "elsewhere", tmp_path / "project"
    elsewhere.mkdir()
    (root / folder).parent.mkdir(parents=True, exist_ok=True)
    (root / folder).symlink_to(elsewhere)
    store = ProductStore(root)
    name = "surface_ply" if folder == "exports" else "surface"
    with pytest.raises(InputError, match="leads out of it"):
        written(store, name)
    assert not list(elsewhere.iterdir())
    # A link to a place inside is the user's own way to lay out a project.
    (root / folder).unlink()
    (root / "other").mkdir()
    (root / folder).symlink_to(root / "other")
    written(store, name)
    assert store.exists(name)
