"""A surface made ready to be asked what each photograph shows of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.color.blending_observations import (
    Observations,
    WeighedPhoto,
    observed,
    weighed_photo,
)
from workbench.color.blending_samples import blocks_of_mesh, vertex_spacing
from workbench.color.blending_weights import WeightOptions, pixel_weights
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.photo_view import PhotoView, PlainBlock, view_of_surface
from workbench.geometry.surface_rays import SurfaceRays

_NEARLY_ALL = 0.99


class ReadySurface:
    """A surface made ready for every photograph: rays, and vertices as samples.

    Attributes
    ----------
    mesh : in the world.
    rays : of the mesh.
    blocks : its vertices in order.
    normals : (n, 3) of them.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        self.mesh = mesh
        self.rays: SurfaceRays = SurfaceRays(mesh)
        self.blocks: list[PlainBlock] = blocks_of_mesh(mesh)
        self.normals = np.concatenate([block.normals for block in self.blocks])
        self._spacing = float(np.quantile(vertex_spacing(mesh), _NEARLY_ALL))

    def view(self, camera: PhotoCamera) -> PhotoView:
        """What a camera sees of it."""
        return view_of_surface(self.rays, self.normals, camera)

    def weighed(
        self,
        camera: PhotoCamera,
        picture: NDArray[np.float32],
        usable: NDArray[np.bool_],
        options: WeightOptions,
        normal_px: int,
    ) -> WeighedPhoto:
        """A photograph ready to be asked for samples.

        Parameters
        ----------
        camera : of the size of the picture.
        picture : (h, w, 3) linear.
        usable : (h, w) pixels that may tell.
        options : what pixels are weighed by.
        normal_px : side of the square of pixels that normals are averaged over.
        """
        view = self.view(camera).smoothed(normal_px)
        weights = pixel_weights(view, picture, usable, options)
        return weighed_photo(view, picture, usable, weights, self.spacing_px(camera))

    def spacing_px(self, camera: PhotoCamera) -> float:
        """How far vertices are from their neighbours in a photograph: nearly all are nearer."""
        middle = 0.5 * (self.mesh.vertices.min(axis=0) + self.mesh.vertices.max(axis=0))
        far = max(float(np.linalg.norm(camera.center - middle)), 1e-9)
        return self._spacing * camera.params[0] / far

    def observed(self, photo: WeighedPhoto) -> Observations:
        """What a photograph says of the vertices."""
        return observed(photo, self.blocks)
