"""What the page costs in every form of a model, and how near its pictures are to rays.

A browser without a window opens each form, goes once around the object and nearer in even steps
without waiting long at any, and then looks from three of these places at leisure: those pictures
are held against those of the same form drawn without a browser, and against rays cast at the
source surface.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from skimage.metrics import structural_similarity

from workbench.formats.surface_files import read_surface
from workbench.pipeline.progress import Progress
from workbench.project.project import Project
from workbench.viewer.drawn_models import drawn_model
from workbench.viewer.link_views import LinkView
from workbench.viewer.page_browser import PageTab
from workbench.viewer.page_light import Light
from workbench.viewer.server import site_server
from workbench.viewer.site import Site
from workbench.viewer.surface_pictures import surface_picture
from workbench.viewer.wanted_views import WantedView

# As the page has it behind the model.
_BACKGROUND = np.array([0xD6, 0xD5, 0xD2], np.float64)
# Forms that are shown in their own colours, not lit.
_EVEN = ("textured", "stitched")
_HEADLESS = {"textured": "surface", "stitched": "stitch"}
_NEAREST = 1.0 / 3.0
_COMPARED = 3
_FRAMES = 3

Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class MeasureOptions:
    """How the page is measured.

    Attributes
    ----------
    steps : places along the path.
    patience_s : at most so long is waited at each.
    width, height : of the picture, pixels.
    budget_bytes : on the card, at most.
    pixel_errors : that forms with levels of detail are allowed.
    """

    steps: int = 50
    patience_s: float = 0.5
    width: int = 640
    height: int = 480
    budget_bytes: int = 256 << 20
    pixel_errors: tuple[float, ...] = (1.0, 2.0, 4.0, 8.0)


def page_measures(
    opened: Any, project: Project, site: Site, options: MeasureOptions, progress: Progress
) -> dict[str, Any]:
    """Measure a project's site in a browser, as `page_browser.browser` opens it.

    Returns
    -------
    Plain data: ``card`` (what draws), ``width``, ``height``, ``budget_bytes``, ``patience_s`` and
    ``forms``: ``mode``, ``label``, ``file_bytes``; ``first_s``, ``first_bytes`` to the first
    picture and ``full_s``, ``full_bytes`` until nothing more was to come; ``path``, a row of
    ``frame_ms``, ``calls``, ``items``, ``card_bytes``, ``uploaded_bytes``, ``read_bytes``,
    ``requests`` for each step; ``end_card_bytes``; ``compared``, rows of ``headless`` and ``rays``
    (structural similarity); ``errors``, rows of ``pixel_error``, ``frame_ms``, ``card_bytes``,
    ``error`` (one minus the similarity to rays); and ``told``, what went wrong.
    """
    server = site_server(site)
    thread = threading.Thread(target=server.serve)
    thread.start()
    try:
        with progress.step("the page", len(site.scene["modes"])) as step:
            forms, card = [], ""
            for entry in site.scene["modes"]:
                measuring = _Form(project, site, entry, options)
                told, card = measuring.told(opened, server.url)
                forms.append(told)
                step.advance()
    finally:
        server.stop()
        thread.join()
    return {
        "card": card,
        "width": options.width,
        "height": options.height,
        "budget_bytes": options.budget_bytes,
        "patience_s": options.patience_s,
        "forms": forms,
    }


def path_around(eye: NDArray[np.float64], steps: int) -> list[LinkView]:
    """Views once around the origin from ``eye`` (3,) on, nearing it to a third."""
    views = []
    for share in np.arange(steps) / steps:
        turn, near = 2.0 * np.pi * share, 1.0 - share * (1.0 - _NEAREST)
        c, s = float(np.cos(turn)), float(np.sin(turn))
        x, y, z = (float(value) for value in near * eye)
        views.append(LinkView((c * x - s * y, s * x + c * y, z)))
    return views


class _Form:
    """One form of the model."""

    def __init__(
        self, project: Project, site: Site, entry: dict[str, Any], options: MeasureOptions
    ) -> None:
        self.project, self.entry, self.options = project, entry, options
        self.mode = str(entry["mode"])
        self.light: Light = "even" if self.mode in _EVEN else "camera"
        self.origin = np.array(site.scene["origin"], np.float64)
        self.views = path_around(np.array(site.scene["home"]["eye"]), options.steps)
        self.with_texture = any(one["mode"] == "textured" for one in site.scene["modes"])

    def told(self, opened: Any, url: str) -> tuple[dict[str, Any], str]:
        """What the form costs, and what draws."""
        options, first = self.options, self.views[0]
        eye = ",".join(map(repr, first.eye))
        light = "none" if self.light == "even" else "camera"
        link = f"mode={self.mode}&eye={eye}&to=0,0,0&light={light}"
        tab = PageTab(opened, url, link, options.width, options.height)
        try:
            first_bytes = tab.counts()["read_bytes"]
            tab.set_look(budgetBytes=options.budget_bytes, pixelError=options.pixel_errors[0])
            started = tab.first_picture_s
            waited = _seconds(tab.settled)
            full = tab.counts()["read_bytes"]
            path = [self._step(tab, view) for view in self.views]
            tab.settled()
            told = {
                "mode": self.mode,
                "label": self.entry["label"],
                "file_bytes": self.entry["bytes"],
                "first_s": started,
                "first_bytes": first_bytes,
                "full_s": started + waited,
                "full_bytes": full,
                "path": path,
                "end_card_bytes": tab.counts()["card_bytes"],
                "compared": self._compared(tab),
                "errors": self._errors(tab) if tab.has_pixel_error else [],
                "told": [*tab.told, *tab.notices],
            }
            return told, tab.card
        finally:
            tab.close()

    def _step(self, tab: PageTab, view: LinkView) -> dict[str, Any]:
        tab.look_from(view)
        took, drawn = tab.frame_ms(), tab.counts()
        tab.settled(self.options.patience_s)
        # Of the picture that was timed: later ones may have less to do.
        return {"frame_ms": took, **tab.counts(), "calls": drawn["calls"], "items": drawn["items"]}

    def _compared(self, tab: PageTab) -> list[dict[str, float]]:
        rows = []
        for number in np.linspace(0, len(self.views) - 1, _COMPARED).astype(int):
            view = self.views[number]
            tab.look_from(view)
            if not tab.settled():
                tab.told.append("a picture was compared before it was finished")
            shown = tab.picture()
            rows.append(
                {
                    "headless": _likeness(shown, self._drawn(view)),
                    "rays": _likeness(shown, self._rays(view)),
                }
            )
        return rows

    def _errors(self, tab: PageTab) -> list[dict[str, float]]:
        view = self.views[0]
        truth = self._rays(view)
        rows = []
        for error in self.options.pixel_errors:
            tab.look_from(view)
            tab.set_look(pixelError=error)
            tab.settled()
            took = float(np.median([tab.frame_ms() for _ in range(_FRAMES)]))
            rows.append(
                {
                    "pixel_error": error,
                    "frame_ms": took,
                    "card_bytes": tab.counts()["card_bytes"],
                    "error": 1.0 - _likeness(tab.picture(), truth),
                }
            )
        return rows

    def _drawn(self, view: LinkView) -> Picture:
        """The same form without a browser."""
        if self.mode == "surface":
            return self._plain(view)
        options = self.options
        wanted = WantedView(None, view, self.light, 0.0, 0.0, None, options.width, options.height)
        name = _HEADLESS.get(self.mode, self.mode)
        return _over(drawn_model(self.project.root, name, wanted).picture)

    def _rays(self, view: LinkView) -> Picture:
        """The source surface by rays: with its texture for forms that have one."""
        if self.mode not in _EVEN or not self.with_texture:
            return self._plain(view)
        options = self.options
        wanted = WantedView(None, view, "even", 0.0, 0.0, None, options.width, options.height)
        return _over(drawn_model(self.project.root, "surface", wanted).picture)

    def _plain(self, view: LinkView) -> Picture:
        mesh = read_surface(self.project.store.path("surface_ply"))
        camera = view.camera(self.origin, self.options.width, self.options.height)
        return _over(surface_picture(mesh, None, camera, self.light))


def _over(picture: Picture) -> Picture:
    """A picture with alpha over the page's background, (h, w, 3)."""
    share = picture[..., 3:] / 255.0
    return np.rint(share * picture[..., :3] + (1.0 - share) * _BACKGROUND).astype(np.uint8)


def _likeness(a: Picture, b: Picture) -> float:
    return float(structural_similarity(a, b, channel_axis=2))  # type: ignore[no-untyped-call]


def _seconds(act: Callable[[], Any]) -> float:
    from time import perf_counter

    start = perf_counter()
    act()
    return perf_counter() - start
