"""What is drawn stays: with the server dying, the disk full, and others at the same mask."""

from __future__ import annotations

import socket

import numpy as np
import pytest
from PIL import Image

from .conftest import object_mask
from .editor import STROKE, STROKE_MASK, Editor, expect, near_segment, overlap


def refused(line):
    return "net::ERR" in line or "403" in line


def test_a_killed_server_loses_nothing_and_the_new_one_offers_it(serve, tabs, drawn):
    tabs.expected = refused
    served = serve()
    old = Editor(tabs(served.url))
    old.drag((60, 30), (180, 30))
    old.saved()
    on_disk = drawn("training")
    start, end = (old.on_screen(*place) for place in STROKE)
    old.tab.mouse.move(*start)
    old.tab.mouse.down()
    served.kill()
    old.tab.mouse.move(*end, steps=8)
    old.tab.mouse.up()
    old.notice("The workbench has stopped.")
    old.saved("Not saved – kept in this browser")
    np.testing.assert_array_equal(drawn("training"), on_disk)

    again = serve()
    assert again.port == served.port
    assert again.url != served.url
    new = Editor(tabs(again.url))
    old.notice("this page has ended")
    new.notice("this browser kept it")
    new.click("Keep my drawing")
    new.saved()
    assert overlap(drawn("training"), STROKE_MASK | near_segment((60, 30), (180, 30), 16)) > 0.97
    new.press("Control+z")
    new.saved()
    np.testing.assert_array_equal(drawn("training"), on_disk)
    new.tab.reload()
    new.ready()
    expect(new.tab.locator("#notices")).to_be_empty()


def test_a_closed_browser_tab_loses_nothing_either(serve, tabs, drawn):
    tabs.expected = refused
    served = serve()
    old = Editor(tabs(served.url))
    served.kill()
    old.drag(*STROKE)
    old.saved("Not saved – kept in this browser")
    old.tab.close()
    new = Editor(tabs(serve().url))
    new.notice("A drawing from before was not saved")
    new.click("Look at the mask on disk")
    new.click("Keep the mask on disk")
    new.saved("Nothing drawn yet")
    assert drawn("training") is None
    new.press("Control+z")
    new.saved()
    assert overlap(drawn("training"), STROKE_MASK) > 0.97


def test_what_was_drawn_under_another_port_is_found(serve, tabs, drawn):
    tabs.expected = refused
    served = serve()
    old = Editor(tabs(served.url))
    served.kill()
    old.drag(*STROKE)
    old.saved("Not saved – kept in this browser")
    old.tab.close()
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        other = free.getsockname()[1]
    again = serve(other)
    assert again.port == other
    new = Editor(tabs(again.url))
    new.notice(f"under port {served.port}")
    new.click("Go there")
    new.notice("A drawing from before was not saved")
    new.click("Keep my drawing")
    new.saved()
    assert overlap(drawn("training"), STROKE_MASK) > 0.97


def test_a_server_that_stands_still_for_a_while_is_waited_for(serve, tabs, drawn):
    tabs.expected = refused
    served = serve()
    editor = Editor(tabs(served.url))
    editor.tab.route("**/mask?role=*", lambda route: route.abort())
    editor.drag(*STROKE)
    editor.saved("Not saved – kept in this browser")
    editor.drag((60, 30), (180, 30))
    editor.tab.unroute("**/mask?role=*")
    editor.saved()
    assert overlap(drawn("training"), STROKE_MASK | near_segment((60, 30), (180, 30), 16)) > 0.97


@pytest.mark.parametrize("keep", ["mine", "theirs"])
def test_of_two_masks_both_are_kept_and_the_user_chooses(editor, project, drawn, tabs, keep):
    tabs.expected = lambda line: "412" in line
    editor.drag(*STROKE)
    editor.saved()
    theirs = object_mask()
    path = project.root / "masks" / "training" / "a.png"
    Image.fromarray(np.where(theirs, 255, 0).astype(np.uint8)).save(path)
    editor.drag((60, 30), (180, 30))
    editor.notice("changed elsewhere")
    mine = STROKE_MASK | near_segment((60, 30), (180, 30), 16)
    np.testing.assert_array_equal(drawn("training"), theirs)
    if keep == "mine":
        editor.click("Keep my drawing")
        editor.saved()
        assert overlap(drawn("training"), mine) > 0.97
        editor.press("Control+z")
        editor.saved()
        np.testing.assert_array_equal(drawn("training"), theirs)
    else:
        editor.click("Look at the mask on disk")
        editor.click("Keep the mask on disk")
        editor.saved()
        np.testing.assert_array_equal(drawn("training"), theirs)
        editor.press("Control+z")
        editor.saved()
        assert overlap(drawn("training"), mine) > 0.97


def test_two_tabs_do_not_overwrite_each_other(server, tabs, drawn):
    tabs.expected = lambda line: "412" in line
    one, two = (Editor(tabs(server.url)) for _ in range(2))
    one.tab.bring_to_front()
    one.drag(*STROKE)
    one.saved()
    first = drawn("training")
    two.tab.bring_to_front()
    two.drag((60, 30), (180, 30))
    two.notice("changed elsewhere")
    np.testing.assert_array_equal(drawn("training"), first)


def test_a_damaged_mask_is_told_and_drawn_over(project, server, tabs, drawn):
    tabs.expected = lambda line: "422" in line
    folder = project.root / "masks" / "training"
    folder.mkdir(parents=True)
    (folder / "a.png").write_bytes(b"nothing")
    editor = Editor(tabs(server.url))
    editor.notice("The mask cannot be read")
    editor.drag(*STROKE)
    editor.saved()
    assert overlap(drawn("training"), STROKE_MASK) > 0.97


def test_a_full_disk_is_told_and_the_drawing_kept(editor, drawn, tabs, monkeypatch):
    from workbench.project import user_masks

    tabs.expected = lambda line: "422" in line

    def full_disk(path, mask):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(user_masks, "write_mask_png", full_disk)
        editor.drag(*STROKE)
        editor.saved("Could not be saved")
        editor.notice("No space left on device")
    editor.click("Try again")
    editor.saved()
    assert overlap(drawn("training"), STROKE_MASK) > 0.97


def test_without_a_store_in_the_browser_it_says_so_and_asks_before_it_goes(serve, tabs, browser):
    tabs.expected = refused
    served = serve()
    tab = tabs("about:blank")
    tab.add_init_script("IDBFactory.prototype.open = () => { throw new Error('private'); }")
    tab.goto(served.url)
    editor = Editor(tab)
    editor.notice("This browser keeps no drawings.")
    served.kill()
    editor.drag(*STROKE)
    editor.saved("Not saved")
    editor.notice("do not close this page")
    asked = []
    tab.on("dialog", lambda dialog: (asked.append(dialog.type), dialog.dismiss()))
    tab.close(run_before_unload=True)
    tab.wait_for_timeout(300)
    assert asked == ["beforeunload"]
