"""The page with surfels: what it shows, reads, keeps on the card, and does when bytes are bad."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.viewer.conftest import Tab
from tests.viewer.looking import HEIGHT, WIDTH, View, ray_cast, similarity
from workbench.surfels.surfel_file import SurfelFile
from workbench.surfels.surfel_size import SizeControl
from workbench.viewer.site import Site

VIEW = View((1.2, -4.0, 1.1))
FAR = View((12.0, -40.0, 11.0))


@pytest.fixture
def surfels(site: Site) -> Path:
    """The ball's surfels, in the folder of the site."""
    (entry,) = [mode for mode in site.scene["modes"] if mode["mode"] == "surfels"]
    return site.folder / entry["file"]


def fine(tab: Tab, size_px: float = 1.0) -> None:
    """Surfels of that many pixels, and all there is to come."""
    tab.page.wait_for_function("() => window.page?.stage.mode")
    tab.page.evaluate(f"() => {{ page.stage.look.pixelError = {size_px}; page.stage.redraw(); }}")
    tab.settled()


def test_it_shows_what_rays_meet_and_keeps_to_the_depth(site: Site, serve, show, ball):
    tab = show(
        f"{serve(site.folder)}#mode=surfels&light=camera&{VIEW.link}", width=WIDTH, height=HEIGHT
    )
    fine(tab)
    assert similarity(tab.picture(), ray_cast(ball, VIEW, WIDTH, HEIGHT)) > 0.97
    # What is measured is where the surface is: in the middle of the picture, 1 m from the middle.
    place = np.array(tab.value("page.stage.placeAt(240, 120)"))
    assert np.linalg.norm(place) == pytest.approx(1.0, abs=0.01)
    # Another form takes their place on the card, and they take it again.
    bytes_before = tab.value("page.stage.counts.bytes")
    for mode in ("surface", "surfels"):
        tab.page.locator(f'[data-mode="{mode}"]').click()
        tab.page.wait_for_function(f"() => page.stage.entry.mode === '{mode}'")
        tab.settled()
    assert tab.value("page.stage.counts.bytes") == bytes_before
    assert tab.told == []
    assert tab.told_to_user() == []


def test_so_much_is_read_as_the_picture_needs(ranges: str, show, surfels: Path, ball):
    tab = show(f"{ranges}#mode=surfels&light=camera&{FAR.link}", width=WIDTH, height=HEIGHT)
    tab.settled()
    size = surfels.stat().st_size
    before = tab.value("page.network.bytes")
    assert 0 < before < 0.2 * size
    # From near, the rest of what one sees comes; the other side of the ball stays where it is.
    tab.page.evaluate(f"() => {{ location.hash = 'mode=surfels&light=camera&{VIEW.link}' }}")
    tab.page.wait_for_timeout(100)
    fine(tab)
    assert before < tab.value("page.network.bytes") <= size
    assert similarity(tab.picture(), ray_cast(ball, VIEW, WIDTH, HEIGHT)) > 0.97
    assert tab.told_to_user() == []


def test_a_damaged_part_is_told_once_and_shown_coarser(site: Site, serve, show, surfels, ball):
    file = SurfelFile(surfels)
    leaf = file.nodes[file.nodes["children"] == 0][0]
    content = bytearray(surfels.read_bytes())
    content[int(leaf["offset"]) + int(leaf["bytes"]) // 2] ^= 255
    surfels.write_bytes(content)
    tab = show(
        f"{serve(site.folder)}#mode=surfels&light=camera&{VIEW.link}", width=WIDTH, height=HEIGHT
    )
    fine(tab, 0.3)
    # From all sides, so that the damaged part is asked for.
    for eye in ("0,0.1,4.2", "0,0.1,-4.2", VIEW.link.split("&")[0].removeprefix("eye=")):
        tab.page.evaluate(f"() => {{ page.camera.read({{ eye: '{eye}' }}); page.stage.redraw(); }}")
        fine(tab, 0.3)
    (told,) = tab.told_to_user()
    assert "damaged" in told
    # The message lies over the picture.
    tab.page.locator("#notices button").click()
    assert similarity(tab.picture(), ray_cast(ball, VIEW, WIDTH, HEIGHT)) > 0.95
    assert tab.told == []


def test_a_file_that_is_cut_short_is_told(site: Site, serve, show, surfels):
    surfels.write_bytes(surfels.read_bytes()[: surfels.stat().st_size // 2])
    tab = show(f"{serve(site.folder)}#mode=surfels", width=WIDTH, height=HEIGHT)
    tab.page.wait_for_function("() => document.querySelectorAll('#notices p').length > 0")
    (told,) = tab.told_to_user()
    assert "shorter than it says" in told
    assert not [line for line in tab.told if "exception" in line]


def test_bytes_on_the_card_stay_below_the_budget(ranges: str, show, surfels: Path):
    tab = show(f"{ranges}#mode=surfels&{VIEW.link}", width=WIDTH, height=HEIGHT)
    tab.settled()
    # The pictures that discs are mixed in, and half of the surfels.
    budget = WIDTH * HEIGHT * 12 + surfels.stat().st_size // 2
    most = tab.page.evaluate(
        """async (budget) => {
            const { stage, camera } = window.page;
            Object.assign(stage.look, { budgetBytes: budget, pixelError: 1 });
            let most = 0;
            for (let k = 0; k < 16; k++) {
                const angle = k / 2;
                const away = 1.3 + 3 * Math.abs(Math.sin(k / 3));
                camera.eye = [away * Math.cos(angle), away * Math.sin(angle), 0.5];
                stage.redraw();
                await new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
                most = Math.max(most, stage.counts.bytes);
            }
            return most;
        }""",
        budget,
    )
    tab.settled()
    assert 0 < most <= budget
    assert tab.told_to_user() == []
    assert tab.value("page.stage.counts.items") > 1000


def test_surfels_grow_while_frames_are_slow(site: Site, serve, show):
    tab = show(serve(site.folder), width=WIDTH, height=HEIGHT)
    tab.settled()
    # Frames 0.05 s apart where 1 / 30 s are wanted: the published formula, step by step.
    found = tab.page.evaluate(
        """async () => {
            const { SizeControl } = await import('./modes/surfel_size.js');
            const control = new SizeControl();
            let now = 1000;
            performance.now = () => now;
            const sizes = [];
            for (let k = 0; k < 30; k++, now += 50) sizes.push(control.sizeFor({ clip: [k] }, 1.5));
            now += 1000;
            return [sizes, control.sizeFor({ clip: [29] }, 1.5), control.waiting];
        }"""
    )
    own, recent = SizeControl(1 / 30, smallest_px=1.5), [1.5]
    for _ in range(28):
        recent.append(own.next_px(recent, 0.05))
    np.testing.assert_allclose(found[0][1:], recent, rtol=1e-9)
    assert recent[-1] == 8.0
    assert found[1:] == [1.5, False]


def test_sharp_in_the_middle_alone_draws_fewer_at_the_sides(site: Site, serve, show):
    tab = show(
        f"{serve(site.folder)}#mode=surfels&light=camera&{VIEW.link}", width=WIDTH, height=HEIGHT
    )
    fine(tab, 2.0)
    inside, everywhere = tab.picture().astype(int), tab.value("page.stage.counts.items")
    tab.page.locator("#foveated").check()
    fine(tab, 2.0)
    # The ball is in the middle.
    assert tab.value("page.stage.counts.items") == everywhere
    assert np.abs(tab.picture().astype(int) - inside).max() <= 2
    # Looking past it, it is at the side.
    tab.page.evaluate("() => page.camera.read({ eye: '1.2,-4,1.1', to: '2.2,0.5,0' })")
    fine(tab, 2.0)
    aside, coarse = tab.picture().astype(int), tab.value("page.stage.counts.items")
    tab.page.locator("#foveated").uncheck()
    fine(tab, 2.0)
    assert coarse < 0.85 * tab.value("page.stage.counts.items")
    assert np.abs(tab.picture().astype(int) - aside).max() > 2
    assert tab.told == []
