"""Options of ``infill``."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from workbench.project.settings import StageOptions


class InfillOptions(StageOptions):
    """Options of ``infill``."""

    depth: Annotated[int, Field(ge=5, le=24)] | Literal["auto"] = Field(
        "auto",
        description="Octree depth of screened Poisson over the whole, 5 to 24; auto makes the "
        "finest cell one sample distance (Kazhdan and Hoppe 2013).",
    )
    block_samples: int = Field(
        1_000_000,
        ge=2_000,
        le=100_000_000,
        description="Samples solved at once; where there are more, the surface is solved in "
        "blocks that overlap, so that memory does not grow with the scene.",
    )
    point_weight: float = Field(
        4.0,
        ge=0.0,
        le=100.0,
        description="Pull of the samples against smoothness (Kazhdan and Hoppe 2013: 4).",
    )
    samples_per_node: float = Field(
        1.5, ge=1.0, le=20.0, description="Samples per finest cell; more for noisy scans."
    )
    refine_rounds: int = Field(
        2,
        ge=0,
        le=10,
        description="Moves of the vertices onto the samples' own surface; 2 take a third off the "
        "error of the octree in about a second (Shen et al. 2004).",
    )
    reach_factor: float = Field(
        1.0,
        gt=0.0,
        le=20.0,
        description="A vertex within this many sample distances of a sample is measured.",
    )
    trim_distance_m: float | None = Field(
        None,
        gt=0.0,
        description="Take away infilled surface further than this from any sample; opens it.",
    )
    threads: int = Field(
        1,
        ge=1,
        le=64,
        description="Threads of the Poisson solver; more than one is faster and not reproducible.",
    )
