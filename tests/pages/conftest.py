"""A small project to draw masks in, the page served, and a browser."""

from __future__ import annotations

import subprocess
import sys
import threading
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from workbench.pages.mask_editor import mask_editor_server
from workbench.project.creation import create_project
from workbench.project.project import Project

WIDTH, HEIGHT = 240, 180
_SERVED = """
import sys
from workbench.pages.mask_editor import mask_editor_server
from workbench.project.project import Project
server = mask_editor_server(Project(sys.argv[1]), int(sys.argv[2]))
print(server.url, flush=True)
server.serve()
"""


def object_mask() -> np.ndarray:
    """True inside the ellipse that every photograph of the project shows."""
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    return ((x - 120) / 60) ** 2 + ((y - 90) / 45) ** 2 < 1


@pytest.fixture
def project(tmp_path) -> Project:
    """Three photographs of an orange ellipse on blue."""
    rng = np.random.default_rng(5)
    picture = np.where(object_mask()[..., None], (220, 120, 40), (40, 70, 150))
    folder = tmp_path / "photos"
    folder.mkdir()
    for name in ("a", "b", "c"):
        noisy = picture + rng.normal(0, 6, picture.shape)
        Image.fromarray(noisy.clip(0, 255).astype(np.uint8)).save(folder / f"{name}.png")
    return create_project(tmp_path / "project", photos=[folder])


@pytest.fixture
def server(project):
    """The page, answering from a thread of this process."""
    made = mask_editor_server(project)
    thread = threading.Thread(target=made.serve)
    thread.start()
    yield made
    made.stop()
    thread.join()


@dataclass
class Served:
    """The page, served by a process of its own that can be killed."""

    process: subprocess.Popen
    url: str

    @property
    def port(self) -> int:
        return int(self.url.split(":")[2].split("/")[0])

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()


@pytest.fixture
def serve(project):
    """A function that starts the page in a process; all are killed in the end."""
    started = []

    def start(port: int = 0) -> Served:
        command = [sys.executable, "-c", _SERVED, str(project.root), str(port)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        started.append(Served(process, process.stdout.readline().strip()))
        return started[-1]

    yield start
    for served in started:
        served.kill()


@pytest.fixture(scope="session")
def browser(chromium):
    """Chromium without a window."""
    return chromium()


@pytest.fixture
def tabs(browser):
    """A function that opens a tab at an address; all tabs share one store.

    At the end no tab may have reported an error or asked for anything off this machine.
    """
    context = browser.new_context(viewport={"width": 1100, "height": 700})
    context.set_default_timeout(15_000)
    told, asked = [], []

    def open_tab(url: str):
        tab = context.new_page()
        tab.on("console", lambda message: told.append(f"{message.type}: {message.text}"))
        tab.on("pageerror", lambda error: told.append(f"exception: {error}"))
        tab.on("request", lambda request: asked.append(request.url))
        tab.goto(url)
        return tab

    open_tab.expected = lambda message: False
    yield open_tab
    context.close()
    assert [line for line in told if not open_tab.expected(line)] == []
    local = ("http://127.0.0.1:", "blob:http://127.0.0.1:")
    assert [url for url in asked if not url.startswith(local)] == []


@pytest.fixture
def drawn(project):
    """A function to the mask a project holds of a photograph, as booleans; None without."""

    def read(role: str, name: str = "a") -> np.ndarray | None:
        path = Path(project.root) / "masks" / role / f"{name}.png"
        return np.asarray(Image.open(path).convert("L")) > 127 if path.exists() else None

    return read


@pytest.fixture
def editor(server, tabs):
    """The page in a browser, at the first photograph."""
    from .editor import Editor

    return Editor(tabs(server.url))
