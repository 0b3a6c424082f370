"""The page with a voxel graph: what its rays meet, from words that are checked before."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.viewer.conftest import Tab
from tests.viewer.looking import BACKGROUND, HEIGHT, WIDTH, View, pixel_rays, ray_cast, similarity
from workbench.pipeline.progress import Progress
from workbench.project.project import Project
from workbench.viewer import site as sites
from workbench.viewer.representations import SiteOptions
from workbench.viewer.site import Site, build_site
from workbench.voxels.dag_file import read_voxel_graph
from workbench.voxels.tracing import VoxelTracer

VIEW = View((1.2, -4.0, 1.1))


@pytest.fixture
def site(project: Project, monkeypatch: pytest.MonkeyPatch) -> Site:
    """The ball's voxel graph alone, of voxels 16 mm wide."""
    forms = tuple(form for form in sites.REPRESENTATIONS if form.mode == "graph")
    monkeypatch.setattr(sites, "REPRESENTATIONS", forms)
    return build_site(project, SiteOptions(resolution=128), Progress())


def graph_file(site: Site) -> Path:
    """Where the graph of a site is."""
    (entry,) = site.scene["modes"]
    return site.folder / entry["file"]


def settled(tab: Tab, **look: Any) -> None:
    """Let settings take effect, and every pixel get its ray."""
    tab.page.wait_for_function("() => window.page?.stage.mode")
    tab.page.evaluate(
        "(look) => { Object.assign(window.page.stage.look, look); window.page.stage.redraw(); }",
        {"pixelError": 1, **look},
    )
    tab.page.wait_for_timeout(50)
    tab.settled()


def met(tab: Tab) -> tuple[np.ndarray, np.ndarray]:
    """Depths in voxels (h, w), infinite for nothing, and sizes of cells, from the top row down."""
    words = tab.page.evaluate(
        """() => {
            const { gl, mode } = window.page.stage;
            const { tracing, width, height } = mode.screen.fine;
            const words = new Uint32Array(4 * width * height);
            gl.bindFramebuffer(gl.FRAMEBUFFER, tracing);
            gl.readPixels(0, 0, width, height, gl.RGBA_INTEGER, gl.UNSIGNED_INT, words);
            gl.bindFramebuffer(gl.FRAMEBUFFER, null);
            return [...words];
        }"""
    )
    table = np.array(words, np.uint32).reshape(HEIGHT, WIDTH, 4)[::-1]
    depths = np.ascontiguousarray(table[..., 0]).view(np.float32).astype(np.float64)
    sizes = 1 << (table[..., 1] >> 24 & 31).astype(np.int64)
    return np.where(table[..., 0] == 0, np.inf, depths), sizes


@pytest.mark.parametrize("pixel_error", [0.5, 6.0])
def test_rays_meet_what_they_meet_without_a_browser(site: Site, page, pixel_error: float):
    tab = page(site.folder, f"mode=graph&light=camera&{VIEW.link}")
    settled(tab, pixelError=pixel_error)
    depths, sizes = met(tab)
    told = read_voxel_graph(graph_file(site))
    ways = pixel_rays(VIEW, WIDTH, HEIGHT)
    length = np.linalg.norm(ways, axis=-1, keepdims=True)
    eye = np.array(VIEW.eye) + np.array(site.scene["origin"])
    slope = max(pixel_error, 1.0) * np.tan(np.radians(VIEW.fov) / 2) / (HEIGHT / 2)
    hits = VoxelTracer(told.graph, told.grid).first_met(
        eye, (ways / length).reshape(-1, 3), slope=slope
    )
    truth = hits.distance.reshape(HEIGHT, WIDTH) / length[..., 0] / told.grid.voxel_size
    # Single precision decides otherwise where a ray passes an edge of a voxel.
    seen = np.isfinite(truth)
    assert 10_000 < seen.sum() < 40_000
    assert (seen != np.isfinite(depths)).mean() < 1e-3
    both = seen & np.isfinite(depths)
    assert (np.abs(depths[both] - truth[both]) < 0.01).mean() > 0.995
    assert (sizes == hits.sizes.reshape(HEIGHT, WIDTH))[both].mean() > 0.995
    assert set(np.unique(sizes[both])) == ({1} if pixel_error < 1 else {2, 4})


def test_it_shows_the_surface_its_colours_and_its_depth(site: Site, page, ball):
    tab = page(site.folder, f"mode=graph&light=camera&{VIEW.link}")
    settled(tab)
    picture = tab.picture()
    assert similarity(picture, ray_cast(ball, VIEW, WIDTH, HEIGHT)) > 0.9
    blue, yellow = picture[180, 240].astype(int), picture[70, 240].astype(int)
    assert blue[2] - blue[0] > 60
    assert yellow[0] - yellow[2] > 60
    place = np.array(tab.value("page.stage.placeAt(240, 120)"))
    assert np.linalg.norm(place) == pytest.approx(1.0, abs=0.03)
    assert tab.told == []
    assert tab.told_to_user() == []


def test_a_lamp_throws_shadows_and_a_section_opens(site: Site, page):
    tab = page(site.folder, "mode=graph&light=fixed&" + View((0.0, -4.0, 0.0)).link)
    # The front is cut away; from above, light falls on the lower half of the hollow only
    # where the upper half lets it in.
    lamp = {"lit": True, "headlight": False, "light": [0.0, -0.6, 0.8]}
    settled(tab, section=[0.0, 1.0, 0.0, 0.0], overlay="shape", **lamp)
    picture = tab.picture().astype(int)
    assert (np.abs(picture[60:180, 180:300] - BACKGROUND).max(axis=2) > 20).all()
    depths, _ = met(tab)
    # The far half: further than the middle of the ball.
    voxel = read_voxel_graph(graph_file(site)).grid.voxel_size
    assert depths[120, 240] * voxel == pytest.approx(5.0, abs=0.05)
    # The cut does not let light in: whatever lies under the whole of the ball's shell is dark.
    dark = picture[60:180, 180:300, 0]
    assert np.ptp(dark) <= 2
    settled(tab, section=[0.0, 0.0, 0.0, 1.0], overlay="shape", **lamp)
    lit = tab.picture().astype(int)[..., 0]
    assert lit[40, 240] > dark.max() + 60
    assert np.abs(lit[205:212, 240] - dark.mean()).max() < 3


def test_it_is_rough_while_one_moves_and_fine_at_rest(site: Site, page):
    tab = page(site.folder, f"mode=graph&light=camera&{VIEW.link}")
    settled(tab)
    told = tab.page.evaluate(
        """async () => {
            const { stage, camera } = window.page;
            const rows = [];
            for (let k = 0; k < 5; k++) {
                camera.turn(0.05, 0);
                stage.frame();
                rows.push([stage.mode.screen.rows, stage.mode.pending]);
            }
            return rows;
        }"""
    )
    assert told == [[0, True]] * 5
    # There is a picture at once: the middle of the ball is no hole.
    rough = tab.picture()
    assert np.abs(rough[120, 240].astype(int) - BACKGROUND).max() > 20
    settled(tab)
    assert tab.value("[page.stage.mode.screen.rows, page.stage.mode.pending]") == [HEIGHT, False]


@pytest.mark.parametrize(
    ("place", "told"), [(0, "another header"), (9, "another version"), (-900, "a wrong checksum")]
)
def test_damage_is_told_and_nothing_is_followed(site: Site, page, place: int, told: str):
    path = graph_file(site)
    content = bytearray(path.read_bytes())
    content[place] ^= 255
    path.write_bytes(content)
    tab = page(site.folder, "mode=graph")
    tab.page.wait_for_function("() => document.querySelectorAll('#notices p').length > 0")
    (message,) = tab.told_to_user()
    assert told in message
    assert tab.told == []


def test_a_pointer_out_of_bounds_is_found_though_the_checksum_fits(site: Site, page):
    import zlib

    path = graph_file(site)
    content = bytearray(path.read_bytes())
    graph = read_voxel_graph(path).graph
    # The first node's last pointer, behind header, depths and bricks.
    halves = 80 + 8 * (graph.level + 1) + 8 * len(graph.bricks)
    content[halves + 2 : halves + 4] = b"\xff\x1f"
    content[12:16] = zlib.crc32(content[16:]).to_bytes(4, "little")
    path.write_bytes(content)
    tab = page(site.folder, "mode=graph")
    tab.page.wait_for_function("() => document.querySelectorAll('#notices p').length > 0")
    (message,) = tab.told_to_user()
    assert "not there" in message
