"""How near a rendered picture is to a photograph, how sharp it is, and how its seams show."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError

_SSIM_SIDE = 7
_DISPLAY = 255.0


@dataclass(frozen=True)
class ColorSteps:
    """Mean difference of colour between direct neighbours, of 255.

    Attributes
    ----------
    across : where the label changes; NaN where it nowhere does.
    within : where it does not: what the surface's own colours make of it.
    pairs : of neighbours across which the label changes.
    """

    across: float
    within: float
    pairs: int


def psnr(
    picture: NDArray[np.floating], truth: NDArray[np.floating], mask: NDArray[np.bool_]
) -> float:
    """Peak signal-to-noise ratio over a mask, dB; infinite where all is equal.

    Parameters
    ----------
    picture, truth : (h, w, 3) sRGB-encoded in [0, 1].
    mask : (h, w) pixels that count.

    Raises
    ------
    InputError : sizes differ, or no pixel counts.
    """
    _check(picture, mask, truth)
    error = np.mean((picture[mask].astype(np.float64) - truth[mask]) ** 2)
    return float(-10.0 * np.log10(error)) if error > 0.0 else float("inf")


def ssim(
    picture: NDArray[np.floating], truth: NDArray[np.floating], mask: NDArray[np.bool_]
) -> float:
    """Mean structural similarity over a mask, in [−1, 1] (Wang et al. 2004, 7 × 7 windows).

    Only windows that lie inside the mask count, so that what surrounds it has no part.

    Parameters are those of `psnr`.

    Raises
    ------
    InputError : sizes differ, or no window lies inside the mask.
    """
    from skimage.metrics import structural_similarity

    _check(picture, mask, truth)
    inside = cv2.erode(
        mask.astype(np.uint8),
        np.ones((_SSIM_SIDE, _SSIM_SIDE), np.uint8),
        borderType=cv2.BORDER_CONSTANT,
        borderValue=0,
    ).astype(bool)
    _check(picture, inside, truth)
    box = _box(mask)
    _, similar = structural_similarity(  # type: ignore[no-untyped-call]
        np.asarray(picture, np.float64)[box],
        np.asarray(truth, np.float64)[box],
        win_size=_SSIM_SIDE,
        data_range=1.0,
        channel_axis=2,
        full=True,
    )
    return float(similar[inside[box]].mean())


def sharpness(picture: NDArray[np.floating], mask: NDArray[np.bool_]) -> float:
    """Mean squared gradient of the luma over a mask, of 255² per pixel².

    Only pixels count whose four neighbours are in the mask.

    Parameters
    ----------
    picture : (h, w, 3) sRGB-encoded in [0, 1].
    mask : (h, w) pixels that count.

    Raises
    ------
    InputError : sizes differ, or no pixel counts.
    """
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    inside = cv2.erode(
        mask.astype(np.uint8), cross, borderType=cv2.BORDER_CONSTANT, borderValue=0
    ).astype(bool)
    _check(picture, inside)
    luma = _DISPLAY * (np.asarray(picture, np.float64) @ np.array([0.2126, 0.7152, 0.0722]))
    down, across = np.gradient(luma)
    return float(np.asarray(down**2 + across**2)[inside].mean())


def color_steps(
    color: NDArray[np.floating],
    label: NDArray[np.int32],
    depth: NDArray[np.float32],
    epsilon: float,
) -> ColorSteps:
    """Steps of colour across the borders of labels, and elsewhere.

    Parameters
    ----------
    color : (h, w, 3) sRGB-encoded in [0, 1].
    label : (h, w) where each pixel's colour comes from.
    depth : (h, w) infinite where nothing is.
    epsilon : neighbours whose depths differ by more do not count.
    """
    seen = np.isfinite(depth)
    deep = np.where(seen, depth, np.float32(0.0))
    across: list[NDArray[np.float64]] = []
    within: list[NDArray[np.float64]] = []
    for one, other in (
        (np.s_[:, :-1], np.s_[:, 1:]),
        (np.s_[:-1], np.s_[1:]),
    ):
        joined = seen[one] & seen[other] & (np.abs(deep[one] - deep[other]) <= epsilon)
        step = np.abs(color[one].astype(np.float64) - color[other]).mean(axis=2)
        differ = label[one] != label[other]
        across.append(step[joined & differ])
        within.append(step[joined & ~differ])
    return ColorSteps(_mean_step(across), _mean_step(within), sum(len(part) for part in across))


def _mean_step(parts: list[NDArray[np.float64]]) -> float:
    steps = np.concatenate(parts)
    return float(_DISPLAY * steps.mean()) if len(steps) else float("nan")


def _box(mask: NDArray[np.bool_]) -> tuple[slice, slice]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)


def _check(
    picture: NDArray[np.floating],
    mask: NDArray[np.bool_],
    truth: NDArray[np.floating] | None = None,
) -> None:
    if picture.shape != (*mask.shape, 3) or (truth is not None and truth.shape != picture.shape):
        found = [picture.shape, mask.shape] + ([truth.shape] if truth is not None else [])
        raise InputError("pictures and mask must be of one size", found=str(found))
    if not mask.any():
        raise InputError("no pixel to compare", fix="compare where both pictures show the object")
