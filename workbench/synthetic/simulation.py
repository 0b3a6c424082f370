"""From options to scenes and scans, each reproducible on its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.geometry import transforms
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.rangemap import RangeMap
from workbench.synthetic import analytic
from workbench.synthetic.building import building_mesh
from workbench.synthetic.options import SimulationOptions
from workbench.synthetic.scanner import Samples, scan_samples
from workbench.synthetic.scene import OBJECT, Scene, painted
from workbench.synthetic.solids import collected
from workbench.synthetic.stations import coarse_pose, local_from_scan
from workbench.synthetic.statue import statue_mesh
from workbench.synthetic.support import support_mesh

Progress = Callable[[int, int, str], None]

_ANALYTIC: dict[str, Callable[[], TriangleMesh]] = {
    "plane": analytic.plane_mesh,
    "sphere": analytic.sphere_mesh,
    "cylinder": analytic.cylinder_mesh,
    "thin-sheet": analytic.thin_sheet_mesh,
}
_FOCUS = {"statue": (0.0, 0.0, 0.60), "building": (0.0, 0.0, 5.0)}
# First entries of the spawn keys: independent streams of one seed.
_SCENE_STREAM, _SCAN_STREAM, _STATION_STREAM, _COARSE_STREAM = range(4)


@dataclass(frozen=True)
class SimulatedScan:
    """One scan with its truth.

    Attributes
    ----------
    index : counts from 0.
    range_map : what the pipeline gets; its ``world_from_scan`` is the coarse pose.
    local_from_scan : 4×4 float64 true pose in the frame of the scene's surface.
    world_from_scan : 4×4 float64 true pose, shifted by the scene's origin.
    samples : the truth about every sample, in the order of the range map.
    object_mask : (rows, cols) uint8, 255 where a sample lies on the object, 0 for clutter,
        mixed pixels, stray points and holes.
    """

    index: int
    range_map: RangeMap
    local_from_scan: NDArray[np.float64]
    world_from_scan: NDArray[np.float64]
    samples: Samples
    object_mask: NDArray[np.uint8]


def build_scene(options: SimulationOptions) -> Scene:
    """The true surface that the options ask for."""
    rng = _stream(options.seed, _SCENE_STREAM, 0)
    if options.scene == "statue":
        statue = statue_mesh(rng, options.mesh_spacing_m)
        surface = collected(
            [
                statue.with_attributes(material=np.full(len(statue.vertices), OBJECT, np.uint8)),
                support_mesh(statue, rng),
            ]
        )
    elif options.scene == "building":
        surface = building_mesh(rng)
    else:
        surface = painted(_ANALYTIC[options.scene](), OBJECT, np.array([0.6]))
    return Scene(
        options.scene,
        surface,
        np.array(options.world_offset_m, float),
        np.array(_FOCUS.get(options.scene, (0.0, 0.0, 0.0))),
    )


def scan_name(index: int) -> str:
    """Name of a scan, ``scan_00`` for the first."""
    return f"scan_{index:02d}"


def simulate_scan(scene: Scene, options: SimulationOptions, index: int) -> SimulatedScan:
    """One scan of a scene, the same whatever other scans are simulated, and where.

    Parameters
    ----------
    scene : as ``build_scene(options)`` returns it; it can be sent to another process.
    options : the simulation's options.
    index : which scan, in [0, ``options.scans``).
    """
    pose = local_from_scan(scene, options, index, _stream(options.seed, _STATION_STREAM, index))
    samples = scan_samples(scene, pose, options.scanner, _stream(options.seed, _SCAN_STREAM, index))
    world_from_local = transforms.rigid(np.eye(3), scene.origin_in_world)
    coarse_in_local = coarse_pose(
        pose, scene.focus, options.coarse_poses, _stream(options.seed, _COARSE_STREAM, index)
    )
    shape = (options.scanner.rows, options.scanner.cols)
    grid = np.full(shape, -1, np.int32)
    grid.flat[samples.pixel] = np.arange(len(samples.pixel), dtype=np.int32)
    mask = np.zeros(shape, np.uint8)
    on_object = (samples.material == OBJECT) & ~samples.is_mixed & ~samples.is_stray
    mask.flat[samples.pixel[on_object]] = 255
    range_map = RangeMap(
        name=scan_name(index),
        points_in_scan=samples.points_in_scan,
        grid=grid,
        viewpoint_in_scan=np.zeros(3),
        reflectance=samples.reflectance,
        world_from_scan=world_from_local @ coarse_in_local,
    )
    return SimulatedScan(index, range_map, pose, world_from_local @ pose, samples, mask)


def simulate_scans(
    options: SimulationOptions, progress: Progress | None = None, scene: Scene | None = None
) -> Iterator[SimulatedScan]:
    """All scans in order, one in memory at a time.

    Parameters
    ----------
    options : the simulation's options.
    progress : called with (done, total, label) before the scene and after every scan.
    scene : the scene, where it was built already.
    """
    report = progress or _silent
    total = options.scans + 1
    if scene is None:
        report(0, total, f"building the {options.scene}")
        scene = build_scene(options)
    report(1, total, options.scene)
    for index in range(options.scans):
        yield simulate_scan(scene, options, index)
        report(index + 2, total, scan_name(index))


def _stream(seed: int, kind: int, index: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(kind, index)))


def _silent(done: int, total: int, label: str) -> None:
    """Progress that nobody watches."""
