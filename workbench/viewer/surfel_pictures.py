"""Pictures of surfel files, as the page draws and lights them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.formats.gltf import srgb_from_linear
from workbench.geometry.photo_camera import PhotoCamera
from workbench.kernels.srgb_bytes import LINEAR_OF_BYTE
from workbench.surfels.drawing import blended_light
from workbench.surfels.surfel_file import SurfelFile
from workbench.surfels.view_surfels import shown_prefixes, view_surfels
from workbench.viewer.page_light import PLAIN, Light, lit

SIZE_PX = 1.0


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
    picture = np.zeros((camera.height, camera.width, 4), np.uint8)
    surfels = view_surfels(file, shown_prefixes(file, camera, size_px))
    if surfels.normals is None or surfels.radius is None or not len(surfels):
        return picture
    albedo = np.full((len(surfels), 3), PLAIN)
    if surfels.color is not None:
        albedo = LINEAR_OF_BYTE[surfels.color]
    normals, ways = surfels.normals.astype(np.float64), surfels.points - camera.center
    light_of_each = lit(albedo, normals, ways, light)
    seen, linear = blended_light(surfels, surfels.radius, camera, light_of_each)
    picture[seen, :3] = srgb_from_linear(linear)
    picture[seen, 3] = 255
    return picture
