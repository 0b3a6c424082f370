"""What the stage has to say of its photographs, depth meshes and labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from workbench.metrics import Metric

_Done = Mapping[str, Mapping[str, Any]]


def photo_metrics(done: _Done, held: Sequence[str]) -> list[Metric]:
    """How much of the photographs may be used."""
    used = [item["used"] for item in done.values()] or [0.0]
    doubted = [item["doubted"] for item in done.values()] or [0.0]
    return [
        Metric("photographs", len(done) - len(held), "", "Photographs to texture with."),
        Metric("held_out", len(held), "", "Photographs kept out, to compare renderings with."),
        Metric("used_pixels", 100.0 * float(np.median(used)), "%",
               "Of a photograph's pixels that show the surface, those that may be used, median."),
        Metric("doubted_pixels", 100.0 * float(np.mean(doubted)), "%",
               "Of usable pixels, those that the other photographs contradict, mean."),
    ]  # fmt: skip


def depth_metrics(done: _Done) -> list[Metric]:
    """Sizes, energies and costs of all depth meshes together."""

    def total(name: str) -> float:
        return float(sum(item[name] for item in done.values()))

    triangles, energy, bound = total("triangles"), total("energy"), total("bound")
    count = [item["photos"] for item in done.values()] or [0]
    gap = max(0.0, (energy - bound) / energy) if energy > 0.0 else 0.0
    background = triangles - total("foreground")
    overlap = 100.0 * background / triangles if triangles else 0.0
    return [
        Metric("depth_meshes", len(done), "", "One for each photograph that textures."),
        Metric("depth_triangles", int(triangles), "", "Their triangles."),
        Metric("foreground_triangles", int(total("foreground")), "",
               "Triangles textured by the photograph their mesh was made for."),
        Metric("overlap", overlap, "%",
               "Triangles of the background (Arikan et al., table 2: 57 to 73 %)."),
        Metric("unseen_triangles", int(total("unseen")), "", "Triangles that no photograph shows."),
        Metric("candidate_photos", float(np.mean(count)), "",
               "Photographs that are candidates of a mesh, mean."),
        Metric("energy_before", total("before"), "", "Energy of the best photograph everywhere."),
        Metric("energy", energy, "", "Energy of the labels, eq. 1."),
        Metric("energy_of_seams", total("seams"), "", "The smoothness term in it."),
        Metric("energy_gap", 100.0 * gap, "%", "Of it, what lies above the proven lower bound."),
        Metric("cost_seconds", total("cost_seconds"), "s", "Candidates, costs and colours."),
        Metric("label_seconds", total("label_seconds"), "s", "α-expansion and the bound."),
        Metric("picture_loads", int(total("loads")), "", "Photographs loaded."),
        Metric("load_seconds", total("load_seconds"), "s", "Spent in loading them."),
    ]  # fmt: skip
