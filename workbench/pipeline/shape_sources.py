"""What tells the shape: range scans, and depth maps of photographs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.rangemap import RangeMap
from workbench.geometry.transforms import rigid
from workbench.pipeline.stage import Products

SCANNED, PHOTOGRAPHED = "range_maps", "photo_range_maps"


@dataclass(frozen=True)
class ShapeSource:
    """A scan, or a photograph's depth map.

    Attributes
    ----------
    name : unique among all of them.
    item : its own name, within ``maps``.
    maps : the artefact that holds it.
    entry : what the inventory tells of it.
    number : its owner number in the samples.
    project_from_map : 4×4; None where registration left it out.
    """

    name: str
    item: str
    maps: str
    entry: Mapping[str, Any]
    number: int
    project_from_map: NDArray[np.float64] | None


def shape_sources(products: Products) -> tuple[ShapeSource, ...]:
    """All of them in the order of the samples' owners: scans first."""
    found: list[ShapeSource] = []
    scans = products.load_if_there("scan_inventory")
    if scans is not None and products.is_there("scan_poses"):
        poses = products.load("scan_poses")["scans"]
        to_project = rigid(np.eye(3), -np.array(scans["origin_m"]))
        found += _placed(SCANNED, scans["scans"], poses, to_project, ())
    photos = products.load_if_there("photo_range_inventory")
    if photos is not None:
        poses = {entry["name"]: entry for entry in photos["scans"]}
        # Cameras are oriented about the project's origin, and their depth maps are so, too.
        taken = [source.name for source in found]
        found += _placed(PHOTOGRAPHED, photos["scans"], poses, np.eye(4), taken)
    return tuple(found)


def kept_scan(products: Products, name: str) -> RangeMap:
    """A scan without what was masked away."""
    scan: RangeMap = products.load(SCANNED, name)
    mask = products.load_if_there("scan_masks", name)
    return scan if mask is None else scan.masked(mask)


def _placed(
    maps: str,
    entries: Sequence[Mapping[str, Any]],
    poses: Mapping[str, Any],
    to_project: NDArray[np.float64],
    taken: Sequence[str],
) -> list[ShapeSource]:
    found = []
    for number, entry in enumerate(entries, len(taken)):
        name, pose = entry["name"], None
        if name in poses:
            world_from_scan = np.array(poses[name]["world_from_scan"])
            pose = to_project @ world_from_scan @ rigid(np.eye(3), entry["scan_shift_m"])
        # A photograph may be called as a scan is.
        unique = f"{name}-photograph" if name in taken else name
        found.append(ShapeSource(unique, name, maps, entry, number, pose))
    return found
