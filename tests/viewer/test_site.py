"""The folder of a site, and the loopback server of it."""

from __future__ import annotations

import json
import shutil
import threading
import urllib.error
import urllib.request
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.viewer.conftest import PLACE
from workbench.errors import InputError
from workbench.formats.surface_files import write_surface_ply
from workbench.pipeline.progress import Progress
from workbench.project.project import Project
from workbench.viewer.representations import SiteOptions
from workbench.viewer.server import site_server
from workbench.viewer.site import Site, build_site, publish


def test_a_site_tells_where_the_model_is_and_what_there_is_not(site: Site):
    scene = json.loads((site.folder / "scene.json").read_text())
    np.testing.assert_allclose(scene["origin"], PLACE, atol=1e-6)
    np.testing.assert_allclose(scene["bounds"], [[-1, -1, -1], [1, 1, 1]], atol=2e-3)
    # All of the ball is seen from the first place: it fits into the angle of view.
    home = scene["home"]
    away = np.linalg.norm(np.subtract(home["eye"], home["to"])) - np.linalg.norm(home["to"])
    assert scene["unit"] == "m"
    assert np.arcsin(1 / away) < np.radians(scene["home"]["fov"]) / 2
    modes = {mode["mode"]: mode for mode in scene["modes"]}
    assert modes["surface"]["items"] == 20 * 4**5
    for mode in modes.values():
        file = site.folder / mode["file"]
        assert file.is_file()
        assert mode["bytes"] >= file.stat().st_size
    left_out = {one["mode"]: one["reason"] for one in scene["left_out"]}
    assert "workbench texture" in left_out["textured"]


def test_what_did_not_change_is_not_made_again(site: Site, project: Project):
    def stamps() -> dict[str, int]:
        data = site.folder / "data"
        return {str(p.relative_to(data)): p.stat().st_mtime_ns for p in data.rglob("made.json")}

    before = stamps()
    options = SiteOptions(resolution=256, surfels=5000)
    build_site(Project(project.root), options, Progress())
    assert stamps() == before
    # Another surface gives other forms, and the old ones go.
    from workbench.formats.surface_files import read_surface

    ply = project.root / "exports" / "surface.ply"
    mesh = read_surface(ply)
    write_surface_ply(ply, replace(mesh, vertices=mesh.vertices * 1.0 + [0.0, 0.0, 0.5]))
    scene = build_site(Project(project.root), options, Progress()).scene
    assert scene["origin"][2] == pytest.approx(PLACE[2] + 0.5, abs=1e-6)
    changed = {name.split("-")[0] for name in set(stamps()) - set(before)}
    assert "surface" not in changed
    assert len(stamps()) == len(before)


def test_publishing_replaces_a_site_and_nothing_else(site: Site, tmp_path: Path):
    out = tmp_path / "public"
    made = publish(site, out)
    assert made.bytes == sum(p.stat().st_size for p in out.rglob("*") if p.is_file())
    assert not list(out.rglob("made.json"))
    (out / "left.txt").write_text("of an older site")
    publish(site, out)
    assert not (out / "left.txt").exists()
    other = tmp_path / "thesis"
    other.mkdir()
    (other / "chapter.txt").write_text("years of work")
    with pytest.raises(InputError, match="something else"):
        publish(site, other)
    assert (other / "chapter.txt").read_text() == "years of work"


def test_a_project_without_exports_says_what_to_do(project: Project):
    shutil.rmtree(project.root / "exports")
    with pytest.raises(InputError) as caught:
        build_site(project, SiteOptions(), Progress())
    assert "workbench export" in caught.value.fix


@pytest.fixture
def served(site: Site):
    """The loopback server of the ball's site."""
    server = site_server(site)
    thread = threading.Thread(target=server.serve)
    thread.start()
    yield server
    server.stop()
    thread.join()


def ask(url: str, **headers: str) -> tuple[int, dict[str, str], bytes]:
    request = urllib.request.Request(
        url, headers={k.replace("_", "-"): v for k, v in headers.items()}
    )
    try:
        with urllib.request.urlopen(request, timeout=10) as answer:
            return answer.status, dict(answer.headers), answer.read()
    except urllib.error.HTTPError as error:
        return error.code, dict(error.headers), error.read()


def test_parts_of_files_are_handed_out(served, site: Site):
    mode = next(mode for mode in site.scene["modes"] if mode["mode"] == "surface")
    whole = (site.folder / mode["file"]).read_bytes()
    url = served.url + mode["file"]
    assert ask(url)[::2] == (200, whole)
    for asked, part in (
        ("bytes=0-3", whole[:4]), ("bytes=100-199", whole[100:200]), ("bytes=-10", whole[-10:]),
        (f"bytes={len(whole) - 5}-", whole[-5:]), (f"bytes=10-{len(whole) + 99}", whole[10:]),
    ):  # fmt: skip
        status, headers, body = ask(url, Range=asked)
        assert (status, body) == (206, part)
        assert headers["Content-Range"].endswith(f"/{len(whole)}")
        assert int(headers["Content-Length"]) == len(part)
    status, headers, _ = ask(url, Range=f"bytes={len(whole)}-")
    assert (status, headers["Content-Range"]) == (416, f"bytes */{len(whole)}")
    for odd in ("bytes=5", "bytes=1-2,4-5", "lines=1-2"):
        assert ask(url, Range=odd)[0] == 200


def test_nothing_but_the_site_is_handed_out(served, site: Site):
    assert b"<canvas" in ask(served.url)[2]
    (site.folder / "later.txt").write_text("not listed")
    for name in (
        "later.txt",
        "../../project.toml",
        "%2e%2e/%2e%2e/project.toml",
        "data",
        "/etc/passwd",
    ):
        assert ask(served.url + name)[0] in (403, 404), name
    token = served.url.rstrip("/").rsplit("/", 1)[1]
    assert ask(served.url.replace(token, "x" * len(token)))[0] == 403
    assert ask(served.url, Host="elsewhere.example")[0] == 403
    assert ask(served.url, Origin="https://elsewhere.example")[0] == 403
