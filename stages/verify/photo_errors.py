"""How wrong the products made of photographs are, for sweeps of knobs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stages.verify.frames import compared_poses
from stages.verify.masks import against_corrections, masked_samples, photo_errors
from stages.verify.texturing import PICTURE_CACHE_BYTES, held_out_views
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.transforms import apply, rigid
from workbench.pipeline.knobs import MeasuredError, NotMeasured
from workbench.pipeline.stage import Products
from workbench.project.project import Scene
from workbench.verification.photo_sections import evenly_chosen

if TYPE_CHECKING:
    from workbench.color.blending_colors import Colored
    from workbench.masking.evaluation import MaskingErrors

_PHOTOGRAPHS = 6
_LEFT_OUT = 3
# What is slower over the picture than so many pixels is light and shape, not the mosaic.
_SLOW_PX = 4.0
# Of the albedo, 16 bits: below, the logarithm is of noise.
_DARKEST, _FULL = 0.02, 65535.0
# Logarithms that are further apart are of highlights and edges of shadows.
_FAR = 0.5


def develop_error(products: Products, scene: Scene) -> MeasuredError | NotMeasured:
    """How far developed pixels are from their paint, light and shape taken out."""
    known = set(products.items("truth_albedo")) & set(products.items("developed_photos"))
    if known:
        chosen = evenly_chosen(sorted(known), _PHOTOGRAPHS)
        apart = np.concatenate([_pixels_apart(products, name) for name in chosen])
        told = (
            "mean difference of single pixels from the true albedo, what is slower than "
            f"{_SLOW_PX:.0f} pixels taken out"
        )
        return MeasuredError(100.0 * float(apart.mean()), "%", told)
    said = {m["name"]: m["value"] for m in products.load("records", "develop")["metrics"]}
    left_out = said.get("chart_left_out_delta_e2000")
    if left_out is None:
        return NotMeasured("neither a truth nor a chart to leave patches out of")
    told = "mean difference of each patch of the chart from a matrix made without it"
    return MeasuredError(float(left_out), "ΔE2000", told)


def _pixels_apart(products: Products, name: str) -> NDArray[np.float64]:
    """Of one photograph, (k,) absolute differences of logarithms, slow ones taken out."""
    import cv2

    truth = cv2.imread(str(products.load("truth_albedo", name)), cv2.IMREAD_UNCHANGED)
    albedo = np.asarray(truth)[..., ::-1].astype(np.float64) / _FULL
    size = (albedo.shape[1], albedo.shape[0])
    picture = products.load("developed_photos", name).values
    if picture.shape[1::-1] != size:
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR)
    shown = np.asarray(cv2.imread(str(products.load("truth_object", name)), 0)) == 255
    shown &= np.asarray(cv2.imread(str(products.load("truth_shadow", name)), 0)) < 128
    shown &= (albedo > _DARKEST).all(axis=2)
    ratio = np.log(np.maximum(picture.astype(np.float64), 1e-6)) - np.log(
        np.maximum(albedo, _DARKEST)
    )
    weight = shown.astype(np.float64)
    slow = cv2.GaussianBlur(ratio * weight[..., None], (0, 0), _SLOW_PX)
    slow /= np.maximum(cv2.GaussianBlur(weight, (0, 0), _SLOW_PX), 1e-9)[..., None]
    apart = np.abs(ratio - slow)[shown].mean(axis=1)
    return np.asarray(apart[apart < _FAR], np.float64)


def mask_error(products: Products, scene: Scene) -> MeasuredError | NotMeasured:
    """Clutter kept and object lost for good, per clutter; photographs' masks, else scans'."""
    photos = products.items("photo_masks")
    if photos and set(products.items("truth_object")) & set(photos):
        wrong = photo_errors(products, list(photos)).automatic
        return MeasuredError(_wrong_percent(wrong), "%", _mask_words("photographs", "the truth"))
    if scene.truth and products.items("scan_masks"):
        from workbench.verification.mask_errors import checked_scan_masks

        radius = max(1e-3, products.load("simulation")["nominal_sample_spacing_m"])
        known = set(products.items("truth_scan_masks"))
        samples = [masked_samples(products, n) for n in products.items("scan_masks") if n in known]
        wrong = checked_scan_masks(samples, radius).automatic
        return MeasuredError(_wrong_percent(wrong), "%", _mask_words("scans", "the truth"))
    for kind, plural in (("photo", "photographs"), ("scan", "scans")):
        checked, against = against_corrections(products, kind)
        if checked is not None:
            words = _mask_words(plural, against)
            return MeasuredError(_wrong_percent(checked.automatic), "%", words)
    return NotMeasured("neither a truth nor masks corrected by hand; correct a few")


def _wrong_percent(found: MaskingErrors) -> float:
    lost = found.true_false_negative_percent
    return found.false_positive_percent + (found.false_negative_percent if lost is None else lost)


def _mask_words(plural: str, against: str) -> str:
    return (
        f"clutter that masks of {plural} keep and object that none keeps, per clutter, against "
        f"{against}"
    )


def color_error(products: Products, scene: Scene) -> MeasuredError | NotMeasured:
    """Of the surface's colours; without a truth of photographs left out of the blend."""
    from workbench.verification.color_truth import color_difference, true_albedo_of

    surface, told = products.load_if_there("surface"), products.load("surface_color")
    flash = products.load("flash")
    known = products.load_if_there("truth_surface_albedo")
    lit = set(flash["gains"]) - set(flash["without_flash"])
    if surface is None:
        return NotMeasured("the surface was made elsewhere")
    if known is not None and products.is_there("scan_inventory") and lit:
        truth = _true_surface(products)
        albedo = true_albedo_of(surface, truth, known["albedo"])
        told_there = np.isfinite(told["color"]).all(axis=1)
        found = color_difference(told["color"], flash["space"], albedo, told_there)
        words = "mean difference of vertices, spread colours included, from the paint around them"
        return MeasuredError(found.mean, "ΔE2000", words)
    return _left_out_photographs(products, surface, flash)


def _true_surface(products: Products) -> TriangleMesh:
    """The simulated surface in the frame of the model."""
    inventory, arrays = products.load("scan_inventory"), products.load("truth_surface")
    origin = np.array(inventory["origin_m"])
    common = compared_poses(products, inventory).estimate_from_truth
    moved = common @ rigid(np.eye(3), arrays["origin"] - origin)
    return TriangleMesh(apply(moved, arrays["vertices"]), arrays["triangles"])


@dataclass(frozen=True)
class _Corrected:
    """What photographs say, free of their flash; iterated again and again."""

    products: Products
    points: NDArray[np.float64]
    flash: Mapping[str, Any]
    poses: Mapping[str, Any]
    names: tuple[str, ...]

    def __iter__(self) -> Iterator[Colored]:
        return (self.of(name) for name in self.names)

    def of(self, name: str) -> Colored:
        """One photograph."""
        from workbench.color.blending_colors import corrected, uncorrected
        from workbench.color.blending_observations import Observations
        from workbench.color.flash_light import FlashLight

        seen = Observations.from_arrays(self.products.load("photo_observations", name))
        gain, light = self.flash["gains"][name], self.flash["light"]
        if light is None or name in self.flash["without_flash"]:
            return uncorrected(seen, gain)
        lit = self.products.load("photo_lighting", name)["lit"]
        seen = replace(seen, weights=seen.weights * lit)
        pose = np.array(self.poses[name]["camera_from_world"])
        points = self.points[seen.index]
        return corrected(seen, points, pose, FlashLight.from_document(light), gain)


def _left_out_photographs(
    products: Products, surface: TriangleMesh, flash: Mapping[str, Any]
) -> MeasuredError | NotMeasured:
    """What photographs tell of the surface against a blend of all others."""
    from workbench.color.blending import blended
    from workbench.verification.color_truth import lab_d65

    names = tuple(sorted(set(flash["gains"]) & set(products.items("photo_observations"))))
    if len(names) < _LEFT_OUT:
        return NotMeasured("too few photographs to leave one out")
    from workbench.color.spaces import delta_e2000

    options = products.load("records", "color")["options"]
    photos = _Corrected(
        products, surface.vertices, flash, products.load("photo_poses")["photos"], names
    )
    apart, weights = [], []
    for name in evenly_chosen(names, _LEFT_OUT):
        rest = replace(photos, names=tuple(other for other in names if other != name))
        blend = blended(rest, len(surface.vertices), options["robust"], options["least_weight"])
        own = photos.of(name)
        expected = blend.colors[own.index]
        both = np.isfinite(expected).all(axis=1) & (own.weights > 0.0)
        labs = [lab_d65(c[both], flash["space"]) for c in (own.colors, expected)]
        apart.append(delta_e2000(*labs))
        weights.append(own.weights[both])
    total = np.concatenate(weights)
    if not total.sum() > 0.0:
        return NotMeasured("the photographs share nothing of the surface")
    told = f"mean difference of {_LEFT_OUT} photographs from a blend of the others, by weight"
    return MeasuredError(float(np.average(np.concatenate(apart), weights=total)), "ΔE2000", told)


def texture_error(products: Products, scene: Scene) -> MeasuredError | NotMeasured:
    """Renderings in the place of photographs that textured nothing."""
    from workbench.pipeline.depth_scene import depth_scene
    from workbench.pipeline.stitched_pictures import colored_surface
    from workbench.texturing.picture_cache import PictureCache

    told, surface = products.load("texturing"), products.load_if_there("surface")
    if surface is None or not told["held_out"] or not products.items("depth_meshes"):
        return NotMeasured("no photograph was held out, or no depth meshes were made")
    stitched = depth_scene(products, colored_surface(products, surface))
    pictures = PictureCache(stitched.picture, PICTURE_CACHE_BYTES).get
    views = held_out_views(products, stitched, {}, pictures, told, scene.truth)
    if not views:
        return NotMeasured("what the photographs held out show is nowhere known")
    # The mean of squares, for PSNR is its logarithm.
    squares = [10.0 ** (-view.quality["stitched"].psnr / 10.0) for view in views]
    words = f"RMS difference of renderings from {views[0].told}, where photographs were held out"
    return MeasuredError(255.0 * float(np.sqrt(np.mean(squares))), "of 255", words)
