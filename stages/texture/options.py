"""Options of ``texture``."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from workbench.project.settings import StageOptions


class TextureOptions(StageOptions):
    """Options of ``texture``."""

    depth_meshes: bool = Field(
        True,
        description="Make a mesh of what each photograph sees, for the stitching renderer "
        "(Arikan et al., 5).",
    )
    single_mesh: bool = Field(
        True, description="Texture the surface itself, for exports that any program opens."
    )
    depth_map_px: int = Field(
        256,
        ge=16,
        le=8192,
        description="Longer side of the depth maps (Arikan et al., 5.1: 256).",
    )
    flatness_px: float = Field(
        0.0,
        ge=0.0,
        le=10.0,
        description="Depth meshes have larger triangles where that moves the surface by no more "
        "than so many pixels' widths; 0 keeps two triangles to each square of pixels.",
    )
    depth_from: Literal["surface", "samples"] = Field(
        "surface",
        description="What depth maps are made of: the surface by rays, or the samples as Gauss "
        "splats, which needs no surface and leaves holes as they are.",
    )
    smoothness: float = Field(
        0.2,
        ge=0.0,
        le=1e6,
        description="Weight of visible seams against the quality of photographs, λs of Arikan et "
        "al., eq. 1.",
    )
    distance_weight: float = Field(
        1.0, ge=0.0, le=1e6, description="Weight of the distance, λdist of eq. 2."
    )
    orientation_weight: float = Field(
        2.0, ge=0.0, le=1e6, description="Weight of the angle of view, λor of eq. 2."
    )
    far_m: float | None = Field(
        None,
        gt=0.0,
        le=1e6,
        description="Distance from which photographs are as bad as each other, h of eq. 3 (10 m "
        "there, for rooms); twice the photographs' median distance where nothing is said.",
    )
    edge_samples: int = Field(
        2, ge=1, le=64, description="Places along each edge where photographs are compared, eq. 5."
    )
    most_candidates: int = Field(
        8,
        ge=0,
        le=10_000,
        description="Photographs of least cost that each triangle keeps; 0 keeps all.",
    )
    cycles: int = Field(
        2, ge=0, le=100, description="Cycles of α-expansion at most (Arikan et al., table 2: 2)."
    )
    bound_sweeps: int = Field(
        3,
        ge=0,
        le=10_000,
        description="Sweeps for the lower bound of the energy, which says how far from the best "
        "the labels can be.",
    )
    border_px: int = Field(
        2,
        ge=0,
        le=200,
        description="Pixels beside masks, clipped pixels, shadows and outlines that are not used.",
    )
    doubt: float | None = Field(
        0.2,
        gt=0.0,
        le=100.0,
        description="Pixels are not used whose lightness differs by so much (its logarithm) from "
        "what all photographs together say, as highlights and clutter do; none uses all.",
    )
    normal_px: int = Field(
        5, ge=1, le=99, description="Side of the square of pixels that normals are averaged over."
    )
    image_px: int = Field(
        12_000,
        ge=100,
        le=60_000,
        description="Longer side at which photographs are used; larger ones are reduced.",
    )
    seam_levelling: Literal["none", "global", "global-and-local"] = Field(
        "global-and-local",
        description="What is done about seams of the textured surface: nothing, smooth offsets "
        "over all of it, or these and a blend of what they leave beside the seams.",
    )
    page_px: int = Field(
        8192, ge=256, le=32_768, description="Longest side of a page of the texture atlas."
    )
    held_out: int = Field(
        0,
        ge=0,
        le=1000,
        description="Photographs, evenly chosen, that texture nothing: the report compares "
        "renderings with them.",
    )
    cache_mb: int = Field(
        2048,
        ge=1,
        le=1_000_000,
        description="Memory for photographs, per worker; the one not used for longest goes first.",
        json_schema_extra={"changes_result": False},
    )
