"""Error of the flash's position against run time, by number of observations and terms.

    python -m tests.benchmarks.bench_flash OUT

estimates the flash of simulated scenes with a rough surface, a beam that falls off, 1 % of noise
and 5 % of outliers, each number with three seeds; prints a table with how far the position is
off, in millimetres and in stated standard deviations, and how uneven the albedo stays; and
writes ``flash_tradeoff.svg`` and, where an SVG renderer is at hand, ``.png`` to OUT.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from time import process_time

import numpy as np

from tests.benchmarks.drawing import draw_tradeoff
from tests.color.flash_scene import flash_scene
from workbench.color.flash_estimation import estimated_flash
from workbench.color.flash_parameters import FlashTerm
from workbench.verification.figures import TradeoffPoint

FLASH = np.array([-0.13, -0.05, 0.02])
ALL: tuple[FlashTerm, ...] = ("falloff", "roughness", "indirect")
TERMS: dict[str, tuple[FlashTerm, ...]] = {
    "position and gains": (),
    "with roughness": ("roughness",),
    "with falloff": ("falloff",),
    "all terms, chosen": ALL,
}
# Samples and photographs.
SIZES = ((100, 10), (400, 15), (1500, 30), (6000, 50), (20_000, 60), (60_000, 80))
TERMS_SIZE = (6000, 50)
SEEDS = (0, 1, 2)


def measured(name: str, size: tuple[int, int], terms: Sequence[FlashTerm]) -> TradeoffPoint:
    errors, sigmas, uneven, seconds, count = [], [], [], [], 0
    for seed in SEEDS:
        scene = flash_scene(
            seed, *size, sigma=0.3, beam=0.4, gain_sigma=0.2, noise=0.01, outliers=0.05
        )
        seen = scene.seen
        start = process_time()
        found = estimated_flash(seen, terms=terms)
        seconds.append(process_time() - start)
        count += len(seen.sample)
        if not found:
            print(f"{name:24s} seed {seed}: {found.reason}")
            continue
        off = found.light.position_in_camera - FLASH
        errors.append(1e3 * float(np.linalg.norm(off)))
        sigmas.append(float(np.abs(off / found.position_sigma).max()))
        received = found.light.received(seen.places_in_camera, seen.normals_in_camera)
        albedo = seen.values / (found.gains[seen.photo] * received * scene.albedo)
        uneven.append(float(np.log(albedo[~scene.outlier]).std()))
    print(
        f"{name:24s}{count // len(SEEDS):10d}{np.mean(seconds):8.2f}{np.mean(errors):10.2f}"
        f"{np.max(errors):8.2f}{np.max(sigmas):9.1f}{100 * np.mean(uneven):10.2f}",
        flush=True,
    )
    return TradeoffPoint(name, float(np.mean(seconds)), float(np.mean(errors)))


def main(out: Path) -> None:
    # Of compiled parts and imports, the first estimate would pay for all.
    estimated_flash(flash_scene(9, samples=200, photos=8).seen)
    print(
        f"{'setting':24s}{'observed':>10s}{'CPU s':>8s}{'mean mm':>10s}{'max mm':>8s}"
        f"{'sigmas':>9s}{'albedo %':>10s}"
    )
    points = [
        measured(f"{samples} × {photos}, all terms", (samples, photos), ALL)
        for samples, photos in SIZES
    ]
    points += [measured(name, TERMS_SIZE, terms) for name, terms in TERMS.items()]
    draw_tradeoff(
        out,
        "flash_tradeoff",
        points,
        "position off (mm)",
        f"{SIZES[-1][0]} × {SIZES[-1][1]}, all terms",
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
