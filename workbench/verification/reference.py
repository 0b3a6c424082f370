"""A model against a reference surface that may itself have holes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.mesh import TriangleMesh
from workbench.metrics import Metric
from workbench.verification.distances import DistanceSummary, distance_to_surface
from workbench.verification.truth import measured_vertices


def reference_metrics(surface: TriangleMesh, reference: TriangleMesh) -> list[Metric]:
    """Distances of the reference's vertices to the model and of the model's to the reference.

    Only measured vertices count, and of them those whose closest point lies on the border of
    a hole of the reference do not: the reference says nothing there.
    """
    to_model = DistanceSummary.of(distance_to_surface(reference.vertices, surface).distance_m)
    measured = surface.vertices[measured_vertices(surface)]
    found = distance_to_surface(measured, reference)
    silent = border_vertices(reference)[found.nearest_vertex(reference)]
    to_reference = DistanceSummary.of(found.distance_m[~silent])
    return [
        Metric("reference_to_model_rms", to_model.rms, "m",
               "Root mean square distance of the reference's vertices from the model."),
        Metric("reference_to_model_p95", to_model.p95, "m",
               "95 % of the reference's vertices lie this close to the model."),
        Metric("measured_to_reference_rms", to_reference.rms, "m",
               "Root mean square distance of measured vertices from the reference."),
        Metric("measured_to_reference_p95", to_reference.p95, "m",
               "95 % of the measured vertices lie this close to the reference."),
        Metric("reference_silent_share", float(silent.mean()) if len(silent) else 0.0, "",
               "Share of measured vertices beside holes of the reference, not compared."),
    ]  # fmt: skip


def border_vertices(mesh: TriangleMesh) -> NDArray[np.bool_]:
    """(n,) vertices on an edge that has one face only."""
    edges = np.sort(mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    border = np.zeros(len(mesh.vertices), bool)
    border[unique[count == 1]] = True
    return border
