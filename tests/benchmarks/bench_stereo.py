"""Error of depth maps against run time: size of pictures, other views, rounds, patches.

    python -m tests.benchmarks.bench_stereo PROJECT OUT

takes five photographs in a row of a simulated project with their true cameras and masks, prints
a table and writes ``stereo.svg`` to OUT. Times are those of one core, of matching and bettering
one depth map; the error is the RMS distance of what is agreed on from the true surface.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from time import thread_time

import numpy as np
from numpy.typing import NDArray

from tests.benchmarks.drawing import draw_tradeoff
from workbench.formats.colmap import read_colmap_text
from workbench.formats.mask_png import read_mask_png
from workbench.formats.photo_reading import read_photo
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_view import within
from workbench.geometry.transforms import apply
from workbench.stereo.agreement import AgreementSettings, agreed_range_map
from workbench.stereo.choice import depth_span, seen_points
from workbench.stereo.matching import MatchingSettings, agreed, matched
from workbench.stereo.views import StereoView, stereo_view
from workbench.verification.distances import distance_to_surface
from workbench.verification.figures import TradeoffPoint

_FIRST, _COUNT = 2, 5
PLAIN = MatchingSettings()


@dataclass(frozen=True)
class Trial:
    """What is tried: the pictures' longer side, other views, and how they are compared."""

    image_px: int = 1600
    others: int = 4
    matching: MatchingSettings = PLAIN
    geometric: bool = True


TRIALS = {
    "default": Trial(),
    "400 px": Trial(image_px=400),
    "800 px": Trial(image_px=800),
    "2 other views": Trial(others=2),
    "3 other views": Trial(others=3),
    "no finer rounds": Trial(matching=replace(PLAIN, rounds=0)),
    "1 finer round": Trial(matching=replace(PLAIN, rounds=1)),
    "4 finer rounds": Trial(matching=replace(PLAIN, rounds=4)),
    "patches of 5 pixels": Trial(matching=replace(PLAIN, half_px=2)),
    "patches of 9 pixels": Trial(matching=replace(PLAIN, half_px=4)),
    "patches of 13 pixels": Trial(matching=replace(PLAIN, half_px=6)),
    "one size": Trial(matching=replace(PLAIN, levels=1)),
    "photometric alone": Trial(geometric=False),
}


@dataclass(frozen=True)
class Shots:
    """Photographs in a row, by size, and the true surface."""

    project: Path

    def views(self, image_px: int) -> tuple[list[StereoView], list[tuple[float, float]]]:
        truth = self.project / "truth" / "photos"
        model = read_colmap_text(truth)
        cameras = model.photo_cameras()
        names = sorted(cameras)[_FIRST : _FIRST + _COUNT]
        views = [
            stereo_view(
                read_photo(next((self.project / "photos").glob(f"{name}.*"))),
                read_mask_png(truth / "object" / f"{name}.png"),
                within(cameras[name], image_px),
            )
            for name in names
        ]
        points = seen_points(model, dict.fromkeys(cameras, 1.3))
        spans = [depth_span(points, points.names.index(name), cameras[name]) for name in names]
        return views, spans

    def surface(self) -> TriangleMesh:
        arrays = np.load(self.project / "truth" / "surface.npz")
        return TriangleMesh(arrays["vertices"] + arrays["origin"], arrays["triangles"])


def tried(shots: Shots, trial: Trial, surface: TriangleMesh) -> tuple[float, float, float, float]:
    """RMS error in mm, share of the middle photograph, seconds, and those a megapixel and view."""
    views, spans = shots.views(trial.image_px)
    middle = _COUNT // 2
    nearest = sorted(range(_COUNT), key=lambda k: (abs(k - middle), k))[: trial.others + 1]
    start = thread_time()
    found = {
        k: matched(
            views[k],
            [views[j] for j in nearest if j != k],
            spans[k],
            trial.matching,
            k,
            last=not trial.geometric,
        )
        for k in nearest
    }
    if trial.geometric:
        near = {k: one.nearness for k, one in found.items()}
        found = {
            k: agreed(
                views[k],
                [views[j] for j in nearest if j != k],
                found[k],
                [near[j] for j in nearest if j != k],
                spans[k],
                trial.matching,
                k + _COUNT,
            )
            for k in nearest
        }
    seconds = thread_time() - start
    megapixels = sum(int(views[k].usable.sum()) for k in nearest) * 1e-6
    others = [k for k in nearest if k != middle]
    agreement = agreed_range_map(
        "middle",
        views[middle],
        [views[k] for k in others],
        found[middle],
        [found[k] for k in others],
        AgreementSettings(),
    )
    scan = agreement.range_map
    assert scan.world_from_scan is not None
    off: NDArray[np.float64] = distance_to_surface(
        apply(scan.world_from_scan, scan.points_in_scan), surface
    ).distance_m
    return (
        1e3 * float(np.sqrt((off**2).mean())),
        len(scan) / float(views[middle].usable.sum()),
        seconds / len(nearest),
        seconds / (megapixels * trial.others),
    )


def main() -> None:
    shots, out = Shots(Path(sys.argv[1])), Path(sys.argv[2])
    surface = shots.surface()
    tried(shots, Trial(image_px=200), surface)  # compiled
    points = []
    print(f"{'':24}{'RMS mm':>9}{'agreed':>9}{'s a map':>9}{'s/MP/view':>11}")
    for name, trial in TRIALS.items():
        error, share, seconds, each = tried(shots, trial, surface)
        print(f"{name:24}{error:9.3f}{100 * share:8.1f}%{seconds:9.2f}{each:11.2f}", flush=True)
        points.append(TradeoffPoint(name, seconds, error))
    out.mkdir(parents=True, exist_ok=True)
    draw_tradeoff(out, "stereo", points, "RMS error / mm", "default")


if __name__ == "__main__":
    main()
