"""Pictures of a project's textured depth meshes, stitched as Arikan et al. (2014) do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.pipeline.depth_scene import DepthScene, depth_scene
from workbench.pipeline.photo_surface import surface_mesh, told_camera, told_surface
from workbench.pipeline.stage import Products
from workbench.project.project import Project
from workbench.project.settings import suggestion

_CACHE_BYTES = 2 << 30
_READS = (
    *("surface", "geometry_file", "surface_color", "photo_poses"),
    *("texturing", "texture_photos", "depth_maps", "depth_meshes"),
)
_GREY = 128


@dataclass(frozen=True)
class StitchedProject:
    """What a project has to be drawn from photographs.

    Attributes
    ----------
    products : of the project.
    surface : the model, coloured.
    scene : its depth meshes and their photographs.
    """

    products: Products
    surface: TriangleMesh
    scene: DepthScene

    @classmethod
    def of(cls, project: Project) -> StitchedProject:
        """Open the textured depth meshes of a project.

        Raises
        ------
        InputError
            It has none.
        """
        products = Products(project, _READS, ())
        if not products.items("depth_meshes") or products.load_if_there("texturing") is None:
            raise InputError(
                "The project has no textured depth meshes to stitch.",
                file=project.root,
                fix=f"workbench texture {project.root}",
            )
        surface = colored_surface(products, surface_mesh(products, told_surface(products)))
        return cls(products, surface, depth_scene(products, surface))

    def camera_of(self, name: str) -> PhotoCamera:
        """The camera of a photograph, held out or not, of its texture picture's size.

        Raises
        ------
        InputError
            No photograph of this name is oriented.
        """
        poses = self.products.load("photo_poses")["photos"]
        if name not in poses:
            raise InputError(
                f"There is no oriented photograph {name!r}",
                expected=", ".join(sorted(poses)),
                fix=suggestion(name, poses) or "choose one of the expected names",
            )
        return told_camera(poses[name], self.products.load("texturing")["image_px"])

    def picture(self, camera: PhotoCamera) -> NDArray[np.uint8]:
        """What a camera sees, (h, w, 4) uint8 sRGB with alpha: 0 where there is nothing."""
        from workbench.render.stitch.renderer import stitched_view
        from workbench.render.stitch.scene import StitchScene
        from workbench.texturing.picture_cache import PictureCache

        scene = self.scene
        cache = PictureCache(scene.picture, _CACHE_BYTES)
        view = stitched_view(StitchScene.of(scene.meshes), camera, scene.cameras, cache.get)
        seen = view.shown.seen
        picture = np.zeros((camera.height, camera.width, 4), np.uint8)
        picture[..., :3] = np.rint(255.0 * np.clip(view.color, 0.0, 1.0))
        picture[seen, 3] = 255
        picture[~seen] = 0
        return picture


def colored_surface(products: Products, surface: TriangleMesh) -> TriangleMesh:
    """The surface with its own colours as ``color`` (n, 3) uint8 sRGB; grey where unknown.

    Parameters
    ----------
    products : of a stage that reads ``surface_color``.
    """
    from workbench.color.blending_display import encoded_srgb

    colors = np.full((len(surface.vertices), 3), _GREY, np.uint8)
    told = products.load_if_there("surface_color")
    if told is not None:
        known = np.isfinite(told["color"]).all(axis=1)
        colors[known] = encoded_srgb(told["color"][known], told["space"].item())
    return surface.with_attributes(color=colors)
