"""The scans as registration holds them: masked, with normals, thinned to what memory allows."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.transforms import Matrix4, rigid
from workbench.pipeline.shape_sources import kept_scan
from workbench.pipeline.stage import Job

if TYPE_CHECKING:
    from stages.register import RegisterOptions
    from workbench.geometry.orientedscan import OrientedScan

_LEAST_SAMPLES = 6


@dataclass(frozen=True)
class HeldScans:
    """What the stage knows of the scans, in the order of the inventory.

    ``given`` are project_from_scan of the scans whose pose is given and to be used; ``own``
    are those of every scan standing at its given pose or at the coordinates of its file.
    """

    names: list[str]
    oriented: list[OrientedScan]
    viewpoints: list[NDArray[np.float64] | None]
    given: dict[int, Matrix4]
    own: list[Matrix4]

    def sound(self) -> list[int]:
        """Those with a surface that can be trusted."""
        return [k for k, scan in enumerate(self.oriented) if len(scan) >= _LEAST_SAMPLES]

    def first(self, among: Iterable[int]) -> int:
        """The scan whose frame is kept: the first by name, of those with a given pose if any."""
        chosen = set(among)
        return min(chosen & set(self.given) or chosen, key=lambda k: self.names[k])


def held_scans(job: Job[RegisterOptions], inventory: dict[str, Any]) -> HeldScans:
    """Every range map of the inventory, read one at a time; raises where none can be trusted."""
    from workbench.geometry.orientedscan import OrientationSettings, orient

    names = [entry["name"] for entry in inventory["scans"]]
    own = own_poses(inventory)
    given = {
        k: own[k]
        for k, entry in enumerate(inventory["scans"])
        if entry["world_from_scan"] is not None and job.options.placement != "features"
    }
    if len(given) < len(names) and job.options.placement == "given":
        raise InputError(
            "Some scans have no pose",
            found=", ".join(name for k, name in enumerate(names) if k not in given),
            fix="add the poses, or --set register.placement=auto",
        )
    oriented, viewpoints = [], []
    with job.progress.step("normals", len(names)) as step:
        for name in names:
            scan = kept_scan(job.products, name)
            most = job.options.memory_samples // len(names)
            oriented.append(orient(scan, OrientationSettings()).thinned(most))
            viewpoints.append(scan.viewpoint_in_scan)
            step.advance()
    scans = HeldScans(names, oriented, viewpoints, given, own)
    if not scans.sound():
        raise InputError(
            "No scan has a surface that can be trusted",
            found=", ".join(names),
            fix="check the scans, their masks and ingest.scan_unit",
        )
    return scans


def own_poses(inventory: dict[str, Any]) -> list[Matrix4]:
    """project_from_scan at the given pose or, without one, at the coordinates of the file."""
    to_project = rigid(np.eye(3), -np.array(inventory["origin_m"]))
    return [
        to_project
        @ (
            rigid(np.eye(3), entry["scan_shift_m"])
            if entry["world_from_scan"] is None
            else np.array(entry["world_from_scan"])
        )
        for entry in inventory["scans"]
    ]
