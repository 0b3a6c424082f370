"""A photograph on disk as a photographer would deliver it and, apart, the truth."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
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
    target_photograph,
)
from workbench.synthetic.scene import Scene

Kind = Literal["photo", "chart", "flat", "linearity"]

# Changes whenever the same options give other pictures.
_MODEL_VERSION = 1


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

    Folders must exist, as `workbench.synthetic.photo_series.write_photos` makes them.

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
