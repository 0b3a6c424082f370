"""What can be chosen about a simulation; every default that depends on the scene is filled in."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from workbench.synthetic.presets import scene_defaults

SceneName = Literal["statue", "building", "plane", "sphere", "cylinder", "thin-sheet"]
SizeName = Literal["small", "medium", "large"]
Probability = Annotated[float, Field(ge=0.0, le=1.0)]
_FROZEN = ConfigDict(extra="forbid", frozen=True)


class ScannerOptions(BaseModel):
    """An organised range scanner and its faults. Defaults suit the statue."""

    model_config = _FROZEN

    projection: Literal["perspective", "spherical"] = Field(
        default="perspective", description="Rays through a flat grid, or equal steps of two angles."
    )
    rows: int = Field(default=300, ge=2, le=20000, description="Rays from top to bottom.")
    cols: int = Field(default=220, ge=2, le=20000, description="Rays from left to right.")
    vertical_fov_deg: float = Field(
        default=46.0, gt=0.1, lt=170.0, description="Field of view, height."
    )
    horizontal_fov_deg: float = Field(
        default=34.0, gt=0.1, lt=360.0, description="Field of view, width."
    )
    depth_sigma_m: float = Field(
        default=0.0005,
        ge=0.0,
        le=1.0,
        description="Range noise along the ray at the reference distance.",
    )
    reference_distance_m: float = Field(
        default=1.5,
        gt=0.0,
        le=1000.0,
        description="Where depth_sigma_m holds; noise grows with (d/d0)².",
    )
    angular_jitter_rad: float = Field(
        default=3e-5,
        ge=0.0,
        le=0.01,
        description="How far the beam strays from its nominal direction.",
    )
    beam_divergence_rad: float = Field(
        default=8e-4,
        ge=0.0,
        le=0.05,
        description="Full opening angle of the beam; 0 has no mixed pixels.",
    )
    footprint_rays: int = Field(
        default=7,
        ge=1,
        le=61,
        description="Rays that sample the footprint, the beam's axis among them.",
    )
    mixed_step_min_m: float = Field(
        default=0.004,
        gt=0.0,
        description="A depth step above this within the footprint mixes a pixel.",
    )
    mixed_step_max_m: float = Field(
        default=0.4,
        gt=0.0,
        description="Echoes further apart are told apart; the stronger one counts.",
    )
    min_return_share: Probability = Field(
        default=0.25,
        description="Share of the footprint that must come back for a sample to exist.",
    )
    grazing_start_deg: float = Field(
        default=75.0,
        ge=0.0,
        lt=90.0,
        description="Incidence angle from which samples begin to drop out.",
    )
    grazing_dropout: Probability = Field(
        default=0.9, description="Probability of a dropout at 90°, reached linearly in the angle."
    )
    dark_signal: float = Field(
        default=0.06,
        ge=0.0,
        le=1.0,
        description="Reflectance × cosine below which samples drop out.",
    )
    dark_dropout: Probability = Field(
        default=0.35,
        description="Probability of a dropout without signal, falling to 0 at dark_signal.",
    )
    stray_probability: Probability = Field(
        default=0.0002,
        description="Probability of a sample at a random range before the surface (dust).",
    )
    reflectance_sigma: float = Field(
        default=0.04, ge=0.0, le=1.0, description="Relative noise of the reflectance channel."
    )
    reflectance_floor_sigma: float = Field(
        default=0.004, ge=0.0, le=1.0, description="Absolute noise of the reflectance channel."
    )
    min_range_m: float = Field(default=0.2, ge=0.0, description="Nearer surfaces give no sample.")
    max_range_m: float = Field(default=4.0, gt=0.0, description="Farther surfaces give no sample.")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.projection == "perspective" and self.horizontal_fov_deg >= 170.0:
            raise ValueError("a perspective grid needs horizontal_fov_deg below 170")
        if self.mixed_step_max_m <= self.mixed_step_min_m:
            raise ValueError("mixed_step_max_m must exceed mixed_step_min_m")
        if self.max_range_m <= self.min_range_m:
            raise ValueError("max_range_m must exceed min_range_m")
        return self


class StationOptions(BaseModel):
    """Where the scanner stands. Defaults suit the statue."""

    model_config = _FROZEN

    standoff_m: float = Field(
        default=1.65,
        gt=0.0,
        le=1000.0,
        description="Distance from the object's middle (building: walls).",
    )
    standoff_spread: float = Field(
        default=0.06, ge=0.0, lt=0.9, description="Relative spread (uniform, ±) of that distance."
    )
    aim_spread_m: float = Field(
        default=0.03,
        ge=0.0,
        le=100.0,
        description="Spread (uniform, ±) of the point that is aimed at.",
    )


class CoarsePoseOptions(BaseModel):
    """How wrong the poses are that the pipeline starts from. Defaults suit the statue."""

    model_config = _FROZEN

    rotation_sigma_deg: float = Field(
        default=1.0,
        ge=0.0,
        le=90.0,
        description="Standard deviation of each part of the rotation vector.",
    )
    translation_sigma_m: float = Field(
        default=0.008,
        ge=0.0,
        le=1000.0,
        description="Standard deviation of each part of the shift.",
    )
    pivot: Literal["object", "scanner"] = Field(
        default="object",
        description="The rotation error turns about the object's middle, as with picked points, "
        "or about the scanner, as with a compass.",
    )


class SimulationOptions(BaseModel):
    """A scene, how finely it is scanned, and every fault of the scans.

    What is not given is filled in for the scene and size, so a saved copy is complete.
    """

    model_config = _FROZEN

    scene: SceneName = Field(default="statue", description="What is scanned.")
    size: SizeName = Field(
        default="small", description="Sample spacing; for the statue about 4.5, 2 and 1 mm."
    )
    seed: int = Field(default=0, ge=0, le=2**63 - 1, description="Same seed, same bytes.")
    scans: int = Field(default=12, ge=1, le=999, description="Number of scans.")
    mesh_spacing_m: float = Field(
        default=0.0045, gt=0.0, le=1.0, description="Lattice spacing of the carved true surface."
    )
    world_offset_m: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 0.0), description="World coordinates of the scene's own origin."
    )
    scanner: ScannerOptions = Field(
        default=ScannerOptions(), description="The scanner and its faults."
    )
    stations: StationOptions = Field(
        default=StationOptions(), description="Where the scanner stands."
    )
    coarse_poses: CoarsePoseOptions = Field(
        default=CoarsePoseOptions(), description="Errors of the poses that the pipeline gets."
    )

    @model_validator(mode="before")
    @classmethod
    def _filled(cls, given: Any) -> Any:
        if not isinstance(given, dict):
            return given
        scene, size = given.get("scene", "statue"), given.get("size", "small")
        defaults = scene_defaults(scene, size) if isinstance(scene, str) else {}
        filled = {**defaults, **given}
        for name, values in defaults.items():
            if isinstance(values, dict) and isinstance(given.get(name), dict):
                filled[name] = {**values, **given[name]}
        return filled
