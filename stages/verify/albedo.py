"""What a simulation's photographs would tell of the surface's colour in even light."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.transforms import Matrix4, inverse
from workbench.pipeline.stage import Products
from workbench.verification.photo_sections import evenly_chosen

# More photographs change no digit that is shown.
_PHOTOGRAPHS = 64
# Pixels much finer than the vertices are only averaged again, and take their time.
_PIXELS_PER_VERTEX = 8.0
_FULL, _WHOLLY = 65535, 255


def photographed_albedo(
    products: Products,
    surface: TriangleMesh,
    model_from_local: Matrix4,
    names: Collection[str],
    options: Mapping[str, Any],
) -> NDArray[np.float64] | None:
    """The painted albedo (n, 3) as perfect photographs tell it; linear Rec. 709.

    The pictures of the albedo alone are blended onto the vertices as photographs are, from
    where the cameras truly stood: what differs from it is the flash's doing, the cameras' and
    the masks', and not that pixels and vertices are larger than the finest paint. NaN where
    none shows a vertex; None where no such pictures were written.

    Parameters
    ----------
    model_from_local : 4×4 from the local frame of the simulation to the model's.
    names : photographs that were blended.
    options : of the stage ``color``.
    """
    from workbench.color.blending import BlendSums
    from workbench.color.blending_colors import uncorrected
    from workbench.color.blending_surface import ReadySurface
    from workbench.color.blending_weights import WeightOptions
    from workbench.formats.colmap import read_colmap_text
    from workbench.geometry.photo_view import reduced_camera

    known = sorted(set(products.items("truth_albedo")) & set(names))
    if not known or products.load_if_there("truth_cameras") is None:
        return None
    cameras = read_colmap_text(Path(products.load("truth_cameras")).parent).photo_cameras()
    ready, sums = ReadySurface(surface), BlendSums(len(surface.vertices))
    weights = WeightOptions(options["feather"], options["angle_power"], options["sharpness_power"])
    for name in evenly_chosen(known, _PHOTOGRAPHS):
        camera = cameras[name]
        camera = replace(
            camera, camera_from_world=camera.camera_from_world @ inverse(model_from_local)
        )
        share = min(
            1.0,
            options["image_px"] / max(camera.width, camera.height),
            _PIXELS_PER_VERTEX / ready.spacing_px(camera),
        )
        camera = reduced_camera(camera, round(share * camera.width), round(share * camera.height))
        picture, shown = true_albedo(products, name, camera)
        photo = ready.weighed(camera, picture, shown, weights, options["normal_px"])
        sums.add(uncorrected(ready.observed(photo), 1.0))
    return np.where(sums.weights[:, None] > 0.0, sums.mean_colors, np.nan)


def true_albedo(
    products: Products, name: str, camera: PhotoCamera
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """A simulated photograph's true albedo (h, w, 3), linear, and where the object is (h, w).

    Parameters
    ----------
    camera : of the size wanted.
    """
    stored = _read(products.load("truth_albedo", name), camera)
    picture = stored[..., ::-1].astype(np.float32) / np.float32(_FULL)
    return picture, np.asarray(_read(products.load("truth_object", name), camera) == _WHOLLY)


def _read(path: Path, camera: PhotoCamera) -> NDArray[Any]:
    """A picture at the size of a camera's."""
    import cv2

    picture = np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED))
    size = (camera.width, camera.height)
    if picture.shape[1::-1] == size:
        return picture
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
