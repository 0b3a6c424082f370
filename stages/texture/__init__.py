"""Texturing: photographs free of their flash, many labelled depth meshes, and one atlas."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from stages.texture.items import free_photo, label_photo
from stages.texture.options import TextureOptions
from stages.texture.surface import textured_surface
from stages.texture.telling import depth_metrics, photo_metrics
from workbench.errors import InputError
from workbench.metrics import Metric
from workbench.pipeline.knobs import Knob
from workbench.pipeline.photo_surface import surface_mesh, told_photo, told_surface
from workbench.pipeline.stage import Estimate, Job, Need, Products, Stage, StageResult
from workbench.project.project import NO_SURFACE, Scene

if TYPE_CHECKING:
    from workbench.texturing.cost_options import CostOptions
    from workbench.texturing.depth_map import DepthMap

# What is taken out is rounded to steps nobody sees, so that a photograph that is added, and
# moves the flash by less, leaves the others' pictures as they are: logarithm of the gain,
# shares of the distance, degrees, and coefficients of the beam.
_GAIN_STEP, _PLACE_STEP, _ANGLE_STEP, _BEAM_STEP = 0.005, 0.0025, 0.5, 0.005

# Options that what is made of each photograph by itself depends on.
_OF_PHOTOS = ("image_px", "normal_px", "border_px", "depth_map_px", "flatness_px")


def needed(scene: Scene, options: TextureOptions) -> Need:
    if not (options.depth_meshes or options.single_mesh):
        return Need(False, "neither depth meshes nor a textured surface asked for")
    if not scene.photos:
        return Need(False, "no photographs")
    if not scene.has_surface:
        return Need(False, f"no surface to texture: {NO_SURFACE}")
    return Need(True, f"{scene.photos} photographs to texture the surface with")


def estimate(scene: Scene, options: TextureOptions) -> Estimate:
    # A photograph of 24 million pixels takes some 3 GiB of buffers while its flash is taken out.
    pixels = options.depth_map_px**2
    one = 3 * 2**30 + (options.cache_mb << 20) + 500 * pixels
    return Estimate(one, scene.photos * (64 * pixels + 2**25), item_bytes=one)


@dataclass(frozen=True)
class _Photos:
    """Photographs of the scene, and what was made of each.

    ``told`` is what items were asked with, ``names`` those that texture, ``held`` those kept out.
    """

    told: Mapping[str, Mapping[str, Any]]
    names: tuple[str, ...]
    held: tuple[str, ...]


def run(job: Job[TextureOptions]) -> StageResult:
    products, options = job.products, job.options
    poses = products.load("photo_poses")
    if poses["frame"] != "world":
        return StageResult(
            warnings=("nothing was textured: the photographs are not oriented onto the surface",)
        )
    photos, metrics = _free_photos(job, poses["photos"])
    maps = _depth_maps(job, photos)
    far = _far(options, maps)
    if options.depth_meshes:
        metrics += _labelled(job, photos, maps, far)
    else:
        products.remove_items_except("depth_meshes", set())
    if options.single_mesh:
        metrics += textured_surface(job, photos.told, photos.names, _costs(options, far))
    else:
        products.remove_items_except("texture_pages", set())
    products.save(
        "texturing",
        {
            "photographs": list(photos.names),
            "held_out": list(photos.held),
            "far_m": far,
            "costs": asdict(_costs(options, far)),
            "image_px": options.image_px,
        },
    )
    return StageResult(tuple(metrics))


def _free_photos(
    job: Job[TextureOptions], poses: Mapping[str, Any]
) -> tuple[_Photos, list[Metric]]:
    """Take the flash out of every photograph that is placed."""
    from workbench.geometry.mesh import edge_census

    products, options = job.products, job.options
    masked = set(products.items("photo_masks"))
    flash = products.load("flash")
    surface = told_surface(products)
    surface["closed"] = edge_census(surface_mesh(products, surface).triangles).watertight
    unlit = set(flash["without_flash"])
    samples = _told_samples(products) if options.depth_from == "samples" else None
    colors = products.content_hash("surface_color") if options.doubt is not None else None
    told = {
        name: told_photo(products, name, poses[name], name in masked)
        | {
            "surface": surface,
            "space": flash["space"],
            "light": None if name in unlit else _rounded(flash["light"]),
            "gain": float(np.exp(_nearest(np.log(gain), _GAIN_STEP))),
            **{k: getattr(options, k) for k in _OF_PHOTOS},
            "samples": samples,
            "doubt": options.doubt,
            "colors": colors,
        }
        for name, gain in sorted(flash["gains"].items())
        if name in poses
    }
    done = job.tasks.map_items("taking the flash out of photographs", free_photo, told)
    for name in ("texture_photos", "depth_maps"):
        products.remove_items_except(name, set(told))
    held = _held_out(tuple(told), options.held_out)
    names = tuple(name for name in told if name not in held)
    return _Photos(told, names, held), photo_metrics(done, held)


def _told_samples(products: Products) -> dict[str, Any]:
    """Where the samples are that depth maps are made of."""
    for name in ("sample_cloud", "samples"):
        if products.is_there(name):
            return {"artefact": name, "hash": products.content_hash(name)}
    raise InputError(
        "there are no samples to make depth maps of",
        fix="bring scans, or set texture.depth_from=surface",
    )


def _held_out(names: tuple[str, ...], count: int) -> tuple[str, ...]:
    """Photographs evenly chosen, none of them first or last."""
    count = min(count, max(len(names) - 2, 0))
    places = np.linspace(0, len(names), count + 2)[1:-1].astype(int)
    return tuple(names[place] for place in places)


def _rounded(light: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """A flash's light in steps that are not seen."""
    if light is None:
        return None
    step = _PLACE_STEP * light["reference_distance_m"]
    return {
        **light,
        "position_in_camera_m": [_nearest(x, step) for x in light["position_in_camera_m"]],
        "roughness_deg": _nearest(light["roughness_deg"], _ANGLE_STEP),
        "falloff": [_nearest(x, _BEAM_STEP) for x in light["falloff"]],
        "indirect": _nearest(light["indirect"], _BEAM_STEP),
    }


def _nearest(value: float, step: float) -> float:
    return float(step * np.round(value / step))


def _depth_maps(job: Job[TextureOptions], photos: _Photos) -> dict[str, DepthMap]:
    from workbench.pipeline.photo_surface import told_camera
    from workbench.texturing.depth_map import DepthMap

    return {
        name: DepthMap.from_arrays(
            told_camera(photos.told[name]["camera"], job.options.image_px),
            job.products.load("depth_maps", name),
        )
        for name in photos.names
    }


def _far(options: TextureOptions, maps: Mapping[str, DepthMap]) -> float:
    from workbench.texturing.cost_options import far_of_scene

    return far_of_scene(maps.values()) if options.far_m is None else options.far_m


def _labelled(
    job: Job[TextureOptions], photos: _Photos, maps: Mapping[str, DepthMap], far: float
) -> list[Metric]:
    """Label the depth mesh of each photograph."""
    from workbench.texturing.multi_mesh import which_see

    products, options = job.products, job.options
    names = photos.names
    seen = which_see({number: maps[name] for number, name in enumerate(names)})
    contents = {
        name: {
            "camera": photos.told[name]["camera"],
            "picture": products.content_hash("texture_photos", name),
            "depth": products.content_hash("depth_maps", name),
        }
        for name in names
    }
    items = {
        name: {
            "name": name,
            "photos": {names[other]: contents[names[other]] for other in seen[number]},
            "image_px": options.image_px,
            "costs": asdict(_costs(options, far)),
            "cycles": options.cycles,
            "bound_sweeps": options.bound_sweeps,
            "cache_mb": options.cache_mb,
        }
        for number, name in enumerate(names)
    }
    done = job.tasks.map_items("labelling depth meshes", label_photo, items)
    products.remove_items_except("depth_meshes", set(items))
    return depth_metrics(done)


def _costs(options: TextureOptions, far: float) -> CostOptions:
    from workbench.texturing.cost_options import CostOptions

    return CostOptions(
        far,
        options.smoothness,
        options.distance_weight,
        options.orientation_weight,
        options.edge_samples,
        options.most_candidates,
    )


TEXTURE = Stage(
    name="texture",
    version=1,
    summary="Chooses a photograph for every triangle: a depth mesh of each camera, and an atlas.",
    options=TextureOptions,
    reads=(
        *("geometry_file", "surface", "surface_color", "samples", "sample_cloud"),
        *("photo_poses", "flash"),
        *("developed_photos", "unclipped_masks", "photo_masks"),
    ),
    writes=(
        *("texture_photos", "depth_maps", "depth_meshes", "texturing"),
        *("labelled_surface", "texture_atlas", "texture_pages"),
    ),
    needed=needed,
    run=run,
    libraries=(
        *("numpy", "scipy", "numba", "open3d", "pycolmap", "opencv-contrib-python-headless"),
        *("PyMaxflow", "colour-science"),
    ),
    estimate=estimate,
    knobs=(
        Knob("depth_map_px", (64, 128, 256, 512), quick=(64, 128), fixed={"held_out": 2}),
        Knob("flatness_px", (2.0, 1.0, 0.5, 0.0), quick=(), fixed={"held_out": 2}),
        Knob("most_candidates", (2, 4, 8, 16), quick=(), fixed={"held_out": 2}),
        Knob("edge_samples", (1, 2, 4), quick=(), fixed={"held_out": 2}),
        Knob("cycles", (0, 1, 2, 4), quick=(), fixed={"held_out": 2}),
    ),
)
