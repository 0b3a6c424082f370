"""The mask editor as people use it, in a browser."""

from __future__ import annotations

import numpy as np
import pytest

from .conftest import HEIGHT, WIDTH, object_mask
from .editor import MARGIN_PX, STROKE, STROKE_MASK, Editor, expect, near_segment, overlap


def test_what_is_painted_is_saved_at_full_size_and_there_after_a_reload(editor, drawn):
    editor.saved("Nothing drawn yet")
    editor.drag(*STROKE)
    editor.saved()
    # A place on the screen is known to a pixel of it, some third of a pixel of the mask.
    assert overlap(drawn("training"), STROKE_MASK) > 0.97
    before = drawn("training")
    editor.tab.reload()
    editor.ready()
    editor.saved()
    expect(editor.tab.locator("#standing")).to_have_text("training")
    editor.drag((20, 20), (21, 20))
    editor.saved()
    assert (drawn("training") & before).sum() == before.sum()
    assert drawn("training")[20, 20]


def test_the_eraser_and_the_right_button_take_away(editor, drawn):
    editor.tab.get_by_role("button", name="Keep all").click()
    editor.press("e")
    editor.drag(*STROKE)
    editor.saved()
    assert overlap(~drawn("training"), STROKE_MASK) > 0.97
    editor.press("b")
    editor.drag((60, 30), (180, 30), button="right")
    editor.saved()
    assert overlap(~drawn("training"), STROKE_MASK | near_segment((60, 30), (180, 30), 16)) > 0.97


def test_undo_and_redo_reach_the_disk(editor, drawn):
    editor.drag(*STROKE)
    editor.saved()
    first = drawn("training")
    editor.drag((60, 30), (180, 30))
    editor.saved()
    second = drawn("training")
    editor.press("Control+z")
    editor.saved()
    np.testing.assert_array_equal(drawn("training"), first)
    editor.press("Control+Shift+z")
    editor.saved()
    np.testing.assert_array_equal(drawn("training"), second)
    editor.press("Control+z", "Control+z")
    editor.saved()
    assert not drawn("training").any()
    expect(editor.tab.locator("#undo")).to_be_disabled()


def test_a_lasso_that_is_dragged_and_one_of_corners(editor, drawn):
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    editor.press("l")
    editor.drag((20, 20), (100, 20), (100, 80), (20, 80))
    editor.saved()
    box = (x > 20) & (x < 100) & (y > 20) & (y < 80)
    assert overlap(drawn("training"), box) > 0.97
    for corner in ((120, 20), (220, 20), (220, 120)):
        editor.tab.mouse.click(*editor.on_screen(*corner), delay=20)
    editor.press("Enter")
    editor.saved()
    triangle = (x < 220) & (y > 20) & (x - 120 > y - 20)
    assert overlap(drawn("training"), box | triangle) > 0.97
    editor.press("x")
    editor.drag((40, 40), (80, 40), (80, 60), (40, 60))
    editor.saved()
    hole = (x > 40) & (x < 80) & (y > 40) & (y < 60)
    assert overlap(drawn("training"), (box & ~hole) | triangle) > 0.97


def test_a_polygon_can_be_corrected_and_given_up(editor, drawn):
    editor.press("l")
    for corner in ((20, 20), (100, 20), (230, 170), (100, 80)):
        if corner == (100, 80):
            editor.press("Backspace")
        editor.tab.mouse.click(*editor.on_screen(*corner), delay=20)
    editor.press("Enter")
    editor.saved()
    assert drawn("training").sum() == pytest.approx(80 * 60 / 2, rel=0.05)
    editor.tab.mouse.click(*editor.on_screen(150, 20), delay=20)
    editor.press("Escape", "Enter")
    assert drawn("training").sum() == pytest.approx(80 * 60 / 2, rel=0.05)


def test_a_rectangle_finds_the_object(editor, drawn):
    editor.press("r")
    editor.drag((45, 30), (195, 150))
    expect(editor.tab.locator("#saved")).to_have_text("Saved")
    assert overlap(drawn("training"), object_mask()) > 0.95


def test_a_rectangle_that_finds_nothing_says_why(editor, tabs):
    tabs.expected = lambda line: "422" in line
    editor.press("-", "-", "r")
    box = editor.tab.locator("#stage").bounding_box()
    editor.tab.mouse.move(box["x"] + 3, box["y"] + 3)
    editor.tab.mouse.down()
    editor.tab.mouse.move(box["x"] + box["width"] - 3, box["y"] + box["height"] - 3, steps=3)
    editor.tab.mouse.up()
    editor.notice("covers the whole image")


def test_the_keyboard_does_everything_the_buttons_do(editor):
    tab = editor.tab
    tools = {"b": "brush", "e": "eraser", "l": "lasso", "r": "rectangle", "h": "hand"}
    for key, tool in tools.items():
        editor.press(key)
        chosen = tab.locator('[data-tool][aria-checked="true"]')
        expect(chosen).to_have_attribute("data-tool", tool)
    editor.press("b", "x")
    expect(tab.locator('[data-tool="eraser"]')).to_have_attribute("aria-checked", "true")
    expect(tab.locator("#size-value")).to_have_text("32 px")
    editor.press("]", "]")
    expect(tab.locator("#size-value")).to_have_text("46 px")
    editor.press("[", "[", ",")
    expect(tab.locator("#size-value")).to_have_text("27 px")
    editor.press("v")
    expect(tab.locator('[data-mode="tint"]')).to_have_attribute("aria-checked", "true")
    editor.press("o", "o")
    expect(tab.locator("#opacity")).to_have_value("30")
    editor.press("Shift+o")
    expect(tab.locator("#opacity")).to_have_value("40")
    editor.press("1")
    expect(tab.locator("#zoom")).to_have_text("100 %")
    editor.press("+")
    expect(tab.locator("#zoom")).to_have_text("125 %")
    editor.press("0")
    expect(tab.locator("#zoom")).to_have_text(f"{round(100 * editor.scale)} %")
    editor.press("i")
    expect(tab.locator("#kept")).to_have_text("100.0 % kept")
    editor.press("t")
    expect(tab.locator("#training")).to_have_attribute("aria-checked", "false")
    editor.saved()
    editor.press("Delete")
    expect(tab.locator("#kept")).to_have_text("0.0 % kept")
    editor.press("PageDown")
    editor.ready("b")
    editor.press("n")
    editor.ready("c")
    editor.press("p")
    editor.ready("b")
    editor.press("g", "Home")
    editor.ready("a")
    editor.press("ArrowDown")
    editor.ready("b")


def test_every_key_is_in_the_help_panel(editor):
    tab = editor.tab
    editor.press("?")
    panel = tab.locator("#help-panel")
    expect(panel).to_be_visible()
    caps = set(panel.locator("kbd").all_inner_texts())
    assert {"B", "E", "L", "R", "H", "X", "[", "]", "I", "T", "V", "M", "N", "P", "?"} <= caps
    assert {"Ctrl Z", "Ctrl Shift Z", "Ctrl S", "Delete", "Esc", "Enter", "Space"} <= caps
    editor.press("e")
    expect(tab.locator('[data-tool="brush"]')).to_have_attribute("aria-checked", "true")
    editor.press("Escape")
    expect(panel).to_be_hidden()


def test_zoomed_in_and_moved_it_draws_where_the_pointer_is(editor, drawn):
    tab = editor.tab
    centre = editor.on_screen(120, 90)
    tab.mouse.move(*centre)
    for _ in range(5):
        tab.mouse.wheel(0, -200)
    tab.keyboard.down("Space")
    tab.mouse.down()
    tab.mouse.move(centre[0] + 70, centre[1] - 40, steps=3)
    tab.mouse.up()
    tab.keyboard.up("Space")
    for _ in range(12):
        editor.press("[")
    tab.mouse.click(centre[0] + 70, centre[1] - 40)
    editor.saved()
    rows, columns = np.nonzero(drawn("training"))
    assert (rows.mean() + 0.5, columns.mean() + 0.5) == pytest.approx((90, 120), abs=0.6)
    assert 4 < len(rows) < 30


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_turned_it_draws_where_the_pointer_is_and_shows_what_is_drawn(editor, drawn, turns):
    """A dot near the picture's upper left corner, found on the screen by its colour."""
    tab = editor.tab
    for _ in range(turns):
        editor.press("q")
    box = tab.locator("#stage").bounding_box()
    across, down = (HEIGHT, WIDTH) if turns % 2 else (WIDTH, HEIGHT)
    scale = min((box["width"] - 2 * MARGIN_PX) / across, (box["height"] - 2 * MARGIN_PX) / down)
    # A quarter turn clockwise brings the upper left corner to the upper right.
    x, y = {1: (across - 30, 50), 2: (across - 50, down - 30), 3: (30, down - 50)}[turns]
    left = box["x"] + (box["width"] - across * scale) / 2
    top = box["y"] + (box["height"] - down * scale) / 2
    place = left + x * scale, top + y * scale
    tab.mouse.click(*place)
    editor.saved()
    rows, columns = np.nonzero(drawn("training"))
    assert (columns.mean() + 0.5, rows.mean() + 0.5) == pytest.approx((50, 30), abs=0.6)
    # Of the veil's pixels under the brush none is left, and a little off all are.
    tab.mouse.move(*editor.on_screen(0, 0))
    x, y, off = (round(v) for v in (place[0] - box["x"], place[1] - box["y"], 17 * scale))
    veil = tab.evaluate(
        """(places) => {
            const canvas = document.querySelectorAll("#stage canvas")[1];
            const { width, height } = canvas;
            const { data } = canvas.getContext("2d").getImageData(0, 0, width, height);
            return places.map(([x, y]) => data[4 * (y * width + x) + 3]);
        }""",
        [[x, y], [x + off, y], [x, y - off]],
    )
    assert veil[0] == 0
    assert min(veil[1:]) > 100


def test_the_switch_moves_the_mask_and_the_list_shows_it(editor, drawn):
    badge = editor.tab.locator(".subject", has_text="a").first.locator(".badge")
    expect(badge).to_have_text("no mask")
    editor.drag(*STROKE)
    editor.saved()
    expect(badge).to_have_text("training")
    editor.tab.locator("#training").click()
    editor.saved()
    expect(badge).to_have_text("corrected")
    assert drawn("training") is None
    assert overlap(drawn("corrected"), STROKE_MASK) > 0.97


def test_a_correction_starts_from_the_automatic_mask_and_goes_back_to_it(
    project, server, tabs, drawn
):
    automatic = np.where(object_mask(), 255, 0).astype(np.uint8)
    project.store.save("automatic_photo_masks", automatic, "a")
    editor = Editor(tabs(server.url))
    expect(editor.tab.locator("#standing")).to_have_text("automatic")
    editor.drag((10, 10), (60, 10))
    editor.saved()
    assert (drawn("corrected") & object_mask()).sum() == object_mask().sum()
    assert drawn("training") is None
    corrected = drawn("corrected")
    editor.click("Back to automatic")
    expect(editor.tab.locator("#standing")).to_have_text("automatic")
    assert drawn("corrected") is None
    editor.press("Control+z")
    editor.saved()
    np.testing.assert_array_equal(drawn("corrected"), corrected)


def test_going_on_to_the_next_picture_loses_nothing(editor, drawn):
    editor.drag(*STROKE)
    editor.press("n")
    editor.ready("b")
    editor.drag((60, 30), (180, 30))
    editor.press("p")
    editor.ready("a")
    editor.saved()
    assert overlap(drawn("training", "a"), STROKE_MASK) > 0.97
    assert overlap(drawn("training", "b"), near_segment((60, 30), (180, 30), 16)) > 0.97
    editor.press("Control+z")
    editor.saved()
    assert not drawn("training", "a").any()


def test_odd_names_and_scans_without_a_grid(project, server, tabs, drawn):
    odd = project.photo_files[0]
    odd.rename(odd.with_name("ä 1#?%2F&.png"))
    scan = {"name": "s", "file": "s.ply", "grid": None}
    project.store.save("scan_inventory", {"scans": [scan]})
    editor = Editor(tabs(server.url), "b")
    row = editor.tab.locator(".subject", has_text="s").first
    expect(row.locator(".badge")).to_have_text("no grid, no mask")
    row.click(force=True)
    editor.press("End")
    editor.tab.get_by_role("option", name="ä 1#?%2F&").click()
    editor.ready("ä 1#?%2F&")
    editor.drag(*STROKE)
    editor.saved()
    editor.tab.reload()
    editor.ready("ä 1#?%2F&")
    assert overlap(drawn("training", "ä 1#?%2F&"), STROKE_MASK) > 0.97


def test_the_list_can_be_narrowed(editor):
    editor.drag(*STROKE)
    editor.saved()
    editor.tab.locator("#filter").select_option("none")
    expect(editor.tab.locator(".subject:visible .name")).to_have_text(["b", "c"])
    editor.tab.locator("#filter").select_option("training")
    expect(editor.tab.locator(".subject:visible .name")).to_have_text(["a"])
    expect(editor.tab.locator("#summary")).to_have_text("1 training · 2 no mask")
