"""What the page costs in every form of a model, with more and less room on the card.

    python -m tests.benchmarks.bench_viewer PROJECT OUT [--steps N] [--budgets-mb A,B,C]
                                            [--size WxH] [--modes A,B]

builds the site of PROJECT and measures it as ``workbench publish --measure`` does, once for each
budget. Prints a table and writes ``viewer.json`` and ``viewer.svg``, likeness to rays against
bytes on the card, to OUT. Times hold within one run.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tests.benchmarks.drawing import draw_tradeoff
from workbench.pipeline.progress import Progress
from workbench.project.project import Project
from workbench.verification.figures import TradeoffPoint
from workbench.viewer.page_browser import browser
from workbench.viewer.page_measures import MeasureOptions, page_measures
from workbench.viewer.representations import SiteOptions
from workbench.viewer.site import build_site


def row(form: dict[str, Any], budget_mb: float) -> str:
    """A line of the table."""
    path = form["path"]
    frames = [step["frame_ms"] for step in path]
    most = max(step["card_bytes"] for step in path)
    return (
        f"{form['mode']:10s}{budget_mb:7.0f}{form['first_s']:9.2f}{1e-6 * form['first_bytes']:8.2f}"
        f"{1e-6 * path[-1]['read_bytes']:8.1f}{path[-1]['requests']:9d}{np.median(frames):10.0f}"
        f"{max(frames):8.0f}{1e-6 * most:8.1f}{1e-6 * form['end_card_bytes']:8.1f}"
        f"{form['compared'][-1]['headless']:8.3f}{form['compared'][-1]['rays']:8.3f}"
    )


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("project", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--steps", type=int, default=50)
    parser.add_argument("--budgets-mb", default="32,64,128,256")
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--modes", default="")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    project = Project(args.project)
    site = build_site(project, SiteOptions(), Progress())
    if args.modes:
        wanted = args.modes.split(",")
        modes = [entry for entry in site.scene["modes"] if entry["mode"] in wanted]
        site = replace(site, scene=site.scene | {"modes": modes})
    width, height = (int(side) for side in args.size.split("x"))
    print(f"{'':10s}{'budget':>7s}{'first s':>9s}{'MB':>8s}{'path MB':>8s}{'requests':>9s}"
          f"{'frame ms':>10s}{'worst':>8s}{'card MB':>8s}{'end MB':>8s}{'twin':>8s}{'rays':>8s}",
          flush=True)  # fmt: skip
    told, points = {}, []
    with browser() as opened:
        for budget in (float(text) for text in args.budgets_mb.split(",")):
            options = MeasureOptions(
                args.steps, 0.5, width, height, round(1e6 * budget), pixel_errors=(1.0,)
            )
            measured = page_measures(opened, project, site, options, Progress(quiet=True))
            told[budget] = measured
            for form in measured["forms"]:
                print(row(form, budget), flush=True)
                name = f"{form['mode']} in {budget:g} MB"
                error = 1.0 - form["compared"][-1]["rays"]
                points.append(TradeoffPoint(name, 1e-6 * form["end_card_bytes"], error))
    (args.out / "viewer.json").write_text(json.dumps(told, indent=1), encoding="utf-8")
    draw_tradeoff(args.out, "viewer", points, "1 - SSIM to rays", points[0].name)


if __name__ == "__main__":
    main()
