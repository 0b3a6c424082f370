"""Options of ``color``."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from workbench.project.settings import StageOptions

Degrees = Annotated[float, Field(ge=0.0, le=60.0)]
Metres = Annotated[float, Field(ge=-100.0, le=100.0)]


class ColorOptions(StageOptions):
    """Options of ``color``."""

    flash: Literal["auto", "given", "none"] = Field(
        "auto",
        description="Where the flash is: auto finds it from the photographs, given takes "
        "flash_position_m, none takes colours as photographed.",
    )
    flash_position_m: tuple[Metres, Metres, Metres] = Field(
        (0.0, 0.0, 0.0),
        description="Middle of the flash from the lens: right, down, forward.",
    )
    flash_terms: tuple[Literal["falloff", "roughness", "indirect"], ...] = Field(
        ("falloff", "roughness"),
        description="What may be found of the flash's light beyond its place and strength, where "
        "photographs tell; light from all around looks much like a flash further forward.",
    )
    reference_distance_m: float | None = Field(
        None,
        gt=0.0,
        le=1000.0,
        description="Distance at which a facing surface keeps its level, d₀ of Jaspe 2018, eq. "
        "3.2; the photographs' median where nothing is said. A chart anchors the level instead.",
    )
    epsilon: float = Field(
        0.1,
        ge=0.0,
        le=1.0,
        description="Share of the flash's light taken to come at any incidence (Jaspe 2018, eq. "
        "3.2: 0.1); 1 corrects the distance alone.",
    )
    roughness_deg: Degrees | Literal["auto"] = Field(
        "auto",
        description="Roughness of the surface (Oren and Nayar 1994); auto finds it from "
        "the photographs.",
    )
    normal_px: int = Field(
        5,
        ge=1,
        le=99,
        description="Side of the square of pixels that normals are averaged over (Jaspe 2018, "
        "3.4.5: 5).",
    )
    image_px: int = Field(
        12_000,
        ge=100,
        le=60_000,
        description="Longer side at which photographs are looked at; larger ones are reduced.",
    )
    feather: float = Field(
        0.01,
        ge=0.0,
        le=0.5,
        description="Width of the ramp at the borders of what a photograph tells, as a share of "
        "its longer side (Pintus et al. 2011).",
    )
    angle_power: float = Field(
        1.0, ge=0.0, le=16.0, description="Power of the cosine of the view in the weights."
    )
    sharpness_power: float = Field(
        1.0, ge=0.0, le=16.0, description="Power of the sharpness in the weights; 0 leaves it out."
    )
    robust: Literal["median", "none"] = Field(
        "median",
        description="Count photographs less where they differ from the median of all, as in "
        "highlights, or take the mean.",
    )
    least_weight: float = Field(
        0.01,
        ge=0.0,
        le=1.0,
        description="Vertices told with less than this share of the median weight are left to "
        "inpainting.",
    )
    inpaint: bool = Field(
        True, description="Spread colour over what no photograph shows (Jaspe 2018, 3.4.6)."
    )
    inpaint_cycles: int = Field(
        60, ge=1, le=1000, description="Multigrid cycles at most (Jaspe 2018, 3.4.6: 10)."
    )
