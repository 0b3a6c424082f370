"""Options of ``verify``."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from workbench.project.settings import StageOptions


class VerifyOptions(StageOptions):
    """Options of ``verify``."""

    up: Literal["x", "y", "z"] = Field("z", description="The vertical axis of the pictures.")
    front_deg: float = Field(
        0.0, ge=-360.0, le=360.0, description="Turn about the vertical that shows the front."
    )
    picture_width_px: int = Field(460, ge=120, le=4000, description="Width of each picture.")
    samples: int = Field(
        200_000, ge=1000, le=50_000_000, description="Surface samples for the comparisons."
    )
    texture_sizes_px: tuple[Annotated[int, Field(ge=16, le=4096)], ...] = Field(
        (64, 128, 192),
        description="Sizes of depth maps at which labelling is timed, where photographs are held "
        "out; [] leaves that out.",
    )
