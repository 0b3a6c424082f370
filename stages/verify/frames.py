"""Where the surface of a report lies in the user's own coordinates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.pipeline.stage import Products


def users_origin(products: Products) -> NDArray[np.float64]:
    """(3,) of the frame the surface is told in; one from elsewhere is in the user's own."""
    inventory = products.load_if_there("scan_inventory")
    if inventory is None or products.load_if_there("surface") is None:
        return np.zeros(3)
    return np.array(inventory["origin_m"])
