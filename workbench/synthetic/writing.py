"""A simulation on disk: the scans as a lab would deliver them and, apart, the truth."""

from __future__ import annotations

import json
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from workbench.formats.atomic import replacing
from workbench.formats.poses import write_conf, write_scan_poses_json
from workbench.formats.range_ply import write_range_ply
from workbench.geometry import transforms
from workbench.synthetic.options import SimulationOptions
from workbench.synthetic.scene import Scene
from workbench.synthetic.simulation import Progress, SimulatedScan, build_scene, simulate_scans


def write_simulation(
    out: Path,
    options: SimulationOptions,
    progress: Progress | None = None,
    scene: Scene | None = None,
) -> Path:
    """Simulate and write everything below ``out``; the same options give the same bytes.

    Parameters
    ----------
    out : folder to fill; made where it is missing.
    options : the simulation's options.
    progress : called with (done, total, label).
    scene : as ``build_scene(options)`` returns it, where it was built already.

    Returns
    -------
    ``out``.

    Notes
    -----
    ``scans/scan_NN.ply`` and ``scans/poses.conf`` (coarse poses) are what the pipeline reads.
    ``truth/`` holds:

    * ``surface.npz``: ``vertices`` (n, 3) float64 local, ``triangles`` (m, 3) int32,
      ``material`` (n,) uint8 (0 object, 1 support), ``reflectance`` (n,) float32 and
      ``origin`` (3,) float64, so that world = local + origin;
    * ``scan_poses.json``: true pose of every scan in the world, and the scene's ``origin``;
    * ``masks/scan_NN.png``: 255 where the sample lies on the object, 0 elsewhere;
    * ``scans/scan_NN.npz``: one row per sample, in the order of the PLY: see `Samples`;
      ``true_points_in_local`` are hits in the frame of ``surface.npz``;
    * ``simulation.json``: all options, the version and the nominal sample spacing.
    """
    scans, truth = out / "scans", out / "truth"
    for folder in (scans, truth / "masks", truth / "scans"):
        folder.mkdir(parents=True, exist_ok=True)
    if scene is None:
        if progress is not None:
            progress(0, options.scans + 1, f"building the {options.scene}")
        scene = build_scene(options)
    _write_surface(truth / "surface.npz", scene)
    coarse, true = {}, {}
    for scan in simulate_scans(options, progress, scene):
        name = scan.range_map.name
        write_range_ply(scans / f"{name}.ply", scan.range_map, float_type="float64")
        Image.fromarray(scan.object_mask).save(truth / "masks" / f"{name}.png")
        _write_samples(truth / "scans" / f"{name}.npz", scan)
        assert scan.range_map.world_from_scan is not None
        coarse[f"{name}.ply"] = scan.range_map.world_from_scan
        true[name] = scan.world_from_scan
    write_conf(scans / "poses.conf", coarse)
    write_scan_poses_json(truth / "scan_poses.json", true, scene.origin_in_world)
    # Last, for it says that all is there.
    with replacing(_facts_path(out)) as partial:
        partial.write_text(json.dumps(_facts(options), indent=2) + "\n", encoding="utf-8")
    return out


def is_simulated(out: Path, options: SimulationOptions) -> bool:
    """Whether `write_simulation` has written everything below ``out`` with these options."""
    try:
        return bool(json.loads(_facts_path(out).read_text(encoding="utf-8")) == _facts(options))
    except (OSError, ValueError):
        return False


def _facts_path(out: Path) -> Path:
    return out / "truth" / "simulation.json"


def _facts(options: SimulationOptions) -> dict[str, Any]:
    return {
        "version": version("scan-workbench"),
        "nominal_sample_spacing_m": nominal_spacing_m(options),
        "options": options.model_dump(mode="json"),
    }


def nominal_spacing_m(options: SimulationOptions) -> float:
    """Distance between neighbouring samples on a surface that faces the scanner, metres.

    For the statue at the stand-off itself; the surface lies up to 0.2 m nearer.
    """
    scanner = options.scanner
    opening = np.radians(scanner.vertical_fov_deg)
    step = 2 * np.tan(0.5 * opening) if scanner.projection == "perspective" else opening
    return float(options.stations.standoff_m * step / scanner.rows)


def _write_surface(path: Path, scene: Scene) -> None:
    surface = scene.surface
    _write_arrays(
        path,
        {
            "vertices": surface.vertices,
            "triangles": surface.triangles,
            "material": scene.material,
            "reflectance": surface.vertex_attributes["reflectance"],
            "origin": scene.origin_in_world,
        },
    )


def _write_samples(path: Path, scan: SimulatedScan) -> None:
    samples = scan.samples
    _write_arrays(
        path,
        {
            "pixel": samples.pixel,
            "material": samples.material,
            "true_points_in_local": transforms.apply(
                scan.local_from_scan, samples.true_points_in_scan
            ),
            "true_range_m": samples.true_range_m,
            "near_range_m": samples.near_range_m,
            "far_range_m": samples.far_range_m,
            "depth_sigma_m": samples.depth_sigma_m,
            "is_mixed": samples.is_mixed,
            "is_stray": samples.is_stray,
        },
    )


def _write_arrays(path: Path, arrays: dict[str, NDArray[np.generic]]) -> None:
    """An ``.npz`` without compression; NumPy gives its members a fixed date."""
    with path.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)
