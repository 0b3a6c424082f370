"""The report on a model made from range scans, or from the depth maps of photographs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workbench.geometry.mesh import TriangleMesh, edge_census
from workbench.render.camera import UpAxis
from workbench.verification import record_sections
from workbench.verification.coverage_sections import (
    FilledByPhotographs,
    Overlap,
    coverage_section,
    measured_share,
    origins_of,
)
from workbench.verification.distance_sections import fit_section, truth_section
from workbench.verification.distances import (
    distance_to_surface,
    signed_distances_m,
    vertex_areas,
)
from workbench.verification.model_pictures import FourSides
from workbench.verification.quantities import (
    has_scale,
    length_unit,
    shown_length,
    shown_number,
    shown_percent,
    shown_unit,
)
from workbench.verification.report_content import (
    Block,
    Card,
    Cards,
    Paragraph,
    ReportContent,
    Section,
    TextList,
)
from workbench.verification.truth import TruthComparison, compare_to_truth, measured_vertices


def build_scan_report(
    records: Sequence[Mapping[str, Any]],
    surface: TriangleMesh,
    *,
    project_name: str,
    date: str,
    up: UpAxis = "z",
    front_deg: float = 0.0,
    residuals: Mapping[str, ArrayLike] | None = None,
    overlap: Overlap | None = None,
    samples_per_scan: Mapping[str, int] | None = None,
    of_photographs: bool = False,
    filled: FilledByPhotographs | None = None,
    truth: TriangleMesh | None = None,
    comparison: TruthComparison | None = None,
    reference_name: str = "known truth",
    citations: Sequence[str] = (),
    reproducibility: str = "",
    further_sections: Sequence[Section] = (),
    picture_width_px: int = 460,
) -> ReportContent:
    """All a report on a scanned model says.

    What is not there — registration of a single scan, a truth — is left out, and a
    sentence says so.

    Parameters
    ----------
    records
        of the stages, as their record files hold them.
    surface
        the model in project-local metres. Vertex attributes used where present:
        ``provenance`` (n,) uint8, 0 measured, 1 infilled; ``distance_to_samples_m`` (n,);
        ``normal`` (n, 3); ``color`` (n, 3) uint8.
    project_name
        as the user wrote it.
    date
        of the run, ISO 8601.
    up
        the axis that is vertical.
    front_deg
        the azimuth the front is seen from.
    residuals
        name → (k,) distances in metres; ``before_m`` and ``after_m`` are those
        between overlapping scans before and after registration, ``samples_to_surface_m``
        those of the samples from the surface.
    overlap
        scan names and (n, n) shares of the row's scan that the column's scan saw too.
    samples_per_scan
        scan name → number of samples used.
    of_photographs
        whether what is called scans are depth maps of photographs.
    filled
        what photographs added where scans have nothing.
    truth
        known true surface in the frame of ``surface``.
    comparison
        with that truth, where it was made already.
    reference_name
        what the truth is, e.g. ``simulated statue``.
    citations
        works to cite, one text each.
    reproducibility
        a statement on how the result can be had again.
    further_sections
        of other stages; they stand after the truth section.
    picture_width_px
        of each of the four views; the cover is half as wide again.
    """
    residuals = residuals or {}
    if truth is not None and comparison is None:
        comparison = compare_to_truth(surface, truth)
    sides = FourSides.of(surface, up, picture_width_px, front_deg)
    metrics = record_sections.stage_metrics(records)
    sections = [
        _summary_section(surface, residuals, comparison, reference_name, records),
        _model_section(surface, sides, truth, reference_name, filled),
        fit_section(residuals, samples_per_scan, of_photographs),
        coverage_section(surface, overlap, samples_per_scan, of_photographs, filled),
        truth_section(comparison, reference_name),
        *further_sections,
        record_sections.warnings_section(records),
        record_sections.run_section(records),
        record_sections.metrics_section(metrics),
        record_sections.settings_section(records),
        record_sections.inputs_section(records),
    ]
    if reproducibility or citations:
        sections.append(_citation_section(citations, reproducibility))
    return ReportContent(
        title="Verification report",
        project_name=project_name,
        date=date,
        lead=_lead(surface, samples_per_scan, of_photographs, filled),
        sections=tuple(sections),
        metrics=metrics,
        cover=sides.cover(),
    )


def _lead(
    surface: TriangleMesh,
    samples_per_scan: Mapping[str, int] | None,
    of_photographs: bool,
    filled: FilledByPhotographs | None,
) -> str:
    made_of = ""
    if samples_per_scan:
        scans = len(samples_per_scan)
        total = shown_number(sum(int(count) for count in samples_per_scan.values()))
        origin = f"{scans} range scans, joined in" if scans > 1 else "one range scan, made into"
        if of_photographs:
            origin = f"{scans} photographs, joined in"
        made_of = f"{total} samples of {origin} "
        if filled is not None:
            made_of = (
                f"{total} samples of {scans} range scans, and {shown_number(filled.samples)} of "
                f"{filled.photographs} photographs where the scans have none, joined in "
            )
    triangles = shown_number(len(surface.triangles))
    text = f"{made_of}a surface of {triangles} triangles."
    return text[0].upper() + text[1:]


def _summary_section(
    surface: TriangleMesh,
    residuals: Mapping[str, ArrayLike],
    comparison: TruthComparison | None,
    reference_name: str,
    records: Sequence[Mapping[str, Any]],
) -> Section:
    cards = [_watertight_card(surface), _measured_card(surface)]
    fit = _sample_distances(surface, residuals)
    if len(fit):
        median = float(np.median(np.abs(fit)))
        cards.append(
            Card(
                "Typical deviation",
                shown_length(median, digits=2),
                "Half of the samples lie this close to the surface or closer."
                if "samples_to_surface_m" in residuals
                else "Half of the measured surface lies this close to a sample or closer.",
                number=median,
                unit=shown_unit("m"),
            )
        )
    if "after_m" in residuals:
        median = float(np.median(np.abs(np.asarray(residuals["after_m"], float))))
        cards.append(
            Card(
                "Scans agree to",
                shown_length(median, digits=2),
                "Median distance between overlapping scans after they were aligned.",
                number=median,
                unit=shown_unit("m"),
            )
        )
    if comparison is not None:
        rms = comparison.accuracy_measured.rms
        cards.append(
            Card(
                "Distance from truth",
                shown_length(rms, digits=2),
                f"Root mean square distance of the measured surface from the {reference_name}.",
                number=rms,
                unit=shown_unit("m"),
            )
        )
    cards.append(_size_card(surface))
    if not has_scale():
        cards.append(_no_scale_card())
    warnings = sum(len(record.get("warnings", ())) for record in records)
    cards.append(
        Card(
            "Warnings",
            str(warnings) if warnings else "none",
            "Read them before the model is used." if warnings else "No stage had to warn.",
            "attention" if warnings else "good",
            number=warnings,
        )
    )
    return Section("In short", "", (Cards(tuple(cards)),))


def _watertight_card(surface: TriangleMesh) -> Card:
    census = edge_census(surface.triangles)
    if census.watertight:
        sentence = "The surface is closed: every edge joins exactly two triangles."
        return Card("Watertight", "yes", sentence, "good", number=True)
    faults = [
        f"{shown_number(count)} {words}"
        for count, words in (
            (census.boundary_edges, "edges lie at an opening"),
            (census.nonmanifold_edges, "join more than two triangles"),
            (census.misoriented_edges, "join triangles that face opposite ways"),
        )
        if count
    ]
    sentence = f"Of {shown_number(census.edges)} edges, {', '.join(faults)}."
    return Card("Watertight", "no", sentence, "attention", number=False)


def _measured_card(surface: TriangleMesh) -> Card:
    share = measured_share(surface)
    if "provenance" not in surface.vertex_attributes:
        sentence = "The surface does not say which parts were measured."
        return Card("Measured", "not recorded", sentence, "attention")
    if share == 1:
        sentence = "Nothing was added: every part of the surface rests on samples."
    else:
        added = shown_percent(1 - share)
        sentence = f"The other {added} of the area was closed by computation; it is marked orange."
    value = f"{shown_percent(share)} of the area"
    return Card("Measured", value, sentence, "plain", number=100 * share, unit="%")


def _size_card(surface: TriangleMesh) -> Card:
    used = surface.vertices[np.unique(surface.triangles)]
    extent = used.max(axis=0) - used.min(axis=0)
    unit = length_unit(float(extent.max()))
    sides = "\u00a0× ".join(shown_number(float(side) * unit.per_metre, 3) for side in extent)
    detail = float(np.sqrt(vertex_areas(surface).sum() / max(len(used), 1)))
    sentence = (
        f"Width along x, y and z. Vertices stand {shown_length(detail, digits=2)} apart on average."
    )
    return Card("Size", f"{sides}\u00a0{unit.symbol}", sentence)


def _no_scale_card() -> Card:
    sentence = (
        "Photographs alone tell the shape, not how large it is: lengths are in a unit of the "
        "model’s own, u. Coded markers or a known distance between cameras would tell."
    )
    return Card("Scale", "no scale", sentence, "attention", number=False)


def _sample_distances(
    surface: TriangleMesh, residuals: Mapping[str, ArrayLike]
) -> NDArray[np.float64]:
    """Distances (k,) between samples and surface, metres; empty when none are known."""
    if "samples_to_surface_m" in residuals:
        return np.asarray(residuals["samples_to_surface_m"], float)
    at_vertices = surface.vertex_attributes.get("distance_to_samples_m")
    if at_vertices is None:
        return np.empty(0)
    values = np.asarray(at_vertices, float)[measured_vertices(surface)]
    return np.asarray(values[np.isfinite(values)], np.float64)


def _model_section(
    surface: TriangleMesh,
    sides: FourSides,
    truth: TriangleMesh | None,
    reference_name: str,
    filled: FilledByPhotographs | None,
) -> Section:
    attributes = surface.vertex_attributes
    blocks: list[Block] = [sides.lit()]
    if "color" in attributes:
        blocks.append(sides.colored())
    if "provenance" in attributes:
        blocks.append(sides.provenance(origins_of(surface, filled)))
    if "distance_to_samples_m" in attributes:
        distance = np.array(attributes["distance_to_samples_m"], float)
        distance[~measured_vertices(surface)] = np.nan
        blocks.append(
            sides.lengths(
                "bar-samples",
                distance,
                "Distance to the nearest samples",
                "How far the surface lies from the samples it was made from.",
                "infilled: nothing to compare with",
            )
        )
    if truth is not None:
        found = distance_to_surface(surface.vertices, truth)
        deviation = signed_distances_m(found, truth)
        # Infilled parts may be far off and would drown the scale of what was measured.
        deviation[~measured_vertices(surface)] = np.nan
        blocks.append(
            sides.lengths(
                "bar-truth",
                deviation,
                f"Deviation from the {reference_name}",
                f"Red stands proud of the {reference_name}, blue lies below it.",
                "infilled: not compared",
            )
        )
    return Section("The model", "", tuple(blocks))


def _citation_section(citations: Sequence[str], reproducibility: str) -> Section:
    blocks: list[Block] = []
    if reproducibility:
        blocks.append(Paragraph(reproducibility))
    if citations:
        blocks.append(TextList(tuple(citations)))
    return Section("Reproducing and citing", "", tuple(blocks))
