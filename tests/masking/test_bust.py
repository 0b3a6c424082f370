"""A real bust apart from its plinth and the backdrop, after a mask over a tenth of the scan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.formats.scans import read_scans
from workbench.masking.range_maps import learned_range_maps, mask_of_range_map

# Outlines read off the picture of the bust's range map: columns, then rows of the grid.
PLINTH = np.column_stack(
    (
        [236, 249, 249, 250, 253, 255, 255, 236],
        [140, 140, 270, 300, 345, 375, 380, 380],
    )
)
BESIDE_THE_HAIR = np.column_stack(
    (
        [953, 905, 868, 868, 900, 912, 919, 921, 924, 926, 918, 908, 918, 930, 953],
        [0, 0, 90, 112, 124, 150, 165, 190, 220, 280, 292, 330, 360, 390, 440],
    )
)
OVER_THE_SHOULDER = np.column_stack(
    ([503, 550, 605, 605, 560, 515, 503], [75, 75, 135, 145, 165, 165, 125])
)
UNDER_THE_CHIN = np.column_stack(([545, 575, 575, 545], [358, 358, 390, 390]))
AT_THE_EDGE = np.column_stack(([530, 600, 640, 530], [610, 610, 651, 651]))
BACKDROP = [BESIDE_THE_HAIR, OVER_THE_SHOULDER, UNDER_THE_CHIN, AT_THE_EDGE]
# Part of the plinth and of the chest, of the hair and of the backdrop on both sides of it.
DRAWN_OVER = [
    np.s_[300:400, 236:430],
    np.s_[80:260, 830:953],
    np.s_[80:165, 500:560],
    np.s_[150:250, 560:650],
]


def test_a_mask_over_a_tenth_of_the_bust_removes_plinth_and_backdrop(
    shared_data: Callable[..., Path],
) -> None:
    path = shared_data("bust-reflectance", "alexander_range_refl.ply")
    scan = read_scans(path, {})[0].range_map
    assert scan.grid is not None
    samples = scan.grid >= 0

    def inside(polygons: list[NDArray[np.int64]]) -> NDArray[np.bool_]:
        drawn = np.zeros(samples.shape, np.uint8)
        for polygon in polygons:
            cv2.fillPoly(drawn, [polygon.astype(np.int32)], 1)
        return samples & (drawn > 0)

    plinth, backdrop = inside([PLINTH]), inside(BACKDROP)
    truth = np.where(plinth | backdrop, 0, 255).astype(np.uint8)
    unseen = samples.copy()
    examples = []
    for window in DRAWN_OVER:
        examples.append((replace(scan, grid=scan.grid[window].copy()), truth[window]))
        unseen[window] = False
    assert sum(mask.size for _, mask in examples) < 0.1 * samples.size
    classifier = learned_range_maps(examples)
    assert classifier
    kept = mask_of_range_map(scan, classifier) > 0
    for clutter, least in ((plinth, 800), (backdrop, 2000)):
        judged = clutter & unseen
        assert judged.sum() > least
        assert kept[judged].mean() < 0.005
    bust = unseen & (truth > 0)
    assert bust.sum() > 100_000
    assert kept[bust].mean() > 0.99
    # The file is in millimetres, which must not matter; powers of two leave no rounding.
    smaller = replace(scan, points_in_scan=2.0**-10 * scan.points_in_scan)
    np.testing.assert_array_equal(mask_of_range_map(smaller, classifier) > 0, kept)
