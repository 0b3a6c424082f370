"""Error of range maps' masks against run time, for what the masking uses and how it is set.

    python -m tests.benchmarks.bench_range_map_masking OUT [PROJECT]

learns from two suggested scans of a simulated statue, masks the others, prints a table next
to GrabCut from the histogram of the reflectance, and writes ``range_map_masking.svg`` and,
where an SVG renderer is at hand, ``.png`` to OUT. PROJECT is a simulation on disk; without
it 24 scans are simulated. Errors are per cent of the clutter: whole samples on the support.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np
from numpy.typing import NDArray

from tests.benchmarks.drawing import draw_tradeoff
from tests.masking.scenes import range_map_channels
from workbench.formats.mask_png import read_mask_png
from workbench.formats.range_ply import read_range_ply
from workbench.geometry import transforms
from workbench.geometry.rangemap import RangeMap
from workbench.masking.classifier import PAPER, trained
from workbench.masking.grid_surface import grid_image, grid_surface
from workbench.masking.histograms import Example
from workbench.masking.range_map_signal import range_map_picture, reflectance_span
from workbench.masking.range_maps import (
    RangeMapMaskingOptions,
    learned_range_maps,
    mask_of_range_map,
)
from workbench.masking.segmentation import SegmentationOptions, segmented
from workbench.masking.suggestion import suggested
from workbench.synthetic.options import SimulationOptions
from workbench.synthetic.scene import OBJECT
from workbench.synthetic.simulation import simulate_scans
from workbench.synthetic.writing import nominal_spacing_m
from workbench.verification.figures import TradeoffPoint
from workbench.verification.mask_errors import MaskedSamples, checked_scan_masks

Mask = NDArray[np.uint8]
MaskOf = Callable[[RangeMap], Mask]
DEFAULT = RangeMapMaskingOptions()
CHOSEN = "+ cut (default)"
SETTINGS = {
    "threshold, reflectance alone": RangeMapMaskingOptions(incidence_bins=1, smoothness=0.0),
    "+ incidence": RangeMapMaskingOptions(smoothness=0.0),
    CHOSEN: DEFAULT,
    "cut, reflectance alone": RangeMapMaskingOptions(incidence_bins=1),
    "8 bins": RangeMapMaskingOptions(bins=8),
    "16 bins": RangeMapMaskingOptions(bins=16),
    "64 bins": RangeMapMaskingOptions(bins=64),
    "smoothness 0.5": RangeMapMaskingOptions(smoothness=0.5),
    "smoothness 2": RangeMapMaskingOptions(smoothness=2.0),
    "keep odds 1": RangeMapMaskingOptions(keep_odds=1.0),
    "keep odds 4": RangeMapMaskingOptions(keep_odds=4.0),
    "erosion 1": RangeMapMaskingOptions(erosion_px=1),
    "erosion 2": RangeMapMaskingOptions(erosion_px=2),
    "erosion 4": RangeMapMaskingOptions(erosion_px=4),
    "median 5, erosion 4": RangeMapMaskingOptions(median_px=5, erosion_px=4),
}
# It neither drops pieces nor closes holes here, since the others do not, either.
BARE = SegmentationOptions(
    method="grabcut", least_piece=0.0, largest_hole=0.0, median_px=0, erosion_px=0
)
GRABCUTS = {
    "GrabCut": BARE,
    "GrabCut, median 5, erosion 4": replace(BARE, median_px=5, erosion_px=4),
}


@dataclass(frozen=True)
class Scan:
    """A simulated scan, its true mask, and of every whole sample its cell, place and class."""

    range_map: RangeMap
    mask: Mask
    cells: NDArray[np.int64]
    places: NDArray[np.float64]
    model: NDArray[np.bool_]


def simulated() -> tuple[list[Scan], float]:
    options = SimulationOptions(scene="statue", seed=11, scans=24)
    scans = []
    for scan in simulate_scans(options):
        true = scan.samples
        whole = ~(true.is_mixed | true.is_stray)
        places = transforms.apply(scan.local_from_scan, true.true_points_in_scan)
        scans.append(
            Scan(
                scan.range_map,
                scan.object_mask,
                true.pixel[whole],
                places[whole],
                true.material[whole] == OBJECT,
            )
        )
    return scans, nominal_spacing_m(options)


def read(project: Path) -> tuple[list[Scan], float]:
    truth = project / "truth"
    told = json.loads((truth / "simulation.json").read_text(encoding="utf-8"))
    return list(_read_scans(project)), float(told["nominal_sample_spacing_m"])


def _read_scans(project: Path) -> Iterator[Scan]:
    for file in sorted((project / "scans").glob("*.ply")):
        true = np.load(project / "truth" / "scans" / f"{file.stem}.npz")
        whole = ~(true["is_mixed"] | true["is_stray"])
        yield Scan(
            read_range_ply(file),
            read_mask_png(project / "truth" / "masks" / f"{file.stem}.png"),
            true["pixel"][whole],
            true["true_points_in_local"][whole],
            true["material"][whole] == OBJECT,
        )


def shown_for_suggestion(scan: RangeMap) -> NDArray[np.float32]:
    """The picture's grey in [0, 1], NaN in holes."""
    assert scan.grid is not None
    grey = range_map_picture(scan)[..., 1].astype(np.float32) / np.float32(255)
    return np.where(scan.grid >= 0, grey, np.float32(np.nan))


def grabcut(taught: list[Scan], scans: list[Scan], options: SegmentationOptions) -> MaskOf:
    """The cut of the reflectance, the depth steps and the slant, from the histogram's seeds."""
    low, high = reflectance_span(scan.range_map for scan in scans)

    def reflectance(scan: RangeMap) -> NDArray[np.float32]:
        assert scan.reflectance is not None
        part = np.clip((scan.reflectance - low) / (high - low), 0.0, 1.0)
        return np.asarray(grid_image(scan, part.astype(np.float32), np.nan), np.float32)

    classifier = trained([Example(reflectance(s.range_map), s.mask) for s in taught], PAPER)

    def mask_of(scan: RangeMap) -> Mask:
        shown, normals = reflectance(scan), grid_surface(scan).normals
        distance = np.linalg.norm(scan.points_in_scan, axis=1)
        channels = range_map_channels(
            shown,
            np.asarray(grid_image(scan, distance, np.nan), np.float64),
            np.asarray(grid_image(scan, normals, np.nan), np.float64),
        )
        return segmented(channels, classifier.probability(shown), options)

    return mask_of


def measured(name: str, tests: list[Scan], radius_m: float, mask_of: MaskOf) -> TradeoffPoint:
    seconds, samples = [], []
    for scan in tests:
        start = perf_counter()
        mask = mask_of(scan.range_map)
        seconds.append(perf_counter() - start)
        keep = mask.ravel()[scan.cells] > 127
        samples.append(MaskedSamples(scan.places, scan.model, ~scan.model, keep, keep))
    errors, each = checked_scan_masks(samples, radius_m).final, float(np.median(seconds))
    print(
        f"{name:30s}{each:8.3f}{errors.false_positive_percent:9.4f}"
        f"{errors.false_negative_percent:9.3f}{errors.true_false_negative_percent:10.4f}",
        flush=True,
    )
    return TradeoffPoint(name, each, errors.false_positive_percent + errors.false_negative_percent)


def main(out: Path, project: Path | None) -> None:
    cv2.setNumThreads(1)
    scans, spacing_m = simulated() if project is None else read(project)
    shown = suggested((shown_for_suggestion(scan.range_map) for scan in scans), 2)
    taught = [scans[n] for n in shown]
    tests = [scan for n, scan in enumerate(scans) if n not in shown]
    radius_m = max(1e-3, spacing_m)
    print(
        f"learned from scans {shown}, {len(tests)} masked; covered within {1e3 * radius_m:.1f} mm"
    )
    print(f"{'setting':30s}  s/scan     FP %     FN %  true FN %")
    pairs = [(scan.range_map, scan.mask) for scan in taught]
    # Once for nothing, since what is compiled at its first use would count.
    mask_of_range_map(tests[0].range_map, learned_range_maps(pairs))
    points = []
    for name, options in SETTINGS.items():
        classifier = learned_range_maps(pairs, options)
        points.append(
            measured(
                name,
                tests,
                radius_m,
                lambda scan, c=classifier, o=options: mask_of_range_map(scan, c, o),
            )
        )
    for name, cut in GRABCUTS.items():
        points.append(measured(name, tests, radius_m, grabcut(taught, scans, cut)))
    draw_tradeoff(out, "range_map_masking", points, "FP + FN (% of the clutter)", CHOSEN)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else None)
