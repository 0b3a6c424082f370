"""From a scene and options to photographs, each reproducible on its own."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from workbench.formats.dng import DngMetadata
from workbench.synthetic import chart
from workbench.synthetic.camera import local_from_camera
from workbench.synthetic.flash import (
    Flash,
    ambient_exposure,
    flash_at,
    flash_exposure,
    flash_power,
)
from workbench.synthetic.indirect import Exchange
from workbench.synthetic.lens import Lens
from workbench.synthetic.photo_options import PhotoOptions
from workbench.synthetic.rendering import STRIP_ROWS, View, depths, rendered_strip
from workbench.synthetic.scene import Scene
from workbench.synthetic.sensor import COLOR_MATRIX_A, COLOR_MATRIX_D65, Sensor
from workbench.synthetic.subject import Subject

MAKE, MODEL, LENS = "Scan Workbench", "Simulated Flash Camera", "Simulated 50mm f/2.8 Macro"
_SERIAL, _SOFTWARE = "000001", "scan-workbench simulate"
_FIRST_SHOT = datetime(2024, 5, 14, 9, 0, 0)
_ALBEDO_FULL_SCALE = 65535
# First entries of the spawn keys: independent streams of one seed.
_STREAMS = {"photo": 21, "chart": 22, "flat": 23, "linearity": 24}
_POSE, _POWER, _NOISE = range(3)

Kind = Literal["photo", "chart", "flat", "linearity"]


@dataclass(frozen=True)
class Photograph:
    """One photograph with its truth.

    Attributes
    ----------
    name : ``photo_000`` and so on.
    mosaic : (rows, cols) uint16 digital numbers as the camera writes them.
    metadata : what its file says.
    preview : (h, w, 3) uint8 sRGB-encoded.
    local_from_camera : 4×4 true pose; x right, y down, z forward.
    flash : true flash in the scene's local frame.
    object_mask, support_mask : (rows, cols) uint8, 255 where more than half of the pixel
        shows the object, at least half of it the support, else 0.
    shadow_mask : (rows, cols) uint8, 255 where a surface is seen that gets less than half of
        the flash's light, because it is hidden from it or turned away.
    albedo : (rows, cols, 3) uint16, linear Rec. 709 reflectance × 65535, 0 where nothing is
        seen; none with truth ``masks``.
    depth : (rows, cols) float32 along the optical axis at pixel centres, metres, infinite
        for none; only with truth ``full``.
    diffuse, specular : (rows, cols, 3) and (rows, cols) float32: light on the surface in the
        level of a white diffuser and specular level, 1 is the full scale, before vignetting;
        only with truth ``full``.
    """

    name: str
    mosaic: NDArray[np.uint16]
    metadata: DngMetadata
    preview: NDArray[np.uint8]
    local_from_camera: NDArray[np.float64]
    flash: Flash
    object_mask: NDArray[np.uint8]
    support_mask: NDArray[np.uint8]
    shadow_mask: NDArray[np.uint8]
    albedo: NDArray[np.uint16] | None
    depth: NDArray[np.float32] | None
    diffuse: NDArray[np.float32] | None
    specular: NDArray[np.float32] | None


@dataclass(frozen=True)
class _Shot:
    kind: Kind
    index: int
    subject: Subject
    local_from_camera: NDArray[np.float64]
    focused_m: float
    power: float


@dataclass(frozen=True)
class Studio:
    """A scene with camera and flash; holds what all photographs share.

    Attributes
    ----------
    scene : as ``build_scene`` returns it.
    options : of the photographs.
    """

    scene: Scene
    options: PhotoOptions

    @cached_property
    def subject(self) -> Subject:
        """The painted scene with what it stands on."""
        return Subject.of_scene(self.scene, self.options.surface, self.options.seed)

    @cached_property
    def exchange(self) -> Exchange | None:
        """Who sees whom among the subject's surfaces, where one bounce is asked for."""
        rays = self.options.surface.indirect_rays
        return Exchange.of(self.subject, rays, self.options.seed) if rays else None

    @cached_property
    def lens(self) -> Lens:
        """The intrinsics that all photographs share."""
        return Lens.from_options(self.options.camera)

    @cached_property
    def sensor(self) -> Sensor:
        """The sensor at the chosen sensitivity."""
        options = self.options
        return Sensor.from_options(
            options.sensor, options.camera.iso, options.flash.temperature_k, options.seed
        )

    @property
    def vertex_albedo(self) -> NDArray[np.float32]:
        """Linear Rec. 709 reflectance (n, 3) at the vertices of the scene's surface."""
        return self.subject.vertex_paint.albedo[: len(self.scene.surface.vertices)]

    def __getstate__(self) -> dict[str, Any]:
        """Scene and options; a worker process derives the rest for itself."""
        return {"scene": self.scene, "options": self.options}


_studio_lock = threading.Lock()
_last_studio: list[Studio] = []


def studio_of(scene: Scene, options: PhotoOptions) -> Studio:
    """The studio for a scene and options; the last one is kept, since building costs seconds."""
    with _studio_lock:
        if _last_studio and _last_studio[0].scene is scene and _last_studio[0].options == options:
            return _last_studio[0]
        _last_studio[:] = [Studio(scene, options)]
        return _last_studio[0]


def photo_name(index: int) -> str:
    """Name of a photograph, ``photo_000`` for the first."""
    return f"photo_{index:03d}"


def photograph(scene: Scene, options: PhotoOptions, index: int) -> Photograph:
    """One photograph of a scene, the same whatever others are taken, and where.

    Parameters
    ----------
    scene : as ``build_scene`` returns it; it can be sent to another process.
    options : of the photographs.
    index : which one, in [0, ``options.photos``).
    """
    studio = studio_of(scene, options)
    path = options.path
    rng = _stream(options.seed, "photo", index, _POSE)
    pose = local_from_camera(scene.focus, path, options.photos, index, rng)
    distance = float(np.linalg.norm(pose[:3, 3] - scene.focus))
    power = flash_power(
        options.flash,
        distance / path.distance_m,
        _stream(options.seed, "photo", index, _POWER),
    )
    shot = _Shot("photo", index, studio.subject, pose, distance, power)
    return _taken(studio, shot, photo_name(index))


def chart_photograph(scene: Scene, options: PhotoOptions, index: int) -> Photograph:
    """One photograph of the ColorChecker, tilted another way each time."""
    charts = options.charts
    pose = chart.facing_pose(
        charts.color_distance_m,
        charts.color_tilt_deg,
        35.0 + 137.5 * index,
        _stream(options.seed, "chart", index, _POSE),
    )
    power = flash_power(options.flash, 1.0, _stream(options.seed, "chart", index, _POWER))
    shot = _Shot("chart", index, chart.chart_subject(), pose, charts.color_distance_m, power)
    return _taken(studio_of(scene, options), shot, f"chart_{index:02d}")


def target_photograph(
    scene: Scene, options: PhotoOptions, kind: Literal["flat", "linearity"], index: int
) -> Photograph:
    """One photograph of the white target, squarely: a flat frame or one of the series."""
    charts = options.charts
    series = charts.linearity_distances_m
    distance = charts.flat_distance_m if kind == "flat" else series[index]
    studio = studio_of(scene, options)
    rng = _stream(options.seed, kind, index, _POSE)
    pose = chart.facing_pose(distance, 0.0, 0.0, rng)
    size = 3.0 * distance * studio.lens.corner_slope
    subject = chart.white_subject(charts.flat_reflectance, size)
    power = flash_power(options.flash, 1.0, _stream(options.seed, kind, index, _POWER))
    shot = _Shot(kind, index, subject, pose, distance, power)
    return _taken(studio, shot, f"{kind}_{index:02d}")


def _taken(studio: Studio, shot: _Shot, name: str) -> Photograph:
    """Render and expose strip by strip: memory grows with the mosaic, not with the samples."""
    options, lens, sensor = studio.options, studio.lens, studio.sensor
    view = _view(studio, shot)
    shape = (lens.height, lens.width)
    truth = options.rendering.truth
    mosaic = np.empty(shape, np.uint16)
    masks = np.zeros((3, *shape), np.uint8)
    albedo = np.empty((*shape, 3), np.uint16) if truth != "masks" else None
    diffuse = np.empty((*shape, 3), np.float32) if truth == "full" else None
    specular = np.empty(shape, np.float32) if truth == "full" else None
    for number, first in enumerate(range(0, lens.height, STRIP_ROWS)):
        rows = slice(first, min(first + STRIP_ROWS, lens.height))
        count = rows.stop - first
        strip = rendered_strip(shot.subject, view, first, count)
        mosaic[rows] = sensor.exposed(
            strip.light * lens.vignetting(first, count)[..., None],
            first,
            options.camera.exposure_time_s,
            _stream(options.seed, shot.kind, shot.index, _NOISE, number),
        )
        for mask, flag in zip(
            masks, (strip.is_object, strip.is_support, strip.in_shadow), strict=True
        ):
            mask[rows] = np.where(flag, 255, 0)
        if albedo is not None:
            scaled = np.clip(strip.albedo, 0.0, 1.0) * _ALBEDO_FULL_SCALE
            albedo[rows] = np.rint(scaled).astype(np.uint16)
        if diffuse is not None and specular is not None:
            diffuse[rows], specular[rows] = strip.diffuse, strip.specular
    return Photograph(
        name=name,
        mosaic=mosaic,
        metadata=_metadata(studio, shot),
        preview=sensor.preview(mosaic),
        local_from_camera=shot.local_from_camera,
        flash=view.flash,
        object_mask=masks[0],
        support_mask=masks[1],
        shadow_mask=masks[2],
        albedo=albedo,
        depth=depths(shot.subject, view) if truth == "full" else None,
        diffuse=diffuse,
        specular=specular,
    )


def _view(studio: Studio, shot: _Shot) -> View:
    options, lens = studio.options, studio.lens
    camera = options.camera
    flash = flash_at(options.flash, shot.local_from_camera, lens.corner_slope, shot.power)
    exposure = flash_exposure(options.flash, camera) * flash.power
    is_photo, is_even = shot.kind == "photo", shot.kind in ("flat", "linearity")
    vertex_light = None
    if is_photo and flash.power > 0.0 and studio.exchange is not None:
        vertex_light = studio.exchange.vertex_light(flash, exposure)
    sigma2 = np.radians(options.surface.oren_nayar_sigma_deg) ** 2 if is_photo else 0.0
    rough = np.array([1 - 0.5 * sigma2 / (sigma2 + 0.33), 0.45 * sigma2 / (sigma2 + 0.09)])
    radius = 0.0
    if camera.focus == "thin lens":
        radius = 0.5e-3 * camera.focal_length_mm / camera.f_number
    return View(
        lens=lens,
        local_from_camera=shot.local_from_camera,
        flash=flash,
        exposure=exposure,
        ambient=ambient_exposure(options.flash, camera) * np.array(options.flash.ambient_color),
        sky=options.flash.sky,
        vertex_light=vertex_light,
        oren_nayar=rough,
        varnish=options.surface.varnish,
        aperture=np.array([radius, shot.focused_m]),
        blur_sigma_px=camera.blur_sigma_px,
        # An even target has nothing that more than one ray could average.
        samples=1 if is_even else options.rendering.samples_per_pixel,
        edge_samples=0 if is_even else options.rendering.edge_samples,
        seed=int(_stream(options.seed, shot.kind, shot.index, _NOISE).integers(1, 2**30)),
    )


def _metadata(studio: Studio, shot: _Shot) -> DngMetadata:
    camera, sensor = studio.options.camera, studio.sensor
    order = list(_STREAMS).index(shot.kind)
    minutes = {0: 30, 1: 0, 2: 10, 3: 15}[order]
    r, g, b = (float(value) for value in sensor.as_shot_neutral)
    return DngMetadata(
        make=MAKE,
        model=MODEL,
        lens_model=LENS,
        serial_number=_SERIAL,
        software=_SOFTWARE,
        taken_at=_FIRST_SHOT + timedelta(minutes=minutes, seconds=25 * shot.index),
        cfa=sensor.options.cfa,
        black_level=sensor.options.black_level,
        white_level=sensor.options.white_level,
        color_matrix_a=COLOR_MATRIX_A,
        color_matrix_d65=COLOR_MATRIX_D65,
        as_shot_neutral=(r, g, b),
        noise_profile=sensor.noise_profile,
        exposure_time_s=camera.exposure_time_s,
        f_number=camera.f_number,
        iso=camera.iso,
        focal_length_mm=camera.focal_length_mm,
        pixel_pitch_mm=camera.pixel_pitch_mm,
        focal_length_35mm=round(camera.focal_length_mm * 36.0 / camera.sensor_long_side_mm),
        flash_fired=studio.options.flash.mode != "off",
    )


def _stream(seed: int, kind: Kind, *key: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAMS[kind], *key)))
