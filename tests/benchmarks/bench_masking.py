"""Error of photographs' masks against run time, for the forest, the cut and the published method.

    python -m tests.benchmarks.bench_masking OUT [DTU_SCAN]

trains with three suggested masks, masks one in eight of the others, prints a table
next to plain GrabCut from each mask's bounding rectangle and to the threshold alone, and
writes ``masking_tradeoff.svg`` and, where an SVG renderer is at hand, ``.png`` to OUT.
DTU_SCAN holds ``photos`` and ``masks``; without it the photographs are synthetic.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np
from numpy.typing import NDArray

from tests.benchmarks.drawing import draw_tradeoff
from tests.masking.scenes import photograph
from workbench.masking.classifier import PAPER, ClassifierOptions, trained
from workbench.masking.evaluation import joined_errors, masking_errors
from workbench.masking.histograms import Example
from workbench.masking.segmentation import SegmentationOptions, segmented
from workbench.masking.suggestion import suggested
from workbench.verification.figures import TradeoffPoint

Image = NDArray[np.uint8]
CHOSEN = "forest of 30, cut at 800 px"
BARE = SegmentationOptions(erosion_px=0)
PUBLISHED = replace(BARE, method="grabcut", coarse_side_px=400, finer_levels=2)
SETTINGS = {
    CHOSEN: (ClassifierOptions(), BARE),
    "forest of 10": (ClassifierOptions(trees=10), BARE),
    "forest of 60": (ClassifierOptions(trees=60), BARE),
    "cut at 400 px": (ClassifierOptions(), replace(BARE, coarse_side_px=400)),
    "cut at 1600 px": (ClassifierOptions(), replace(BARE, coarse_side_px=1600)),
    "1 finer level": (ClassifierOptions(), replace(BARE, finer_levels=1)),
    "smoothness 2": (ClassifierOptions(), replace(BARE, smoothness=2.0)),
    "smoothness 8": (ClassifierOptions(), replace(BARE, smoothness=8.0)),
    "smoothness 128": (ClassifierOptions(), replace(BARE, smoothness=128.0)),
    "histograms with tone, cut": (ClassifierOptions(trees=0), BARE),
    "published: histogram, GrabCut": (PAPER, PUBLISHED),
    "published, 5 iterations": (PAPER, replace(PUBLISHED, iterations=5)),
    "published, 0 finer levels": (PAPER, replace(PUBLISHED, finer_levels=0)),
    "published, 8 bins": (replace(PAPER, bins=8), PUBLISHED),
    "published, 64 bins": (replace(PAPER, bins=64), PUBLISHED),
}


def examples(scan: Path | None) -> list[Example]:
    if scan is None:
        places = np.random.default_rng(0).uniform(0.35, 0.65, (15, 2))
        return [Example(*photograph(n, 1200, (x, y))) for n, (x, y) in enumerate(places)]
    pairs = zip(
        sorted((scan / "photos").iterdir()), sorted((scan / "masks").iterdir()), strict=True
    )
    return [
        Example(
            cv2.cvtColor(cv2.imread(str(photo)), cv2.COLOR_BGR2RGB),
            cv2.imread(str(mask), cv2.IMREAD_GRAYSCALE),
        )
        for photo, mask in pairs
    ]


def plain(example: Example) -> Image:
    """GrabCut as it comes, from the bounding rectangle of the true mask."""
    labels, models = np.zeros(example.mask.shape, np.uint8), np.zeros((2, 1, 65))
    box = cv2.boundingRect(example.mask)
    cv2.setRNGSeed(0)
    cv2.grabCut(example.image, labels, box, models[0], models[1], 5, cv2.GC_INIT_WITH_RECT)
    return np.where(labels & 1, 255, 0).astype(np.uint8)


def measured(name: str, tests: list[Example], mask_of: Callable[[Example], Image]) -> TradeoffPoint:
    start = perf_counter()
    masks = [mask_of(example) for example in tests]
    seconds = (perf_counter() - start) / len(tests)
    errors = [masking_errors(m, e.mask) for m, e in zip(masks, tests, strict=True)]
    each = [error.iou for error in errors]
    total = joined_errors(errors)
    print(
        f"{name:34s}{seconds:8.2f}{np.mean(each):10.4f}{min(each):9.4f}"
        f"{total.false_positive_percent:8.2f}{total.false_negative_percent:8.2f}",
        flush=True,
    )
    return TradeoffPoint(name, seconds, 100.0 * (1.0 - float(np.mean(each))))


def main(out: Path, scan: Path | None) -> None:
    cv2.setNumThreads(1)
    every = examples(scan)
    shown = suggested([example.image for example in every], 3)
    taught = [every[n] for n in shown]
    tests = [example for n, example in enumerate(every) if n not in shown][::8]
    print(f"trained with images {shown}, {len(tests)} masked")
    print(f"{'setting':34s} s/image  mean IoU      min    FP %    FN %")
    points = [measured("plain GrabCut, rectangle", tests, plain)]
    default = trained(taught)

    def thresholded(example: Example) -> Image:
        size = example.mask.shape[::-1]
        large = cv2.resize(default.probability(example.image), size)
        return np.where(large > 0.5, 255, 0).astype(np.uint8)

    points.append(measured("threshold alone", tests, thresholded))
    for name, (learning, options) in SETTINGS.items():
        classifier = trained(taught, learning)
        points.append(
            measured(
                name,
                tests,
                lambda e, c=classifier, o=options: segmented(e.image, c.probability(e.image), o),
            )
        )
    draw_tradeoff(out, "masking_tradeoff", points, "100 × (1 − mean IoU)", CHOSEN)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else None)
