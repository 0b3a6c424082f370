"""What each size asks of the camera where nothing else is said."""

from __future__ import annotations

from typing import Any

_PHOTOS = {"small": 24, "medium": 68, "large": 400}
_SIZE_PX = {"small": (1200, 800), "medium": (3000, 2000), "large": (6000, 4000)}
# Coarse pixels see more of the paint's detail at once and need more samples against aliasing.
_SAMPLES = {"small": 4, "medium": 2, "large": 1}
_TURNS = {"small": 1, "medium": 3, "large": 8}


# Nothing that is carried lights a façade: it is photographed under an overcast sky.
_BUILDING: dict[str, Any] = {
    "camera": {"held": "level", "focal_length_mm": 24.0, "f_number": 5.6, "iso": 100,
               "exposure_time_s": 1 / 125},
    "flash": {"mode": "off", "ambient_lux": 15000.0, "ambient_color": (1.0, 1.0, 1.0), "sky": 0.9},
    "surface": {"surroundings": "none", "indirect_rays": 0},
    "path": {"kind": "along walls", "distance_m": 12.0, "turns": 2, "position_sigma_m": 0.4,
             "aim_sigma_m": 0.5},
    "charts": {"linearity_distances_m": ()},
}  # fmt: skip


def scene_photo_defaults(scene: str) -> dict[str, Any]:
    """Defaults of the photograph options for a scene, where they differ from a figure's."""
    return dict(_BUILDING) if scene == "building" else {}


def photo_defaults(size: str) -> dict[str, Any]:
    """Defaults of the photograph options for a size; empty for an unknown name."""
    if size not in _PHOTOS:
        return {}
    long_side, short_side = _SIZE_PX[size]
    return {
        "photos": _PHOTOS[size],
        "camera": {"long_side_px": long_side, "short_side_px": short_side},
        "rendering": {
            "samples_per_pixel": _SAMPLES[size],
            "truth": "albedo" if size != "large" else "masks",
        },
        "path": {"turns": _TURNS[size]},
    }
