"""Pictures without a browser: those of the page, from the same links."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.viewer.conftest import PLACE
from tests.viewer.looking import BACKGROUND, View, ray_cast, similarity
from workbench.cli import run_cli
from workbench.errors import SettingsError
from workbench.formats.surface_files import read_surface
from workbench.formats.textured_gltf import write_textured_glb
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.surface_texture import SurfaceTexture
from workbench.geometry.textured_mesh import TexturedMesh
from workbench.project.project import Project
from workbench.viewer.link_views import LinkView
from workbench.viewer.page_light import lit
from workbench.viewer.site import Site
from workbench.viewer.surface_pictures import surface_picture
from workbench.viewer.wanted_views import WantedView

VIEW = View((1.2, -4.0, 1.1))


@pytest.fixture
def render(capsys, tmp_path):
    """Run the command; returns what it told and the picture over the page's background."""

    def call(path: Path, mode: str, camera: str, size: str = "640x480", *more: str):
        out = tmp_path / "picture.png"
        given = ("--mode", mode, f"--camera={camera}", "--size", size, "--out", str(out), *more)
        capsys.readouterr()
        assert run_cli((), ["render", str(path), *given, "--json"]) == 0
        drawn = cv2.imread(str(out), cv2.IMREAD_UNCHANGED).astype(float)
        share = drawn[..., 3:] / 255
        over = np.rint(share * drawn[..., 2::-1] + (1 - share) * BACKGROUND).astype(np.uint8)
        return json.loads(capsys.readouterr()[0]), over

    return call


def test_the_same_link_gives_the_same_picture_with_and_without_a_browser(
    project: Project, site: Site, serve, show, render
):
    tab = show(f"{serve(site.folder)}#mode=surface&light=camera&{VIEW.link}", width=480, height=240)
    for mode in ("surface", "surfels"):
        tab.page.evaluate(f"() => {{ location.hash = 'mode={mode}&light=camera&{VIEW.link}' }}")
        tab.page.wait_for_function(f"() => window.page?.stage.entry?.mode === '{mode}'")
        tab.page.evaluate("() => { page.stage.look.pixelError = 1; page.stage.redraw(); }")
        tab.settled()
        told, own = render(project.root, mode, VIEW.link, "480x240")
        assert similarity(tab.picture(), own) > 0.99, mode
        assert told["camera"] == {"eye": [1.2, -4.0, 1.1], "to": [0.0, 0.0, 0.0], "fov": 35.0}


@pytest.mark.parametrize("mode", ["voxels", "graph"])
def test_voxels_are_those_of_the_page(project: Project, site: Site, serve, show, render, mode: str):
    tab = show(f"{serve(site.folder)}#mode={mode}&light=camera&{VIEW.link}", width=480, height=240)
    tab.page.wait_for_function("() => window.page?.stage.mode")
    tab.page.evaluate("() => { page.stage.look.pixelError = 1; page.stage.redraw(); }")
    tab.page.wait_for_timeout(50)
    tab.settled(60_000)
    _, own = render(project.root, mode, VIEW.link, "480x240", "--light", "camera")
    assert similarity(tab.picture(), own) > 0.98


def test_a_lamp_belongs_to_voxels(project: Project, tmp_path, capsys):
    given = ["render", str(project.root), "--mode", "surface", "--light", "lamp"]
    assert run_cli((), [*given, "--out", str(tmp_path / "a.png"), "--json"]) == 2
    assert "shadows" in json.loads(capsys.readouterr()[0])["error"]["message"]


def test_a_surface_is_what_rays_meet_wherever_it_stands(project: Project, render):
    mesh = read_surface(project.root / "exports" / "surface.ply")
    local = TriangleMesh(mesh.vertices - PLACE, mesh.triangles, mesh.vertex_attributes)
    told, own = render(project.root, "surface", VIEW.link.replace("&", ";"), "160x120")
    assert similarity(own, ray_cast(local, VIEW, 160, 120)) > 0.995
    # A ball of radius 1 from a distance d shows as a disc of the angle asin(1 / d).
    away = np.linalg.norm(VIEW.eye)
    radius = np.tan(np.arcsin(1 / away)) / np.tan(np.radians(17.5)) * 60
    assert told["shown"] == pytest.approx(np.pi * radius**2 / (160 * 120), rel=0.03)


def test_a_camera_around_the_object_is_told_as_a_link(project: Project, render):
    told, around = render(project.root, "surface", "30,15", "120x90")
    words = {key: told["camera"][key] for key in ("eye", "to")}
    link = ";".join(f"{key}={','.join(map(repr, place))}" for key, place in words.items())
    _, by_link = render(project.root, "surface", f"{link};fov={told['camera']['fov']!r}", "120x90")
    assert told["camera"]["fov"] == pytest.approx(35.0)
    np.testing.assert_allclose(told["camera"]["to"], 0.0, atol=1e-9)
    assert np.abs(around.astype(int) - by_link).max() <= 1


def square(picture: np.ndarray) -> tuple[TriangleMesh, SurfaceTexture]:
    """A square of 2 m that faces −y with a picture on it."""
    corners = np.array([[-1.0, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1]])
    triangles = np.array([[0, 2, 1], [0, 3, 2]], np.int32)
    places = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    return (
        TriangleMesh(corners, triangles),
        SurfaceTexture(places, np.zeros(2, np.int32), (picture,)),
    )


def test_texels_are_where_they_belong_and_fine_ones_are_averaged():
    quarters = np.zeros((64, 64, 3), np.uint8)
    quarters[:32, :32], quarters[:32, 32:], quarters[32:, :32] = (
        (255, 0, 0),
        (0, 255, 0),
        (0, 0, 255),
    )
    # The square fills a quarter of the picture's sides.
    view = LinkView((0.0, -8.0, 0.0), fov=float(np.degrees(2 * np.arctan(0.5))))
    camera = view.camera(np.zeros(3), 128, 128)
    seen = surface_picture(*square(quarters), camera, "even")
    np.testing.assert_array_equal(seen[54, 54], [255, 0, 0, 255])
    np.testing.assert_array_equal(seen[54, 74], [0, 255, 0, 255])
    np.testing.assert_array_equal(seen[74, 54], [0, 0, 255, 255])
    assert (seen[..., 3] == 255).sum() == 32 * 32
    assert not seen[20, 20].any()
    # Black and white by turns are half of the light, not half of the number.
    fine = np.tile(np.array([[0, 255], [255, 0]], np.uint8), (256, 256))[..., None].repeat(3, 2)
    seen = surface_picture(*square(fine), camera, "even")
    assert np.abs(seen[50:78, 50:78, :3].astype(int) - 188).max() <= 1


def test_a_textured_surface_far_away_is_drawn_in_its_place(project: Project, render):
    # So far that the file keeps the place beside the mesh.
    mesh = read_surface(project.root / "exports" / "surface.ply")
    local = TriangleMesh(mesh.vertices - PLACE, mesh.triangles)
    half = np.full((len(mesh.vertices), 2), 0.5)
    page = np.full((4, 4, 3), (200, 30, 20), np.uint8)
    textured = TexturedMesh(local, half, np.zeros(len(mesh.triangles), np.int32), (page,))
    told, plain = render(project.root, "surface", VIEW.link, "160x120")
    write_textured_glb(project.root / "exports" / "textured.glb", textured, tuple(PLACE))
    again, own = render(project.root, "surface", VIEW.link, "160x120")
    assert again["shown"] == pytest.approx(told["shown"], abs=0.002)
    # Even light: the colour is that of the picture.
    assert np.abs(own[60, 80].astype(int) - [200, 30, 20]).max() <= 2
    assert (plain[0, 0] == own[0, 0]).all()


def test_light_from_the_camera_falls_as_the_cosine_on_either_side():
    albedo = np.full((4, 3), 0.5)
    normals = np.array([[0, 0, 2.0], [0, 0, -1], [0, np.sqrt(3), 1], [0, 0, 0]])
    ways = np.broadcast_to([0, 0, -3.0], (4, 3))
    np.testing.assert_allclose(
        lit(albedo, normals, ways, "camera")[:, 0], [0.5, 0.5, 0.5 * 0.65, 0.5]
    )
    np.testing.assert_array_equal(lit(albedo, normals, ways, "even"), albedo)


@pytest.mark.parametrize(
    "text",
    [
        "eye=1,2", "to=0,0,0", "eye=1,2,3;to=1,2,3", "eye=0,0,5;to=0,0,0", "eye=1,2,nan",
        "eye=1,2,3;fov=200", "eye=1,2,3;roll=3",
    ],
)  # fmt: skip
def test_links_that_show_nothing_are_told(text: str):
    with pytest.raises(SettingsError, match="not understood"):
        WantedView.of_texts(text, "640x480")


def test_a_project_whose_surfels_nobody_made_says_how(project: Project, tmp_path, capsys):
    shutil.rmtree(project.root / "work" / "view")
    out = str(tmp_path / "a.png")
    given = ["render", str(project.root), "--mode", "surfels", "--out", out, "--json"]
    assert run_cli((), given) == 2
    assert "workbench export" in json.loads(capsys.readouterr()[0])["error"]["fix"]
