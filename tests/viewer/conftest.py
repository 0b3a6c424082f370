"""A project with a surface, its site, web servers of several kinds, and a browser with WebGL2."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.viewer.looking import HEIGHT, WIDTH
from workbench.formats.surface_files import read_surface, write_surface_glb, write_surface_ply
from workbench.geometry.mesh import TriangleMesh, vertex_normals
from workbench.pipeline.progress import Progress
from workbench.project.creation import create_project
from workbench.project.project import Project
from workbench.viewer.representations import SiteOptions
from workbench.viewer.server import site_server
from workbench.viewer.site import Site, build_site

#: Far from the origin, as georeferenced models are.
PLACE = np.array([4_000_000.0, 2_500_000.0, 300.0])
COARSE = SiteOptions(resolution=256, surfels=5000)


@pytest.fixture(scope="session")
def made_once(
    tmp_path_factory: pytest.TempPathFactory, sphere: Callable[..., TriangleMesh]
) -> Path:
    """A folder with a ball of radius 1 m, blue below and yellow above, and a project of it.

    Its upper half counts as filled in. The forms of the ball for the browser are made in it.
    """
    folder = tmp_path_factory.mktemp("ball")
    ball = sphere(center=PLACE, subdivisions=5)
    above = ball.vertices[:, 2:] > PLACE[2]
    color = np.where(above, [[220, 180, 40]], [[30, 60, 190]]).astype(np.uint8)
    mesh = ball.with_attributes(
        color=color,
        normal=vertex_normals(ball),
        provenance=above[:, 0].astype(np.uint8),
        color_provenance=np.zeros(len(color), np.uint8),
        distance_to_samples_m=np.where(
            above[:, 0], np.inf, 0.002 * (PLACE[2] - ball.vertices[:, 2])
        ),
    )
    write_surface_ply(folder / "ball.ply", mesh)
    root = create_project(folder / "ball", geometry=folder / "ball.ply").root
    (root / "exports").mkdir()
    write_surface_ply(root / "exports" / "surface.ply", mesh)
    local = TriangleMesh(mesh.vertices - PLACE, mesh.triangles, mesh.vertex_attributes)
    write_surface_glb(root / "exports" / "surface.glb", local, tuple(PLACE))
    build_site(Project(root), COARSE, Progress())
    return folder


@pytest.fixture
def project(made_once: Path, tmp_path: Path) -> Project:
    """A project of the ball for this test alone; its forms for the browser are made already."""
    shutil.copytree(made_once, tmp_path, dirs_exist_ok=True)
    return Project(tmp_path / "ball")


@pytest.fixture
def site(project: Project) -> Site:
    """The ball's site with coarse forms."""
    return build_site(project, COARSE, Progress())


@pytest.fixture
def ball(project: Project) -> TriangleMesh:
    """The ball's surface in the local coordinates of its site."""
    mesh = read_surface(project.root / "exports" / "surface.ply")
    return TriangleMesh(mesh.vertices - PLACE, mesh.triangles, mesh.vertex_attributes)


@pytest.fixture
def ranges(site: Site) -> Iterator[str]:
    """The address of a server of the site that hands out parts of files."""
    server = site_server(site)
    thread = threading.Thread(target=server.serve)
    thread.start()
    yield server.url
    server.stop()
    thread.join()


class Answers(SimpleHTTPRequestHandler):
    """Static files without ranges, as ``python -m http.server`` hands them out."""

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing."""


@pytest.fixture
def serve() -> Iterator[Callable[..., str]]:
    """A function from a folder (and a handler) to the address of a server of it."""
    servers = []

    def start(folder: Path, handler: type[SimpleHTTPRequestHandler] = Answers) -> str:
        server = ThreadingHTTPServer(("127.0.0.1", 0), partial(handler, directory=str(folder)))
        servers.append(server)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        return f"http://127.0.0.1:{server.server_address[1]}/"

    yield start
    for server in servers:
        server.shutdown()
        server.server_close()


@dataclass
class Tab:
    """A page in the browser, and what its console said."""

    page: Any
    told: list[str]

    def settled(self, timeout_ms: int = 30_000) -> None:
        """Wait until something is drawn and nothing more is to come."""
        self.page.wait_for_function(
            "() => window.page?.stage.mode && !window.page.stage.pending", timeout=timeout_ms
        )
        self.page.evaluate("() => new Promise(done => requestAnimationFrame(() => done()))")

    def picture(self) -> np.ndarray:
        """What the canvas shows, (h, w, 3) uint8 sRGB."""
        self.page.evaluate("() => document.activeElement.blur()")
        shot = self.page.locator("#picture").screenshot()
        return cv2.imdecode(np.frombuffer(shot, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]

    def told_to_user(self) -> list[str]:
        """The messages on the page."""
        return [p.get_attribute("data-message") for p in self.page.locator("#notices p").all()]

    def value(self, expression: str) -> Any:
        """Of a JavaScript expression; the page is ``page``."""
        return self.page.evaluate(f"() => {{ const page = window.page; return {expression}; }}")


@pytest.fixture(scope="session")
def browser(chromium: Callable[..., Any]) -> Any:
    """Chromium without a window, drawing on the processor."""
    return chromium(
        "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"
    )


@pytest.fixture
def show(browser: Any) -> Iterator[Callable[..., Tab]]:
    """A function that opens an address in a tab of its own, 640 × 480 pixels for the picture."""
    contexts = []

    def open_tab(address: str, *, width: int = 640, height: int = 480) -> Tab:
        # The panel takes 18 rem beside the picture.
        context = browser.new_context(viewport={"width": width + 288, "height": height})
        contexts.append(context)
        page = context.new_page()
        tab = Tab(page, [])
        page.on("console", lambda message: tab.told.append(f"{message.type}: {message.text}"))
        page.on("pageerror", lambda error: tab.told.append(f"exception: {error}"))
        page.goto(address)
        return tab

    yield open_tab
    for context in contexts:
        context.close()


@pytest.fixture
def page(serve: Callable[..., str], show: Callable[..., Tab]) -> Callable[..., Tab]:
    """A function from a folder and the rest of the address to a tab with a small picture."""

    def opened(folder: Path, link: str, handler: type[Answers] = Answers) -> Tab:
        return show(f"{serve(folder, handler)}#{link}", width=WIDTH, height=HEIGHT)

    return opened
