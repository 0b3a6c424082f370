"""Pictures of surfel files, as the page draws and lights them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.transforms import apply
from workbench.kernels.srgb_bytes import LINEAR_OF_BYTE
from workbench.kernels.surfel_discs import NO_DISC, blend_discs, draw_discs
from workbench.surfels.drawing import pinhole
from workbench.surfels.surfel_file import SurfelFile
from workbench.surfels.view_surfels import shown_prefixes, view_surfels
from workbench.viewer.page_light import Light, encoded, lit

SIZE_PX = 1.0
_PLAIN = 0.55


def surfel_picture(
    file: SurfelFile, camera: PhotoCamera, light: Light = "camera", size_px: float = SIZE_PX
) -> NDArray[np.uint8]:
    """What a camera sees of surfels, (h, w, 4) uint8 sRGB; alpha 0 where nothing is.

    Discs that overlap on one surface mix (Brandt 2019, 4.2).

    Parameters
    ----------
    file
        The file.
    camera
        A pinhole camera in its frame.
    light
        See `page_light.lit`.
    size_px
        Across surfels at the place of a node that is nearest to the camera, pixels.

    Raises
    ------
    InputError
        The file is damaged, or the camera has another lens.
    """
    lens = pinhole(camera)
    picture = np.zeros((camera.height, camera.width, 4), np.uint8)
    surfels = view_surfels(file, shown_prefixes(file, camera, size_px))
    if surfels.normals is None or surfels.radius is None or not len(surfels):
        return picture
    discs = (
        apply(camera.camera_from_world, surfels.points),
        surfels.normals.astype(np.float64) @ camera.camera_from_world[:3, :3].T,
        surfels.radius.astype(np.float64),
    )
    shape = picture.shape[:2]
    depth, number = np.full(shape, np.inf), np.full(shape, NO_DISC, np.int32)
    draw_discs(*discs, lens, 0, depth, number)
    albedo = np.full((len(surfels), 3), _PLAIN)
    if surfels.color is not None:
        albedo = LINEAR_OF_BYTE[surfels.color]
    sums = np.zeros((*shape, 4))
    blend_discs(*discs, lens, depth, lit(albedo, discs[1], discs[0], light), sums)
    seen = number != NO_DISC
    picture[seen, :3] = np.rint(255.0 * encoded(sums[seen, :3] / sums[seen, 3:]))
    picture[seen, 3] = 255
    return picture
