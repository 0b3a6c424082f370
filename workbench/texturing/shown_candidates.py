"""Which triangles of a surface each photograph shows.

Source: Lempitsky, Ivanov 2007, section 3, asks the same of triangles; here a triangle counts as
shown only if every pixel that texturing it may read is its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh, face_normals_and_areas
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.transforms import apply
from workbench.kernels.data_costs import penalties
from workbench.kernels.triangle_depths import nearness_buffer, wholly_shown
from workbench.texturing.candidates import Candidates
from workbench.texturing.cost_options import CostOptions

_USABLE = 255
# How much nearer something must be to hide a triangle, pixels' widths on the surface: within
# it, where its own neighbours are at most so near, and around it, where they may be steep.
_INSIDE_PX, _BESIDE_PX = 3.0, 12.0
# What lies farther out than the picture's corner by more than this is not projected: lens models
# fold back there.
_REACH = 1.05


def shown_candidates(
    mesh: TriangleMesh,
    cameras: Mapping[int, PhotoCamera],
    pictures: Callable[[int], NDArray[np.uint8]],
    options: CostOptions,
    threads: int = 1,
) -> Candidates:
    """The photographs that show each triangle of a surface, wholly and usably.

    Parameters
    ----------
    mesh : in the world.
    cameras : of the photographs by their numbers, of their pictures' sizes.
    pictures : from a photograph's number to its texture picture (h, w, 4) uint8.
    threads : photographs at once; each needs some 5 bytes a pixel beside the picture.

    Raises
    ------
    InputError : a picture is not of its camera's size, or vertices are not finite.
    """
    if not np.isfinite(mesh.vertices).all():
        raise InputError("a mesh to be textured has vertices that are not finite")
    m = len(mesh.triangles)
    normals, _ = face_normals_and_areas(mesh)
    middles = mesh.vertices[mesh.triangles].mean(axis=1) if m else np.zeros((0, 3))

    def shown_by(photo: int) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        camera, picture = cameras[photo], pictures(photo)
        if picture.shape[:2] != (camera.height, camera.width):
            raise InputError(
                f"the texture picture of photograph {photo} is not of its camera's size",
                expected=f"{camera.width} × {camera.height}",
                found=f"{picture.shape[1]} × {picture.shape[0]}",
            )
        pixels, nearness = pixels_within(mesh.vertices, camera)
        buffer = nearness_buffer(pixels, nearness, mesh.triangles, camera.height, camera.width)
        shown = wholly_shown(
            pixels, nearness, mesh.triangles, middles, normals, camera.center, buffer,
            picture[..., 3] == _USABLE, camera.params[0],
            _INSIDE_PX, _BESIDE_PX, options.least_cosine,
        )  # fmt: skip
        which = np.flatnonzero(shown).astype(np.int32)
        return which, penalties(
            which, middles, normals, camera.center,
            options.far, options.distance, options.orientation,
        )  # fmt: skip

    photos = sorted(cameras)
    with ThreadPoolExecutor(max(1, threads)) as pool:
        parts = list(pool.map(shown_by, photos))
    owner = np.concatenate([np.zeros(0, np.int32), *(which for which, _ in parts)])
    labels = np.repeat(np.array(photos, np.int32), [len(which) for which, _ in parts])
    costs = np.concatenate([np.zeros(0), *(cost for _, cost in parts)])
    order = np.argsort(owner, kind="stable")
    starts = np.zeros(m + 1, np.int64)
    np.cumsum(np.bincount(owner, minlength=m), out=starts[1:])
    return Candidates(starts, labels[order], costs[order]).best(options.most_candidates)


def pixels_within(
    points: NDArray[np.float64], camera: PhotoCamera
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Pixels (n, 2) and nearness 1 / depth (n,) of points (n, 3) that are about in the picture.

    NaN and 0 for those behind the camera or farther out than its corners: lens models know
    nothing of what they never saw, and fold it back into the picture.
    """
    in_camera = apply(camera.camera_from_world, points)
    depth = in_camera[:, 2]
    rows, columns = np.linspace(0, camera.height, 9), np.linspace(0, camera.width, 9)
    border = np.concatenate(
        [
            np.stack(np.meshgrid(columns, [0.0, camera.height]), axis=-1).reshape(-1, 2),
            np.stack(np.meshgrid([0.0, camera.width], rows), axis=-1).reshape(-1, 2),
        ]
    )
    ways = camera.directions(border) @ camera.camera_from_world[:3, :3].T
    slopes = np.linalg.norm(ways[:, :2], axis=1) / ways[:, 2]
    # Corners that no direction reaches have none.
    reach = _REACH * float(np.max(slopes, where=np.isfinite(slopes), initial=0.0))
    known = depth > 0.0
    known &= np.square(in_camera[:, 0]) + np.square(in_camera[:, 1]) <= np.square(reach * depth)
    if known.all():
        return camera.project(points)[0], 1.0 / depth
    pixels, nearness = np.full((len(points), 2), np.nan), np.zeros(len(points))
    pixels[known] = camera.project(points[known])[0]
    nearness[known] = 1.0 / depth[known]
    return pixels, nearness
