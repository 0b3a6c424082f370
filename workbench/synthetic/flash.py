"""The flash of each photograph: where it is, how it shines, how strong it was."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.geometry import transforms
from workbench.synthetic.photo_options import CameraOptions, FlashOptions

# Saturation-based speed (ISO 12232): a mid grey of 18 % fills 12.8 % of the scale, hence a
# white one 71 %.
_WHITE_LEVEL_AT_GUIDE = 0.128 / 0.18
# Light meters and sensors: exposure in lux seconds that saturates at ISO 100 (ISO 12232).
_SATURATION_LUX_S = 78.0 / 100.0


@dataclass(frozen=True)
class Flash:
    """One flash in the scene's local frame.

    Attributes
    ----------
    middle : (3,) metres.
    across, down : (3,) edges of its window, metres.
    axis : (3,) unit vector along which it shines strongest.
    falloff : loss of intensity per squared tangent of the angle to the axis.
    power : relative to the nominal power.
    """

    middle: NDArray[np.float64]
    across: NDArray[np.float64]
    down: NDArray[np.float64]
    axis: NDArray[np.float64]
    falloff: float
    power: float


def flash_at(
    options: FlashOptions,
    local_from_camera: NDArray[np.float64],
    corner_slope: float,
    power: float,
) -> Flash:
    """The flash on a camera.

    Parameters
    ----------
    options : position, size and beam in the camera frame.
    local_from_camera : 4×4 pose of the camera.
    corner_slope : tangent of the field angle at the frame's corner.
    power : relative to the nominal power.
    """
    right, down = np.tan(np.radians(options.beam_tilt_deg))
    axis = np.array([right, down, 1.0])
    return Flash(
        transforms.apply(local_from_camera, np.array(options.offset_in_camera_m)),
        transforms.rotate(local_from_camera, np.array([options.size_m[0], 0.0, 0.0])),
        transforms.rotate(local_from_camera, np.array([0.0, options.size_m[1], 0.0])),
        transforms.rotate(local_from_camera, axis / np.linalg.norm(axis)),
        options.edge_falloff / corner_slope**2,
        power,
    )


def flash_power(options: FlashOptions, distance_ratio: float, rng: np.random.Generator) -> float:
    """Power of one firing relative to the nominal power.

    Parameters
    ----------
    options : mode and spread; 0 where it is off.
    distance_ratio : distance to the subject over the path's nominal one; a metered flash
        makes up for it and errs by about a sixth of a stop.
    rng : draws the same count of numbers in both modes.
    """
    spread, metering = rng.standard_normal(2)
    power = np.exp(options.power_sigma * spread)
    if options.mode == "ttl":
        power *= distance_ratio**2 * np.exp(0.12 * metering)
    return float(power) if options.mode != "off" else 0.0


def flash_exposure(options: FlashOptions, camera: CameraOptions) -> float:
    """Level of a white diffuser that squarely faces the flash at 1 m; 1 is the full scale."""
    return float(
        _WHITE_LEVEL_AT_GUIDE * (options.guide_number_m / camera.f_number) ** 2 * camera.iso / 100
    )


def ambient_exposure(options: FlashOptions, camera: CameraOptions) -> float:
    """Level of a white diffuser under the ambient light alone; 1 is the full scale.

    A diffuser of luminance L = E/π gives π/4 · L / N² on the sensor.
    """
    lux_s = 0.25 * options.ambient_lux / camera.f_number**2 * camera.exposure_time_s
    return float(lux_s * camera.iso / 100 / _SATURATION_LUX_S)
