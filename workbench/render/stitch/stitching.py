"""Third pass: which of the overlapping meshes shows the surface at each pixel.

Source: Arikan et al., section 6.2. Foreground goes before background there, and the rest is
chance; section 9 leaves open how to choose among backgrounds without tearing neighbouring pixels
apart. Here the lower penalty wins, and neighbours have a vote: a label that few around a pixel
have must be better by so much. A shader does the vote as further passes over the label of the
pass before; two buffers that change places are enough, for all pixels vote at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.transforms import inverse
from workbench.kernels.stitch_passes import lowest_penalties, voted
from workbench.kernels.triangle_raster import draw_competing
from workbench.render.stitch.scene import StitchScene
from workbench.render.stitch.screen import Screen
from workbench.render.stitch.visibility import NO_TRIANGLE, Visibility, on_screen


@dataclass(frozen=True)
class StitchSettings:
    """How fragments compete.

    Attributes
    ----------
    rounds : how often neighbours vote; 0 leaves every pixel to its own penalty.
    radius_px : neighbours are in a square of 2 · radius + 1 pixels.
    label_weight : how much better, in units of the penalty (0 to 3), a fragment must be whose
        label no neighbour has.
    mesh_weight : likewise of the mesh; a change of the mesh alone shows as a step in shape.
    coarseness_weight : of the triangles' coarseness beside the photograph's penalty: backgrounds
        differ less in their photographs than in how well their meshes sample the surface.
    slots : at most so many meshes compete at a pixel.
    """

    rounds: int = 3
    radius_px: int = 3
    label_weight: float = 0.5
    mesh_weight: float = 0.3
    coarseness_weight: float = 0.3
    slots: int = 8

    def __post_init__(self) -> None:
        if not (1 <= self.slots <= 127 and self.rounds >= 0 and self.radius_px >= 1):
            raise InputError("settings of stitching out of bounds", found=str(self))


@dataclass(frozen=True)
class Competition:
    """Fragments that show the same surface at a pixel, all foreground or all background.

    Attributes
    ----------
    depth : (h, w, k) float32; of empty slots anything.
    triangle : (h, w, k) int32 numbers, one a mesh; `NO_TRIANGLE` in empty slots, which are last.
    """

    depth: NDArray[np.float32]
    triangle: NDArray[np.int32]

    @property
    def contested(self) -> NDArray[np.bool_]:
        """(h, w) where two or more compete."""
        if self.triangle.shape[2] < 2:
            return np.zeros(self.triangle.shape[:2], bool)
        return np.asarray(self.triangle[:, :, 1] != NO_TRIANGLE)


@dataclass(frozen=True)
class Fragments:
    """One fragment a pixel: what the texturing pass colours.

    Attributes
    ----------
    camera : of the picture.
    position : (h, w, 3) float64 in the world; NaN where nothing is.
    depth : (h, w) float32 along the camera's axis, infinite where nothing is.
    triangle, mesh, label : (h, w) int32 as in `Visibility`.
    epsilon : metres; neighbours whose depths differ by more do not hang together.
    """

    camera: PhotoCamera
    position: NDArray[np.float64]
    depth: NDArray[np.float32]
    triangle: NDArray[np.int32]
    mesh: NDArray[np.int32]
    label: NDArray[np.int32]
    epsilon: float

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(h, w) where a surface is."""
        return np.asarray(self.triangle != NO_TRIANGLE)


def competition(
    scene: StitchScene, camera: PhotoCamera, visible: Visibility, settings: StitchSettings
) -> Competition:
    """Draw all meshes again and keep what lies within reach of the front.

    A shader that has no lists draws once for the front-most foreground and background and once
    for each round of the vote. It may leave out meshes that are front-most nowhere, as the paper
    does, and loses those that lie behind others by less than ε everywhere.
    """
    screen = Screen(camera)
    shape = (*visible.depth.shape, settings.slots)
    costs, reach = _costs(scene, settings), np.float32(scene.epsilon) * scene.reach
    depth = np.zeros(shape, np.float32)
    triangle = np.full(shape, NO_TRIANGLE, np.int32)
    for mesh in range(scene.meshes):
        placed, first = on_screen(scene, mesh, screen)
        draw_competing(
            placed.pixels,
            placed.depths,
            placed.triangles,
            placed.numbers,
            first,
            visible.depth,
            reach,
            scene.foreground,
            costs,
            depth,
            triangle,
        )
    return Competition(depth, triangle)


def choice(
    scene: StitchScene, competing: Competition, settings: StitchSettings
) -> NDArray[np.int8]:
    """(h, w) the slot that wins; −1 where none competes."""
    costs = _costs(scene, settings)
    chosen = lowest_penalties(competing.triangle, competing.depth, costs)
    meshes = np.repeat(np.arange(scene.meshes, dtype=np.int32), np.diff(scene.starts))
    # Where nothing competes all is settled. Such pixels vote first: else a cheap island between
    # two foregrounds would keep itself up by its own votes.
    voters = np.where(competing.contested, np.int8(-1), chosen)
    for _ in range(settings.rounds):
        chosen = voted(
            chosen,
            voters,
            competing.triangle,
            competing.depth,
            scene.labels,
            meshes,
            costs,
            scene.epsilon,
            settings.radius_px,
            settings.label_weight,
            settings.mesh_weight,
        )
        voters = chosen
    return np.asarray(chosen)


def _costs(scene: StitchScene, settings: StitchSettings) -> NDArray[np.float32]:
    """(t,) what the choice of each triangle costs without its neighbours."""
    weight = np.float32(settings.coarseness_weight)
    return np.asarray(scene.penalties + weight * scene.coarseness, np.float32)


def fragments(
    scene: StitchScene,
    camera: PhotoCamera,
    depth: NDArray[np.float32],
    triangle: NDArray[np.int32],
) -> Fragments:
    """What is shown, from depths (h, w) and triangle numbers (h, w) of a scene."""
    world_from_camera = inverse(camera.camera_from_world)
    position = np.full((*depth.shape, 3), np.nan)
    seen = triangle != NO_TRIANGLE
    deep = depth[seen].astype(np.float64)[:, None]
    rays = np.column_stack([Screen(camera).slopes(*np.nonzero(seen)), np.ones(len(deep))])
    position[seen] = (rays * deep) @ world_from_camera[:3, :3].T + world_from_camera[:3, 3]
    return Fragments(
        camera,
        position,
        np.where(seen, depth, np.float32(np.inf)),
        triangle,
        scene.mesh_of(triangle),
        scene.label_of(triangle),
        scene.epsilon,
    )


def stitched(
    scene: StitchScene,
    camera: PhotoCamera,
    visible: Visibility,
    settings: StitchSettings | None = None,
) -> Fragments:
    """The third pass: one fragment a pixel of those that compete."""
    settings = settings or StitchSettings()
    competing = competition(scene, camera, visible, settings)
    return chosen_fragments(scene, camera, competing, choice(scene, competing, settings))


def chosen_fragments(
    scene: StitchScene, camera: PhotoCamera, competing: Competition, chosen: NDArray[np.int8]
) -> Fragments:
    """The fragments in the chosen slots (h, w)."""
    at = np.maximum(chosen, 0).astype(np.intp)[..., None]
    depth = np.take_along_axis(competing.depth, at, axis=2)[..., 0]
    triangle = np.take_along_axis(competing.triangle, at, axis=2)[..., 0]
    return fragments(scene, camera, depth, triangle)
