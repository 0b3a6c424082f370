"""Options of ``fuse``."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from workbench.project.settings import StageOptions


class FuseOptions(StageOptions):
    """Options of ``fuse``."""

    half_window: int = Field(
        2, ge=1, le=8, description="Half width of the window a normal is fitted in, grid cells."
    )
    step_factor: float = Field(
        4.0,
        gt=1.0,
        le=50.0,
        description="Neighbours further apart than this many sample distances are across a step.",
    )
    min_neighbours: int = Field(
        6, ge=3, le=200, description="Samples with fewer neighbours on their surface are dropped."
    )
    max_incidence_deg: float = Field(
        80.0, gt=0.0, lt=90.0, description="Samples seen more obliquely are dropped."
    )
    border_erosion: int = Field(
        1, ge=0, le=10, description="Rings dropped along depth steps, where pixels are mixed."
    )
    thinning: Annotated[float, Field(ge=0.0, le=10.0)] | Literal["auto"] = Field(
        "auto",
        description="Samples within this many sample distances become one; 0 keeps all. auto: "
        "0.5, and 2 of photographs, whose neighbouring depths come from the same patches.",
    )
    memory_samples: int = Field(
        5_000_000,
        ge=1_000,
        le=1_000_000_000,
        description="More samples than this are not held in memory but in a layered point cloud "
        "on disk (Jaspe 2018, 3.3.1).",
    )
