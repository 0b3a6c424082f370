"""Photographs stitched in the browser, held against the renderer that needs none."""

from __future__ import annotations

import json
import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.texturing.scenes import picture, ring, together
from tests.texturing.test_candidates import maps_of
from tests.viewer.conftest import PLACE, Answers, Tab
from tests.viewer.looking import BACKGROUND, View, similarity
from workbench.errors import InputError
from workbench.formats.surface_files import write_surface_ply
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.surface_rays import SurfaceRays
from workbench.geometry.transforms import rigid
from workbench.pipeline.stitched_pictures import StitchedProject
from workbench.project.creation import create_project
from workbench.project.project import Project
from workbench.render.stitch.renderer import StitchedView, stitched_view
from workbench.render.stitch.scene import StitchScene
from workbench.texturing.cost_options import CostOptions, far_of_scene
from workbench.texturing.multi_mesh import labelled_depth_mesh
from workbench.viewer.site import copy_page
from workbench.viewer.stitched_files import write_project, write_stitched

COUNT = 6
SIZE = (320, 240)
VIEW = View((1.6, -1.9, 0.9))
# Where the page's coordinates begin, in the project's.
MIDDLE = np.array([0.1, -0.05, 0.02])
FOCAL, BEND = 300.0, -0.2
LENSES = {
    "SIMPLE_RADIAL": (FOCAL, 160.0, 120.0, BEND),
    "PINHOLE": (FOCAL, 1.01 * FOCAL, 158.0, 121.0),
    "OPENCV": (FOCAL, FOCAL, 161.0, 119.0, -0.1, 0.05, 0.03, -0.02),
    "FULL_OPENCV": (FOCAL, FOCAL, 160.0, 120.0, 0.2, 0.1, -0.02, 0.03, 0.01, 0.5, 0.05, 0.01),
    "OPENCV_FISHEYE": (FOCAL, FOCAL, 160.0, 120.0, 0.2, -0.1, 0.05, 0.02),
    "RADIAL": (FOCAL, 160.0, 120.0, -0.2, 0.1),
}  # fmt: skip
# Exposures differ, as they do where photographs are not developed alike.
GAINS = (1.0, 0.85, 1.1, 0.9, 1.05, 0.8)


# Of every pixel from below: its photograph's number + 1, and its mesh from bit 15 on.
CHOSEN = """(() => {
  const { gl, mode } = page.stage;
  const [{ framebuffer, width, height }] = mode.shown;
  const fragments = new Uint32Array(4 * width * height);
  gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
  gl.readPixels(0, 0, width, height, gl.RGBA_INTEGER, gl.UNSIGNED_INT, fragments);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  return Array.from({ length: width * height }, (_, k) => fragments[4 * k + 1] & 0xfffffff);
})()"""


@dataclass(frozen=True)
class Patches:
    """A project, its site and what the renderer without a browser makes of it."""

    root: Path
    site: Path
    project: StitchedProject
    scene: StitchScene

    def offline(self, view: View, width: int, height: int) -> StitchedView:
        eye, to = np.array(view.eye) + MIDDLE, np.array(view.to) + MIDDLE
        back = (eye - to) / np.linalg.norm(eye - to)
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        turn = np.stack([right, -np.cross(back, right), -back])
        focal = 0.5 * height / np.tan(np.radians(view.fov) / 2)
        params = (focal, focal, 0.5 * width, 0.5 * height)
        camera = PhotoCamera("PINHOLE", width, height, params, rigid(turn, -turn @ eye))
        photographs = self.project.scene
        return stitched_view(self.scene, camera, photographs.cameras, photographs.picture)


def on_page(color: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """A picture (h, w, 3) in [0, 1] over the page's background, uint8."""
    out = np.broadcast_to(BACKGROUND, color.shape).copy()
    out[seen] = 255 * np.clip(color[seen], 0, 1)
    return np.rint(out).astype(np.uint8)


@pytest.fixture(scope="module")
def patches(sphere, tmp_path_factory) -> Patches:
    """Two painted balls, one before the other, photographed with six lenses and exposures."""
    folder = tmp_path_factory.mktemp("patches")
    mesh = together(sphere(0.7, (0, 0, 0), 5), sphere(0.3, (0.8, -0.5, 0.3), 4))
    write_surface_ply(folder / "balls.ply", mesh)
    store = create_project(folder / "balls", geometry=folder / "balls.ply").store
    rays = SurfaceRays(mesh)
    small = ring(COUNT, distance=2.2, size=(64, 48), focal=60.0)
    cameras = {
        k: PhotoCamera(model, *SIZE, params, small[k].camera_from_world)
        for k, (model, params) in enumerate(LENSES.items())
    }
    pictures = {k: picture(rays, camera, GAINS[k]) for k, camera in cameras.items()}
    maps = maps_of(mesh, small)
    costs = CostOptions(far_of_scene(maps.values()))
    names = np.array([f"photo_{k}" for k in range(COUNT)])
    for k, name in enumerate(names):
        made = labelled_depth_mesh(k, maps, cameras, pictures.__getitem__, costs, 1)
        store.save("depth_meshes", {**made.arrays(), "photos": names}, str(name))
        store.save("depth_maps", maps[k].arrays(), str(name))
        store.save("texture_photos", pictures[k], str(name))
    poses = {
        f"photo_{k}": {
            "model": camera.model,
            "size": list(SIZE),
            "params": list(camera.params),
            "camera_from_world": camera.camera_from_world.tolist(),
        }
        for k, camera in cameras.items()
    }
    store.save("photo_poses", {"frame": "world", "photos": poses})
    store.save("scan_inventory", {"origin_m": PLACE.tolist()})
    store.save(
        "texturing",
        {"photographs": names.tolist(), "held_out": [], "far_m": costs.far, "image_px": 320},
    )
    root = folder / "balls"
    site = folder / "site"
    copy_page(site)
    data = site / "data" / "stitched"
    data.mkdir(parents=True)
    told = write_project(store, data)
    entry = {"mode": "stitched", "kind": "stitched", "label": "Stitched", "unit": "triangles"}
    entry |= {"file": "data/stitched/stitched.json", "bytes": 1, "told": ""}
    entry |= {"items": sum(one["triangles"] for one in told["meshes"])}
    size = [1.2, 1.0, 0.8]
    scene = {
        "version": 1, "name": "balls", "unit": "m", "up": "z", "light": "none",
        "origin": (PLACE + MIDDLE).tolist(), "bounds": [[-s for s in size], size],
        "home": {"eye": [3.0, 0.0, 0.0], "to": [0.0, 0.0, 0.0], "fov": 35.0},
        "modes": [entry], "left_out": [],
    }  # fmt: skip
    (site / "scene.json").write_text(json.dumps(scene))
    project = StitchedProject.of(Project(root))
    return Patches(root, site, project, StitchScene.of(project.scene.meshes))


def test_it_shows_what_the_renderer_without_a_browser_shows(patches: Patches, serve, show):
    tab = show(f"{serve(patches.site)}#mode=stitched&light=none&{VIEW.link}", width=480, height=360)
    tab.settled()
    found = tab.picture()
    view = patches.offline(VIEW, 480, 360)
    seen = view.shown.seen
    assert similarity(found, on_page(view.color, seen)) > 0.98
    assert ((found != BACKGROUND).any(axis=2) != seen).sum() < 0.002 * seen.sum()
    error = np.abs(found.astype(int) - on_page(view.color, seen))[seen].mean()
    bare = on_page(view.textured.color, seen).astype(int)
    # Photographs differ in exposure by up to a third; levelling takes their borders away.
    assert np.abs(bare - on_page(view.color, seen))[seen].mean() > 5 * error
    tab.page.locator('#overlays [data-key="unlevelled"]').click()
    assert similarity(tab.picture(), on_page(view.textured.color, seen)) > 0.98
    # What is measured is where the surface is.
    row, column = np.argwhere(seen)[seen.sum() // 2]
    place = tab.value(f"page.stage.placeAt({column + 0.5}, {row + 0.5})")
    expected = view.shown.position[row, column] - MIDDLE
    assert np.linalg.norm(np.array(place) - expected) < patches.scene.epsilon / 10
    # On a slow card a moving picture is simpler; at rest it is whole again.
    quick = "page.stage.mode.histogram.tookMs = 1e3, page.camera.turn(0.3, 0), page.stage.frame()"
    assert tab.value(f"({quick}, page.stage.mode.quick)")
    tab.value("(page.camera.turn(-0.3, 0), page.stage.redraw())")
    tab.settled()
    assert similarity(tab.picture(), on_page(view.textured.color, seen)) > 0.98
    assert not tab.value("page.stage.mode.quick")
    assert tab.told == []
    assert tab.told_to_user() == []


def test_photographs_are_chosen_alike_and_projected_by_their_lenses(patches: Patches, serve, show):
    tab = show(f"{serve(patches.site)}#mode=stitched&color=unlevelled&{VIEW.link}", height=360)
    checked = set()
    for side in (1.0, -1.0):
        view = View((side * VIEW.eye[0], side * VIEW.eye[1], VIEW.eye[2]))
        tab.page.wait_for_function("() => window.page")
        tab.value(f"(page.camera.eye = {list(view.eye)}, page.stage.redraw())")
        tab.settled()
        found, expected = tab.picture().astype(int), patches.offline(view, 640, 360)
        chosen = np.reshape(tab.value(CHOSEN), (360, 640))[::-1]
        seen = expected.shown.seen
        alike = seen & ((chosen & 0x7FFF) - 1 == expected.shown.label)
        assert alike.sum() > 0.99 * seen.sum()
        assert ((chosen >> 15) == expected.shown.mesh)[seen].mean() > 0.98
        bare = on_page(expected.textured.color, expected.shown.seen)
        for photo in range(COUNT):
            of_it = alike & (expected.textured.label == photo)
            if of_it.sum() > 1000:
                # A texel beside is a step of about four.
                assert np.abs(found - bare)[of_it].mean() < 1.0
                checked.add(photo)
    assert checked == set(range(COUNT))


def uncovered(tab: Tab) -> np.ndarray:
    """The picture without the messages before it."""
    tab.page.evaluate(
        "() => document.querySelectorAll('#notices button').forEach((b) => b.click())"
    )
    return tab.picture()


def failing(data: Path) -> type[Answers]:
    """Without one photograph, with half of another and with a byte of one mesh changed."""
    told = json.loads((data / "stitched.json").read_text())
    names = [photo["picture"] for photo in told["photos"]]
    place = told["meshes"][1]["offset"] + 20

    class Failing(Answers):
        def do_GET(self) -> None:  # noqa: N802
            name = self.path.rpartition("/")[2]
            if name == names[0]:
                self.send_error(404)
            elif name in (names[1], "meshes.bin"):
                content = bytearray((data / name).read_bytes())
                if name == names[1]:
                    content = content[: len(content) // 2]
                else:
                    content[place] ^= 255
                self.send_response(200)
                self.send_header("Content-Length", str(len(content)))
                self.end_headers()
                self.wfile.write(content)
            else:
                super().do_GET()

    return Failing


def test_what_is_missing_is_told_and_the_rest_is_shown(patches: Patches, serve, show):
    data = patches.site / "data" / "stitched"
    address = serve(patches.site, failing(data))
    # From above all photographs are wanted.
    view = View((0.1, -0.3, 3.2))
    tab = show(f"{address}#mode=stitched&light=none&{view.link}", width=480, height=360)
    tab.settled()
    told = sorted(tab.told_to_user())
    assert [message for message in told if "part of the surface" in message] == [
        "A part of the surface is left out: the file is damaged"
    ]
    photographs = [message for message in told if "photograph is missing" in message]
    assert len(photographs) == 2
    assert any("not on the server" in message for message in photographs)
    assert any("damaged" in message for message in photographs)
    assert tab.value("page.stage.mode.meshes.there") == COUNT - 1
    assert not [line for line in tab.told if "exception" in line]
    # Other meshes show the surface, and colours of corners stand in for photographs.
    whole = patches.offline(view, 480, 360)
    seen = whole.shown.seen
    found = uncovered(tab).astype(int)
    shown = (np.abs(found - BACKGROUND) > 1).any(axis=2)
    assert (shown & seen).sum() > 0.9 * seen.sum()
    assert np.abs(found - on_page(whole.color, seen))[shown & seen].mean() < 10


def test_memory_stays_within_its_budget_on_a_way_round(patches: Patches, serve, show):
    tab = show(f"{serve(patches.site)}#mode=stitched&light=none&{VIEW.link}", width=480, height=360)
    # Room for the meshes, a smaller picture and about two photographs of 320 × 240.
    tab.page.wait_for_function("() => window.page")
    budget = tab.value("(page.stage.look.budgetBytes = 2.5e6)")
    tab.settled()
    most = tab.page.evaluate(
        """async () => {
          const { stage, camera } = window.page;
          let most = 0;
          for (let k = 0; k < 50; k++) {
            camera.turn(2 * Math.PI / 50, 0);
            stage.frame();
            most = Math.max(most, stage.counts.bytes);
            await new Promise((done) => setTimeout(done, 5));
          }
          return most;
        }"""
    )
    assert 0.5 * budget < most <= budget
    tab.settled()
    loaded = tab.value("[...page.stage.mode.photos.loaded.keys()]")
    assert 1 <= len(loaded) < COUNT
    assert tab.value("page.stage.counts.bytes") <= budget
    assert not [line for line in tab.told if "exception" in line]
    assert tab.told_to_user() == []
    # All is given back.
    assert tab.value("(page.stage.mode.dispose(), page.stage.counts.bytes)") == 0


def test_a_card_without_floating_point_pictures_shows_what_it_can(patches: Patches, serve, browser):
    context = browser.new_context(viewport={"width": 480 + 288, "height": 360})
    page = context.new_page()
    page.add_init_script(
        "const own = WebGL2RenderingContext.prototype.getExtension;"
        "WebGL2RenderingContext.prototype.getExtension = function (name) {"
        "  return name.startsWith('EXT_color_buffer') ? null : own.call(this, name); };"
    )
    page.goto(f"{serve(patches.site)}#mode=stitched&light=none&{VIEW.link}")
    tab = Tab(page, [])
    tab.settled()
    (told,) = tab.told_to_user()
    assert "not levelled" in told
    view = patches.offline(VIEW, 480, 360)
    expected = on_page(view.textured.color, view.shown.seen)
    assert similarity(uncovered(tab), expected) > 0.98
    context.close()


def test_files_hold_what_the_scene_holds(patches: Patches):
    data, scene = patches.site / "data" / "stitched", patches.scene
    told = json.loads((data / "stitched.json").read_text())
    bulk = (data / told["file"]).read_bytes()
    for k, mesh in enumerate(told["meshes"]):
        block = bulk[mesh["offset"] : mesh["offset"] + mesh["bytes"]]
        assert zlib.crc32(block) == mesh["crc"]
        n, m = mesh["vertices"], mesh["triangles"]
        places = np.frombuffer(block, "<f4", 3 * n).reshape(n, 3) + told["from_positions"] - PLACE
        own = slice(scene.vertex_starts[k], scene.vertex_starts[k + 1])
        np.testing.assert_allclose(places, scene.vertices[own], atol=1e-6)
        labels = np.frombuffer(block, "<u2", m, 16 * n)
        which = slice(scene.starts[k], scene.starts[k + 1])
        np.testing.assert_array_equal((labels & 0x7FFF).astype(int) - 1, scene.labels[which])
        np.testing.assert_array_equal(labels >> 15 == 1, scene.foreground[which])
        triangles = np.frombuffer(block, "<u2", 3 * m, 16 * n + 4 * m).reshape(m, 3)
        expected = scene.triangles[which] - scene.vertex_starts[k]
        np.testing.assert_array_equal(triangles, expected)
    for photo in told["photos"]:
        assert zlib.crc32((data / photo["picture"]).read_bytes()) == photo["picture_crc"]


def test_photographs_are_made_as_small_as_cards_take_them(
    patches: Patches, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("workbench.viewer.stitched_files._LONGEST_PX", SIZE[0] // 2)
    photographs = patches.project.scene
    told = write_stitched(
        tmp_path, patches.scene, photographs.cameras, photographs.picture, np.zeros(3)
    )
    for k, photo in enumerate(told["photos"]):
        assert photo["size"] == [160, 120]
        assert photo["lens"][0] == pytest.approx(FOCAL / 2)
        found = cv2.imread(str(tmp_path / photo["picture"]))[..., ::-1].astype(int)
        mask = cv2.imread(str(tmp_path / photo["mask"]), cv2.IMREAD_UNCHANGED)
        whole = photographs.picture(k).reshape(120, 2, 160, 2, 4).astype(int)
        usable = (whole[..., 3] > 0).all(axis=(1, 3))
        np.testing.assert_array_equal(mask > 0, usable)
        assert np.abs(found - whole[..., :3].mean(axis=(1, 3)))[usable].mean() < 2


def test_what_pages_cannot_draw_is_told(patches: Patches, tmp_path: Path):
    camera = patches.project.scene.cameras[0]
    odd: Any = replace(camera, model="FOV", params=(FOCAL, FOCAL, 160.0, 120.0, 0.5))
    with pytest.raises(InputError, match="lens model FOV"):
        write_stitched(tmp_path, patches.scene, [odd], patches.project.scene.picture, np.zeros(3))
