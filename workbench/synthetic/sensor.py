"""From light to digital numbers: colour response, mosaic, noise, saturation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.synthetic.photo_options import SensorOptions

XYZ_FROM_REC709 = np.array(
    [
        [0.4123908, 0.3575843, 0.1804808],
        [0.2126390, 0.7151687, 0.0721923],
        [0.0193308, 0.1191948, 0.9505322],
    ]
)
"""Linear Rec. 709 to CIE XYZ relative to D65 (ITU-R BT.709)."""

# Plausible for a full-frame sensor: CIE XYZ to camera RGB under D65 and under illuminant A.
COLOR_MATRIX_D65 = np.array(
    [[0.7866, -0.2108, -0.0555], [-0.4869, 1.2483, 0.2681], [-0.1176, 0.2069, 0.7501]]
)
COLOR_MATRIX_A = np.array(
    [[0.8354, -0.2586, -0.0489], [-0.4713, 1.2267, 0.2757], [-0.0913, 0.1648, 0.7213]]
)
_A_KELVIN, _D65_KELVIN = 2856.0, 6504.0
_CHANNEL = {"R": 0, "G": 1, "B": 2}
_PATTERN_ROWS = 64


@dataclass(frozen=True)
class Sensor:
    """One camera body's sensor at one sensitivity.

    Attributes
    ----------
    options : levels and noise.
    iso : sensitivity.
    camera_from_scene : (3, 3) camera RGB from linear Rec. 709; white gives ``neutral``.
    neutral : (3,) camera RGB of white under the flash, green 1.
    as_shot_neutral : (3,) what the camera writes for it, largest 1.
    seed : of the fixed pattern and of this body's colour response.
    """

    options: SensorOptions
    iso: int
    camera_from_scene: NDArray[np.float64]
    neutral: NDArray[np.float64]
    as_shot_neutral: NDArray[np.float64]
    seed: int

    @classmethod
    def from_options(
        cls, options: SensorOptions, iso: int, temperature_k: float, seed: int
    ) -> Sensor:
        """The sensor under light of a correlated colour temperature.

        Scene-linear RGB is what the object would send out under a white light. A raw
        converter that divides by the neutral and applies the inverse of the D65 matrix,
        rows scaled so that white stays white, gets it back — apart from this body's own
        deviations.
        """
        neutral = _neutral(temperature_k)
        published = COLOR_MATRIX_D65 @ XYZ_FROM_REC709
        published /= published.sum(axis=1, keepdims=True)
        rng = _stream(seed, 0)
        strays = published * (1 + options.response_deviation * rng.standard_normal((3, 3)))
        strays /= strays.sum(axis=1, keepdims=True)
        told = neutral * np.exp(options.neutral_deviation * rng.standard_normal(3) * [1, 0, 1])
        return cls(options, iso, neutral[:, None] * strays, neutral, told / told.max(), seed)

    @property
    def range_dn(self) -> int:
        """Digital numbers between no light and saturation."""
        return self.options.white_level - self.options.black_level

    @property
    def full_scale_e(self) -> float:
        """Electrons at the white level."""
        return self.options.full_well_e * 100 / self.iso

    @property
    def gain_e_per_dn(self) -> float:
        """Electrons per digital number."""
        return self.full_scale_e / self.range_dn

    @property
    def noise_profile(self) -> tuple[float, float]:
        """Scale and offset of the variance of the signal in [0, 1] (DNG's NoiseProfile)."""
        return 1.0 / self.full_scale_e, (self.options.read_noise_e / self.full_scale_e) ** 2

    def mosaic_channel(self, first_row: int, rows: int, cols: int) -> NDArray[np.int64]:
        """Which of R, G, B (0, 1, 2) each photosite (rows, cols) sees."""
        pattern = np.array([_CHANNEL[letter] for letter in self.options.cfa]).reshape(2, 2)
        down, right = first_row + np.arange(rows)[:, None], np.arange(cols)[None, :]
        channel: NDArray[np.int64] = pattern[down % 2, right % 2]
        return channel

    def exposed(
        self,
        light: NDArray[np.float64],
        first_row: int,
        exposure_time_s: float,
        rng: np.random.Generator,
    ) -> NDArray[np.uint16]:
        """Digital numbers (rows, cols) uint16 of a strip of the picture.

        Parameters
        ----------
        light : (rows, cols, 3) scene-linear RGB on the sensor; 1 in green saturates.
        first_row : where the strip begins.
        exposure_time_s : for the dark current.
        rng : the noise of this strip alone.
        """
        rows, cols = light.shape[:2]
        weights = self.camera_from_scene[self.mosaic_channel(first_row, rows, cols)]
        signal = np.maximum(np.einsum("ijk,ijk->ij", light, weights), 0.0) * self.full_scale_e
        signal *= self._sensitivity(first_row, rows, cols)
        signal += self.options.dark_current_e_per_s * exposure_time_s
        # Above the full well nothing is collected; far above it the Poisson draw has no use.
        electrons = rng.poisson(np.minimum(signal, 2.0 * self.full_scale_e)).astype(np.float64)
        electrons += self.options.read_noise_e * rng.standard_normal(electrons.shape)
        numbers = np.rint(electrons / self.gain_e_per_dn + self.options.black_level)
        kept = np.clip(numbers, 0, self.options.white_level)
        digital: NDArray[np.uint16] = kept.astype(np.uint16)
        return digital

    def preview(self, mosaic: NDArray[np.uint16], long_side: int = 256) -> NDArray[np.uint8]:
        """A small sRGB-encoded picture (h, w, 3) uint8 of a mosaic, as the camera sees it."""
        step = 2 * max(1, -(-max(mosaic.shape) // (2 * long_side)))
        rows, cols = (max(1, side // step) for side in mosaic.shape)
        whole = mosaic[: rows * step, : cols * step]
        if whole.size == 0:
            whole, rows, cols, step = mosaic[:2, :2], 1, 1, 2
        level = (whole.astype(np.float32) - self.options.black_level) / self.range_dn
        channel = self.mosaic_channel(0, *whole.shape)
        color = np.empty((rows, cols, 3))
        for k in range(3):
            chosen = np.where(channel == k, level, 0.0).reshape(rows, step, cols, step)
            share = (channel == k).mean()
            color[..., k] = chosen.mean(axis=(1, 3)) / share
        published = COLOR_MATRIX_D65 @ XYZ_FROM_REC709
        published /= published.sum(axis=1, keepdims=True)
        linear = np.minimum(color / self.as_shot_neutral, 1.0) @ np.linalg.inv(published).T
        linear = np.clip(linear, 0.0, 1.0)
        encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        small: NDArray[np.uint8] = np.rint(255.0 * encoded).astype(np.uint8)
        return small

    def _sensitivity(self, first_row: int, rows: int, cols: int) -> NDArray[np.float64]:
        """Fixed relative sensitivity (rows, cols) of the photosites."""
        if self.options.prnu == 0.0:
            return np.ones((rows, cols))
        # Drawn in fixed blocks of rows: a photosite keeps its own whatever strip is asked for.
        first, last = first_row // _PATTERN_ROWS, (first_row + rows - 1) // _PATTERN_ROWS
        blocks = [
            _stream(self.seed, 1, block).standard_normal((_PATTERN_ROWS, cols), np.float32)
            for block in range(first, last + 1)
        ]
        start = first_row - first * _PATTERN_ROWS
        pattern = np.concatenate(blocks)[start : start + rows]
        return 1.0 + self.options.prnu * pattern.astype(np.float64)


def _neutral(temperature_k: float) -> NDArray[np.float64]:
    """Camera RGB (3,) of white light, green 1; DNG 1.4, chapter 6, interpolates the matrices."""
    share = (1 / temperature_k - 1 / _D65_KELVIN) / (1 / _A_KELVIN - 1 / _D65_KELVIN)
    share = min(max(share, 0.0), 1.0)
    matrix = share * COLOR_MATRIX_A + (1 - share) * COLOR_MATRIX_D65
    x, y = _daylight_xy(temperature_k)
    white = matrix @ [x / y, 1.0, (1 - x - y) / y]
    neutral: NDArray[np.float64] = white / white[1]
    return neutral


def _daylight_xy(temperature_k: float) -> tuple[float, float]:
    """Chromaticity of daylight, extended below 4000 K by the Planckian locus (Kim 2002)."""
    t = 1e3 / temperature_k
    if temperature_k >= 4000.0:
        if temperature_k <= 7000.0:
            x = 0.244063 + 0.09911 * t + 2.9678 * t**2 - 4.6070 * t**3
        else:
            x = 0.237040 + 0.24748 * t + 1.9018 * t**2 - 2.0064 * t**3
        return x, -3.0 * x**2 + 2.870 * x - 0.275
    x = -0.2661239 * t**3 - 0.2343589 * t**2 + 0.8776956 * t + 0.179910
    return x, -0.9549476 * x**3 - 1.37418593 * x**2 + 2.09137015 * x - 0.16748867


def _stream(seed: int, *key: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(30, *key)))
