"""The page as a person at it: drags, keys and what is read off it."""

from __future__ import annotations

import numpy as np
import pytest

from .conftest import HEIGHT, WIDTH

expect = pytest.importorskip("playwright.sync_api", reason="playwright is not installed").expect
MARGIN_PX = 24


class Editor:
    """The page in a tab, told what to do in pixels of the picture."""

    def __init__(self, tab, name="a"):
        self.tab = tab
        self.ready(name)

    def ready(self, name="a"):
        expect(self.tab.locator("#name")).to_have_text(name)
        expect(self.tab.locator("#working")).to_be_hidden()

    def saved(self, words="Saved"):
        expect(self.tab.locator("#saved")).to_have_text(words)

    def notice(self, words):
        expect(self.tab.locator("#notices")).to_contain_text(words)

    def click(self, words):
        self.tab.get_by_role("button", name=words, exact=True).click()

    @property
    def scale(self):
        box = self.tab.locator("#stage").bounding_box()
        return min((box["width"] - 2 * MARGIN_PX) / WIDTH, (box["height"] - 2 * MARGIN_PX) / HEIGHT)

    def on_screen(self, x, y):
        """Where a place in a picture that is shown whole lies."""
        box = self.tab.locator("#stage").bounding_box()
        left = box["x"] + (box["width"] - WIDTH * self.scale) / 2
        top = box["y"] + (box["height"] - HEIGHT * self.scale) / 2
        return left + x * self.scale, top + y * self.scale

    def drag(self, *places, button="left"):
        mouse = self.tab.mouse
        mouse.move(*self.on_screen(*places[0]))
        mouse.down(button=button)
        for place in places[1:]:
            mouse.move(*self.on_screen(*place), steps=4)
        mouse.up(button=button)

    def press(self, *keys):
        for key in keys:
            self.tab.keyboard.press(key)


def near_segment(start, end, radius):
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    (ax, ay), (bx, by) = start, end
    share = ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / ((bx - ax) ** 2 + (by - ay) ** 2)
    share = np.clip(share, 0, 1)
    return np.hypot(x - ax - share * (bx - ax), y - ay - share * (by - ay)) < radius


def overlap(found, wanted):
    return (found & wanted).sum() / (found | wanted).sum()


STROKE = ((60, 90), (180, 90))
STROKE_MASK = near_segment(*STROKE, 16)
