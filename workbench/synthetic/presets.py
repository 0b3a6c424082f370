"""What each scene and size asks of the scanner where nothing else is said."""

from __future__ import annotations

from typing import Any

_MESH_SPACING_M = {"small": 0.0045, "medium": 0.0025, "large": 0.0016}
_STATUE_GRID = {"small": (300, 220), "medium": (680, 500), "large": (1360, 1000)}
_BUILDING_GRID = {"small": (225, 330), "medium": (610, 900), "large": (1220, 1800)}
# Coarse scanners are noisy scanners: about a tenth of the sample spacing and more.
_STATUE_SIGMA_M = {"small": 0.0005, "medium": 0.0003, "large": 0.0002}
_SQUARE_GRID = {"small": (200, 200), "medium": (450, 450), "large": (900, 900)}

# The analytic shapes are small and scanned closely.
_FINE = {"depth_sigma_m": 0.0002}
_SCANNER: dict[str, dict[str, Any]] = {
    "statue": {},
    "building": {
        "projection": "spherical",
        "vertical_fov_deg": 75.0,
        "horizontal_fov_deg": 110.0,
        "depth_sigma_m": 0.002,
        "reference_distance_m": 10.0,
        "angular_jitter_rad": 5e-5,
        "beam_divergence_rad": 6e-4,
        "mixed_step_min_m": 0.02,
        "mixed_step_max_m": 0.8,
        "min_range_m": 0.5,
        "max_range_m": 60.0,
    },
    "plane": {
        "vertical_fov_deg": 40.0,
        "horizontal_fov_deg": 40.0,
        "reference_distance_m": 1.0,
        **_FINE,
    },
    "sphere": {
        "vertical_fov_deg": 44.0,
        "horizontal_fov_deg": 44.0,
        "reference_distance_m": 1.0,
        **_FINE,
    },
    "cylinder": {
        "vertical_fov_deg": 40.0,
        "horizontal_fov_deg": 24.0,
        "reference_distance_m": 1.0,
        **_FINE,
    },
    "thin-sheet": {
        "vertical_fov_deg": 44.0,
        "horizontal_fov_deg": 44.0,
        "reference_distance_m": 1.0,
        **_FINE,
        "mixed_step_min_m": 0.003,
    },
}
_STATIONS: dict[str, dict[str, Any]] = {
    "statue": {},
    "building": {"standoff_m": 12.0, "standoff_spread": 0.15, "aim_spread_m": 0.5},
    "plane": {"standoff_m": 1.0, "aim_spread_m": 0.08},
    "sphere": {"standoff_m": 1.0},
    "cylinder": {"standoff_m": 1.0, "aim_spread_m": 0.05},
    "thin-sheet": {"standoff_m": 0.9, "aim_spread_m": 0.02},
}
_COARSE_POSES: dict[str, dict[str, Any]] = {
    "building": {"rotation_sigma_deg": 0.4, "translation_sigma_m": 0.1, "pivot": "scanner"},
}
_DEGENERATE = {"rotation_sigma_deg": 0.6, "translation_sigma_m": 0.004}
UTM_OFFSET_M = (5e5, 5.2e6, 120.0)


def scene_defaults(scene: str, size: str) -> dict[str, Any]:
    """Defaults of the simulation options for a scene and a size; empty for unknown names."""
    if scene not in _SCANNER or size not in _SQUARE_GRID:
        return {}
    grids = {"statue": _STATUE_GRID, "building": _BUILDING_GRID}.get(scene, _SQUARE_GRID)
    rows, cols = grids[size]
    return {
        "mesh_spacing_m": _MESH_SPACING_M[size],
        "world_offset_m": UTM_OFFSET_M if scene == "building" else (0.0, 0.0, 0.0),
        "scanner": {
            "rows": rows,
            "cols": cols,
            **({"depth_sigma_m": _STATUE_SIGMA_M[size]} if scene == "statue" else {}),
            **_SCANNER[scene],
        },
        "stations": dict(_STATIONS[scene]),
        "coarse_poses": dict({} if scene == "statue" else _COARSE_POSES.get(scene, _DEGENERATE)),
    }
