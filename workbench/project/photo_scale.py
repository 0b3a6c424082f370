"""Whether the lengths of a project are metres."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def scale_is_known(photo_poses: Mapping[str, Any] | None) -> bool:
    """False where photographs alone tell the shape, and nothing told how large it is.

    Parameters
    ----------
    photo_poses : as ``orient`` left them; None where it did not run.
    """
    told = (photo_poses or {}).get("scale", {})
    return bool(told.get("way") != "none")
