"""Error of the cameras against run time, for image size and number of features.

    python -m tests.benchmarks.bench_orientation OUT [SKULL] [FOUNTAIN]

orients the real photographs in the folders given (by default those beside the repository) with
each setting, and with pycolmap's defaults at the same image sizes, in turn within one run.
Prints a table and writes ``orientation_SET.svg`` and, where an SVG renderer is at hand,
``.png`` to OUT. Times are wall times: compare them within one run.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np

from tests.benchmarks.drawing import draw_tradeoff
from tests.orientation.real_sets import KnownSet, fountain_p11, poses_of, skull_flash
from workbench.geometry.transforms import Matrix4, rigid
from workbench.orientation.features import FeatureSettings
from workbench.orientation.mapping import quiet_pycolmap
from workbench.orientation.structure_from_motion import OrientationSettings, oriented
from workbench.verification.figures import TradeoffPoint

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
IMAGE_PX, FEATURES = (3200, 1000), (6000, 3000, 1500)


def by_defaults(known: KnownSet, image_px: int) -> Mapping[str, Matrix4]:
    """Poses by pycolmap's defaults: all with all, incremental."""
    import pycolmap

    folder = known.photos[0].picture
    assert isinstance(folder, Path)
    with TemporaryDirectory() as work, quiet_pycolmap():
        database = Path(work) / "database.db"
        extraction = pycolmap.FeatureExtractionOptions()
        extraction.max_image_size = image_px
        pycolmap.set_random_seed(0)
        pycolmap.extract_features(database, folder.parent, extraction_options=extraction)
        pycolmap.match_exhaustive(database)
        models = pycolmap.incremental_mapping(database, folder.parent, Path(work))
        best = max(models.values(), key=lambda model: model.num_reg_images())
        poses = {}
        for image in best.images.values():
            if image.has_pose:
                pose = image.cam_from_world().matrix()
                poses[image.name] = rigid(pose[:, :3], pose[:, 3])
        return poses


def by_workbench(known: KnownSet, image_px: int, count: int) -> Mapping[str, Matrix4]:
    """Poses by this repository."""
    features = FeatureSettings(max_image_px=image_px, max_features=count)
    return poses_of(oriented(known.photos, replace(OrientationSettings(), features=features)).model)


def measure(name: str, known: KnownSet, out: Path) -> None:
    """One set: its table and its drawing."""
    distance = known.object_distance
    print(f"{name}: {len(known.photos)} photographs, errors in % of the object distance")
    print("setting                           seconds  placed  median     rms     max", flush=True)
    points = []
    for image_px in IMAGE_PX:
        runs = [(f"{count} features, {image_px} px", count) for count in FEATURES]
        for label, count in [*runs[:1], (f"pycolmap's defaults, {image_px} px", 0), *runs[1:]]:
            start = perf_counter()
            poses = by_workbench(known, image_px, count) if count else by_defaults(known, image_px)
            seconds = perf_counter() - start
            errors = 100.0 * known.center_errors(poses) / distance
            rms = float(np.sqrt((errors**2).mean()))
            print(
                f"{label:32s}{seconds:9.1f}{len(poses):8d}{np.median(errors):8.4f}"
                f"{rms:8.4f}{errors.max():8.4f}",
                flush=True,
            )
            if len(poses) == len(known.photos):
                points.append(TradeoffPoint(label, seconds, rms))
    draw_tradeoff(
        out,
        f"orientation_{name}",
        points,
        "RMS camera error (% of distance)",
        f"{FEATURES[0]} features, {IMAGE_PX[0]} px",
    )


def main(out: Path, skull: Path, fountain: Path) -> None:
    measure("fountain", fountain_p11(fountain), out)
    measure("skull", skull_flash(skull), out)


if __name__ == "__main__":
    given = [Path(word) for word in sys.argv[2:]]
    main(Path(sys.argv[1]), *(given + [DATA / "skull-flash", DATA / "fountain-p11"][len(given) :]))
