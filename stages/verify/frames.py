"""Where the surface of a report lies: in the user's own coordinates, and against the truth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.transforms import Matrix4, rigid
from workbench.pipeline.stage import Products

if TYPE_CHECKING:
    from workbench.verification.gauge import PoseComparison

# The material of the object in a simulation's truth; others are its support and surroundings.
OBJECT = 0


def users_origin(products: Products) -> NDArray[np.float64]:
    """(3,) of the frame the surface is told in; one from elsewhere is in the user's own."""
    inventory = products.load_if_there("scan_inventory")
    if inventory is None or products.load_if_there("surface") is None:
        return np.zeros(3)
    return np.array(inventory["origin_m"])


def compared_poses(products: Products, inventory: Mapping[str, Any]) -> PoseComparison:
    """The scans' poses against the true ones; tells the common motion, too."""
    from workbench.verification.gauge import compare_poses

    to_project = rigid(np.eye(3), -np.array(inventory["origin_m"]))

    def around_origin(poses: Mapping[str, Any]) -> dict[str, Matrix4]:
        scans = poses["scans"]
        return {n: to_project @ np.array(scans[n]["world_from_scan"]) for n in scans}

    estimate = around_origin(products.load("scan_poses"))
    truth = around_origin(products.load("truth_poses"))
    centres = {e["name"]: np.array(e["centre_in_scan_m"]) for e in inventory["scans"]}
    extent = float(np.median([max(e["extent_m"]) for e in inventory["scans"]]))
    return compare_poses(estimate, {n: truth[n] for n in estimate}, centres, extent)


def true_hits(products: Products, object_alone: bool) -> NDArray[np.float64]:
    """(k, 3) places in the truth's own frame that some beam met squarely."""
    hits = []
    for item in products.items("truth_samples"):
        arrays = products.load("truth_samples", item)
        square = ~(arrays["is_mixed"] | arrays["is_stray"])
        if object_alone:
            square &= arrays["material"] == OBJECT
        hits.append(arrays["true_points_in_local"][square])
    return np.concatenate(hits)
