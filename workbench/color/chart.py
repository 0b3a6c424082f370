"""The ColorChecker Classic: where its patches lie and what colours they are said to have."""

from __future__ import annotations

from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

ROWS, COLS = 4, 6
PATCHES = ROWS * COLS
NEUTRALS = tuple(range(18, 24))
"""Numbers of the grey row, white first."""
WHITE = 18

# What the maker measured changed in November 2014 with its pigments.
Edition = Literal["after_2014", "before_2014"]
_COLOUR_NAMES = {
    "after_2014": "ColorChecker24 - After November 2014",
    "before_2014": "ColorChecker24 - Before November 2014",
}


@cache
def patch_names() -> tuple[str, ...]:
    """Names of the patches, row by row from the dark skin."""
    import colour

    told = colour.CCS_COLOURCHECKERS[_COLOUR_NAMES["after_2014"]].data
    return tuple(name.split(" (")[0] for name in told)


@cache
def reference_xyz_d50(edition: Edition) -> NDArray[np.float64]:
    """Published colours (24, 3) in CIE XYZ relative to D50, Y of a perfect diffuser 1."""
    import colour

    data = colour.CCS_COLOURCHECKERS[_COLOUR_NAMES[edition]].data
    return np.asarray(colour.xyY_to_XYZ(list(data.values())), float)


def patch_middles() -> NDArray[np.float64]:
    """Middles (24, 2) of the patches in cells, right and down; the chart is 6 × 4 cells."""
    down, right = np.divmod(np.arange(PATCHES), COLS)
    return np.stack([right + 0.5, down + 0.5], axis=1)


def in_chart(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Places (n, 2) in cells as x to the right and y down in [−1, 1] over the chart's width."""
    return np.asarray((places - [0.5 * COLS, 0.5 * ROWS]) / (0.5 * COLS))
