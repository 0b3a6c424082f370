"""The page with the surface as triangles: what it shows, and what hands do."""

from __future__ import annotations

from collections.abc import Callable
from http.server import SimpleHTTPRequestHandler
from typing import Any

import numpy as np
import pytest

from tests.viewer.conftest import Answers
from tests.viewer.looking import View, ray_cast, similarity
from workbench.viewer.site import Site

VIEW = View((1.2, -4.0, 1.1))


def test_it_shows_what_rays_meet(site: Site, serve, show, ball):
    tab = show(f"{serve(site.folder)}#mode=surface&{VIEW.link}")
    tab.settled()
    assert similarity(tab.picture(), ray_cast(ball, VIEW)) > 0.99
    assert tab.told == []
    assert tab.told_to_user() == []
    assert tab.value("page.stage.counts.items") == 20 * 4**5
    # Bytes on the card: positions, normals, colours, provenances, distances and indices.
    n, m = len(ball.vertices), len(ball.triangles)
    assert tab.value("page.stage.counts.bytes") == n * (12 + 12 + 12 + 4 + 4 + 4) + m * 12


def test_overlays_section_and_distance(site: Site, serve, show):
    tab = show(f"{serve(site.folder)}#mode=surface&{VIEW.link}&light=none&color=provenance")
    tab.settled()
    picture = tab.picture()
    above, below = picture[200, 320].astype(int), picture[330, 320].astype(int)
    assert np.abs(above - [0xC8, 0x79, 0x1A]).max() <= 2
    assert np.abs(below - [0x5A, 0x8F, 0x8A]).max() <= 2
    assert tab.page.locator("#legend li").all_inner_texts() == ["measured", "filled in"]
    # Up to 2 mm from the samples at the bottom; above there are none.
    tab.page.locator('#overlays [data-key="distance"]').click()
    assert tab.page.locator("#legend li").all_inner_texts() == ["none", "2 mm and more"]
    picture = tab.picture().astype(int)
    assert np.abs(picture[200, 320] - [0x9A, 0x95, 0x8B]).max() <= 2
    rows = picture[310:370:10, 320]
    assert (np.diff(rows[:, 1]) < 0).all()
    tab.page.locator('#overlays [data-key="provenance"]').click()
    # The middle of a ball of radius 1 from 4.3 m away, and a place beside it.
    tab.page.locator("#measure").click()
    for x in (320, 380):
        tab.page.mouse.click(x, 240)
    eye = np.array(VIEW.eye)
    back = eye / np.linalg.norm(eye)
    right = np.cross([0, 0, 1], back)
    right /= np.linalg.norm(right)
    way = 60.5 / 240 * np.tan(np.radians(17.5)) * right - back
    way /= np.linalg.norm(way)
    along = eye @ way
    met = eye - (along + np.sqrt(along**2 - eye @ eye + 1)) * way
    assert tab.value("page.measuring.distance") == pytest.approx(
        np.linalg.norm(met - back), rel=0.02
    )
    assert "Distance" in tab.page.locator("#said").inner_text()
    tab.page.keyboard.press("Escape")
    # Cut in half, the back of the other side shows through.
    tab.page.locator('#sections [data-axis="2"]').click()
    cut = tab.picture().astype(int)
    assert np.abs(cut[300, 320] - below).max() <= 2
    assert np.abs(cut[140, 320] - [0xD6, 0xD5, 0xD2]).max() <= 2


def test_hands_and_keys_move_it_and_the_address_follows(site: Site, serve, show):
    tab = show(f"{serve(site.folder)}#mode=surface&{VIEW.link}")
    tab.settled()
    far = tab.value("page.camera.distance")
    tab.page.locator("#picture").focus()
    tab.page.keyboard.press("+")
    assert tab.value("page.camera.distance") == pytest.approx(0.9 * far)
    tab.page.mouse.move(320, 240)
    tab.page.mouse.down()
    tab.page.mouse.move(440, 240, steps=4)
    tab.page.mouse.up()
    eye = tab.value("page.camera.eye")
    # A quarter of the picture's height is an eighth turn, about what is looked at.
    turned = np.arctan2(eye[1], eye[0]) - np.arctan2(VIEW.eye[1], VIEW.eye[0])
    assert turned == pytest.approx(-np.pi / 4, abs=1e-6)
    assert np.linalg.norm(eye) == pytest.approx(0.9 * far)
    tab.page.wait_for_function("() => location.hash.includes('eye=')")
    tab.page.wait_for_timeout(600)
    link = tab.page.url
    again = show(link)
    again.settled()
    np.testing.assert_allclose(again.value("page.camera.eye"), eye, atol=1e-4)
    tab.page.keyboard.press("Home")
    home = np.array(tab.value("page.camera.eye"))
    np.testing.assert_allclose(home, site.scene["home"]["eye"])


def broken(answer: Callable[[SimpleHTTPRequestHandler], None]) -> type[Answers]:
    """A server that answers so when it is asked for data."""

    class Broken(Answers):
        def do_GET(self) -> None:  # noqa: N802
            if "/data/" in self.path:
                answer(self)
            else:
                super().do_GET()

    return Broken


def gone(handler: Any) -> None:
    handler.send_error(404)


def half(handler: Any) -> None:
    with open(handler.translate_path(handler.path), "rb") as file:
        content = file.read()
    content = content[: len(content) // 2]
    handler.send_response(200)
    handler.send_header("Content-Length", str(len(content)))
    handler.end_headers()
    handler.wfile.write(content)


@pytest.mark.parametrize(("answer", "words"), [(gone, "not on the server"), (half, "damaged")])
def test_what_is_missing_or_cut_off_is_told(site: Site, serve, show, answer, words):
    tab = show(f"{serve(site.folder, broken(answer))}#mode=surface")
    tab.page.wait_for_function("() => document.querySelectorAll('#notices p').length > 0")
    (told,) = tab.told_to_user()
    assert words in told
    assert not [line for line in tab.told if "exception" in line]


def test_a_browser_without_webgl2_is_told_plainly(site: Site, serve, browser):
    context = browser.new_context()
    page = context.new_page()
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    page.goto(serve(site.folder))
    page.wait_for_function("() => document.querySelectorAll('#notices p').length > 0")
    assert "WebGL2" in page.locator("#notices p").first.inner_text()
    context.close()
