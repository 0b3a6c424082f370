"""What is done to each photograph by itself: a first look, and its development."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from workbench.pipeline.tasks import ItemProducts, Payload

if TYPE_CHECKING:
    from workbench.photos.decoding import LinearPhoto

# Of a linearity frame's sides, the middle part that is measured where there is no chart.
_MIDDLE_SHARE = 0.08
_CLIPPED_SHARE = 0.01


def look_at(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """How a photograph was taken, how bright it is, and what chart or even target it shows."""
    from workbench.photos.decoding import read_linear
    from workbench.photos.exif import photo_facts
    from workbench.photos.exposure import bright_level

    path = Path(payload["path"])
    photo = read_linear(path, "linear", half_size=True)
    balance, matrix, profile = photo.white_balance, photo.camera_from_xyz, photo.profile_matrix
    found: dict[str, Any] = {
        "facts": photo_facts(path).as_dict(),
        "half_size": [photo.values.shape[1], photo.values.shape[0]],
        "white_balance": None if balance is None else balance.tolist(),
        "camera_from_xyz": None if matrix is None else matrix.tolist(),
        "profile_matrix": None if profile is None else profile.tolist(),
        "linearised_from": photo.linearised_from,
        "black_level": photo.black_level,
        "white_level": photo.white_level,
        "bright_level": bright_level(photo.values),
        "middle": _middle(photo),  # None where it is clipped
    }
    if payload["flat"]:
        from workbench.photos.vignetting import flat_frame

        frame = asdict(flat_frame(photo.values, photo.usable))
        found["flat"] = frame | {"levels": frame["levels"].tolist()}
    if payload["corners"] or payload["search"]:
        found |= _chart(photo, payload["corners"])
    return found


def _chart(photo: LinearPhoto, corners: list[list[float]] | None) -> dict[str, Any]:
    """The chart in a photograph of half size: place, patches, and whether it is all of it."""
    from workbench.color.chart_finding import NoChart, chart_at, found_chart
    from workbench.color.patches import UnfitChart, fitness, measured_patches

    chart = (
        chart_at(photo.values, 0.5 * np.array(corners)) if corners else found_chart(photo.values)
    )
    if isinstance(chart, NoChart):
        return {"no_chart": chart.reason}
    patches = measured_patches(photo.values, photo.usable, chart)
    if isinstance(patches, UnfitChart):
        return {"no_chart": patches.reason}
    unfit = fitness(patches)
    return {
        "chart": {
            "by": chart.by,
            "corners_px": chart.scaled(2.0).corners.tolist(),
            "width_px": 2.0 * chart.width_px,
            "fills": chart.share_of(photo.values),
            "patches": patches.as_dict(),
            "unfit": None if unfit is None else unfit.reason,
        }
    }


def _middle(photo: LinearPhoto) -> float | None:
    """Mean green in the photograph's middle; None where it is clipped."""
    height, width = photo.usable.shape
    down, right = (max(1, round(_MIDDLE_SHARE * side / 2)) for side in (height, width))
    y, x = height // 2, width // 2
    middle = (slice(y - down, y + down), slice(x - right, x + right))
    if (photo.usable[middle] == 0).mean() > _CLIPPED_SHARE:
        return None
    return float(photo.values[middle][..., 1].mean(dtype=np.float64))


def develop_photo(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """One photograph in the working space, and the mask of what was not clipped."""
    from workbench.color.calibration import ColorMatrix
    from workbench.formats.icc_profile import linear_rgb_profile
    from workbench.formats.linear_tiff import LinearPicture
    from workbench.photos.decoding import read_linear
    from workbench.photos.vignetting import Vignetting

    start = perf_counter()
    photo = read_linear(Path(payload["path"]), payload["demosaic"], half_size=payload["half_size"])
    values = photo.values
    if payload["vignetting"]:
        lens = Vignetting(tuple(payload["vignetting"]), 0.0)
        values = values / lens.relative_light(*values.shape[:2])[..., None]
    developed = ColorMatrix.from_dict(payload["color"]).applied(values)
    developed *= np.float32(payload["gain"])
    space = payload["space"]
    profile = linear_rgb_profile(space["xyz_d50_from_rgb"], space["title"])
    picture = LinearPicture(developed, space["name"], payload["scale"], profile)
    products.save("developed_photos", picture, payload["name"])
    products.save("unclipped_masks", photo.usable, payload["name"])
    return {
        "size": [values.shape[1], values.shape[0]],
        "clipped": float((photo.usable == 0).mean()),
        "beyond": picture.share_beyond,
        "seconds": perf_counter() - start,
    }
