"""The page with the points of the scans: what it shows, reads, keeps, and does without."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from tests.viewer.conftest import PLACE, Answers, Tab
from tests.viewer.looking import BACKGROUND, HEIGHT, WIDTH, View, ray_cast, similarity
from workbench.cloud.point_export import export_points
from workbench.geometry.point_set import PointSet
from workbench.pipeline.progress import Progress
from workbench.project.project import Project
from workbench.viewer.drawn_models import drawn_model
from workbench.viewer.representations import SiteOptions
from workbench.viewer.site import Site, build_site
from workbench.viewer.wanted_views import WantedView

VIEW = View((1.2, -4.0, 1.1))
FAR = View((18.0, -60.0, 16.5))
POINTS = 150_000


@pytest.fixture
def cloud(project: Project) -> Path:
    """Points all over the ball, coloured as it is, in the project's folder for Potree."""
    rng = np.random.default_rng(7)
    normals = rng.normal(size=(POINTS, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    color = np.where(normals[:, 2:] > 0.0, [[220, 180, 40]], [[30, 60, 190]]).astype(np.uint8)
    points = PointSet(PLACE + normals, normals.astype(np.float32), color, None)
    export_points(points, project.root / "exports" / "potree", "potree")
    return project.root / "exports" / "potree"


@pytest.fixture
def site(project: Project, cloud: Path) -> Site:
    return build_site(project, SiteOptions(resolution=256, surfels=5000), Progress())


def look_from(tab: Tab, view: View, pixel_error: float = 1.0) -> None:
    eye = ",".join(map(str, view.eye))
    tab.page.wait_for_function("() => window.page?.stage.mode")
    tab.page.evaluate(
        f"""() => {{
            window.page.camera.read({{ eye: '{eye}', to: '0,0,0' }});
            window.page.stage.look.pixelError = {pixel_error};
            window.page.stage.redraw();
        }}"""
    )
    tab.settled()


def test_it_shows_the_points_as_a_closed_surface(project: Project, site: Site, serve, show, ball):
    tab = show(
        f"{serve(site.folder)}#mode=cloud&light=camera&{VIEW.link}", width=WIDTH, height=HEIGHT
    )
    look_from(tab, VIEW)
    picture = tab.picture()
    # A server without ranges is asked for no file twice.
    folder = project.root / "exports" / "potree"
    assert tab.value("page.network.bytes") <= sum(f.stat().st_size for f in folder.iterdir())
    assert similarity(picture, ray_cast(ball, VIEW, WIDTH, HEIGHT)) > 0.9
    wanted = WantedView.of_texts(VIEW.link, f"{WIDTH}x{HEIGHT}", "camera")
    own = drawn_model(project.root, "cloud", wanted).picture
    without = np.where(own[..., 3:] > 0, own[..., :3], BACKGROUND).astype(np.uint8)
    assert similarity(picture, without) > 0.98
    assert tab.value("page.stage.counts.items") == POINTS
    place = np.array(tab.value("page.stage.placeAt(240, 120)"))
    assert np.linalg.norm(place) == pytest.approx(1.0, abs=0.01)
    assert tab.told == []
    assert tab.told_to_user() == []


def test_far_points_are_left_on_the_server_and_old_ones_leave_the_card(
    ranges: str, site: Site, show, cloud: Path
):
    tab = show(f"{ranges}#mode=cloud&{FAR.link}", width=WIDTH, height=HEIGHT)
    look_from(tab, FAR)
    size = (cloud / "octree.bin").stat().st_size
    few = tab.value("page.stage.counts.items")
    assert 0 < few < POINTS / 2
    assert tab.value("page.network.bytes") < size / 2
    # Half of what all points take, from all sides: what is shown and kept stays below.
    budget = POINTS * 16 // 2
    tab.page.evaluate(f"() => {{ page.stage.look.budgetBytes = {budget}; }}")
    for eye in ((0.1, -4.0, 0.0), (0.1, 4.0, 0.0), (3.0, 0.0, 3.0), (1.1, 0.0, 0.3)):
        look_from(tab, View(eye))
        assert 0 < tab.value("page.stage.counts.bytes") <= budget
        assert tab.value("page.stage.counts.items") > few / 4
    assert tab.told_to_user() == []


def test_a_part_that_is_not_there_is_told_and_shown_coarser(site: Site, serve, show, ball):
    # The last node of the finest level is looked for beyond the end of the file.
    (hierarchy,) = site.folder.rglob("hierarchy.bin")
    rows = bytearray(hierarchy.read_bytes())
    rows[-16:-8] = (1 << 40).to_bytes(8, "little")
    hierarchy.write_bytes(rows)
    tab = show(
        f"{serve(site.folder)}#mode=cloud&light=camera&{VIEW.link}", width=WIDTH, height=HEIGHT
    )
    # From both sides, so that it is asked for.
    look_from(tab, View((-1.2, 4.0, -1.1)))
    look_from(tab, VIEW)
    (told,) = tab.told_to_user()
    assert "shorter than it says" in told
    assert "coarser" in told
    # The message lies over the picture.
    tab.page.locator("#notices button").click()
    assert similarity(tab.picture(), ray_cast(ball, VIEW, WIDTH, HEIGHT)) > 0.9
    assert not [line for line in tab.told if "exception" in line]


class Slow(Answers):
    """Takes its time over the points."""

    def do_GET(self) -> None:  # noqa: N802
        if self.path.endswith("octree.bin"):
            time.sleep(1.0)
        super().do_GET()


def test_a_server_that_takes_too_long_is_told(site: Site, serve, show):
    tab = show(f"{serve(site.folder, Slow)}#mode=surface&{VIEW.link}", width=WIDTH, height=HEIGHT)
    tab.settled()
    tab.page.evaluate("() => { page.network.timeoutMs = 200; }")
    tab.page.locator('[data-mode="cloud"]').click()
    tab.page.wait_for_function("() => document.querySelectorAll('#notices p').length > 0")
    tab.settled()
    assert all("The server took longer than" in line for line in tab.told_to_user())
    assert not [line for line in tab.told if "exception" in line]


@pytest.mark.parametrize(
    ("name", "words"), [("metadata.json", "no JSON"), ("hierarchy.bin", "shorter than it says")]
)
def test_a_damaged_description_is_told(site: Site, serve, show, name: str, words: str):
    (file,) = site.folder.rglob(name)
    file.write_bytes(file.read_bytes()[:-4])
    tab = show(f"{serve(site.folder)}#mode=cloud", width=WIDTH, height=HEIGHT)
    tab.page.wait_for_function("() => document.querySelectorAll('#notices p').length > 0")
    (told,) = tab.told_to_user()
    assert words in told
    assert not [line for line in tab.told if "exception" in line]


def test_a_project_without_such_an_export_says_how_to_get_it(project: Project):
    (project.root / "exports" / "surface.ply").unlink()
    scene = build_site(project, SiteOptions(resolution=256, surfels=5000), Progress()).scene
    reasons = {one["mode"]: one["reason"] for one in scene["left_out"]}
    assert "export.clouds=potree" in reasons["cloud"]
