"""Options of ``orient``."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from workbench.project.settings import StageOptions


class OrientOptions(StageOptions):
    """Options of ``orient``."""

    image_px: int = Field(
        3200,
        ge=200,
        le=20_000,
        description="Longer side at which features are looked for; larger photographs are reduced.",
    )
    features: int = Field(
        6000, ge=200, le=100_000, description="Features kept of a photograph, the strongest."
    )
    mapper: Literal["incremental", "global"] = Field(
        "incremental",
        description="How cameras are found from pairs: one after the other, or all at once, which "
        "is quicker for hundreds of photographs.",
    )
    seed: int = Field(0, ge=0, description="Of all draws; the same seed gives the same cameras.")
    align: Literal["auto", "own"] = Field(
        "auto",
        description="Bring photographs onto the surface, or leave them in a frame of their own.",
    )
    refine: Literal["auto", "always", "never"] = Field(
        "auto",
        description="Adjust cameras to the surface; auto keeps ready-made orientations as they "
        "come (Pintus and Gobbetti 2015).",
    )
    patch_rounds: int = Field(
        2,
        ge=0,
        le=10,
        description="How often patches are followed over the surface to adjust by; 0 keeps to "
        "features (Furukawa and Ponce 2009).",
    )
    patches_per_photo: int = Field(
        8000, ge=100, le=50_000, description="Patches looked for in each photograph."
    )
    patch_photos: int = Field(
        32,
        ge=2,
        description="Other photographs that each one's patches are looked up in, near and far "
        "ones; without a bound time grows with the square of the photographs.",
    )
    memory_pixels: int = Field(
        400_000_000,
        ge=1_000_000,
        description="Pixels of all photographs held at once for patches, some six bytes each; "
        "larger photographs are reduced alike.",
    )
    given_unit: Literal["m", "none"] = Field(
        "m",
        description="Unit of ready-made orientations without scans; none: they have no scale.",
    )
    markers: Literal["aruco-4x4", "aruco-5x5", "aruco-6x6", "apriltag-36h11"] = Field(
        "apriltag-36h11", description="Kind of the coded markers that tell the scale."
    )
    marker_size_m: float | None = Field(
        None,
        gt=0.0,
        description="Side of the coded markers, where photographs alone tell the shape.",
    )
    marker_distances_m: dict[str, float] = Field(
        {},
        description="Known distances between the middles of coded markers, as a scale bar has "
        'them: `"3 7"` = 0.5.',
    )
    camera_distances_m: dict[str, float] = Field(
        {},
        description='Known distances between the places of cameras: `"photo_001 photo_005"` = 1.2.',
    )
