"""What a report says of colour: whence it comes, how even it is, what the flash did to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.color.flash_light import falloff_terms
from workbench.geometry.mesh import TriangleMesh
from workbench.surface.provenance import INPAINTED, PHOTOGRAPHED, UNCOLORED
from workbench.verification.color_truth import AlbedoComparison, ColorDifference
from workbench.verification.distances import vertex_areas
from workbench.verification.figures import SERIES
from workbench.verification.quantities import shown_length, shown_number, shown_percent, shown_unit
from workbench.verification.report_content import (
    Block,
    Cell,
    Column,
    Paragraph,
    PictureRow,
    Plot,
    Section,
    Table,
    TextList,
)
from workbench.verification.svg import inline_svg, page_style

_WAYS = {
    "estimated": "The flash was found from the photographs themselves: a place has one colour, "
    "and what differs between the photographs that show it is the flash’s doing.",
    "given": "The flash’s place was given; how strong it was each time comes from where "
    "photographs overlap.",
    "at the lens": "The flash is taken to be at the lens: {reason}. Colours near folds and edges "
    "may keep some of its light.",
    "left out": "No flash was taken out, and colours keep the light they were photographed in: "
    "{reason}.",
}
_AXES = (
    ("to the right of the lens", "to the left of the lens"),
    ("below the lens", "above the lens"),
    ("before the lens", "behind the lens"),
)
_TERMS = {
    "falloff": "a beam brighter in some directions",
    "roughness": "a rough surface (Oren and Nayar)",
    "indirect": "light from all around",
}
# Directions in which a beam's unevenness is told, from the axis of the view.
_ASIDE_DEG = 15.0
# Share of the distance beyond which the flash's place is said to be loose.
_LOOSE = 0.05
_ORIGINS = {PHOTOGRAPHED: "photographed", INPAINTED: "inpainted", UNCOLORED: "without colour"}


def color_section(
    surface: TriangleMesh,
    provenance: NDArray[np.uint8],
    flash: Mapping[str, Any],
    record: Mapping[str, Any],
    pictures: Sequence[PictureRow] = (),
    truth: AlbedoComparison | None = None,
    differences: PictureRow | None = None,
) -> Section:
    """The chapter on colour.

    Parameters
    ----------
    surface : the model.
    provenance : (n,) of its vertices' colours.
    flash, record : as the stage ``color`` leaves them.
    pictures : of the coloured model, first of all.
    truth : the colours against a simulation's; ``differences`` is where they differ.
    """
    said = {metric["name"]: metric["value"] for metric in record["metrics"]}
    shares = _areas(surface, provenance)
    blocks: list[Block] = [Paragraph(_in_words(shares, flash, said)), *pictures]
    warnings = tuple(record.get("warnings", ()))
    if warnings:
        blocks.append(TextList(warnings, tone="attention"))
    blocks.append(_origin_table(shares))
    blocks.append(_evenness_table(flash, said))
    blocks.append(Paragraph(_flash_in_words(flash)))
    if flash["light"] is not None:
        blocks.append(_flash_table(flash))
        if flash["estimate"] is not None and flash["estimate"]["terms"]:
            blocks.append(_terms_table(flash["estimate"]["terms"], flash["light"]))
    lit = [name for name in flash["gains"] if name not in set(flash["without_flash"])]
    if len(lit) > 1:
        blocks.append(_gains_plot({name: flash["gains"][name] for name in lit}))
    if shares[INPAINTED] > 0.0:
        blocks.append(Paragraph(_inpainting_in_words(said)))
    if truth is not None:
        blocks.append(_truth_table(truth))
        blocks += [differences] if differences is not None else []
    intro = "The colour of the surface, and how far it is free of the light of the photographs."
    return Section("Colour", intro, tuple(blocks))


def _areas(surface: TriangleMesh, provenance: NDArray[np.uint8]) -> dict[int, float]:
    """Area in m² by where the colours come from."""
    areas = vertex_areas(surface)
    return {kind: float(areas[provenance == kind].sum()) for kind in _ORIGINS}


def _in_words(
    shares: Mapping[int, float], flash: Mapping[str, Any], said: Mapping[str, Any]
) -> str:
    total = sum(shares.values()) or float("nan")
    unlit = len(flash["without_flash"])
    told = f"{shown_number(int(said['photographs']))} photographs"
    if unlit:
        told += f", {unlit} of them taken without flash,"
    text = (
        f"{told} tell the colour of {shown_percent(shares[PHOTOGRAPHED] / total)} of the surface, "
        f"in the median place {shown_number(round(said['photos_per_vertex']))} of them. "
    )
    if shares[INPAINTED] > 0.0:
        text += (
            f"{shown_percent(shares[INPAINTED] / total)} is inpainted: smoothly spread from the "
            "colours around, and nobody’s observation. "
        )
    if shares[UNCOLORED] > 0.0:
        text += f"{shown_percent(shares[UNCOLORED] / total)} has no colour. "
    return text + f"The level of white is {flash['level']}."


def _origin_table(shares: Mapping[int, float]) -> Table:
    total = sum(shares.values()) or float("nan")
    rows = tuple((_ORIGINS[kind], area, 100.0 * area / total) for kind, area in shares.items())
    columns = (Column("Colour"), Column("Area", shown_unit("m²")), Column("Share", "%", 2))
    return Table(columns, rows, "The surface by the origin of its colours.")


def _evenness_table(flash: Mapping[str, Any], said: Mapping[str, Any]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    estimate = flash["estimate"]
    if estimate is not None:
        spreads = (
            ("between photographs, as taken", "scatter_as_shot"),
            ("between photographs, each at its best gain", "scatter_with_gains"),
            ("between photographs, the flash taken out", "scatter"),
            ("the same at places the flash was not fitted to", "scatter_held_out"),
        )
        rows += [(label, _percent(estimate[name])) for label, name in spreads]
    rows += [
        ("between photographs, as blended", said.get("blended_scatter")),
        ("steps of the blend where other photographs begin", said.get("seam_step")),
        ("steps from vertex to vertex within one photograph", said.get("step_noise")),
        ("weight of photographs that was doubted", said.get("doubted_share")),
    ]
    caption = (
        "How well photographs agree on the luminance of one place: standard deviation, the median "
        "of all places. Steps are beyond what the paint itself steps; those where other "
        "photographs begin are seams, which nobody sees while they stay below those within one "
        "photograph. Doubted is what differed from the others, as highlights do."
    )
    return Table(
        (Column("Spread of luminance", style="wide"), Column("Value", "%", 2)), tuple(rows), caption
    )


def _flash_in_words(flash: Mapping[str, Any]) -> str:
    text = _WAYS[flash["way"]].format(reason=flash["reason"])
    estimate, light = flash["estimate"], flash["light"]
    if estimate is None:
        return text
    sigmas, distance = estimate["position_sigma_m"], light["reference_distance_m"]
    axes = ("sideways", "up and down", "along the view")
    loose = [
        f"{axis} (± {shown_length(sigma, digits=2)})"
        for axis, sigma in zip(axes, sigmas, strict=True)
        if sigma > _LOOSE * distance
    ]
    if loose:
        text += (
            f" Its place is loose {' and '.join(loose)}: the photographs are as well explained "
            "from elsewhere in that direction, and the colours hardly depend on it."
        )
    else:
        text += f" Its place is known to {100 * _LOOSE:.0f} % of the distance or better every way."
    return text + ("" if estimate["converged"] else " The fit had not come to rest.")


def _flash_table(flash: Mapping[str, Any]) -> Table:
    light, estimate = flash["light"], flash["estimate"]
    sigmas = estimate["position_sigma_m"] if estimate is not None else (None, None, None)
    rows: list[tuple[Cell, ...]] = [
        (
            ways[0] if place >= 0.0 else ways[1],
            shown_length(abs(place), digits=3),
            None if sigma is None else shown_length(sigma, digits=2),
        )
        for ways, place, sigma in zip(_AXES, light["position_in_camera_m"], sigmas, strict=True)
    ]
    reach = shown_length(light["reference_distance_m"], digits=3)
    rows.append(("distance at which its light counts as 1", reach, None))
    rows += [
        (f"light {_ASIDE_DEG:.0f}° {way}, of that ahead", share, None)
        for way, share in _aside(light)
    ]
    rows += [
        ("light from all around, of that", shown_percent(light["indirect"]), None),
        ("roughness of the surface", f"{light['roughness_deg']:.1f}°", None),
        ("light at any incidence (ε of eq. 3.2)", f"{light['epsilon']:.3g}", None),
    ]
    columns = (Column("Flash", style="wide"), Column("Value"), Column("±"))
    caption = "The light of the flash as it is taken out; it moves with the camera."
    return Table(columns, tuple(rows), caption)


def _aside(light: Mapping[str, Any]) -> list[tuple[str, str]]:
    """How bright the beam is aside, relative to the axis of the view; nothing for an even one."""
    coefficients = np.array(light["falloff"], float)
    if not len(coefficients):
        return []
    lean = np.sin(np.radians(_ASIDE_DEG))
    ways = {"to the right": (lean, 0.0), "to the left": (-lean, 0.0),
            "upwards": (0.0, -lean), "downwards": (0.0, lean)}  # fmt: skip
    directions = np.array([(u, v, np.sqrt(1.0 - u**2 - v**2)) for u, v in ways.values()])
    shares = np.exp(falloff_terms(directions, len(coefficients)) @ coefficients)
    return [(way, f"{100.0 * share:.0f} %") for way, share in zip(ways, shares, strict=True)]


def _terms_table(terms: Sequence[Mapping[str, Any]], light: Mapping[str, Any]) -> Table:
    there = {
        "falloff": bool(light["falloff"]),
        "roughness": light["roughness_deg"] > 0.0,
        "indirect": light["indirect"] > 0.0,
    }
    rows = tuple(
        (
            _TERMS.get(term["term"], term["term"]),
            _fate(there.get(term["term"], term["kept"]), term["kept"]),
            _percent(term["spread_without"]),
            _percent(term["spread_with"]),
            term["certainty"],
        )
        for term in terms
    )
    columns = (
        Column("Beyond distance and incidence", style="wide"),
        Column(""),
        Column("Spread without", "%", 2),
        Column("Spread with", "%", 2),
        Column("Certainty", "σ", 1),
    )
    caption = (
        "What else the flash’s light may do. What surely lessens the spread of places that it was "
        "not fitted to is part of the light that is taken out; certainty is in standard errors."
    )
    return Table(columns, rows, caption)


def _fate(in_the_light: bool, sure: bool) -> str:
    """What became of a term that was tried."""
    if not in_the_light:
        return "left out: not surely better"
    return "taken out" if sure else "taken out, but not surely better"


def _gains_plot(gains: Mapping[str, float]) -> Plot:
    from matplotlib.figure import Figure

    names = list(gains)
    values = np.array([gains[name] for name in names], float)
    relative = values / np.median(values)
    with page_style():
        figure = Figure(figsize=(4.5, 2.1), layout="constrained")
        axes = figure.add_subplot()
        axes.axhline(100.0, color=SERIES[1], linewidth=1.2, linestyle=(0, (4, 2)))
        axes.scatter(np.arange(1, len(names) + 1), 100.0 * relative, s=16, color=SERIES[0])
        axes.set_xlabel("Photograph, in their order")
        axes.set_ylabel("Light (% of the median)")
        axes.grid(visible=False, axis="x")
    low, high = int(relative.argmin()), int(relative.argmax())
    spread = 100.0 * float(np.std(np.log(relative)))
    caption = (
        f"How strong the light was in each photograph. Standard deviation {spread:.1f} %; least "
        f"in {names[low]} ({100 * relative[low]:.1f} %), most in {names[high]} "
        f"({100 * relative[high]:.1f} %). Half or twice the others means another setting."
    )
    svg = inline_svg(figure, "color-gains", "The light’s strength in each photograph as dots")
    return Plot(svg, caption, {"gains": dict(gains)})


def _inpainting_in_words(said: Mapping[str, Any]) -> str:
    factor = said.get("inpaint_factor")
    told = (
        "" if factor is None else
        f" Each cycle of the multigrid solver left {100.0 * factor:.0f} % of the residual."
    )  # fmt: skip
    return (
        "Inpainted colours are the smoothest that meet the photographed ones around them, under "
        "a diffusion that is slow across creases; none is lighter or darker than its rim." + told
    )


def _truth_table(truth: AlbedoComparison) -> Table:
    ways = (
        ("photographs blended as taken, level matched", truth.uncorrected),
        ("distance alone taken out, level matched", truth.distance_only),
        ("as recovered, level matched", truth.corrected_matched),
        ("as recovered", truth.corrected),
        ("as recovered, from the paint itself", truth.of_paint),
        ("inpainted, from the paint itself", truth.inpainted),
    )
    rows = tuple(_difference_cells(label, way) for label, way in ways if way is not None)
    columns = (
        Column("Against the true albedo", style="wide"),
        Column("Vertices", decimals=0),
        Column("Mean ΔE2000", decimals=2),
        Column("Median", decimals=2),
        Column("95 %", decimals=2),
        Column("Level ×", decimals=3),
    )
    caption = (
        "Colour differences from the albedo that the simulation painted, as the same photographs "
        "would tell it in perfectly even light; “from the paint itself” adds what pixels are too "
        "coarse to resolve, against the mean of the paint over what a vertex stands for. CIE Lab "
        "relative to D65, in which a perfect white diffuser is white. 1 is about what a practised "
        "eye can see. “Level matched” means that all colours are multiplied by the one factor "
        "that makes their mean difference least, which colours without a known level need; “as "
        "recovered” has no such help. All but the inpainted ones "
        "are the same vertices."
    )
    return Table(columns, rows, caption)


def _difference_cells(label: str, way: ColorDifference) -> tuple[Cell, ...]:
    return (label, way.count, way.mean, way.percentile(50.0), way.percentile(95.0), way.factor)


def _percent(share: float | None) -> float | None:
    return None if share is None else 100.0 * share
