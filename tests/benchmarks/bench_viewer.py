"""What the page costs in every form of a model: bytes, frame times, calls, along a path.

    python -m tests.benchmarks.bench_viewer PROJECT OUT [--steps N] [--budget-mb N] [--size WxH]

builds the site of PROJECT, serves it with ranges from this machine, and opens it in headless
Chromium, which draws on the processor where there is no graphics card. In every form it notes the
time and the bytes to the first picture and until nothing more is to come; goes once around the
object and nearer in so many steps, each drawn until it is settled; and holds the picture of each
tenth step against that of the first form. Prints a table, and writes
``viewer.csv`` and ``viewer.svg``, error against frame time, to OUT. Times hold within one run.
"""

from __future__ import annotations

import argparse
import csv
import shutil
import threading
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from playwright.sync_api import sync_playwright
from skimage.metrics import structural_similarity

from tests.benchmarks.drawing import draw_tradeoff
from workbench.pipeline.progress import Progress
from workbench.project.project import Project
from workbench.verification.figures import TradeoffPoint
from workbench.viewer.representations import SiteOptions
from workbench.viewer.server import site_server
from workbench.viewer.site import Site, build_site

_ARGUMENTS = (
    "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
)  # fmt: skip
_PANEL_PX = 288
_SETTLED = "() => window.page?.stage.mode && !window.page.stage.pending"
_COMPARED_EVERY = 10


@dataclass(frozen=True)
class Row:
    """One form of the model.

    Attributes
    ----------
    first_s, first_mb : from opening the page to the first picture.
    full_s, full_mb : until nothing more was to come.
    path_mb, requests : over the whole path.
    frame_ms, worst_frame_ms : median and longest of the path's pictures.
    calls, items : of the last picture.
    card_mb : most bytes on the card.
    likeness : mean SSIM to the pictures of the first form from the same places.
    """

    mode: str
    first_s: float
    first_mb: float
    full_s: float
    full_mb: float
    path_mb: float
    requests: int
    frame_ms: float
    worst_frame_ms: float
    calls: int
    items: int
    card_mb: float
    likeness: float


def path_of(site: Site, steps: int) -> list[str]:
    """Views once around the object, nearing it to a third, as links have them."""
    eye = np.array(site.scene["home"]["eye"])
    links = []
    for share in np.arange(steps) / steps:
        turn = 2.0 * np.pi * share
        near = 1.0 - share * 2.0 / 3.0
        c, s = np.cos(turn), np.sin(turn)
        x, y, z = near * eye
        place = (c * x - s * y, s * x + c * y, z)
        links.append("eye=" + ",".join(f"{value:.5f}" for value in place) + "&to=0,0,0")
    return links


def measured(
    browser: Any, site: Site, url: str, mode: str, links: list[str], args: argparse.Namespace
) -> tuple[Row, list[NDArray[np.uint8]]]:
    """One form along the path, and its compared pictures."""
    width, height = (int(side) for side in args.size.split("x"))
    context = browser.new_context(viewport={"width": width + _PANEL_PX, "height": height})
    page = context.new_page()
    start = perf_counter()
    page.goto(f"{url}#mode={mode}&{links[0]}&light=camera")
    page.wait_for_function("() => window.page?.stage.firstPicture", timeout=120_000)
    first = (perf_counter() - start, page.evaluate("() => page.network.bytes"))
    page.evaluate(f"() => {{ page.stage.look.budgetBytes = {args.budget_mb} * 2 ** 20 }}")
    page.wait_for_function(_SETTLED, timeout=300_000)
    full = (perf_counter() - start, page.evaluate("() => page.network.bytes"))
    frames: list[float] = []
    most, pictures = 0, []
    for number, link in enumerate(links):
        page.evaluate(
            f"() => {{ page.camera.read(Object.fromEntries(new URLSearchParams('{link}'))) }}"
        )
        frames.append(
            page.evaluate(
                "() => { const t = performance.now(); page.stage.frame(); page.stage.gl.finish();"
                " return performance.now() - t }"
            )
        )
        page.wait_for_function(_SETTLED, timeout=300_000)
        most = max(most, page.evaluate("() => page.stage.counts.bytes"))
        if number % _COMPARED_EVERY == 0:
            shot = page.locator("#picture").screenshot()
            pictures.append(cv2.imdecode(np.frombuffer(shot, np.uint8), cv2.IMREAD_COLOR))
    told = page.evaluate(
        "() => [page.network.bytes, page.network.requests, page.stage.counts.calls,"
        " page.stage.counts.items]"
    )
    context.close()
    row = Row(
        mode, first[0], 1e-6 * first[1], full[0], 1e-6 * full[1], 1e-6 * told[0], told[1],
        float(np.median(frames)), max(frames), told[2], int(told[3]), 1e-6 * most, 0.0,
    )  # fmt: skip
    return row, pictures


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("project", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--steps", type=int, default=50)
    parser.add_argument("--budget-mb", type=int, default=64)
    parser.add_argument("--size", default="640x480")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    site = build_site(Project(args.project), SiteOptions(), Progress())
    server = site_server(site)
    thread = threading.Thread(target=server.serve)
    thread.start()
    links = path_of(site, args.steps)
    rows: list[Row] = []
    pictures: dict[str, list[NDArray[np.uint8]]] = {}
    found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=found, args=list(_ARGUMENTS))
            print(f"{'':10s}  first s    MB   full s     MB  path MB  requests  frame ms  worst  "
                  "calls   items  card MB   SSIM")  # fmt: skip
            for mode in (entry["mode"] for entry in site.scene["modes"]):
                row, pictures[mode] = measured(browser, site, server.url, mode, links, args)
                truth = pictures[site.scene["modes"][0]["mode"]]
                like = [
                    structural_similarity(a, b, channel_axis=2)
                    for a, b in zip(pictures[mode], truth, strict=True)
                ]
                row = Row(**asdict(row) | {"likeness": float(np.mean(like))})
                rows.append(row)
                print(
                    f"{row.mode:10s}{row.first_s:9.2f}{row.first_mb:6.1f}{row.full_s:9.2f}"
                    f"{row.full_mb:7.1f}{row.path_mb:9.1f}{row.requests:10d}{row.frame_ms:10.1f}"
                    f"{row.worst_frame_ms:7.0f}{row.calls:7d}{row.items:8d}{row.card_mb:9.1f}"
                    f"{row.likeness:7.3f}",
                    flush=True,
                )
            browser.close()
    finally:
        server.stop()
        thread.join()
    with open(args.out / "viewer.csv", "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(asdict(rows[0])))
        writer.writeheader()
        writer.writerows(map(asdict, rows))
    points = [TradeoffPoint(row.mode, 1e-3 * row.frame_ms, 1.0 - row.likeness) for row in rows]
    draw_tradeoff(args.out, "viewer", points, "1 - SSIM to the first form", rows[0].mode)


if __name__ == "__main__":
    main()
