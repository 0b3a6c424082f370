"""What stitching is compared with: simpler ways to draw many meshes, or to use photographs.

A single labelled mesh needs none of this: it is a scene of one mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh, face_normals_and_areas
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.photo_view import within
from workbench.kernels.stitch_passes import between_texels, corner_colors
from workbench.render.stitch.scene import StitchScene
from workbench.render.stitch.stitching import Fragments, StitchSettings, fragments, stitched
from workbench.render.stitch.texturing import Pictures
from workbench.render.stitch.visibility import visibility

_LONG_SIDE_PX = 512
_LEAST_COSINE = 0.05

PhotoDepth = tuple[PhotoCamera, NDArray[np.float32]]


def z_buffered(scene: StitchScene, camera: PhotoCamera) -> Fragments:
    """The front-most of all meshes, however they penetrate each other (Arikan, fig. 1a)."""
    visible = visibility(scene, camera)
    return fragments(scene, camera, visible.depth, visible.triangle)


def overwritten(
    scene: StitchScene, camera: PhotoCamera, photo_of_mesh: Sequence[int], order: Sequence[int]
) -> Fragments:
    """Meshes without labels, drawn one over the other where they overlap (Arikan, fig. 1b).

    Parameters
    ----------
    photo_of_mesh : (k,) the photograph each mesh was made for, which textures all of it.
    order : the k meshes, the last drawn first: it overwrites the others.

    Raises
    ------
    InputError : not one photograph a mesh, or the order leaves meshes out.
    """
    if len(photo_of_mesh) != scene.meshes or sorted(order) != list(range(scene.meshes)):
        raise InputError(
            "overwriting needs a photograph and a rank for every mesh",
            expected=f"{scene.meshes} meshes",
            found=f"{len(photo_of_mesh)} photographs, order {list(order)}",
        )
    counts = np.diff(scene.starts)
    rank = np.argsort(np.asarray(order, np.int64)).astype(np.float32)
    unlabelled = replace(
        scene,
        labels=np.repeat(np.asarray(photo_of_mesh, np.int32), counts),
        foreground=np.ones(len(scene.labels), bool),
        penalties=np.repeat(rank, counts),
    )
    settings = StitchSettings(rounds=0, coarseness_weight=0.0)
    return stitched(unlabelled, camera, visibility(scene, camera), settings)


def photo_depth(
    scene: StitchScene, camera: PhotoCamera, long_side_px: int = _LONG_SIDE_PX
) -> PhotoDepth:
    """What a photograph sees of a scene, in a smaller picture: its camera and depths."""
    small = within(camera, long_side_px)
    return small, visibility(scene, small).depth


def blended(
    shown: Fragments,
    scene: StitchScene,
    cameras: Sequence[PhotoCamera],
    pictures: Pictures,
    photos: Sequence[int],
    depths: Callable[[int], PhotoDepth],
) -> NDArray[np.float32]:
    """Colours (h, w, 3) as the mean of all photographs that show a place.

    Weights are the cosine of incidence over the squared distance.

    Parameters
    ----------
    shown : places to colour, of any choice.
    photos : which photographs take part.
    depths : photograph → `photo_depth`; keep them for several views.
    """
    at = np.flatnonzero(shown.seen)
    places = shown.position.reshape(-1, 3)[at]
    triangle = shown.triangle.reshape(-1)[at]
    normals, _ = face_normals_and_areas(TriangleMesh(scene.vertices, scene.triangles[triangle]))
    total = np.zeros((len(at), 3))
    weights = np.zeros(len(at))
    for photo in photos:
        small, depth = depths(photo)
        pixels, deep = small.project(places)
        within = (pixels >= 0.0) & (pixels < [small.width, small.height])
        inside = np.asarray(within.all(axis=1))
        column, row = np.where(inside[:, None], pixels, 0.0).astype(np.intp).T
        front = np.asarray(depth[row, column])
        way = cameras[photo].center - places
        distance = np.linalg.norm(way, axis=1)
        cosine = np.asarray((way * normals).sum(axis=1) / np.maximum(distance, 1e-12))
        near = np.asarray(deep <= front + scene.epsilon)
        which = np.flatnonzero(np.logical_and.reduce([inside, near, cosine > _LEAST_COSINE]))
        pixels, _ = cameras[photo].project(places[which])
        colors, coverage = between_texels(pictures(photo), pixels)
        weight = cosine[which] / distance[which] ** 2 * coverage
        total[which] += weight[:, None] * colors
        weights[which] += weight
    color = corner_colors(places, triangle, scene.vertices, scene.triangles, scene.colors)
    some = weights > 0.0
    color[some] = total[some] / weights[some, None]
    out = np.zeros((*shown.depth.shape, 3), np.float32)
    out.reshape(-1, 3)[at] = color
    return out
