"""Where the scanner stands, and how wrong the pipeline is told it stands."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.geometry import transforms
from workbench.synthetic.building import round_the_walls
from workbench.synthetic.options import CoarsePoseOptions, SimulationOptions
from workbench.synthetic.scene import Scene

# Elevations of successive stations: near level, from above, from below, steeply from above.
_ELEVATIONS_DEG = {
    "statue": (6.0, 35.0, -12.0, 14.0, 62.0, 22.0),
    "sphere": (0.0, 40.0, -35.0, 15.0),
    "cylinder": (0.0,),
}
_PLANE_TILTS_DEG = (8.0, 22.0, 14.0, 28.0)
_SHEET_ELEVATIONS_DEG = (58.0, -52.0, 72.0, -66.0)


def local_from_scan(
    scene: Scene, options: SimulationOptions, index: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """True 4×4 pose of one scan in the scene's local frame."""
    stations = options.stations
    distance = stations.standoff_m * (1 + rng.uniform(-1, 1) * stations.standoff_spread)
    aim = scene.focus + rng.uniform(-1, 1, 3) * stations.aim_spread_m
    share = (index + rng.uniform(-0.1, 0.1)) / options.scans
    if options.scene == "building":
        return _outdoors(index, share, distance, aim - scene.focus)
    if options.scene == "plane":
        elevation = 90.0 - _PLANE_TILTS_DEG[index % len(_PLANE_TILTS_DEG)]
    elif options.scene == "thin-sheet":
        elevation = _SHEET_ELEVATIONS_DEG[index % len(_SHEET_ELEVATIONS_DEG)]
    else:
        cycle = _ELEVATIONS_DEG[options.scene]
        elevation = cycle[index % len(cycle)]
    elevation_rad = np.radians(elevation + rng.uniform(-3, 3) * (options.scene != "cylinder"))
    azimuth = 2 * np.pi * share + 0.5 * np.pi
    way = np.array(
        [
            np.cos(elevation_rad) * np.cos(azimuth),
            np.cos(elevation_rad) * np.sin(azimuth),
            np.sin(elevation_rad),
        ]
    )
    return transforms.looking_at(aim + distance * way, aim)


def _outdoors(
    index: int, share: float, distance: float, jitter: NDArray[np.float64]
) -> NDArray[np.float64]:
    """A tripod (each fifth station: a lift) on a path round the building, facing its walls."""
    foot, outward = round_the_walls(share)
    height = 15.0 if index % 5 == 4 else 1.7
    position = np.array([*(foot + distance * outward), height])
    # Looking a little towards the building's middle lets neighbouring views overlap at corners.
    target = np.array([*(0.75 * foot), 6.0 if height > 10 else 4.2])
    return transforms.looking_at(position, target + jitter)


def coarse_pose(
    local_from_scan: NDArray[np.float64],
    focus: NDArray[np.float64],
    options: CoarsePoseOptions,
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """A pose (4×4) with the error that a hand-made first alignment has.

    Every component of the rotation vector and of the shift is normal with the stated sigma;
    the rotation turns about the chosen pivot, so that with pivot ``object`` the error at the
    object's middle is the shift alone.
    """
    rotation = np.radians(options.rotation_sigma_deg) * rng.standard_normal(3)
    shift = options.translation_sigma_m * rng.standard_normal(3)
    error = transforms.from_twist(np.concatenate([rotation, np.zeros(3)]))[:3, :3]
    pivot = focus if options.pivot == "object" else local_from_scan[:3, 3]
    position = pivot + error @ (local_from_scan[:3, 3] - pivot) + shift
    return transforms.rigid(error @ local_from_scan[:3, :3], position)
