"""Renderings from where a photograph was taken that textured nothing, held against it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.labelled_mesh import LabelledMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.metrics import Metric
from workbench.render.stitch.alternatives import blended, overwritten, photo_depth, z_buffered
from workbench.render.stitch.renderer import StitchedView, colored_view, stitched_view
from workbench.render.stitch.scene import StitchScene
from workbench.verification.image_quality import ColorSteps, color_steps, psnr, sharpness, ssim

Pictures = Callable[[int], NDArray[np.uint8]]

WAYS = {
    "stitched": "depth meshes, stitched and levelled",
    "unlevelled": "stitched, not levelled",
    "z-buffered": "depth meshes, the front-most seen",
    "overwritten": "depth meshes drawn over each other, unlabelled",
    "blended": "stitched shape, all photographs averaged",
    "reconstructed": "one mesh of as many triangles, reconstructed",
    "simplified": "one mesh of as many triangles, the model simplified",
}


@dataclass(frozen=True)
class Quality:
    """How near a rendering is to what it should be, and how sharp: PSNR in dB, SSIM, and the
    mean squared gradient of its luma.
    """

    psnr: float
    ssim: float
    sharpness: float


@dataclass(frozen=True)
class HeldOutView:
    """One photograph that textured nothing, and what is rendered in its place.

    Attributes
    ----------
    name : of the photograph.
    truth : (h, w, 3) float32 sRGB-encoded in [0, 1]; what should be seen.
    told : what that is, in words.
    mask : (h, w) pixels compared: where all ways show something and the truth is known.
    pictures : way → (h, w, 3) rendering.
    labels : (h, w) int32 photograph that each pixel of the stitched one is from.
    quality : way → over the mask.
    true_sharpness : of the truth.
    before, after : steps of colour at borders of labels, before and after levelling.
    seconds : of each pass of the stitched rendering.
    """

    name: str
    truth: NDArray[np.float32]
    told: str
    mask: NDArray[np.bool_]
    pictures: Mapping[str, NDArray[np.float32]]
    labels: NDArray[np.int32]
    quality: Mapping[str, Quality]
    true_sharpness: float
    before: ColorSteps
    after: ColorSteps
    seconds: Mapping[str, float]


def held_out_view(
    name: str,
    camera: PhotoCamera,
    truth: NDArray[np.float32],
    known: NDArray[np.bool_],
    told: str,
    meshes: Sequence[LabelledMesh],
    singles: Mapping[str, LabelledMesh],
    cameras: Sequence[PhotoCamera],
    pictures: Pictures,
) -> HeldOutView | None:
    """Render a photograph's view in all ways and compare; None where no pixel can be compared.

    Parameters
    ----------
    camera : of the photograph, of the size of ``truth``.
    truth : (h, w, 3) float32 sRGB-encoded in [0, 1].
    known : (h, w) where the truth is known.
    told : what the truth is, in words.
    meshes : depth meshes, one for each of ``cameras``.
    singles : way → one labelled mesh, to compare with.
    cameras, pictures : of the photographs that texture.
    """
    scene = StitchScene.of(meshes)
    shown = stitched_view(scene, camera, cameras, pictures)
    ways: dict[str, NDArray[np.float32]] = {
        "stitched": shown.color,
        "unlevelled": shown.textured.color,
    }
    seen = known & shown.shown.seen
    order = list(range(len(cameras)))
    for way, fragments in (
        ("z-buffered", z_buffered(scene, camera)),
        ("overwritten", overwritten(scene, camera, order, order)),
    ):
        ways[way] = colored_view(scene, fragments, cameras, pictures).textured.color
        seen &= fragments.seen
    ways["blended"] = blended(
        shown.shown,
        scene,
        cameras,
        pictures,
        order,
        lambda photo: photo_depth(scene, cameras[photo]),
    )
    for way, single in singles.items():
        alone = stitched_view(StitchScene.of([single]), camera, cameras, pictures)
        ways[way] = alone.color
        seen &= alone.shown.seen
    if not seen.any():
        return None
    quality = {
        way: Quality(psnr(color, truth, seen), ssim(color, truth, seen), sharpness(color, seen))
        for way, color in ways.items()
    }
    before, after = _steps(shown, scene.epsilon)
    return HeldOutView(
        name, truth, told, seen, ways, shown.shown.label, quality, sharpness(truth, seen),
        before, after, shown.seconds,
    )  # fmt: skip


def _steps(shown: StitchedView, epsilon: float) -> tuple[ColorSteps, ColorSteps]:
    before, after = (
        color_steps(color, shown.shown.label, shown.shown.depth, epsilon)
        for color in (shown.textured.color, shown.color)
    )
    return before, after


def view_metrics(views: Sequence[HeldOutView]) -> list[Metric]:
    """Means over the photographs held out; nothing without any."""
    if not views:
        return []
    metrics = []
    for way, label in WAYS.items():
        told = [view.quality[way] for view in views if way in view.quality]
        if told:
            key = way.replace("-", "_")
            metrics += [
                Metric(f"psnr_{key}", _mean([q.psnr for q in told]), "dB",
                       f"Renderings against photographs held out: {label}."),
                Metric(f"ssim_{key}", _mean([q.ssim for q in told]), "",
                       f"Structural similarity to the same: {label}."),
            ]  # fmt: skip
    return [
        *metrics,
        Metric("border_step_before", _mean([view.before.across for view in views]), "of 255",
               "Step of colour where the photograph changes, as stitched."),
        Metric("border_step_after", _mean([view.after.across for view in views]), "of 255",
               "The same after levelling."),
    ]  # fmt: skip


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))
