"""Labelled depth meshes and their photographs as files that a page stitches its picture of.

``stitched.json`` tells all but the bulk: ``version`` (2); ``from_positions`` (3 numbers), which
added to positions gives the user's coordinates; ``epsilon`` in metres; ``cost_step``; ``vote``
with rounds, radius and weights; ``seam_radius``; ``file``, and in it the place of every mesh
(``offset``, ``bytes``, ``crc``, ``vertices``, ``triangles`` and its box, ``low`` and ``high``);
``photos`` with ``picture`` and ``mask`` (null where all may be used, or nothing is shown of it),
their CRC-32, and the camera: ``size``, ``lens`` (fx, fy, cx, cy, k1, k2, p1, p2, k3 … k6 of the
rational model, or k1 … k4 of fisheyes after the first four), ``fisheye``, and ``from_positions``,
the upper three rows of the camera's matrix for positions as they are stored.

A mesh is, in little-endian order: positions (n, 3) float32; colours (n, 4) uint8 sRGB; labels (m,)
uint16, the photograph's number + 1, 0 for none, plus 32768 in the foreground; costs (m,) uint16 in
steps; triangles (m, 3), uint16 where n is at most 65,536, uint32 otherwise; reach (m,) uint8 in
steps of 1/32: so many times ``epsilon`` behind the front-most surface a triangle competes.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.photo_view import within
from workbench.pipeline.stitched_pictures import StitchedProject
from workbench.project.project import Project
from workbench.project.store import ProductStore
from workbench.render.stitch.levelling import LevellingSettings
from workbench.render.stitch.scene import COARSENESS_STEPS, StitchScene
from workbench.render.stitch.stitching import StitchSettings

MESHES, TOLD = "meshes.bin", "stitched.json"
_QUALITY = 92
# Graphics cards take textures of this side, and a few of them at once.
_LONGEST_PX = 4096
# A reduced pixel is used where all pixels it is made of may be.
_ALL = 0.999
_FOREGROUND = 1 << 15
_COST_STEP = 1.0 / 8192.0
# What pages pack into one number: 13 bits for meshes, 15 for photographs and the foreground.
_MOST_MESHES, _MOST_PHOTOS = (1 << 13) - 1, _FOREGROUND - 2
# Where each model's numbers go in fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6.
_PLACES: dict[str, tuple[tuple[int, ...], ...]] = {
    "SIMPLE_PINHOLE": ((0, 1), (2,), (3,)),
    "PINHOLE": ((0,), (1,), (2,), (3,)),
    "SIMPLE_RADIAL": ((0, 1), (2,), (3,), (4,)),
    "RADIAL": ((0, 1), (2,), (3,), (4,), (5,)),
    "OPENCV": tuple((k,) for k in range(8)),
    "FULL_OPENCV": tuple((k,) for k in range(12)),
    "SIMPLE_RADIAL_FISHEYE": ((0, 1), (2,), (3,), (4,)),
    "RADIAL_FISHEYE": ((0, 1), (2,), (3,), (4,), (5,)),
    "OPENCV_FISHEYE": tuple((k,) for k in range(8)),
}


def write_project(store: ProductStore, folder: Path) -> dict[str, Any]:
    """Write what a project has textured; what ``stitched.json`` says is returned.

    Raises
    ------
    InputError
        It has no textured depth meshes, or what `write_stitched` says.
    """
    project = StitchedProject.of(Project(store.root))
    origin = np.zeros(3)
    if store.exists("scan_inventory"):
        origin = np.array(store.load("scan_inventory")["origin_m"], np.float64)
    photographs = project.scene
    scene = StitchScene.of(photographs.meshes)
    return write_stitched(folder, scene, photographs.cameras, photographs.picture, origin)


def write_stitched(
    folder: Path,
    scene: StitchScene,
    cameras: Sequence[PhotoCamera],
    pictures: Callable[[int], NDArray[np.uint8]],
    origin: NDArray[np.float64],
) -> dict[str, Any]:
    """Write a scene for the page; what ``stitched.json`` says is returned.

    Parameters
    ----------
    folder : that is there.
    scene : the meshes.
    cameras : of all photographs, by the numbers of the scene's labels.
    pictures : photograph → (h, w, 4) uint8 texture picture of its camera's size.
    origin : (3,) of the project, in the user's coordinates.

    Raises
    ------
    InputError
        A lens, or so many meshes or photographs, that pages cannot draw.
    """
    if scene.meshes > _MOST_MESHES or len(cameras) > _MOST_PHOTOS:
        raise InputError(
            "There are more depth meshes than pages can stitch.",
            expected=f"at most {_MOST_MESHES} meshes and {_MOST_PHOTOS} photographs",
            found=f"{scene.meshes} and {len(cameras)}",
            fix="texture with fewer photographs",
        )
    low, high = scene.vertices.min(axis=0), scene.vertices.max(axis=0)
    middle = 0.5 * (low + high)
    used = set(np.unique(scene.labels).tolist())
    vote = StitchSettings()
    told = {
        "version": 2,
        "from_positions": (origin + middle).tolist(),
        "epsilon": scene.epsilon,
        "cost_step": _COST_STEP,
        "vote": {
            "rounds": vote.rounds,
            "radius": vote.radius_px,
            "label_weight": vote.label_weight,
            "mesh_weight": vote.mesh_weight,
        },
        "seam_radius": LevellingSettings().radius_px,
        "file": MESHES,
        "meshes": _write_meshes(folder / MESHES, scene, middle, vote.coarseness_weight),
        "photos": [
            {
                **_camera(camera, middle),
                **_write_picture(folder, k, camera, pictures if k in used else None),
            }
            for k, camera in enumerate(within(camera, _LONGEST_PX) for camera in cameras)
        ],
    }
    (folder / TOLD).write_text(json.dumps(told, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return told


def _write_meshes(
    path: Path, scene: StitchScene, middle: NDArray[np.float64], coarseness_weight: float
) -> list[dict[str, Any]]:
    told, offset = [], 0
    costs = scene.penalties + np.float32(coarseness_weight) * scene.coarseness
    steps = np.rint(np.minimum(costs / _COST_STEP, 65535.0)).astype("<u2")
    labels = (scene.labels + 1).astype("<u2")
    labels[scene.foreground] |= np.uint16(_FOREGROUND)
    reach = np.rint(scene.reach * COARSENESS_STEPS).astype(np.uint8)
    with open(path, "wb") as file:
        for mesh in range(scene.meshes):
            corners = slice(scene.vertex_starts[mesh], scene.vertex_starts[mesh + 1])
            own = slice(scene.starts[mesh], scene.starts[mesh + 1])
            places = (scene.vertices[corners] - middle).astype("<f4")
            colors = np.full((len(places), 4), 255, np.uint8)
            colors[:, :3] = scene.colors[corners]
            index = "<u2" if len(places) <= 1 << 16 else "<u4"
            triangles = (scene.triangles[own] - corners.start).astype(index)
            parts = (places, colors, labels[own], steps[own], triangles, reach[own])
            block = b"".join(part.tobytes() for part in parts)
            file.write(block)
            around = places if len(places) else np.zeros((1, 3), "<f4")
            told.append(
                {
                    "offset": offset,
                    "bytes": len(block),
                    "crc": zlib.crc32(block),
                    "vertices": len(places),
                    "triangles": len(triangles),
                    "low": around.min(axis=0).tolist(),
                    "high": around.max(axis=0).tolist(),
                }
            )
            offset += len(block)
    return told


def _camera(camera: PhotoCamera, middle: NDArray[np.float64]) -> dict[str, Any]:
    """What a page has to know to find a place in a photograph."""
    if camera.model not in _PLACES:
        raise InputError(
            f"Pages cannot draw photographs of the lens model {camera.model}.",
            expected=", ".join(_PLACES),
            fix="orient the photographs with one of the expected models",
        )
    lens = np.zeros(12)
    for places, value in zip(_PLACES[camera.model], camera.params, strict=True):
        lens[list(places)] = value
    matrix = np.array(camera.camera_from_world[:3])
    matrix[:, 3] += matrix[:, :3] @ middle
    return {
        "size": [camera.width, camera.height],
        "lens": lens.tolist(),
        "fisheye": camera.model.endswith("FISHEYE"),
        "from_positions": matrix.ravel().tolist(),
    }


def _write_picture(
    folder: Path,
    number: int,
    camera: PhotoCamera,
    pictures: Callable[[int], NDArray[np.uint8]] | None,
) -> dict[str, Any]:
    """A photograph of a camera's size and what of it may be used, as files of their own."""
    told: dict[str, Any] = {"picture": None, "mask": None}
    if pictures is None:
        return told
    picture = pictures(number)
    usable = picture[..., 3] > 0
    colors, size = _filled(picture[..., :3], usable), (camera.width, camera.height)
    if size != picture.shape[1::-1]:
        colors = np.asarray(cv2.resize(colors, size, interpolation=cv2.INTER_AREA), np.uint8)
        share = cv2.resize(usable.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        usable = np.asarray(share > _ALL)
    files = {"picture": (".jpg", colors[..., ::-1])}
    if not usable.all():
        files["mask"] = (".png", np.where(usable, np.uint8(255), np.uint8(0)))
    # Colours keep their places: halved, they would bleed over the borders of what may be used.
    kept = (cv2.IMWRITE_JPEG_QUALITY, _QUALITY, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, 0x111111)
    settings = {".jpg": kept, ".png": (cv2.IMWRITE_PNG_COMPRESSION, 9)}
    for kind, (suffix, values) in files.items():
        done, encoded = cv2.imencode(suffix, values, settings[suffix])
        if not done:
            raise InputError("A photograph cannot be written.", found=f"number {number}")
        content = encoded.tobytes()
        name = f"photo-{number:04}{suffix}"
        (folder / name).write_bytes(content)
        told |= {kind: name, f"{kind}_bytes": len(content), f"{kind}_crc": zlib.crc32(content)}
    return told


def _filled(picture: NDArray[np.uint8], usable: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """A picture (h, w, 3) that goes on smoothly where it may not be used (h, w).

    JPEG spreads steps over eight pixels: a step at the border would reach what may be used.
    """
    weight = usable.astype(np.float32)
    colors = picture.astype(np.float32) * weight[..., None]
    levels = [(colors, weight)]
    while min(levels[-1][1].shape) > 1:
        size = tuple(max(1, side // 2) for side in levels[-1][1].shape[::-1])
        levels.append(
            tuple(cv2.resize(part, size, interpolation=cv2.INTER_AREA) for part in levels[-1])  # type: ignore[arg-type]
        )
    whole = np.zeros((*levels[-1][1].shape, 3), np.float32)
    for total, share in reversed(levels):
        size = share.shape[::-1]
        coarser = cv2.resize(whole, size, interpolation=cv2.INTER_LINEAR)
        rest = np.float32(1.0) - np.minimum(share, np.float32(1.0))
        whole = total.reshape(*share.shape, 3) + rest[..., None] * coarser.reshape(*share.shape, 3)
    return np.asarray(np.where(usable[..., None], picture, np.rint(whole)), np.uint8)
