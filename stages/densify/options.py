"""Options of ``densify``."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from workbench.project.settings import StageOptions


class DensifyOptions(StageOptions):
    """Options of ``densify``."""

    fill: Literal["never", "missed"] = Field(
        "never",
        description="Beside scans: never, they tell the surface alone; missed, depth maps fill "
        "what they missed. It takes photographs brought with cameras (--cameras) in the scans' "
        "frame, or places picked in alignment.toml.",
    )
    covered: float = Field(
        0.99,
        gt=0.0,
        le=1.0,
        description="With fill=missed: photographs are left out of whose points the scans hold "
        "this share.",
    )
    image_px: int = Field(
        1600,
        ge=100,
        le=20_000,
        description="Longer side at which photographs are compared; larger ones are reduced.",
    )
    matcher: Literal["auto", "own", "colmap"] = Field(
        "auto",
        description="Who compares: own, on the processor, the same bytes everywhere; colmap, on "
        "an NVIDIA card (Schönberger et al. 2016); auto: colmap where it can.",
    )
    neighbours: int = Field(
        5, ge=1, le=16, description="Other photographs that each is compared with."
    )
    levels: int = Field(
        3, ge=1, le=8, description="Sizes from coarse to fine, each twice the one before."
    )
    first_rounds: int = Field(
        6, ge=1, le=50, description="Rounds of propagation at the coarsest size, from chance."
    )
    rounds: int = Field(2, ge=0, le=20, description="Rounds at every finer size.")
    patch_px: int = Field(
        7,
        ge=3,
        le=41,
        description="Side of the patches compared; every second pixel counts, as on a chessboard.",
    )
    geometric: bool = Field(
        True,
        description="Better depth maps by those of the neighbours (Xu and Tao 2019, 4.2).",
    )
    agreeing: int = Field(
        2, ge=1, le=16, description="Other photographs that must agree on a depth at least."
    )
    agreement_px: float = Field(
        1.0,
        gt=0.0,
        le=20.0,
        description="Depth maps agree that lead back to within so many pixels.",
    )
    most_cost: float = Field(
        0.6, gt=0.0, le=2.0, description="Depths whose 1 − NCC is above this are not believed."
    )
    speckle_share: float = Field(
        2e-4,
        ge=0.0,
        le=0.1,
        description="Pieces of a depth map of no more than this share of the picture, apart from "
        "all around them, are dropped.",
    )
