"""Textured GLB and OBJ, read back by another program: places, pictures and colours."""

from __future__ import annotations

import functools
import http.server
import json
import shutil
import struct
import subprocess
import threading
from pathlib import Path

import numpy as np
import pytest
import trimesh

from workbench.errors import InputError
from workbench.formats.textured_gltf import write_textured_glb
from workbench.formats.textured_obj import write_textured_obj
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.textured_mesh import TexturedMesh

AWAY = np.array([4.5e5, 5.4e6, 300.0])


@pytest.fixture
def two_pages() -> TexturedMesh:
    """Two squares side by side, each with its own page of four colours."""
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], float)
    places = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    mesh = TriangleMesh(
        np.vstack([square, square + np.array([1.0, 0, 0])]),
        np.vstack([faces, faces + 4])[[0, 2, 1, 3]],
        {"normal": np.tile([0.0, -1.0, 0.0], (8, 1))},
    )
    first, second = np.zeros((64, 64, 3), np.uint8), np.zeros((32, 64, 3), np.uint8)
    first[:32, :32], first[:32, 32:], first[32:, :32] = (200, 30, 20), (20, 180, 40), (10, 20, 220)
    second[:16], second[16:] = (250, 250, 10), (90, 90, 90)
    return TexturedMesh(
        mesh, np.vstack([places, places]), np.array([0, 1, 0, 1], np.int32), (first, second)
    )


def colors_at(geometry, point) -> np.ndarray:
    """The colour another program shows at a place of a plane y = constant."""
    material = geometry.visual.material
    picture = getattr(material, "baseColorTexture", None) or material.image
    pixels = np.asarray(picture.convert("RGB"))
    corners = geometry.vertices[geometry.faces]
    for triangle, uv in zip(corners, geometry.visual.uv[geometry.faces], strict=True):
        matrix = np.vstack([triangle[:, [0, 2]].T, np.ones(3)])
        share = np.linalg.solve(matrix, [point[0], point[2], 1.0])
        if (share >= 0).all():
            right, up = share @ uv
            height, width = pixels.shape[:2]
            return pixels[int((1 - up) * height), int(right * width)].astype(int)
    raise AssertionError("no triangle there")


PLACES = [
    ((0.25, 0, 0.75), (200, 30, 20)), ((0.75, 0, 0.75), (20, 180, 40)),
    ((0.25, 0, 0.25), (10, 20, 220)), ((0.75, 0, 0.25), (0, 0, 0)),
    ((1.5, 0, 0.75), (250, 250, 10)), ((1.5, 0, 0.25), (90, 90, 90)),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "atol"), [("png", 0), ("jpeg", 3)])
@pytest.mark.parametrize("suffix", ["glb", "obj"])
def test_colours_are_where_they_were(tmp_path, two_pages, suffix, kind, atol):
    path = tmp_path / f"a.{suffix}"
    write = write_textured_glb if suffix == "glb" else write_textured_obj
    write(path, two_pages, pictures=kind)
    scene = trimesh.load_scene(path, process=False)
    parts = [
        part.copy().apply_transform(scene.graph.get(name)[0])
        for name in scene.graph.nodes_geometry
        for part in [scene.geometry[scene.graph.get(name)[1]]]
    ]
    assert len(parts) == 2
    parts.sort(key=lambda part: part.vertices[:, 0].mean())
    assert sum(len(part.faces) for part in parts) == 4
    for point, color in PLACES:
        shown = colors_at(parts[int(point[0])], point)
        np.testing.assert_allclose(shown, color, atol=atol)
    for part in parts:
        np.testing.assert_allclose(part.vertex_normals, [[0, -1, 0]] * len(part.vertices))


def document(path) -> tuple[dict, bytes]:
    content = path.read_bytes()
    magic, version, length = struct.unpack("<4sII", content[:12])
    assert (magic, version, length) == (b"glTF", 2, len(content))
    size, kind = struct.unpack("<II", content[12:20])
    assert kind == 0x4E4F534A
    return json.loads(content[20 : 20 + size]), content[28 + size :]


def test_the_file_is_what_the_specification_says(tmp_path, two_pages):
    path = tmp_path / "a.glb"
    write_textured_glb(path, two_pages, AWAY, pictures="png")
    told, binary = document(path)
    assert told["extensionsUsed"] == ["KHR_materials_unlit"]
    assert [len(told[k]) for k in ("materials", "textures", "images")] == [2, 2, 2]
    assert len(told["meshes"][0]["primitives"]) == 2
    assert told["buffers"][0]["byteLength"] == len(binary)
    for view in told["bufferViews"]:
        assert view["byteOffset"] % 4 == 0
        assert view["byteOffset"] + view["byteLength"] <= len(binary)
    for image in told["images"]:
        view = told["bufferViews"][image["bufferView"]]
        assert binary[view["byteOffset"] :][:8] == b"\x89PNG\r\n\x1a\n"
        assert "target" not in view
    for primitive in told["meshes"][0]["primitives"]:
        counts = {told["accessors"][k]["count"] for k in primitive["attributes"].values()}
        assert counts == {4}
        assert "COLOR_0" not in primitive["attributes"]
    extras = told["asset"]["extras"]
    np.testing.assert_allclose(extras["world_from_local_origin"], AWAY, rtol=0)
    np.testing.assert_allclose(
        extras["world_from_positions"], AWAY + np.array([1.0, 0, 0.5]), rtol=0
    )
    assert "translation" not in told["nodes"][0]


def test_same_bytes_again_and_nothing_beside(tmp_path, two_pages):
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        write_textured_glb(tmp_path / folder / "a.glb", two_pages)
        files = write_textured_obj(tmp_path / folder / "a.obj", two_pages)
        assert sorted(p.name for p in files) == ["a.mtl", "a.obj", "a_0.png", "a_1.png"]
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes()
    assert len(list((tmp_path / "one").iterdir())) == 5


def test_obj_keeps_every_digit(tmp_path, two_pages):
    mesh = two_pages.mesh
    moved = TriangleMesh(mesh.vertices / 3 + AWAY, mesh.triangles, mesh.vertex_attributes)
    textured = TexturedMesh(moved, two_pages.texture_places, two_pages.pages, two_pages.pictures)
    write_textured_obj(tmp_path / "a.obj", textured, world_from_local_origin=AWAY)
    lines = (tmp_path / "a.obj").read_text().splitlines()
    read = np.array([line.split()[1:] for line in lines if line.startswith("v ")], float)
    np.testing.assert_array_equal(read, moved.vertices)
    assert lines[0] == "# world_from_local_origin 450000.0 5400000.0 300.0"
    assert "mtllib a.mtl" in lines


def test_what_cannot_be_written_is_refused(tmp_path, two_pages):
    mesh = two_pages.mesh
    nothing = TexturedMesh(
        TriangleMesh(mesh.vertices, np.zeros((0, 3), np.int32)),
        two_pages.texture_places, np.zeros(0, np.int32), two_pages.pictures,
    )  # fmt: skip
    for write in (write_textured_glb, write_textured_obj):
        with pytest.raises(InputError, match="without triangles"):
            write(tmp_path / "a.glb", nothing)
    assert not list(tmp_path.iterdir())
    places, pages = two_pages.texture_places, two_pages.pages
    with pytest.raises(InputError, match="from 0 to 1"):
        TexturedMesh(mesh, places * 1.5, pages, two_pages.pictures)
    with pytest.raises(InputError, match="not there"):
        TexturedMesh(mesh, places, pages, two_pages.pictures[:1])
    with pytest.raises(InputError, match="does not belong"):
        TexturedMesh(mesh, places[1:], pages, two_pages.pictures)


_PAGE = """<!doctype html><script type="importmap">{"imports": {
"three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/"}}</script>
<script type="module">
import * as THREE from "three";
import {GLTFLoader} from "three/addons/loaders/GLTFLoader.js";
const model = (await new GLTFLoader().loadAsync("/a.glb")).scene;
const renderer = new THREE.WebGLRenderer({preserveDrawingBuffer: true});
renderer.setSize(200, 100);
const scene = new THREE.Scene();
scene.add(model);
const camera = new THREE.OrthographicCamera(-1, 1, 0.5, -0.5, 0.1, 10);
camera.up.set(0, 0, 1);
camera.position.set(1, -5, 0.5);
camera.lookAt(1, 0, 0.5);
renderer.render(scene, camera);
const pixels = new Uint8Array(200 * 100 * 4), gl = renderer.getContext();
gl.readPixels(0, 0, 200, 100, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
window.shown = Array.from(pixels);
</script>"""


def test_three_js_shows_the_same_colours(tmp_path, two_pages):
    npm, chromium = shutil.which("npm"), shutil.which("chromium")
    if not npm or not chromium:
        pytest.skip("no npm or no chromium on this machine")
    root = subprocess.run([npm, "root", "-g"], capture_output=True, text=True, check=True).stdout
    three = Path(root.strip()) / "three"
    if not three.exists():
        pytest.skip("three.js is not there: npm install -g three")
    sync_api = pytest.importorskip("playwright.sync_api")
    write_textured_glb(tmp_path / "a.glb", two_pages)
    (tmp_path / "page.html").write_text(_PAGE)
    (tmp_path / "three").symlink_to(three)
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(tmp_path))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        with sync_api.sync_playwright() as playwright:
            browser = playwright.chromium.launch(
                executable_path=chromium,
                args=["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"],
            )
            page = browser.new_page()
            page.goto(f"http://127.0.0.1:{server.server_port}/page.html")
            page.wait_for_function("window.shown", timeout=60_000)
            shown = np.array(page.evaluate("window.shown")).reshape(100, 200, 4)
            browser.close()
    finally:
        server.shutdown()
        server.server_close()
    for (x, _, z), color in PLACES:
        np.testing.assert_allclose(shown[int(z * 100), int(x * 100), :3], color, atol=4)
