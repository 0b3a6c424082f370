from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from workbench.synthetic import Scene, SimulatedScan, SimulationOptions, build_scene, simulate_scan

COARSE_STATUE = {"scene": "statue", "seed": 3, "mesh_spacing_m": 0.007}


@pytest.fixture(scope="session")
def faultless() -> dict[str, float]:
    """Scanner options without any fault."""
    return {
        "depth_sigma_m": 0.0,
        "angular_jitter_rad": 0.0,
        "beam_divergence_rad": 0.0,
        "grazing_dropout": 0.0,
        "dark_dropout": 0.0,
        "stray_probability": 0.0,
        "reflectance_sigma": 0.0,
        "reflectance_floor_sigma": 0.0,
    }


@pytest.fixture(scope="session")
def statue_options() -> SimulationOptions:
    return SimulationOptions.model_validate(COARSE_STATUE)


@pytest.fixture(scope="session")
def statue_scene(statue_options: SimulationOptions) -> Scene:
    return build_scene(statue_options)


@pytest.fixture(scope="session")
def statue_scans(statue_scene: Scene, statue_options: SimulationOptions) -> list[SimulatedScan]:
    return [simulate_scan(statue_scene, statue_options, index) for index in (0, 1, 6)]


@pytest.fixture(scope="session")
def distance_to_triangles() -> Callable[..., np.ndarray]:
    """Exact point–triangle distances over candidates, by projection onto face, edges, corners."""
    from scipy.spatial import cKDTree

    def to_segment(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        ab = b - a
        t = np.clip(((p - a) * ab).sum(-1) / np.maximum((ab * ab).sum(-1), 1e-300), 0, 1)
        return np.linalg.norm(p - a - t[..., None] * ab, axis=-1)

    def measure(points: np.ndarray, vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
        corners = vertices[triangles]
        center = corners.mean(axis=1)
        reach = np.linalg.norm(corners - center[:, None], axis=2).max(axis=1)
        result = np.full(len(points), np.inf)
        # Few sizes of triangle differ by orders of magnitude: one tree for each octave.
        octave = np.floor(np.log2(np.maximum(reach, 1e-9))).astype(int)
        for size in np.unique(octave):
            members = np.flatnonzero(octave == size)
            tree = cKDTree(center[members])
            near = tree.query_ball_point(points, 2.0 ** (size + 1) + 0.002)
            for n, found in enumerate(near):
                if not found:
                    continue
                a, b, c = corners[members[found]].transpose(1, 0, 2)
                p = points[n]
                normal = np.cross(b - a, c - a)
                area2 = np.maximum((normal * normal).sum(-1), 1e-300)
                w = np.stack(
                    [
                        (np.cross(c - b, p - b) * normal).sum(-1) / area2,
                        (np.cross(a - c, p - c) * normal).sum(-1) / area2,
                        (np.cross(b - a, p - a) * normal).sum(-1) / area2,
                    ]
                )
                plane = np.abs(((p - a) * normal).sum(-1)) / np.sqrt(area2)
                edges = np.minimum(
                    np.minimum(to_segment(p, a, b), to_segment(p, b, c)), to_segment(p, c, a)
                )
                result[n] = min(result[n], np.where((w >= 0).all(0), plane, edges).min())
        return result

    return measure
