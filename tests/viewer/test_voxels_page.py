"""The page with voxels: what it shows, reads, keeps on the card, leaves out behind other parts."""

from __future__ import annotations

import base64
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard

from tests.viewer.conftest import Answers, Tab
from tests.viewer.looking import BACKGROUND, HEIGHT, WIDTH, View, pixel_rays, ray_cast, similarity
from workbench.formats.surface_files import write_surface_ply
from workbench.geometry.mesh import TriangleMesh
from workbench.pipeline.progress import Progress
from workbench.project.creation import create_project
from workbench.project.project import Project
from workbench.viewer import makers
from workbench.viewer import site as sites
from workbench.viewer.representations import SiteOptions
from workbench.viewer.site import Site, build_site
from workbench.voxels.lod_file import LodFile

VIEW = View((1.2, -4.0, 1.1))
FAR = View((24.0, -80.0, 22.0))
CLOSE = View((0.3, -1.35, 0.3))


@pytest.fixture(autouse=True)
def voxels_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sites have no other forms, which take time, and chunks as small as the models."""
    monkeypatch.setattr(makers, "_CHUNK_LEVEL", 5)
    forms = tuple(form for form in sites.REPRESENTATIONS if form.mode == "voxels")
    monkeypatch.setattr(sites, "REPRESENTATIONS", forms)


@pytest.fixture
def site(project: Project) -> Site:
    """The ball's voxels, 16 mm wide, in chunks of 32 a side."""
    return build_site(project, SiteOptions(resolution=128), Progress())


def voxel_file(site: Site) -> Path:
    """Where the voxels of a site are."""
    (entry,) = site.scene["modes"]
    return site.folder / entry["file"]


def settled(tab: Tab, pixel_error: float, **look: Any) -> None:
    """Let an error in pixels, and other settings, take effect, and all come that they need."""
    tab.page.wait_for_function("() => window.page?.stage.mode")
    tab.page.evaluate(
        "(look) => { Object.assign(window.page.stage.look, look); window.page.stage.redraw(); }",
        {"pixelError": pixel_error, **look},
    )
    tab.page.wait_for_timeout(50)
    tab.settled(60_000)


def levels(tab: Tab) -> dict[str, int]:
    """How many parts are drawn of each level, and of the surface itself."""
    return tab.value(
        """page.stage.mode.shown.reduce((sums, { node, kind }) => {
            const name = kind === 'surface' ? kind : String(node.level);
            return { ...sums, [name]: 1 + (sums[name] ?? 0) };
        }, {})"""
    )


def test_it_shows_what_rays_meet_and_keeps_to_the_depth(site: Site, page, ball):
    tab = page(site.folder, f"mode=voxels&light=camera&{VIEW.link}")
    # Voxels are 1.9 pixels wide in front.
    settled(tab, 2.0)
    # What is hidden may be coarser.
    assert max(levels(tab)) == "7"
    truth = ray_cast(ball, VIEW, WIDTH, HEIGHT)
    assert similarity(tab.picture(), truth) > 0.93
    # What is measured is where the surface is, as far as voxels of 16 mm tell.
    place = np.array(tab.value("page.stage.placeAt(240, 120)"))
    assert np.linalg.norm(place) == pytest.approx(1.0, abs=0.03)
    # Coarser where coarser is asked for, and the surface itself where voxels are too large.
    settled(tab, 4.0)
    assert "7" not in levels(tab)
    settled(tab, 1.0)
    assert levels(tab)["surface"] > 0
    assert similarity(tab.picture(), truth) > 0.97
    assert tab.told == []
    assert tab.told_to_user() == []


def test_walls_are_seen_from_inside_through_a_section(site: Site, page):
    tab = page(site.folder, f"mode=voxels&light=none&{View((0.0, -4.0, 1.2)).link}")
    settled(tab, 2.0, section=[0.0, 1.0, 0.0, 0.0])
    picture = tab.picture()[60:180, 180:300].reshape(-1, 3).astype(int)
    # Through the front half, which is cut away, the back half shows its two colours, no holes.
    assert (picture[:, 2] - picture[:, 0] > 80).mean() > 0.2
    assert (picture[:, 0] - picture[:, 2] > 80).mean() > 0.2
    assert np.abs(picture - BACKGROUND).max(axis=1).min() > 20


def test_so_much_is_read_as_the_picture_needs(ranges: str, site: Site, show, ball):
    tab = show(f"{ranges}#mode=voxels&light=camera&{FAR.link}", width=WIDTH, height=HEIGHT)
    tab.settled()
    size = voxel_file(site).stat().st_size
    before = tab.value("page.network.bytes")
    assert 0 < before < 0.2 * size
    # From near, what one sees comes; the other side of the ball stays where it is.
    tab.page.evaluate(f"() => {{ location.hash = 'mode=voxels&light=camera&{CLOSE.link}' }}")
    tab.page.wait_for_timeout(100)
    settled(tab, 1.0)
    assert before < tab.value("page.network.bytes") < 0.7 * size
    assert similarity(tab.picture(), ray_cast(ball, CLOSE, WIDTH, HEIGHT)) > 0.97
    assert tab.told_to_user() == []


class Slow(Answers):
    """Parts of files, each after a while."""

    def do_GET(self) -> None:  # noqa: N802
        if not self.path.endswith(".vlod"):
            super().do_GET()
            return
        time.sleep(0.05)
        first, last = map(int, self.headers["Range"].removeprefix("bytes=").split("-"))
        content = Path(self.translate_path(self.path)).read_bytes()
        self.send_response(206)
        self.send_header("Content-Length", str(last - first + 1))
        self.end_headers()
        self.wfile.write(content[first : last + 1])


@pytest.mark.parametrize("refinement", ["gradual", "whole"])
def test_what_comes_late_leaves_no_hole(site: Site, page, refinement: str):
    tab = page(site.folder, f"mode=voxels&light=none&{VIEW.link}", Slow)
    tab.page.wait_for_function("() => window.page?.stage.mode?.shown.length > 0")
    seen = tab.page.evaluate(
        """async (refinement) => {
            const { stage, camera } = window.page;
            stage.look.pixelError = 2;
            const [gl, pixel, seen] = [stage.gl, new Uint8Array(4), []];
            for (let k = 0; k < 400 && (k < 25 || !stage.network.idle); k++) {
                // Nearer step by step, or to the side.
                if (k < 20 && refinement === 'whole') camera.zoom(0.995);
                else if (k < 20) camera.pan(0.002, 0);
                stage.frame();
                gl.readPixels(240, 120, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
                seen.push([stage.mode.shown.length, ...pixel]);
                await new Promise((done) => setTimeout(done, 20));
            }
            return seen;
        }""",
        refinement,
    )
    parts, colors = np.array(seen)[:, 0], np.array(seen)[:, 1:4]
    assert len(set(parts)) > 3
    assert (np.ptp(colors, axis=1) > 60).all()
    assert tab.told_to_user() == []


def test_a_damaged_chunk_is_told_once_and_shown_coarser(site: Site, page, ball):
    path = voxel_file(site)
    nodes = LodFile(path).nodes
    content = bytearray(path.read_bytes())
    for node in nodes[nodes["level"] == 7]:
        content[int(node["offset"]) + int(node["stored"]) // 2] ^= 255
    path.write_bytes(content)
    tab = page(site.folder, f"mode=voxels&light=camera&{VIEW.link}")
    settled(tab, 2.0)
    (told,) = tab.told_to_user()
    assert "damaged" in told
    assert "coarser" in told
    assert max(levels(tab)) == "6"
    assert similarity(tab.picture(), ray_cast(ball, VIEW, WIDTH, HEIGHT)) > 0.7
    assert tab.told == []


def test_a_file_that_is_cut_short_is_told(site: Site, page):
    path = voxel_file(site)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    tab = page(site.folder, "mode=voxels")
    tab.page.wait_for_function("() => document.querySelectorAll('#notices p').length > 0")
    (told,) = tab.told_to_user()
    assert "shorter than it says" in told
    assert not [line for line in tab.told if "exception" in line]


def test_bytes_on_the_card_stay_and_end_below_the_budget(ranges: str, site: Site, show):
    tab = show(f"{ranges}#mode=voxels&{VIEW.link}", width=WIDTH, height=HEIGHT)
    settled(tab, 2.0)
    budget = 1_200_000
    assert tab.value("page.stage.counts.bytes") > budget
    most = tab.page.evaluate(
        """async (budget) => {
            const { stage, camera } = window.page;
            Object.assign(stage.look, { budgetBytes: budget, pixelError: 1 });
            let most = 0;
            for (let k = 0; k < 50; k++) {
                const angle = k / 6;
                const away = 1.3 + 3 * Math.abs(Math.sin(k / 9));
                camera.eye = [away * Math.cos(angle), away * Math.sin(angle), 0.5];
                stage.frame();
                most = Math.max(most, stage.counts.bytes);
                await new Promise((done) => setTimeout(done, 30));
            }
            return most;
        }""",
        budget,
    )
    tab.settled()
    assert 0 < most <= budget
    assert 0 < tab.value("page.stage.counts.bytes") <= budget
    assert tab.value("page.stage.counts.items") > 1000
    assert tab.told_to_user() == []


@pytest.fixture
def columns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[TriangleMesh, Site]:
    """Columns behind a wall that hides most of them, and their site."""
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], np.float64)
    sides = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    box = np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))], np.int32)
    boxes = [((0.0, 0.0, 0.0), (6.3, 0.2, 4.0))]
    boxes += [
        ((0.3 + 1.0 * i, 1.0 + 1.0 * j, 0.0), (0.4, 0.4, 3.0 + 0.2 * ((i + j) % 3)))
        for i in range(8)
        for j in range(7)
    ]
    vertices = np.concatenate([np.array(low) + corners * size for low, size in boxes])
    triangles = np.concatenate([box + 8 * k for k in range(len(boxes))]).astype(np.int32)
    colors = np.repeat(np.arange(len(boxes)) * 37 % 200 + 40, 8)
    color = np.column_stack([colors, 255 - colors, np.roll(colors, 80)]).astype(np.uint8)
    mesh = TriangleMesh(vertices, triangles).with_attributes(color=color)
    write_surface_ply(tmp_path / "boxes.ply", mesh)
    root = create_project(tmp_path / "boxes", geometry=tmp_path / "boxes.ply").root
    (root / "exports").mkdir()
    write_surface_ply(root / "exports" / "surface.ply", mesh)
    monkeypatch.setattr(makers, "_CHUNK_LEVEL", 3)
    site = build_site(Project(root), SiteOptions(resolution=64), Progress())
    origin = np.array(site.scene["origin"])
    return TriangleMesh(mesh.vertices - origin, triangles, mesh.vertex_attributes), site


def rows_seen(mesh: TriangleMesh, site: Site, view: View) -> set[int]:
    """The finest nodes that rays of all pixels meet, one for each pixel and four between."""
    import open3d as o3d

    file = LodFile(voxel_file(site))
    eye = np.array(view.eye)
    ways = pixel_rays(view, WIDTH, HEIGHT, 2).reshape(-1, 3)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(mesh.vertices.astype(np.float32)),
        o3d.core.Tensor(mesh.triangles.astype(np.uint32)),
    )
    rays = np.concatenate([np.broadcast_to(eye, ways.shape), ways], axis=1).astype(np.float32)
    distance = scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
    met = np.isfinite(distance)
    places = eye + ways[met] * distance[met, None] + np.array(site.scene["origin"])
    side = file.grid.voxel_size * 2**file.chunk_level
    cells = np.unique(np.floor((places - file.grid.origin) / side).astype(int), axis=0)
    finest = np.flatnonzero(file.nodes["level"] == file.grid.level)
    row_of = {tuple(file.nodes["place"][row].tolist()): int(row) for row in finest}
    return {row_of[tuple(cell)] for cell in cells.tolist() if tuple(cell) in row_of}


def test_what_is_hidden_is_not_drawn_in_full_and_nothing_seen_is_missing(columns, page):
    mesh, site = columns
    view = View((-0.4, -13.0, 0.4))
    tab = page(site.folder, f"mode=voxels&light=none&{view.link}")
    tab.page.wait_for_function("() => window.page?.stage.mode")
    tab.page.evaluate("() => { page.stage.mode.sight.enabled = false; }")
    settled(tab, 1.0)
    finest = "page.stage.mode.shown.filter(({ coarse }) => !coarse)"
    every = set(tab.value(f"{finest}.map(({{ node }}) => node.row)"))
    full = tab.picture()
    tab.page.evaluate("() => { page.stage.mode.sight.enabled = true; page.stage.redraw(); }")
    settled(tab, 1.0)
    drawn = set(tab.value(f"{finest}.map(({{ node }}) => node.row)"))
    hidden = every - rows_seen(mesh, site, view)
    assert len(hidden) > 100
    assert len(hidden & drawn) < 0.2 * len(hidden)
    # Nothing that is seen is missing, and hardly a pixel is another.
    picture = tab.picture()
    there = np.abs(full.astype(int) - BACKGROUND).max(axis=2) > 2
    missing = there & (np.abs(picture.astype(int) - BACKGROUND).max(axis=2) <= 2)
    assert there.sum() > 12_000
    assert missing.sum() == 0
    other = np.abs(full.astype(int) - picture.astype(int)).max(axis=2) > 24
    assert other.mean() < 0.002


def test_frames_of_zstd_are_unpacked_as_they_were(site: Site, page):
    rng = np.random.default_rng(5)
    few = bytes(rng.integers(0, 5, 60_000, dtype=np.uint8))
    contents = [
        b"", b"a", bytes(70_000), bytes(rng.integers(0, 256, 3_000, dtype=np.uint8)), few,
        b"one and two and one and two " * 400,
        np.cumsum(rng.integers(-2, 3, 50_000)).astype("<i4").tobytes(),
        bytes(np.minimum(rng.geometric(0.02, 40_000), 255).astype(np.uint8)),
    ]  # fmt: skip
    packed = [
        (
            zstandard.ZstdCompressor(level=level, write_checksum=level == 3).compress(content),
            content,
        )
        for content in contents
        for level in (-5, 1, 3, 19)
    ]
    tab = page(site.folder, "")
    tab.page.wait_for_function("() => window.page")
    wrong = tab.page.evaluate(
        """async (frames) => {
            const { unpacked } = await import('./modes/zstd.js');
            const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
            return frames.filter(([frame, content]) => {
                const plain = bytes(content);
                const own = unpacked(bytes(frame), plain.length);
                return own.some((byte, k) => byte !== plain[k]);
            }).length;
        }""",
        [[base64.b64encode(part).decode() for part in pair] for pair in packed],
    )
    assert wrong == 0
    # A frame that is cut or changed gives an error, or at least no more than was asked for.
    frame, content = packed[4 * 5 + 1]
    told = tab.page.evaluate(
        """async ([frame, length]) => {
            const { unpacked } = await import('./modes/zstd.js');
            const bytes = Uint8Array.from(atob(frame), (c) => c.charCodeAt(0));
            try {
                unpacked(bytes.subarray(0, bytes.length - 4), length);
                return 'nothing';
            } catch (error) {
                return error.message;
            }
        }""",
        [base64.b64encode(frame).decode(), len(content)],
    )
    assert "damaged" in told
