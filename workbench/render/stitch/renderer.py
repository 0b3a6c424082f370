"""The five passes, one after the other: a view of the scene from any camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.photo_camera import PhotoCamera
from workbench.render.stitch.image_management import PicturePlan, picture_plan
from workbench.render.stitch.levelling import Levelling, LevellingSettings, levelling
from workbench.render.stitch.scene import StitchScene
from workbench.render.stitch.stitching import Fragments, StitchSettings, stitched
from workbench.render.stitch.temporal import LevelledFrame, smoothed
from workbench.render.stitch.texturing import Pictures, Textured, textured
from workbench.render.stitch.visibility import visibility

_BUDGET_BYTES = 2 << 30


@dataclass(frozen=True)
class RenderSettings:
    """How views are made.

    Attributes
    ----------
    stitch, levelling : of the third and fifth pass.
    budget_bytes : for the pictures of one view.
    """

    stitch: StitchSettings = field(default_factory=StitchSettings)
    levelling: LevellingSettings = field(default_factory=LevellingSettings)
    budget_bytes: int = _BUDGET_BYTES


@dataclass(frozen=True)
class StitchedView:
    """A finished view and what it was made of.

    Attributes
    ----------
    color : (h, w, 3) float32 sRGB-encoded in [0, 1]; 0 where nothing is.
    shown : one fragment a pixel.
    textured : before levelling.
    plan : the photographs it needed, and those there was no room for.
    levelling : the levelling texture, as applied.
    seconds : of each pass by name.
    """

    color: NDArray[np.float32]
    shown: Fragments
    textured: Textured
    plan: PicturePlan
    levelling: Levelling
    seconds: dict[str, float]

    @property
    def frame(self) -> LevelledFrame:
        """For the next view of a sequence."""
        return LevelledFrame(self.shown, self.levelling.change)


def stitched_view(
    scene: StitchScene,
    camera: PhotoCamera,
    cameras: Sequence[PhotoCamera],
    pictures: Pictures,
    settings: RenderSettings | None = None,
    before: LevelledFrame | None = None,
) -> StitchedView:
    """What a camera sees of a scene, stitched, textured and levelled.

    Parameters
    ----------
    scene : the meshes.
    camera : where from; of a photograph, too.
    cameras : of all photographs.
    pictures : photograph → (h, w, 4) uint8 texture picture of its camera's size.
    settings : defaults otherwise.
    before : the view before in a sequence.
    """
    settings = settings or RenderSettings()
    start = perf_counter()
    visible = visibility(scene, camera)
    drawn = perf_counter()
    shown = stitched(scene, camera, visible, settings.stitch)
    seconds = {"visibility": drawn - start, "stitching": perf_counter() - drawn}
    return colored_view(scene, shown, cameras, pictures, settings, before, seconds)


def colored_view(
    scene: StitchScene,
    shown: Fragments,
    cameras: Sequence[PhotoCamera],
    pictures: Pictures,
    settings: RenderSettings | None = None,
    before: LevelledFrame | None = None,
    seconds: dict[str, float] | None = None,
) -> StitchedView:
    """Image management, texturing and levelling of fragments, however they were chosen.

    Parameters are those of `stitched_view`; ``seconds`` are of the passes before. Without a
    screen to keep busy the pictures are counted after stitching: exactly those that are needed.
    """
    settings = settings or RenderSettings()
    times = dict(seconds or {})
    start = perf_counter()
    plan = picture_plan(shown.label, cameras, settings.budget_bytes)
    counted = perf_counter()
    bare = textured(shown, scene, cameras, pictures, plan.load)
    colored = perf_counter()
    level = levelling(
        bare.color, bare.label, shown.depth, scene.epsilon, settings.levelling, bare.seam
    )
    if before is not None:
        change = smoothed(level.change, shown, before)
        level = Levelling(change, level.kind, level.iterations, level.residual)
    color = np.where(shown.seen[..., None], level.applied(bare.color), np.float32(0.0))
    end = perf_counter()
    times |= {"images": counted - start, "texturing": colored - counted, "levelling": end - colored}
    return StitchedView(color, shown, bare, plan, level, times)
