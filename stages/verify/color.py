"""What is to be said of the surface's colours, gathered from the project."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stages.verify.albedo import photographed_albedo
from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.transforms import Matrix4
from workbench.metrics import Metric
from workbench.pipeline.stage import Products

if TYPE_CHECKING:
    from workbench.color.blending_colors import Colored
    from workbench.color.blending_observations import Observations
    from workbench.color.flash_light import FlashLight
    from workbench.geometry.photo_camera import PhotoCamera
    from workbench.render.camera import UpAxis
    from workbench.verification.color_truth import AlbedoComparison
    from workbench.verification.report_content import PictureRow, Section

_SHOWN_SIDES = ("front", "back")


def color_chapter(
    products: Products,
    surface: TriangleMesh,
    truth: TriangleMesh | None,
    *,
    model_from_local: Matrix4 | None,
    up: UpAxis,
    front_deg: float,
    width_px: int,
) -> tuple[tuple[Section, ...], list[Metric]]:
    """The section on colour, where photographs coloured the surface, and errors where known.

    Parameters
    ----------
    truth : the simulated surface in the frame of the model, with all its vertices.
    model_from_local : 4×4 from the local frame of the simulation to the model's.
    up, front_deg, width_px : of the pictures, as in the rest of the report.
    """
    from workbench.color.blending_display import encoded_srgb
    from workbench.render.palette import UNKNOWN_COLOR
    from workbench.verification.color_pictures import albedo_row, difference_row, told_row
    from workbench.verification.color_sections import color_section
    from workbench.verification.model_pictures import FourSides

    told, flash = products.load_if_there("surface_color"), products.load_if_there("flash")
    if told is None or flash is None:
        return (), []
    n = len(surface.vertices)
    if len(told["color"]) != n:
        raise InputError(
            "the colours do not belong to the surface",
            expected=f"{n} vertices",
            found=f"{len(told['color'])}",
            fix="run the stages color and export again",
        )
    record, space = products.load("records", "color"), flash["space"]
    colors, provenance = told["color"], told["color_provenance"]
    options = record["options"]
    blends = _less_corrected(products, surface, flash, options)
    even, found = None, None
    # Of photographs by daylight colours keep the light there was: albedo is not their truth.
    if set(flash["gains"]) - set(flash["without_flash"]):
        if model_from_local is not None:
            names = tuple(flash["gains"])
            even = photographed_albedo(products, surface, model_from_local, names, options)
        found = _against_truth(products, surface, truth, told, space, blends, even)
    sides = FourSides.of(surface, up, width_px, front_deg)
    views = {side: sides.views[side] for side in _SHOWN_SIDES}
    shown = np.full((n, 3), UNKNOWN_COLOR, np.uint8)
    known = np.isfinite(colors).all(axis=1)
    shown[known] = encoded_srgb(colors[known], space)
    pictures = [albedo_row(views, shown), told_row(views, provenance, told["photos"])]
    same = _same_camera(products, surface, colors, flash, blends, found)
    pictures += [same] if same is not None else []
    differences = None
    if found is not None:
        ways = {"as taken": found.uncorrected, "as recovered": found.corrected}
        compared = {how: way.delta_e for how, way in ways.items() if way is not None}
        differences = difference_row(views, compared)
    section = color_section(surface, provenance, flash, record, pictures, found, differences)
    return (section,), [] if found is None else found.metrics()


@dataclass(frozen=True)
class _Photographs:
    """What photographs say in one way to correct them; iterated again and again."""

    products: Products
    names: tuple[str, ...]
    colored: Callable[[str, Observations], Colored]

    def __iter__(self) -> Iterator[Colored]:
        from workbench.color.blending_observations import Observations

        for name in self.names:
            seen = Observations.from_arrays(self.products.load("photo_observations", name))
            yield self.colored(name, seen)


def _less_corrected(
    products: Products,
    surface: TriangleMesh,
    flash: Mapping[str, Any],
    options: Mapping[str, Any],
) -> dict[str, NDArray[np.float64]]:
    """What the colours (n, 3) would be as taken, and with the distance alone taken out.

    Empty where no flash was taken out.
    """
    from workbench.color.blending import blended
    from workbench.color.blending_colors import corrected, uncorrected

    if flash["light"] is None:
        return {}
    light, gains = _by_distance_alone(flash["light"]), flash["gains"]
    unlit = set(flash["without_flash"])
    poses = products.load("photo_poses")["photos"]

    def as_taken(name: str, seen: Observations) -> Colored:
        return uncorrected(seen, gains[name] if name in unlit else 1.0)

    def by_distance(name: str, seen: Observations) -> Colored:
        if name in unlit:
            return uncorrected(seen, gains[name])
        seen = replace(seen, weights=seen.weights * products.load("photo_lighting", name)["lit"])
        pose = np.array(poses[name]["camera_from_world"])
        return corrected(seen, surface.vertices[seen.index], pose, light, gains[name])

    found = {}
    for how, way in (("as taken", as_taken), ("distance alone", by_distance)):
        photos = _Photographs(products, tuple(gains), way)
        blending = blended(
            photos, len(surface.vertices), options["robust"], options["least_weight"]
        )
        found[how] = blending.colors
    return found


def _by_distance_alone(told: Mapping[str, Any]) -> FlashLight:
    """The flash, with nothing but the fall of its light with the distance."""
    from workbench.color.flash_light import FlashLight

    position = np.array(told["position_in_camera_m"])
    return FlashLight(position, told["reference_distance_m"], epsilon=1.0)


def _against_truth(
    products: Products,
    surface: TriangleMesh,
    truth: TriangleMesh | None,
    told: Mapping[str, NDArray[Any]],
    space: Any,
    blends: Mapping[str, NDArray[np.float64]],
    even_light: NDArray[np.float64] | None,
) -> AlbedoComparison | None:
    from workbench.verification.color_truth import compared_albedo, true_albedo_of

    known = products.load_if_there("truth_surface_albedo")
    if truth is None or known is None:
        return None
    return compared_albedo(
        told["color"],
        told["color_provenance"],
        space,
        true_albedo_of(surface, truth, known["albedo"]),
        blends.get("as taken"),
        blends.get("distance alone"),
        even_light,
    )


def _same_camera(
    products: Products,
    surface: TriangleMesh,
    colors: NDArray[np.float32],
    flash: Mapping[str, Any],
    blends: Mapping[str, NDArray[np.float64]],
    found: AlbedoComparison | None,
) -> PictureRow | None:
    """A photograph beside the model as its camera sees it; None where no camera sees it."""
    from workbench.geometry.surface_rays import SurfaceRays
    from workbench.verification.color_pictures import ModelInPhoto, same_camera_row

    names = set(products.items("photo_observations")) & set(flash["gains"])
    lit = names - set(flash["without_flash"])
    # The one that shows most of the surface; of equals, the first.
    sizes = {
        name: len(products.load("photo_observations", name)["index"])
        for name in sorted(lit or names)
    }
    if not any(sizes.values()):
        return None
    name = max(sizes, key=lambda name: sizes[name])
    camera = _camera(products.load("photo_poses")["photos"][name])
    seen = ModelInPhoto.of(SurfaceRays(surface), camera)
    if seen is None:
        return None
    picture = products.load("developed_photos", name).values
    photograph = seen.of_photo(picture, (camera.width, camera.height))
    captions = {"as taken": "Blended as taken", "distance alone": "Distance taken out"}
    shown: list[tuple[str, NDArray[Any]]] = [
        (captions[how], blend) for how, blend in blends.items()
    ]
    shown.append(("Distance, incidence and all" if blends else "As blended", colors))
    if found is not None:
        shown.append(("True albedo", found.truth))
    return same_camera_row(name, seen, photograph, shown, flash["space"])


def _camera(pose: Mapping[str, Any]) -> PhotoCamera:
    from workbench.geometry.photo_camera import PhotoCamera

    width, height = pose["size"]
    turned = np.array(pose["camera_from_world"])
    return PhotoCamera(pose["model"], width, height, tuple(pose["params"]), turned)
