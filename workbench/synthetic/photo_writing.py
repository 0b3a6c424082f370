"""Photographs on disk as a photographer would deliver them and, apart, the truth."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.errors import WorkbenchError
from workbench.formats.atomic import replacing
from workbench.formats.colmap import ColmapImage, ColmapModel, write_colmap_text
from workbench.formats.dng import write_dng
from workbench.geometry import transforms
from workbench.synthetic.chart import PATCH_ALBEDO, PATCH_NAMES, board_corners, patch_corners
from workbench.synthetic.flash import ambient_exposure, flash_exposure
from workbench.synthetic.options import SimulationOptions
from workbench.synthetic.photo_options import PhotoOptions
from workbench.synthetic.photography import (
    Photograph,
    Studio,
    chart_photograph,
    photo_name,
    photograph,
    studio_of,
    target_photograph,
)
from workbench.synthetic.scene import Scene
from workbench.synthetic.simulation import build_scene

Progress = Callable[[int, int, str], None]
# Maps a function of name and payload over the payloads, on other machines: yields (name,
# result) as they come. The path is a file of the project that those machines must see.
PhotographsElsewhere = Callable[
    [Path, Callable[[str, dict[str, Any]], None], dict[str, dict[str, Any]]],
    Iterable[tuple[str, None]],
]
Kind = Literal["photo", "chart", "flat", "linearity"]

# Changes whenever the same options give other pictures.
_MODEL_VERSION = 1
# Photographs computed at once: each holds its own mosaic and truth.
_MOST_AT_ONCE = 8


@dataclass(frozen=True)
class PhotoItem:
    """One photograph to take: its kind and its number within that kind."""

    kind: Kind
    index: int

    @property
    def name(self) -> str:
        """Name of the file, without suffix."""
        if self.kind == "photo":
            return photo_name(self.index)
        return f"{self.kind}_{self.index:02d}"

    @property
    def folder(self) -> str:
        """Where its file lies below the project's root."""
        return "photos" if self.kind in ("photo", "chart") else "calibration"


def photo_items(options: PhotoOptions) -> list[PhotoItem]:
    """Everything that is to be photographed, in order."""
    charts = options.charts
    counts: tuple[tuple[Kind, int], ...] = (
        ("photo", options.photos),
        ("chart", charts.color_frames),
        ("flat", charts.flat_frames),
        ("linearity", len(charts.linearity_distances_m)),
    )
    return [PhotoItem(kind, index) for kind, count in counts for index in range(count)]


def write_photos(
    out: Path,
    scene: Scene,
    sim_options: SimulationOptions,
    photo_options: PhotoOptions,
    progress: Progress | None = None,
    workers: int | None = None,
    elsewhere: PhotographsElsewhere | None = None,
) -> Path:
    """Photograph a scene and write everything below ``out``; the same options, the same bytes.

    What an earlier call with the same options has finished is not taken again.

    Parameters
    ----------
    out : folder to fill; made where it is missing.
    scene : as ``build_scene(sim_options)`` returns it.
    sim_options : the options the scene was built with; part of what makes a photograph stale.
    photo_options : of the photographs.
    progress : called with (done, total, label).
    workers : photographs computed at once; one per core where nothing is said.
    elsewhere : maps the photographs over other machines that see ``out`` at the same path,
        instead of over the cores of this one.

    Returns
    -------
    ``out``.

    Notes
    -----
    ``photos/photo_NNN.dng`` and ``photos/chart_NN.dng`` are what the pipeline reads,
    ``calibration/flat_NN.dng`` and ``calibration/linearity_NN.dng`` what it may read.
    ``truth/photos/`` holds:

    * ``cameras.txt``, ``images.txt``, ``points3D.txt`` (no points): true cameras in COLMAP's
      conventions; their world is the scene's local frame;
    * ``object/``, ``support/``, ``shadow/`` with ``photo_NNN.png``: 255 where the pixel shows
      the object, its support, a surface without the flash's light; else 0;
    * ``albedo/photo_NNN.png``: 16 bits, linear Rec. 709 × 65535; ``depth/photo_NNN.npz``:
      ``depth`` (rows, cols) float32, metres along the optical axis, ``diffuse`` and
      ``specular`` levels; as the option ``rendering.truth`` asks;
    * ``surface_albedo.npz``: ``albedo`` (n, 3) float32 linear Rec. 709 at the vertices of
      ``truth/surface.npz``;
    * ``photos.json``: flash position and power of every photograph, the sensor, all options;
    * ``charts.json``: corners of the charts and their patches in pixels and their colours;
    * ``records/``: one file per finished photograph.
    """
    studio = studio_of(scene, photo_options)
    digest = options_digest(sim_options, photo_options)
    items = photo_items(photo_options)
    report = progress or _silent
    report(0, len(items), "preparing the photographs")
    _make_folders(out, photo_options)
    waiting = {item.name: item for item in items if not is_finished(out, item, digest)}
    done = len(items) - len(waiting)
    if elsewhere is None:
        finished = _taken_here(out, studio, waiting, digest, workers)
    else:
        finished = _taken_elsewhere(out, studio, sim_options, waiting, digest, elsewhere)
    for name in finished:
        done += 1
        report(done, len(items), name)
    write_photo_truth(out, studio, sim_options)
    return out


def photograph_for(name: str, payload: dict[str, Any]) -> None:
    """One photograph by a process that has nothing but the payload and the project's folder.

    Parameters
    ----------
    name : of the photograph.
    payload : plain data as `write_photos` makes it: ``out``, the options as JSON, ``kind``,
        ``index``, ``digest``.
    """
    options = PhotoOptions.model_validate_json(payload["photos"])
    item = PhotoItem(payload["kind"], payload["index"])
    scene = _scene_for(payload["simulation"])
    write_photograph(Path(payload["out"]), scene, options, item, payload["digest"])


@lru_cache(maxsize=1)
def _scene_for(simulation: str) -> Scene:
    """The scene of options given as JSON: built once in a process, which costs seconds."""
    return build_scene(SimulationOptions.model_validate_json(simulation))


def _taken_here(
    out: Path,
    studio: Studio,
    waiting: dict[str, PhotoItem],
    digest: str,
    workers: int | None,
) -> Iterator[str]:
    """Names of the photographs as they are finished on this machine's cores."""
    if not waiting:
        return
    # Built once before the threads start, which would each wait for it.
    _ = studio.subject.middle, studio.subject.corner_normals, studio.exchange
    with ThreadPoolExecutor(max(1, min(workers or os.cpu_count() or 1, _MOST_AT_ONCE))) as pool:
        jobs = {
            pool.submit(write_photograph, out, studio.scene, studio.options, item, digest): name
            for name, item in waiting.items()
        }
        try:
            for job in as_completed(jobs):
                job.result()
                yield jobs[job]
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _taken_elsewhere(
    out: Path,
    studio: Studio,
    sim_options: SimulationOptions,
    waiting: dict[str, PhotoItem],
    digest: str,
    elsewhere: PhotographsElsewhere,
) -> Iterator[str]:
    """Names of the photographs as other machines finish them."""
    shared = {
        "out": str(out),
        "simulation": sim_options.model_dump_json(),
        "photos": studio.options.model_dump_json(),
        "digest": digest,
    }
    payloads = {
        name: shared | {"kind": item.kind, "index": item.index} for name, item in waiting.items()
    }
    witness = out / "truth" / "photos" / "under_way"
    witness.write_text(digest, encoding="utf-8")
    try:
        for name, _ in elsewhere(witness, photograph_for, payloads):
            yield name
    finally:
        witness.unlink()


def options_digest(sim_options: SimulationOptions, photo_options: PhotoOptions) -> str:
    """What a finished photograph must carry to be taken for fresh."""
    facts = {
        "model": _MODEL_VERSION,
        "version": version("scan-workbench"),
        "simulation": sim_options.model_dump(mode="json"),
        "photos": photo_options.model_dump(mode="json"),
    }
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()


def is_finished(out: Path, item: PhotoItem, digest: str) -> bool:
    """Whether a photograph was written whole with these options."""
    record = _record_path(out, item)
    if not (out / item.folder / f"{item.name}.dng").exists() or not record.exists():
        return False
    try:
        return bool(json.loads(record.read_text(encoding="utf-8"))["digest"] == digest)
    except (ValueError, KeyError, TypeError):
        return False


def write_photograph(
    out: Path, scene: Scene, options: PhotoOptions, item: PhotoItem, digest: str
) -> None:
    """Take and write one photograph with its truth; its record comes last.

    Folders must exist, as `write_photos` makes them.

    Parameters
    ----------
    out : the project's root.
    scene, options : what is photographed.
    item : which photograph.
    digest : as `options_digest` gives it.
    """
    photo = _take(scene, options, item)
    truth = out / "truth" / "photos"
    if item.kind == "photo":
        _write_png(truth / "object" / f"{photo.name}.png", photo.object_mask)
        _write_png(truth / "support" / f"{photo.name}.png", photo.support_mask)
        _write_png(truth / "shadow" / f"{photo.name}.png", photo.shadow_mask)
        if photo.albedo is not None:
            _write_png(truth / "albedo" / f"{photo.name}.png", photo.albedo[..., ::-1])
        if photo.depth is not None and photo.diffuse is not None and photo.specular is not None:
            path = truth / "depth" / f"{photo.name}.npz"
            with replacing(path) as partial, partial.open("wb") as file:
                np.savez_compressed(
                    file,
                    allow_pickle=False,
                    depth=photo.depth,
                    diffuse=photo.diffuse,
                    specular=photo.specular,
                )
    write_dng(out / item.folder / f"{photo.name}.dng", photo.mosaic, photo.metadata, photo.preview)
    record = {
        "digest": digest,
        "name": photo.name,
        "file": f"{item.folder}/{photo.name}.dng",
        "local_from_camera": photo.local_from_camera.tolist(),
        "flash_middle_in_local": photo.flash.middle.tolist(),
        "flash_across_in_local": photo.flash.across.tolist(),
        "flash_down_in_local": photo.flash.down.tolist(),
        "flash_axis_in_local": photo.flash.axis.tolist(),
        "flash_falloff": photo.flash.falloff,
        "flash_power": photo.flash.power,
    }
    _write_json(_record_path(out, item), record)


def write_photo_truth(out: Path, studio: Studio, sim_options: SimulationOptions) -> None:
    """Write what concerns all photographs, from the records of each."""
    options, truth = studio.options, out / "truth" / "photos"
    camera = studio.lens.colmap_camera()
    records = {item: _record(out, item) for item in photo_items(options)}
    images = {}
    for item, record in records.items():
        if item.kind == "photo":
            pose = transforms.inverse(np.array(record["local_from_camera"]))
            number = item.index + 1
            images[number] = ColmapImage(number, pose, 1, f"{item.name}.dng")
    write_colmap_text(truth, ColmapModel({1: camera}, images))
    with replacing(truth / "surface_albedo.npz") as partial, partial.open("wb") as file:
        np.savez(file, allow_pickle=False, albedo=studio.vertex_albedo)
    sensor = studio.sensor
    facts = {
        "version": version("scan-workbench"),
        "options": options.model_dump(mode="json"),
        "simulation": sim_options.model_dump(mode="json"),
        "origin": studio.scene.origin_in_world.tolist(),
        "flash_exposure_at_1m": flash_exposure(options.flash, options.camera),
        "ambient_exposure": ambient_exposure(options.flash, options.camera),
        "gain_e_per_dn": sensor.gain_e_per_dn,
        "read_noise_e": sensor.options.read_noise_e,
        "camera_from_scene": sensor.camera_from_scene.tolist(),
        "neutral": sensor.neutral.tolist(),
        "photos": [
            {key: value for key, value in record.items() if key != "digest"}
            for record in records.values()
        ],
    }
    _write_json(truth / "photos.json", facts)
    charts = [
        _chart_truth(studio, record) for item, record in records.items() if item.kind == "chart"
    ]
    _write_json(
        truth / "charts.json",
        {
            "patch_names": PATCH_NAMES,
            "patch_albedo_linear_rec709": PATCH_ALBEDO.tolist(),
            "charts": charts,
        },
    )


def _chart_truth(studio: Studio, record: dict[str, Any]) -> dict[str, Any]:
    camera_from_local = transforms.inverse(np.array(record["local_from_camera"]))

    def pixels(points: NDArray[np.float64]) -> list[Any]:
        in_camera = transforms.apply(camera_from_local, points.reshape(-1, 3))
        placed: list[Any] = studio.lens.project(in_camera).reshape(*points.shape[:-1], 2).tolist()
        return placed

    return {
        "file": record["file"],
        "board_corners_px": pixels(board_corners()),
        "patch_corners_px": pixels(patch_corners()),
    }


def _take(scene: Scene, options: PhotoOptions, item: PhotoItem) -> Photograph:
    if item.kind == "photo":
        return photograph(scene, options, item.index)
    if item.kind == "chart":
        return chart_photograph(scene, options, item.index)
    return target_photograph(scene, options, item.kind, item.index)


def _make_folders(out: Path, options: PhotoOptions) -> None:
    truth = out / "truth" / "photos"
    folders = [out / "photos", out / "calibration", truth / "records"]
    folders += [truth / name for name in ("object", "support", "shadow")]
    if options.rendering.truth != "masks":
        folders.append(truth / "albedo")
    if options.rendering.truth == "full":
        folders.append(truth / "depth")
    for folder in folders:
        folder.mkdir(parents=True, exist_ok=True)


def _record_path(out: Path, item: PhotoItem) -> Path:
    return out / "truth" / "photos" / "records" / f"{item.name}.json"


def _record(out: Path, item: PhotoItem) -> dict[str, Any]:
    record: dict[str, Any] = json.loads(_record_path(out, item).read_text(encoding="utf-8"))
    return record


def _write_json(path: Path, content: dict[str, Any]) -> None:
    with replacing(path) as partial:
        partial.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _write_png(path: Path, picture: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    """A PNG of (rows, cols) or (rows, cols, BGR); OpenCV, as Pillow has no 16-bit colour."""
    done, data = cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not done:
        raise WorkbenchError("OpenCV could not encode a PNG.", file=path)
    with replacing(path) as partial:
        partial.write_bytes(data.tobytes())


def _silent(done: int, total: int, label: str) -> None:
    """Progress that nobody watches."""
