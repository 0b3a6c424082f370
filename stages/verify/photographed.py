"""A surface made of photographs alone against the simulated truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stages.verify.frames import OBJECT
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.neighbours import k_nearest, tree_of
from workbench.geometry.similarity import NoSimilarity, Similarity, best_similarity
from workbench.geometry.transforms import Matrix4, best_rigid, rigid
from workbench.metrics import Metric
from workbench.pipeline.knobs import NotMeasured
from workbench.pipeline.stage import Products
from workbench.project.photo_scale import scale_is_known

if TYPE_CHECKING:
    from workbench.geometry.photo_camera import PhotoCamera
    from workbench.verification.report_content import Section
    from workbench.verification.truth import TruthComparison

# Pixels that are asked for what they show, on either side; and shares of the truth's diagonal.
_STEP_PX = 4
_SHOWN = 4
_THRESHOLDS = (1e-3, 2e-3)


@dataclass(frozen=True)
class PhotographedTruth:
    """The truth in the frame of the model, and the model held against it.

    Attributes
    ----------
    truth : of the object alone.
    comparison : in metres, whatever the model's unit is.
    metrics : of the comparison.
    model_from_local : 4×4 rigid, from the simulation's own local frame; None where the model
        has no scale.
    """

    truth: TriangleMesh
    comparison: TruthComparison
    metrics: tuple[Metric, ...]
    model_from_local: Matrix4 | None


def depths_chapter(products: Products) -> tuple[Section, ...]:
    """The section on depth maps, where photographs alone tell the shape."""
    from workbench.verification.depth_sections import ShownDepths, depth_section
    from workbench.verification.photo_sections import evenly_chosen

    inventory = products.load_if_there("photo_range_inventory")
    if inventory is None:
        return ()
    names = [one["name"] for one in inventory["scans"] if one["samples"]]
    shown = [
        ShownDepths(name, products.load("photo_range_maps", name))
        for name in evenly_chosen(names, _SHOWN)
    ]
    return (depth_section(inventory, shown),)


def photographed_places(products: Products) -> NDArray[np.float64] | NotMeasured:
    """True places (n, 3) that two photographs show, in the frame of a model with a scale."""
    if products.load_if_there("truth_cameras") is None:
        return NotMeasured("no true cameras to bring the truth to the photographs by")
    known, found = _cameras(products, "truth_cameras"), _cameras(products, "oriented_images")
    scaled = scale_is_known(products.load("photo_poses"))
    brought = _brought(known, found, scaled) if scaled else None
    if brought is None:
        return NotMeasured("the photographs have no scale, or too few of them have a camera")
    truth = _true_object(products)
    return brought.apply(_photographed(products, truth, known))


def photographed_truth(
    products: Products, surface: TriangleMesh, samples: int
) -> PhotographedTruth | None:
    """Compare, once the cameras' places have brought the truth to the model.

    Lengths are in the model's unit; None where no three cameras tell the place.
    """
    from workbench.verification.truth import compare_to_truth

    known, found = _cameras(products, "truth_cameras"), _cameras(products, "oriented_images")
    scaled = scale_is_known(products.load("photo_poses"))
    model_from_world = _brought(known, found, scaled)
    if model_from_world is None:
        return None
    in_world = _true_object(products)
    truth = replace(in_world, vertices=model_from_world.apply(in_world.vertices))
    comparison = compare_to_truth(surface, truth, samples=samples)
    seen = model_from_world.apply(_photographed(products, in_world, known))
    origin = products.load("truth_surface", only=["origin"])["origin"]
    matrix = model_from_world.matrix() @ rigid(np.eye(3), origin)
    metrics = (*comparison.metrics(), *_completeness(surface, seen))
    return PhotographedTruth(truth, comparison, metrics, matrix if scaled else None)


def _cameras(products: Products, artefact: str) -> dict[str, PhotoCamera]:
    """The oriented photographs of the COLMAP model that a file is of."""
    from workbench.formats.colmap import read_colmap_text

    return read_colmap_text(Path(products.load(artefact)).parent).photo_cameras()


def _true_object(products: Products) -> TriangleMesh:
    """The simulated object without its support, in the world of the truth."""
    arrays = products.load("truth_surface")
    of_object = arrays["material"][arrays["triangles"][:, 0]] == OBJECT
    return TriangleMesh(arrays["vertices"] + arrays["origin"], arrays["triangles"][of_object])


def _brought(
    known: Mapping[str, PhotoCamera], found: Mapping[str, PhotoCamera], scaled: bool
) -> Similarity | None:
    """What brings the true cameras to the model's; with scale 1 where the model has its own."""
    names = sorted(set(known) & set(found))
    true, told = (np.array([of[name].center for name in names]) for of in (known, found))
    similarity = best_similarity(true, told)
    if isinstance(similarity, NoSimilarity):
        return None
    if not scaled:
        return similarity
    motion = best_rigid(true, told)
    return Similarity(1.0, motion[:3, :3], motion[:3, 3])


def _photographed(
    products: Products, truth: TriangleMesh, cameras: Mapping[str, PhotoCamera]
) -> NDArray[np.float64]:
    """Places (n, 3) of the truth that two photographs or more show, one to some pixels."""
    from workbench.geometry.surface_rays import SurfaceRays

    rays = SurfaceRays(truth)
    places = {}
    for name in products.items("truth_object"):
        if name in cameras:
            mask: Any = cv2.imread(str(products.load("truth_object", name)), cv2.IMREAD_GRAYSCALE)
            seen = rays.seen_by(cameras[name], _STEP_PX)
            # The middle pixels of the steps, of which the last may be cut short.
            rows, columns = (
                np.minimum(np.arange(0, side, _STEP_PX) + _STEP_PX // 2, side - 1)
                for side in mask.shape
            )
            shown = mask[np.ix_(rows, columns)].ravel() > 127
            places[name] = seen.points[seen.found & shown]
    parts = list(places.values())
    counts = [np.zeros(len(part), np.int64) for part in parts]
    # A place that one photograph shows is shown by another where that one has one near by.
    trees = [tree_of(part) for part in parts]
    apart = [float(np.median(k_nearest(tree, tree.data, 2)[0][:, 1])) for tree in trees]
    for i, part in enumerate(parts):
        for j, tree in enumerate(trees):
            if i != j:
                counts[i] += tree.query(part, distance_upper_bound=1.5 * apart[j])[0] < np.inf
    return np.concatenate([p[c >= 1] for p, c in zip(parts, counts, strict=True)])


def _completeness(surface: TriangleMesh, seen: NDArray[np.float64]) -> list[Metric]:
    """How much of what two photographs show is near the measured surface."""
    from workbench.verification.distances import distance_to_surface
    from workbench.verification.quantities import round_up_125, shown_length
    from workbench.verification.truth import measured_vertices

    measured = np.asarray(measured_vertices(surface)[surface.triangles].all(axis=1))
    distance = distance_to_surface(seen, surface.keep_triangles(measured)).distance_m
    diagonal = float(np.linalg.norm(np.ptp(seen, axis=0)))
    found = []
    for limit in (round_up_125(share * diagonal) for share in _THRESHOLDS):
        found.append(
            Metric(
                f"photographed_within_{limit * 1e6:.0f}um",
                100.0 * float((distance <= limit).mean()),
                "%",
                "Share of what two photographs or more show that has measured surface within "
                f"{shown_length(limit)}.",
            )
        )
    return found
