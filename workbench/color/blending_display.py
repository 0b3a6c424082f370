"""Blended colours as other programs show them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.color.spaces import SpaceName, working_space
from workbench.formats.gltf import srgb_from_linear


def encoded_srgb(colors: NDArray[np.floating], space: SpaceName) -> NDArray[np.uint8]:
    """Colours (n, 3) of a linear working space as sRGB-encoded bytes (n, 3).

    What sRGB cannot show is clipped: lighter than white, or more saturated than its primaries.
    """
    xyz_d50 = np.asarray(colors, np.float64) @ working_space(space).xyz_d50_from_rgb.T
    return srgb_from_linear(xyz_d50 @ working_space("rec709").rgb_from_xyz_d50.T)
