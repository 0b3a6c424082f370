"""What is to be said of texturing, gathered from the project."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stages.verify.albedo import true_albedo
from workbench.geometry.labelled_mesh import LabelledMesh
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.metrics import Metric
from workbench.pipeline.depth_scene import DepthScene, depth_scene
from workbench.pipeline.photo_surface import told_camera
from workbench.pipeline.stage import Products
from workbench.pipeline.stitched_pictures import colored_surface

if TYPE_CHECKING:
    from workbench.verification.report_content import Section
    from workbench.verification.texture_views import HeldOutView, Pictures

PICTURE_CACHE_BYTES = 1 << 30
# With fewer triangles a reconstruction shows nothing.
_LEAST_TRIANGLES = 2000


def texture_chapter(
    products: Products, surface: TriangleMesh, simulated: bool, sizes_px: Sequence[int] = ()
) -> tuple[tuple[Section, ...], list[Metric]]:
    """The section on texturing, where photographs texture the surface.

    Parameters
    ----------
    simulated : whether pictures of the true albedo are what renderings are compared with,
        instead of the photographs held out.
    sizes_px : of depth maps at which labelling is timed, where photographs are held out.
    """
    from workbench.texturing.cost_options import CostOptions
    from workbench.texturing.picture_cache import PictureCache
    from workbench.verification.texture_scaling import ScalingPoint, scaling_points
    from workbench.verification.texture_sections import texture_section
    from workbench.verification.texture_views import view_metrics

    told = products.load_if_there("texturing")
    if told is None:
        return (), []
    record = products.load("records", "texture")
    views: list[HeldOutView] = []
    scaling: list[ScalingPoint] = []
    foreground = 0
    if told["held_out"] and products.items("depth_meshes"):
        colored = colored_surface(products, surface)
        scene = depth_scene(products, colored)
        foreground = scene.foreground
        pictures = PictureCache(scene.picture, PICTURE_CACHE_BYTES).get
        cycles = record["options"]["cycles"]
        singles = _single_meshes(products, scene, colored, pictures, told, cycles)
        views = held_out_views(products, scene, singles, pictures, told, simulated)
        costs = CostOptions(**told["costs"])
        scaling = scaling_points(colored, scene.cameras, pictures, costs, cycles, sizes_px)
    return (texture_section(record, views, foreground, scaling),), view_metrics(views)


def held_out_views(
    products: Products,
    scene: DepthScene,
    singles: dict[str, LabelledMesh],
    pictures: Pictures,
    told: dict[str, Any],
    simulated: bool,
) -> list[HeldOutView]:
    """What is rendered in the place of each photograph held out."""
    from workbench.verification.texture_views import held_out_view

    poses = products.load("photo_poses")["photos"]
    unlit = set(products.load("flash")["without_flash"])
    views = []
    for name in told["held_out"]:
        camera = told_camera(poses[name], told["image_px"])
        truth, known, words = _truth(products, name, camera, simulated, name in unlit)
        view = held_out_view(
            name, camera, truth, known, words, scene.meshes, singles, scene.cameras, pictures
        )
        views += [view] if view is not None else []
    return views


def _truth(
    products: Products, name: str, camera: PhotoCamera, simulated: bool, unlit: bool
) -> tuple[NDArray[np.float32], NDArray[np.bool_], str]:
    """What a photograph should show, sRGB-encoded in [0, 1], where that is known, and its name.

    Textures of photographs taken without a flash keep the light there was: albedo is no truth.
    """
    from workbench.formats.gltf import srgb_from_linear

    if simulated and not unlit and name in products.items("truth_albedo"):
        linear, shown = true_albedo(products, name, camera)
        truth = srgb_from_linear(linear).astype(np.float32) / np.float32(255.0)
        return truth, shown, "the true albedo"
    picture = products.load("texture_photos", name)
    truth = picture[..., :3].astype(np.float32) / np.float32(255.0)
    words = "what it shows itself" + ("" if unlit else ", free of its flash")
    return truth, picture[..., 3] > 0, words


def _single_meshes(
    products: Products,
    scene: DepthScene,
    colored: TriangleMesh,
    pictures: Pictures,
    told: dict[str, Any],
    cycles: int,
) -> dict[str, LabelledMesh]:
    """One mesh with as many triangles as the depth meshes have in the foreground, made two ways.

    Parameters
    ----------
    colored : the model with the colours of its vertices.
    pictures : of the photographs that texture.
    told : what the stage ``texture`` says of them.
    cycles : of α-expansion.
    """
    from workbench.geometry.simplification import simplified
    from workbench.texturing.cost_options import CostOptions
    from workbench.texturing.single_mesh import labelled_surface

    costs = CostOptions(**told["costs"])
    meshes = {"simplified": simplified(colored, scene.foreground)}
    samples = products.load_if_there("samples")
    if samples is not None and scene.foreground > _LEAST_TRIANGLES:
        meshes["reconstructed"] = _reconstructed(samples, colored, scene.foreground)
    cameras = dict(enumerate(scene.cameras))
    return {
        way: labelled_surface(mesh, cameras, pictures, costs, max_cycles=cycles)[0]
        for way, mesh in meshes.items()
    }


def _reconstructed(
    samples: dict[str, NDArray[Any]], colored: TriangleMesh, triangles: int
) -> TriangleMesh:
    """A screened Poisson surface with about so many triangles, as Arikan et al., table 2."""
    from scipy.spatial import cKDTree

    from workbench.surface.poisson import CUBE_SCALE, PoissonSettings, reconstruct

    points, normals = samples["points"], samples["normals"]
    depth = int(np.ceil(0.5 * np.log2(triangles)))
    found = reconstruct(points, normals, PoissonSettings(depth=depth))
    # Triangles grow with the square of the cells' number along a side.
    scale = CUBE_SCALE * float(np.sqrt(len(found.triangles) / triangles))
    if scale > CUBE_SCALE:
        found = reconstruct(points, normals, PoissonSettings(depth=depth, cube_scale=scale))
    nearest = cKDTree(colored.vertices).query(found.vertices)[1]
    return found.with_attributes(color=colored.vertex_attributes["color"][nearest])
