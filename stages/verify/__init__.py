"""Prove how good the model is: the report for people, its numbers, and the provenance file."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from stages.verify.color import color_chapter
from stages.verify.development import development_chapter
from stages.verify.errors import ERRORS
from stages.verify.frames import OBJECT, compared_poses, true_hits
from stages.verify.made_tables import (
    fault_chapter,
    page_chapter,
    stability_chapter,
    sweep_chapter,
)
from stages.verify.masks import masks_chapter
from stages.verify.options import VerifyOptions
from stages.verify.orientation import orientation_chapter
from stages.verify.photographed import depths_chapter, photographed_truth
from stages.verify.photographs import photographs_chapter
from stages.verify.surfels import cell_chapter, surfel_chapter
from stages.verify.texturing import PICTURE_CACHE_BYTES, texture_chapter
from stages.verify.voxels import voxel_chapter
from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh, edge_census
from workbench.geometry.transforms import Matrix4, apply, rigid
from workbench.metrics import Metric
from workbench.pipeline.records import utc_now
from workbench.pipeline.shape_sources import shape_sources
from workbench.pipeline.stage import Estimate, Job, Need, Stage, StageResult
from workbench.project.photo_scale import scale_is_known
from workbench.project.project import NO_SURFACE, Scene

if TYPE_CHECKING:
    from workbench.geometry.samples import Samples
    from workbench.verification.coverage_sections import FilledByPhotographs
    from workbench.verification.report_content import Section
    from workbench.verification.truth import TruthComparison

_CITATIONS = (
    "Jaspe Villanueva, A. (2018). Scalable exploration of 3D massive models. PhD thesis, ch. 3.",
    "Bettio, F. et al. (2015). Mont’e Scan: effective shape and color digitization of cluttered "
    "3D artworks. ACM J. Computing and Cultural Heritage 8(1).",
    "Kazhdan, M. and Hoppe, H. (2013). Screened Poisson surface reconstruction. ACM TOG 32(3).",
)
_REPRODUCIBILITY = (
    "The same inputs, settings and library versions give the same files, byte for byte, whatever "
    "the number of workers. The Poisson solver runs on one thread for that: on two threads it "
    "takes about 0.55 of the time and gives other bytes in every run. The records in work/ "
    "hold the hash of every input and product."
)

# More samples change no figure that is shown.
_SAMPLES_COMPARED = 2_000_000


def needed(scene: Scene, options: VerifyOptions) -> Need:
    if not scene.has_surface:
        return Need(False, f"no surface to verify: {NO_SURFACE}")
    against = " against the known truth" if scene.truth else ""
    against = against or (" against a reference surface" if scene.reference else "")
    return Need(True, f"a report to write{against}")


def estimate(scene: Scene, options: VerifyOptions) -> Estimate:
    # The surface in its colours, and three blends of them, where there are photographs; one of 24
    # million pixels takes some 3 GiB of buffers while its colours are checked.
    per_byte, photos = (25, 3 * 2**30 + PICTURE_CACHE_BYTES) if scene.photos else (10, 0)
    return Estimate(per_byte * scene.shape_bytes + photos + 2**29, 2**26)


def run(job: Job[VerifyOptions]) -> StageResult:
    from workbench.verification.quantities import without_scale

    known = scale_is_known(job.products.load_if_there("photo_poses"))
    with nullcontext() if known else without_scale():
        return _verified(job)


def _verified(job: Job[VerifyOptions]) -> StageResult:
    from workbench.verification.provenance import provenance_document
    from workbench.verification.report import report_html
    from workbench.verification.scan_report import build_scan_report

    products, options = job.products, job.options
    surface = _surface(job)
    metrics, warnings = _exported(job)
    known = _known(job, surface)
    metrics += known.metrics
    records = [products.load("records", item) for item in _in_order(job)]
    records += [{"stage": s, "state": "left out", "reason": r} for s, r in job.left_out.items()]
    own = {"stage": "verify", "metrics": [m.as_dict() for m in metrics], "warnings": warnings}
    photographs, unread = photographs_chapter(products, records)
    masks, found = masks_chapter(job.products, job.scene.truth)
    metrics += found
    cameras, found = orientation_chapter(products, surface, known.model_from_local)
    metrics += found
    depths = depths_chapter(products)
    colors, found = _colors(job, surface, known)
    metrics += found
    with job.progress.step("texture"):
        texture, found = texture_chapter(
            products, surface, known.model_from_local is not None, options.texture_sizes_px
        )
    metrics += found
    with job.progress.step("voxels"):
        voxels, found = voxel_chapter(products, surface, up=options.up, front_deg=options.front_deg)
    metrics += found
    with job.progress.step("surfels and coded points"):
        surfels, found = surfel_chapter(products, surface)
        cells, told = cell_chapter(products)
    metrics += found + told
    shown, found = page_chapter(products)
    metrics += found
    sweep, found = sweep_chapter(products)
    metrics += found
    stability, found = stability_chapter(products)
    faults, told = fault_chapter(products)
    metrics += found + told
    warnings += unread
    with job.progress.step("pictures and plots"):
        content = build_scan_report(
            [*records, own],
            surface,
            project_name=products.project_name,
            date=utc_now(),
            up=options.up,
            front_deg=options.front_deg,
            **_measured(job, surface),
            truth=known.surface,
            comparison=known.comparison,
            reference_name=known.name,
            further_sections=(
                *development_chapter(products),
                *masks,
                *cameras,
                *depths,
                *colors,
                *texture,
                *voxels,
                *surfels,
                *cells,
                *photographs,
                *shown,
                *sweep,
                *stability,
                *faults,
            ),
            citations=_CITATIONS,
            reproducibility=_REPRODUCIBILITY,
            picture_width_px=options.picture_width_px,
        )
        with products.writing("report_html") as page:
            page.write_text(report_html(content), encoding="utf-8")
        products.save("report_json", content.as_dict())
    products.save("provenance", provenance_document(products.project_name, records))
    return StageResult(tuple(metrics), tuple(warnings))


def _surface(job: Job[VerifyOptions]) -> TriangleMesh:
    """The surface as made here, else as exported from elsewhere."""
    from workbench.formats.surface_files import read_surface

    made = job.products.load_if_there("surface")
    if made is not None:
        return cast(TriangleMesh, made)
    path = job.products.load_if_there("surface_ply")
    if path is None:
        raise InputError("There is no surface to verify", fix="workbench export writes it")
    return read_surface(Path(path))


def _in_order(job: Job[VerifyOptions]) -> list[str]:
    """Stages with records of this scene, by the time they ended."""
    items = [i for i in job.products.items("records") if i != "verify" and i not in job.left_out]
    return sorted(items, key=lambda i: job.products.load("records", i).get("ended", ""))


def _exported(job: Job[VerifyOptions]) -> tuple[list[Metric], list[str]]:
    """What the exported file proves by itself, read back as any other tool would."""
    from workbench.formats.surface_files import read_surface

    path = job.products.load_if_there("surface_ply")
    if path is None:
        return [], ["no exported PLY to check; run export"]
    census = edge_census(read_surface(Path(path)).triangles)
    metrics = [
        Metric("exported_watertight", census.watertight, "",
               "Whether every edge of exports/surface.ply has exactly two faces."),
        Metric("exported_open_edges", census.boundary_edges, "", "Edges with one face."),
        Metric("exported_nonmanifold_edges", census.nonmanifold_edges, "",
               "Edges with more than two faces."),
    ]  # fmt: skip
    return metrics, []


def _measured(job: Job[VerifyOptions], surface: TriangleMesh) -> dict[str, Any]:
    """Residuals, overlap and samples per scan, as far as they are there."""
    from workbench.cloud.sample_source import opened_samples
    from workbench.verification.distances import distance_to_surface

    products = job.products
    registration = products.load_if_there("registration")
    found: dict[str, Any] = {"residuals": {}, "of_photographs": job.scene.shape_from_photos}
    # Their order is that of the overlap matrix and of the samples' owners.
    sources = shape_sources(products)
    names = [s.name for s in sources if s.maps == sources[0].maps]
    if registration is not None and len(registration["before_m"]):
        found["residuals"] |= {k: registration[k] for k in ("before_m", "after_m")}
        found["overlap"] = (names, registration["overlap"])
    held, cloud = (products.load_if_there(name) for name in ("samples", "sample_cloud"))
    if held is None and cloud is None:
        return found
    with opened_samples(held, cloud) as source:
        some = source.thinned(_SAMPLES_COMPARED)
        apart = distance_to_surface(some.points, surface).distance_m
        found["residuals"]["samples_to_surface_m"] = apart
        count = np.zeros(len(sources), np.int64)
        for owners in source.owners():
            count += np.bincount(owners, minlength=len(sources))
        if len(names) < len(sources):
            found["filled"] = _filled(some, surface, count, len(names))
    found["samples_per_scan"] = dict(zip(names, count.tolist(), strict=False))
    return found


def _filled(
    some: Samples, surface: TriangleMesh, count: NDArray[np.int64], scans: int
) -> FilledByPhotographs:
    """What photographs added to so many scans, by some samples and the ``count`` by owner."""
    from workbench.geometry.neighbours import nearest, tree_of
    from workbench.verification.coverage_sections import FilledByPhotographs

    _, index = nearest(tree_of(some.points), surface.vertices)
    of_photographs = count[scans:]
    return FilledByPhotographs(
        int(of_photographs.sum()), int((of_photographs > 0).sum()), some.scan[index] >= scans
    )


@dataclass(frozen=True)
class _Known:
    """What is known of the true surface, in the frame of the model.

    Attributes
    ----------
    surface : to compare with; None where nothing is known.
    comparison : against simulated truth.
    name : what the surface is called.
    metrics : of the comparison.
    model_from_local : 4×4, from the simulation's own local frame to the model's.
    """

    surface: TriangleMesh | None = None
    comparison: TruthComparison | None = None
    name: str = ""
    metrics: tuple[Metric, ...] = ()
    model_from_local: Matrix4 | None = None


def _known(job: Job[VerifyOptions], surface: TriangleMesh) -> _Known:
    from workbench.formats.surface_files import read_surface
    from workbench.verification.reference import reference_metrics
    from workbench.verification.truth import compare_to_truth, infill_flagging

    products, inventory = job.products, job.products.load_if_there("scan_inventory")
    origin = np.array(inventory["origin_m"]) if inventory else np.zeros(3)
    if job.scene.truth and inventory:
        poses = compared_poses(products, inventory)
        arrays = products.load("truth_surface")
        # The truth's own local frame, brought around the project origin and then into place.
        model_from_local = poses.estimate_from_truth @ rigid(np.eye(3), arrays["origin"] - origin)
        triangles = arrays["triangles"]
        # What was masked away is no part of the model, so no part of what it is held against.
        masked = bool(products.items("scan_masks"))
        if masked:
            triangles = triangles[arrays["material"][triangles[:, 0]] == OBJECT]
        truth = TriangleMesh(apply(model_from_local, arrays["vertices"]), triangles)
        hits = apply(model_from_local, true_hits(products, masked))
        spacing = products.load("simulation")["nominal_sample_spacing_m"]
        compared = compare_to_truth(surface, truth, samples=job.options.samples)
        flagged = infill_flagging(surface, truth, hits, spacing, samples=job.options.samples)
        metrics = (*poses.metrics(), *compared.metrics(), *flagged.metrics())
        return _Known(truth, compared, "simulated truth", metrics, model_from_local)
    if job.scene.truth and job.scene.shape_from_photos:
        found = photographed_truth(products, surface, job.options.samples)
        if found:
            return _Known(
                found.truth,
                found.comparison,
                "simulated truth",
                found.metrics,
                found.model_from_local,
            )
    paths = products.input_paths("reference_file")
    if not paths:
        return _Known()
    reference = read_surface(paths[0])
    reference = replace(reference, vertices=reference.vertices - origin)
    return _Known(reference, None, paths[0].name, tuple(reference_metrics(surface, reference)))


def _colors(
    job: Job[VerifyOptions], surface: TriangleMesh, known: _Known
) -> tuple[tuple[Section, ...], list[Metric]]:
    options = job.options
    simulated = known.surface if known.model_from_local is not None else None
    return color_chapter(
        job.products,
        surface,
        simulated,
        model_from_local=known.model_from_local,
        up=options.up,
        front_deg=options.front_deg,
        width_px=options.picture_width_px,
    )


VERIFY = Stage[Any](
    name="verify",
    version=5,
    summary="The report for people, its numbers as JSON, and W3C PROV of the whole project.",
    options=VerifyOptions,
    reads=(
        "scan_inventory",
        "scan_poses",
        "registration",
        "samples",
        "sample_cloud",
        "surface",
        "surface_ply",
        "voxel_lod",
        "voxel_graph",
        "surfels",
        "point_cubes",
        "page_measures",
        "stability_table",
        "fault_table",
        "sweep_points",
        "reference_file",
        "photo_files",
        "photo_inventory",
        "color_calibration",
        "developed_photos",
        "photo_poses",
        "oriented_cameras",
        "oriented_images",
        "photo_observations",
        "photo_lighting",
        "flash",
        "surface_color",
        "texturing",
        "texture_photos",
        "depth_maps",
        "depth_meshes",
        "labelled_surface",
        "range_maps",
        "photo_range_inventory",
        "photo_range_maps",
        "corrected_masks",
        "automatic_scan_masks",
        "automatic_photo_masks",
        "scan_masks",
        "photo_masks",
        "records",
        "truth_surface",
        "truth_poses",
        "truth_samples",
        "truth_scan_masks",
        "simulation",
        "truth_cameras",
        "truth_albedo",
        "truth_surface_albedo",
        "truth_object",
        "truth_support",
        "truth_shadow",
    ),
    writes=("report_html", "report_json", "provenance"),
    needed=needed,
    run=run,
    libraries=("numpy", "scipy", "open3d", "matplotlib", "rawpy", "colour-science"),
    estimate=estimate,
    reads_truth=True,
    errors=ERRORS,
)
