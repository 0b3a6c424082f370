"""What can be chosen about simulated photographs."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from workbench.synthetic.photo_presets import photo_defaults

_FROZEN = ConfigDict(extra="forbid", frozen=True)
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Vector = tuple[float, float, float]


class CameraOptions(BaseModel):
    """Body, lens and settings of the camera. Defaults: a 24 × 36 mm frame with a 50 mm lens."""

    model_config = _FROZEN

    long_side_px: int = Field(default=1200, ge=16, le=20000, description="Long side, pixels, even.")
    short_side_px: int = Field(
        default=800, ge=16, le=20000, description="Short side, pixels, even."
    )
    held: Literal["upright", "level"] = Field(
        default="upright", description="Long side vertical, as for a standing figure, or level."
    )
    sensor_long_side_mm: float = Field(
        default=36.0, gt=1.0, le=200.0, description="Size of the sensor along its long side."
    )
    focal_length_mm: float = Field(
        default=50.0, gt=1.0, le=1000.0, description="As engraved on the lens and told in EXIF."
    )
    focal_deviation: float = Field(
        default=0.012,
        ge=-0.2,
        le=0.2,
        description="How much longer the lens truly is, relative to the engraved focal length.",
    )
    principal_offset: tuple[float, float] = Field(
        default=(0.004, -0.003),
        description="Shift of the principal point (right, down) in long sides.",
    )
    model: Literal["SIMPLE_RADIAL", "RADIAL", "OPENCV"] = Field(
        default="OPENCV", description="COLMAP's name of the lens distortion model."
    )
    distortion: tuple[float, float, float, float] = Field(
        default=(-0.09, 0.05, 0.0004, -0.0003),
        description="k1, k2, p1, p2; SIMPLE_RADIAL uses the first, RADIAL the first two.",
    )
    f_number: float = Field(default=11.0, ge=0.7, le=64.0, description="Aperture.")
    exposure_time_s: float = Field(default=1 / 250, gt=0.0, le=60.0, description="Shutter time.")
    iso: int = Field(default=200, ge=25, le=25600, description="Sensitivity; sets the gain.")
    focus: Literal["everywhere", "thin lens"] = Field(
        default="everywhere",
        description="Sharp at all distances, or blurred away from the focused distance.",
    )
    blur_sigma_px: float = Field(
        default=0.45,
        ge=0.0,
        le=5.0,
        description="Gaussian blur by diffraction and the anti-aliasing filter, pixels.",
    )
    vignetting_cosine_power: float = Field(
        default=3.0,
        ge=0.0,
        le=8.0,
        description="Natural vignetting: power of the cosine of the field angle (4 in theory).",
    )
    vignetting_corner_loss: Share = Field(
        default=0.06,
        description="Further loss at the corners by the lens barrel; grows with radius⁴.",
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.long_side_px % 2 or self.short_side_px % 2:
            raise ValueError("a Bayer mosaic needs even sides")
        if self.short_side_px > self.long_side_px:
            raise ValueError("short_side_px must not exceed long_side_px")
        return self

    @property
    def width_px(self) -> int:
        """Columns of the photograph."""
        return self.short_side_px if self.held == "upright" else self.long_side_px

    @property
    def height_px(self) -> int:
        """Rows of the photograph."""
        return self.long_side_px if self.held == "upright" else self.short_side_px

    @property
    def pixel_pitch_mm(self) -> float:
        """Distance between photosites, millimetres."""
        return self.sensor_long_side_mm / self.long_side_px


class SensorOptions(BaseModel):
    """A Bayer sensor with 14 bits and its noise."""

    model_config = _FROZEN

    cfa: Literal["RGGB", "BGGR", "GRBG", "GBRG"] = Field(
        default="RGGB", description="Filter colours of the upper left 2×2 photosites."
    )
    black_level: int = Field(
        default=600, ge=0, le=4000, description="Digital number of no light (14 bits)."
    )
    white_level: int = Field(
        default=15892, ge=1000, le=16383, description="Digital number of saturation (14 bits)."
    )
    full_well_e: float = Field(
        default=58000.0,
        ge=100.0,
        le=1e6,
        description="Electrons at the white level at ISO 100; the gain follows from it.",
    )
    read_noise_e: float = Field(
        default=5.0, ge=0.0, le=200.0, description="Noise of reading a photosite, electrons RMS."
    )
    dark_current_e_per_s: float = Field(
        default=2.0, ge=0.0, le=1e4, description="Electrons per second without light."
    )
    prnu: float = Field(
        default=0.004,
        ge=0.0,
        le=0.1,
        description="Fixed relative spread of the photosites' sensitivity.",
    )
    response_deviation: float = Field(
        default=0.02,
        ge=0.0,
        le=0.2,
        description="How far this body's colour response strays from the matrix in its files.",
    )
    neutral_deviation: float = Field(
        default=0.03,
        ge=0.0,
        le=0.3,
        description="Relative error of the white balance that the camera writes.",
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.white_level <= self.black_level + 100:
            raise ValueError("white_level must exceed black_level by more than 100")
        return self


class FlashOptions(BaseModel):
    """The flash on its bracket, and what other light there is."""

    model_config = _FROZEN

    guide_number_m: float = Field(
        default=17.0,
        gt=0.0,
        le=200.0,
        description="f-number × metres at ISO 100 that exposes a mid grey correctly.",
    )
    offset_in_camera_m: Vector = Field(
        default=(-0.13, -0.03, 0.01),
        description="Middle of the flash in the camera frame (right, down, forward).",
    )
    size_m: tuple[float, float] = Field(
        default=(0.06, 0.04), description="Width and height of its window; 0 is a point."
    )
    edge_falloff: Share = Field(
        default=0.076,
        description="Loss of intensity at the frame's corner against the beam's axis "
        "(Jaspe 2018, 3.4.2: 7.6 %).",
    )
    beam_tilt_deg: tuple[float, float] = Field(
        default=(1.5, -1.0), description="Direction of the beam's axis: to the right, downwards."
    )
    mode: Literal["manual", "ttl", "off"] = Field(
        default="manual",
        description="Same power each time, metered for each photograph, or no flash at all.",
    )
    power_sigma: float = Field(
        default=0.01,
        ge=0.0,
        le=0.5,
        description="Spread of the power between photographs, natural logarithm; ttl adds its own.",
    )
    temperature_k: float = Field(
        default=5600.0, ge=3000.0, le=9000.0, description="Correlated colour temperature."
    )
    ambient_lux: float = Field(
        default=3.0,
        ge=0.0,
        le=1e5,
        description="Light that leaks into the dark room, from above; or the daylight.",
    )
    sky: Share = Field(
        default=0.0, description="Level of what is behind all things; 1 is the full scale."
    )
    ambient_color: Vector = Field(
        default=(1.35, 1.0, 0.5),
        description="Linear RGB of that light relative to the flash.",
    )


class SurfaceOptions(BaseModel):
    """How surfaces are painted and how they reflect."""

    model_config = _FROZEN

    paint: Literal["painted", "stone"] = Field(
        default="painted", description="Worn paint over stone, or bare weathered stone."
    )
    oren_nayar_sigma_deg: float = Field(
        default=15.0,
        ge=0.0,
        le=60.0,
        description="Roughness of the diffuse reflection (Oren and Nayar 1994); 0 is Lambert.",
    )
    varnish: Share = Field(
        default=1.0, description="Strength of the specular reflection; 0 leaves it out."
    )
    surroundings: Literal["none", "table", "floor"] = Field(
        default="table", description="What the support stands on."
    )
    indirect_rays: int = Field(
        default=24,
        ge=0,
        le=1024,
        description="Rays per vertex for light reflected once by other surfaces; 0 has none.",
    )


class PathOptions(BaseModel):
    """Where the photographs are taken from."""

    model_config = _FROZEN

    kind: Literal["walk-round", "turntable", "along walls"] = Field(
        default="walk-round",
        description="A hand-held camera carried round, a tripod before a turning object, or a "
        "walk along the walls of a building.",
    )
    distance_m: float = Field(
        default=2.0,
        gt=0.05,
        le=1000.0,
        description="From the camera to the object's middle, or to the walls.",
    )
    turns: int = Field(default=1, ge=1, le=50, description="Rounds, each at its own height.")
    elevations_deg: tuple[float, ...] = Field(
        default=(12.0, 38.0, -8.0, 24.0, 56.0),
        min_length=1,
        description="Elevation of each round; used again from the first after the last.",
    )
    elevation_swing_deg: float = Field(
        default=10.0,
        ge=0.0,
        le=60.0,
        description="Successive photographs of a walk-round alternate about it by this much.",
    )
    position_sigma_m: float = Field(
        default=0.03, ge=0.0, le=10.0, description="Spread of a hand-held camera's position."
    )
    aim_sigma_m: float = Field(
        default=0.02, ge=0.0, le=10.0, description="Spread of the point it is aimed at."
    )
    roll_sigma_deg: float = Field(
        default=1.5, ge=0.0, le=90.0, description="Spread of its rotation about the view axis."
    )


class ChartOptions(BaseModel):
    """Calibration targets."""

    model_config = _FROZEN

    color_frames: int = Field(default=2, ge=0, le=20, description="Photographs of the chart.")
    color_distance_m: float = Field(
        default=1.9, gt=0.1, le=20.0, description="From the camera to the middle of the chart."
    )
    color_tilt_deg: float = Field(
        default=18.0, ge=0.0, le=70.0, description="Angle between the view and the chart's normal."
    )
    flat_frames: int = Field(
        default=1, ge=0, le=20, description="Photographs of an even white target."
    )
    flat_distance_m: float = Field(
        default=2.0, gt=0.1, le=20.0, description="From the camera to the even target."
    )
    flat_reflectance: float = Field(
        default=0.9, gt=0.0, le=1.0, description="Of the white target, equal in all channels."
    )
    linearity_distances_m: tuple[float, ...] = Field(
        default=(1.9, 2.2, 2.6, 3.1, 3.7, 4.5),
        description="Distances of the white target in the linearity series.",
    )


class RenderingOptions(BaseModel):
    """How finely the pictures are computed; changes noise of the picture, never its model."""

    model_config = _FROZEN

    samples_per_pixel: Literal[1, 2, 4, 8, 16] = Field(
        default=4, description="Rays through every pixel."
    )
    edge_samples: Literal[0, 4, 8, 16, 32] = Field(
        default=8, description="Further rays where a pixel borders on an edge or a shadow."
    )
    truth: Literal["masks", "albedo", "full"] = Field(
        default="albedo",
        description="What is written of the truth at every pixel: masks; also albedo; also depth.",
    )


class PhotoOptions(BaseModel):
    """A series of flash photographs of a scene, and of calibration targets.

    What is not given is filled in for the size, so a saved copy is complete.
    """

    model_config = _FROZEN

    size: Literal["small", "medium", "large"] = Field(
        default="small", description="24 × 1200 × 800, 68 × 3000 × 2000, 400 × 6000 × 4000 pixels."
    )
    seed: int = Field(default=0, ge=0, le=2**63 - 1, description="Same seed, same bytes.")
    photos: int = Field(default=24, ge=1, le=9999, description="Number of photographs.")
    camera: CameraOptions = Field(default=CameraOptions(), description="Camera and lens.")
    sensor: SensorOptions = Field(default=SensorOptions(), description="Sensor and its noise.")
    flash: FlashOptions = Field(default=FlashOptions(), description="Flash and other light.")
    surface: SurfaceOptions = Field(default=SurfaceOptions(), description="Paint and reflection.")
    path: PathOptions = Field(default=PathOptions(), description="Where the camera stands.")
    charts: ChartOptions = Field(default=ChartOptions(), description="Calibration targets.")
    rendering: RenderingOptions = Field(
        default=RenderingOptions(), description="How finely pictures are computed."
    )

    @model_validator(mode="before")
    @classmethod
    def _filled(cls, given: Any) -> Any:
        if not isinstance(given, dict):
            return given
        size = given.get("size", "small")
        defaults = photo_defaults(size) if isinstance(size, str) else {}
        filled = {**defaults, **given}
        for name, values in defaults.items():
            if isinstance(values, dict) and isinstance(given.get(name), dict):
                filled[name] = {**values, **given[name]}
        return filled
