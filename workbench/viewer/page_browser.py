"""The page in a browser without a window, driven step by step."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.errors import MissingPartError
from workbench.viewer.link_views import LinkView

_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_QUIET = ("--no-sandbox", "--disable-background-networking", "--disable-component-update")
# ANGLE draws through EGL on a graphics card where there is one, else on the processor.
_CARDS = ("/dev/dri/renderD128", "/dev/nvidia0")
_ON_CARD = ("--use-angle=gl-egl", "--ignore-gpu-blocklist", "--enable-gpu")
_ON_PROCESSOR = (
    "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"
)  # fmt: skip
_PANEL_PX = 288
_OPENED_MS, _SETTLED_MS = 120_000, 300_000
_PENDING = "window.page.stage.pending"
_TWO_FRAMES = """() => new Promise((done) => {
    requestAnimationFrame(() => requestAnimationFrame(() => done()));
})"""
_CARD = """() => {
    const { gl } = window.page.stage;
    const told = gl.getExtension("WEBGL_debug_renderer_info");
    return gl.getParameter(told ? told.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
}"""
# To read a pixel is to wait until it is drawn; finish() does not.
_FRAME = """() => {
    const { stage } = window.page;
    const pixel = new Uint8Array(4);
    const start = performance.now();
    stage.frame();
    stage.gl.readPixels(0, 0, 1, 1, stage.gl.RGBA, stage.gl.UNSIGNED_BYTE, pixel);
    return performance.now() - start;
}"""
_COUNTS = """() => {
    const { network, stage } = window.page;
    const { calls, items, bytes, uploaded } = stage.counts;
    return { read_bytes: network.bytes, requests: network.requests, calls,
             items: Math.round(items), card_bytes: bytes, uploaded_bytes: uploaded };
}"""


@contextmanager
def browser() -> Iterator[Any]:
    """Chromium, on a graphics card where there is one.

    Raises
    ------
    MissingPartError
        Playwright or Chromium is not installed.
    """
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        raise MissingPartError(
            "What drives a browser is not installed", fix="python -m pip install playwright"
        ) from None
    found = next(filter(None, map(shutil.which, _BROWSERS)), None)
    if found is None:
        raise MissingPartError(
            "There is no Chromium", fix="sudo apt-get install -y --no-install-recommends chromium"
        )
    there = any(Path(card).exists() for card in _CARDS)
    with sync_playwright() as playwright:
        arguments = [*_QUIET, *(_ON_CARD if there else _ON_PROCESSOR)]
        running = playwright.chromium.launch(executable_path=found, args=arguments)
        try:
            yield running
        finally:
            running.close()


class PageTab:
    """A tab that shows one form of a model from one place.

    Parameters
    ----------
    browser : as `browser` gives it.
    url : of the site.
    link : what its address says behind ``#``.
    width, height : of the picture, pixels.

    Attributes
    ----------
    told : errors on the console, and messages to the user as they came.
    """

    def __init__(self, browser: Any, url: str, link: str, width: int, height: int) -> None:
        viewport = {"width": width + _PANEL_PX, "height": height}
        self._context = browser.new_context(viewport=viewport)
        self._page = self._context.new_page()
        self.told: list[str] = []
        self._page.on("console", self._heard)
        self._page.on("pageerror", lambda error: self.told.append(f"exception: {error}"))
        self._page.goto(f"{url}#{link}")
        self._page.wait_for_function("() => window.page?.stage.firstPicture", timeout=_OPENED_MS)

    @property
    def first_picture_s(self) -> float:
        """From the page's start to its first picture, seconds."""
        return 1e-3 * float(self._page.evaluate("() => window.page.stage.firstPicture"))

    @property
    def card(self) -> str:
        """What draws."""
        return str(self._page.evaluate(_CARD))

    @property
    def has_pixel_error(self) -> bool:
        """Whether the form follows an error in pixels."""
        return bool(self._page.evaluate("() => window.page.stage.mode?.pixelError !== undefined"))

    @property
    def notices(self) -> list[str]:
        """What the page tells its user."""
        shown = self._page.locator("#notices p").all()
        return [str(one.get_attribute("data-message")) for one in shown]

    def counts(self) -> dict[str, int]:
        """Bytes read, requests, calls and items of the last frame, bytes on the card."""
        return dict(self._page.evaluate(_COUNTS))

    def set_look(self, **look: Any) -> None:
        """Settings of the picture, such as ``pixelError`` and ``budgetBytes``."""
        self._page.evaluate(
            "(look) => { const { stage } = window.page; Object.assign(stage.look, look);"
            " stage.redraw(); }",
            look,
        )

    def look_from(self, view: LinkView) -> None:
        """Stand elsewhere."""
        words = {name: ",".join(map(repr, getattr(view, name))) for name in ("eye", "to")}
        self._page.evaluate(
            "(words) => { window.page.camera.read(words); window.page.stage.redraw(); }", words
        )

    def frame_ms(self) -> float:
        """Draw once; until it is drawn, milliseconds."""
        return float(self._page.evaluate(_FRAME))

    def settled(self, within_s: float | None = None) -> bool:
        """Wait until nothing more is to come, or so long; whether nothing is."""
        from playwright.sync_api import TimeoutError as TookTooLongError

        limit = _SETTLED_MS if within_s is None else 1e3 * within_s
        # What was asked for begins with the next frame, which a busy machine keeps waiting.
        self._page.wait_for_timeout(20)
        self._page.evaluate(_TWO_FRAMES)
        try:
            self._page.wait_for_function(f"() => !{_PENDING}", timeout=limit)
        except TookTooLongError:
            return False
        self._page.evaluate("() => new Promise(done => requestAnimationFrame(() => done()))")
        return True

    def picture(self) -> NDArray[np.uint8]:
        """What the canvas shows, (h, w, 3) uint8 sRGB."""
        self._page.evaluate("() => document.activeElement.blur()")
        shot = self._page.locator("#picture").screenshot()
        decoded = cv2.imdecode(np.frombuffer(shot, np.uint8), cv2.IMREAD_COLOR)
        return np.asarray(decoded, np.uint8)[..., ::-1]

    def close(self) -> None:
        """Close the tab."""
        self._context.close()

    def _heard(self, message: Any) -> None:
        if message.type in ("error", "warning"):
            self.told.append(f"{message.type}: {message.text}")
