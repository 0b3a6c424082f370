"""The server of a site among links and clients that do not read."""

from __future__ import annotations

import socket
import threading
import time
import urllib.error
import urllib.request
from pathlib import Path

import psutil
import pytest

from workbench.errors import InputError
from workbench.pipeline.progress import Progress
from workbench.project.project import Project
from workbench.viewer.representations import SiteOptions
from workbench.viewer.server import site_server
from workbench.viewer.site import Site, build_site, publish

_LARGE = 1 << 28


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    path = tmp_path / "secret.txt"
    path.write_text("secret")
    return path


@pytest.fixture
def started(site: Site, secret: Path):
    """A served site with a large file in it, and a link that leads out of it."""
    large, link = site.folder / "data" / "large.bin", site.folder / "data" / "link.txt"
    with open(large, "wb") as file:
        file.truncate(_LARGE)
    link.symlink_to(secret)
    server = site_server(site)
    thread = threading.Thread(target=server.serve)
    thread.start()
    yield server
    server.stop()
    thread.join()
    large.unlink()
    link.unlink()


def status(url: str) -> int:
    try:
        with urllib.request.urlopen(url, timeout=10) as answer:
            return answer.status
    except urllib.error.HTTPError as error:
        return error.code


def test_links_are_not_followed_out_of_the_site(started, site: Site, secret: Path):
    assert status(started.url + "data/link.txt") == 404
    large = site.folder / "data" / "large.bin"
    aside = large.with_name("aside.bin")
    assert status(started.url + "data/large.bin") == 200
    large.rename(aside)
    try:
        # Listed when it was a file; a link by now.
        large.symlink_to(secret)
        assert status(started.url + "data/large.bin") == 404
    finally:
        large.unlink()
        aside.rename(large)


def test_who_does_not_read_costs_little_and_keeps_nobody_waiting(started):
    host, port, token = *started.url.split("/")[2].split(":"), started.token
    before = psutil.Process().memory_info().rss
    clients = [socket.create_connection((host, int(port)), timeout=10) for _ in range(20)]
    try:
        for client in clients:
            asked = f"GET /{token}/data/large.bin HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n"
            client.sendall(asked.encode())
        start = time.monotonic()
        assert status(started.url) == 200
        assert time.monotonic() - start < 5
        # A piece of a mebibyte each and some of the system's, not the file.
        assert psutil.Process().memory_info().rss - before < 200 * 2**20
    finally:
        for client in clients:
            client.close()


def test_a_site_with_a_link_is_not_published(site: Site, secret: Path, tmp_path: Path):
    link = site.folder / "data" / "link.txt"
    link.symlink_to(secret)
    try:
        with pytest.raises(InputError, match="link in the site"):
            publish(site, tmp_path / "public")
        assert not (tmp_path / "public").exists()
    finally:
        link.unlink()


def test_notes_that_are_damaged_are_made_again(site: Site, project: Project):
    note = next((site.folder / "data").rglob("made.json"))
    before = note.read_text()
    for damage in ("", "[" * 5000, '{"items": 1}', '{"items": 1, "unit": "a", "x": 2}'):
        note.write_text(damage)
        build_site(Project(project.root), SiteOptions(resolution=256, surfels=5000), Progress())
        assert note.read_text() == before


def test_nothing_from_elsewhere_is_shown(site: Site, project: Project, secret: Path):
    surface = project.root / "exports" / "surface.glb"
    surface.unlink()
    surface.symlink_to(secret)
    with pytest.raises(InputError, match="leads out of the project"):
        build_site(Project(project.root), SiteOptions(resolution=256, surfels=5000), Progress())
