"""What each size asks of the camera where nothing else is said."""

from __future__ import annotations

from typing import Any

_PHOTOS = {"small": 24, "medium": 68, "large": 400}
_SIZE_PX = {"small": (1200, 800), "medium": (3000, 2000), "large": (6000, 4000)}
# Coarse pixels see more of the paint's detail at once and need more samples against aliasing.
_SAMPLES = {"small": 4, "medium": 2, "large": 1}
_TURNS = {"small": 1, "medium": 3, "large": 8}


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
