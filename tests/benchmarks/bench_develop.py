"""Error of developed photographs against run time, for demosaicing, half size and matrix.

    python -m tests.benchmarks.bench_develop OUT

photographs the small statue (seed 1) and its chart with all truth, develops with each setting,
prints tables and writes ``develop_tradeoff.svg`` and, where an SVG renderer is at hand, ``.png``
to OUT. Where real charts are present, the matrices are tried on them, too.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tests.benchmarks.drawing import draw_tradeoff
from workbench.color.calibration import ColorMatrix, calibrated
from workbench.color.chart_finding import FoundChart, chart_at, found_chart
from workbench.color.patches import ChartPatches, measured_patches
from workbench.color.spaces import delta_e2000, lab_from_xyz_d50, working_space
from workbench.formats.dng import write_dng
from workbench.photos.decoding import Demosaic, LinearPhoto, read_linear
from workbench.synthetic import SimulationOptions, build_scene
from workbench.synthetic.photo_options import PhotoOptions
from workbench.synthetic.photography import Photograph, chart_photograph, photograph, studio_of
from workbench.verification.figures import TradeoffPoint

REPEATS = 5
SETTINGS: tuple[tuple[str, Demosaic, bool], ...] = (
    ("half size", "linear", True),
    ("linear", "linear", False),
    ("vng", "vng", False),
    ("ahd", "ahd", False),
    ("dht", "dht", False),
)
REAL = Path(__file__).resolve().parents[3] / "shared" / "data" / "raw"
CHARTS = (
    ("canon/CRW_0304.CRW", [[143, 139], [2165, 111], [2199, 1490], [158, 1473]]),
    ("canon/CRW_0101.CRW", [[168, 179], [2077, 128], [2090, 1383], [199, 1438]]),
    ("kodak-dc120/P003910.KDC", [[31, 114], [869, 110], [884, 708], [22, 683]]),
)


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    """Median seconds of several runs, and what the last one gave."""
    seconds = []
    for _ in range(REPEATS):
        start = perf_counter()
        result = work()
        seconds.append(perf_counter() - start)
    return median(seconds), result


def patches_of(photo: LinearPhoto, corners: NDArray[np.float64] | None = None) -> ChartPatches:
    """The chart's patches of a photograph of half size."""
    chart = found_chart(photo.values) if corners is None else chart_at(photo.values, corners)
    assert isinstance(chart, FoundChart), chart.reason
    patches = measured_patches(photo.values, photo.usable, chart)
    assert isinstance(patches, ChartPatches), patches.reason
    return patches


def sound_pixels(shot: Photograph) -> NDArray[np.bool_]:
    """(h, w) where the object is lit by the flash and does not shine."""
    assert shot.diffuse is not None
    assert shot.specular is not None
    assert shot.albedo is not None
    level = shot.diffuse.mean(axis=2)
    lit = (shot.object_mask > 127) & (shot.shadow_mask < 128) & (level > 0.15)
    return lit & (shot.specular < 0.02 * level * shot.albedo.mean(axis=2) / 65535)


def errors(
    values: NDArray[np.float32], shot: Photograph, light: NDArray[np.float64]
) -> list[float]:
    """Relative RMS error of single pixels, and mean ΔE2000 of 10 × 10 pixels' albedo."""
    assert shot.albedo is not None
    albedo = shot.albedo / 65535.0
    height, width = albedo.shape[:2]
    if values.shape[:2] != (height, width):
        values = cv2.resize(values, (width, height), interpolation=cv2.INTER_LINEAR)
    sound = sound_pixels(shot)
    found = values / np.maximum(light, 1e-3)
    found = found / np.median(found[sound].sum(axis=1) / albedo[sound].sum(axis=1))
    apart = (found - albedo)[sound]
    pixels = float(np.sqrt(np.mean(apart**2) / np.mean(albedo[sound] ** 2)))
    size = (width // 10, height // 10)
    whole = cv2.resize(sound.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.999
    to_xyz = working_space("rec709").xyz_d50_from_rgb.T
    labs = [
        lab_from_xyz_d50(
            np.maximum(cv2.resize(c, size, interpolation=cv2.INTER_AREA)[whole], 0) @ to_xyz
        )
        for c in (found.astype(np.float64), albedo)
    ]
    return [pixels, float(delta_e2000(labs[0], labs[1]).mean())]


def on_the_statue(folder: Path, out: Path) -> None:
    """Every setting on one simulated photograph."""
    options = PhotoOptions.model_validate({"seed": 1, "rendering": {"truth": "full"}})
    scene = build_scene(SimulationOptions(scene="statue", size="small", seed=1))
    shot, chart = photograph(scene, options, 0), chart_photograph(scene, options, 0)
    for one in (shot, chart):
        write_dng(folder / f"{one.name}.dng", one.mosaic, one.metadata)
    lens = studio_of(scene, options).lens
    assert shot.diffuse is not None
    # The light on the sensor: what fell on the surface, less the lens's own loss.
    light = shot.diffuse * lens.vignetting(0, shot.mosaic.shape[0])[..., None]
    patches = patches_of(read_linear(folder / f"{chart.name}.dng", half_size=True))
    space = working_space("rec709")
    path = folder / f"{shot.name}.dng"
    print("setting        matrix           seconds  of AHD's  RMS of pixels (%)  ΔE2000 of albedo")
    rows: list[tuple[str, str, float, list[float]]] = []
    for kind in ("linear", "root_polynomial"):
        color: ColorMatrix = calibrated(patches, space, kind).color
        for name, demosaic, half in SETTINGS:
            seconds, values = timed(
                lambda demosaic=demosaic, half=half, color=color: color.applied(
                    read_linear(path, demosaic, half_size=half).values
                )
            )
            rows.append((name, kind, seconds, errors(values, shot, light)))
    usual = next(seconds for name, kind, seconds, _ in rows if (name, kind) == ("ahd", "linear"))
    points = []
    for name, kind, seconds, (pixels, delta_e) in rows:
        told = f"{name:14s} {kind:16s}{seconds:8.3f}{seconds / usual:10.2f}"
        print(f"{told}{100 * pixels:19.2f}{delta_e:18.2f}", flush=True)
        points.append(TradeoffPoint(f"{name}, {kind.replace('_', ' ')}", seconds, 100 * pixels))
    draw_tradeoff(out, "develop_tradeoff", points, "RMS error of pixels (%)", "dht, linear")


def on_real_charts() -> None:
    """Both matrices on real charts."""
    space = working_space("rec709")
    print("\nchart            matrix            seconds  mean ΔE2000  worst  left out of the fit")
    for file, corners in CHARTS:
        if not (REAL / file).exists():
            continue
        patches = patches_of(read_linear(REAL / file, half_size=True), np.array(corners) / 2)
        for kind in ("linear", "root_polynomial"):
            seconds, found = timed(
                lambda patches=patches, kind=kind: calibrated(patches, space, kind)
            )
            told = f"{Path(file).name:16s} {kind:16s}{seconds:9.2f}"
            print(
                f"{told}{found.mean:13.2f}{found.worst:7.2f}{found.left_out_mean:21.2f}", flush=True
            )


def main(out: Path) -> None:
    cv2.setNumThreads(1)
    out.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as folder:
        on_the_statue(Path(folder), out)
    on_real_charts()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
