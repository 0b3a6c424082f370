"""What colour surfaces have: reflectance as a function of the point and its material."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from workbench.kernels import weathered_paint as kernel
from workbench.synthetic.photo_options import SurfaceOptions
from workbench.synthetic.scene import OBJECT, SUPPORT, Scene

SURROUNDINGS = 2
# Pigments in linear Rec. 709: madder, Egyptian blue, malachite, yellow ochre, flesh, umber.
_PALETTE = {
    kernel.DRESS: (0.40, 0.085, 0.055),
    kernel.MANTLE: (0.070, 0.150, 0.33),
    kernel.TRIM: (0.085, 0.210, 0.105),
    kernel.BAND: (0.58, 0.36, 0.075),
    kernel.SKIN: (0.56, 0.315, 0.205),
    kernel.HAIR: (0.135, 0.068, 0.036),
}
_METAL = np.array([0.046, 0.056, 0.076])
_CLOTH = np.array([0.075, 0.092, 0.080])
# Where the bare base of the statue ends, above the ground.
_BASE_TOP_M = 0.088
_FIGURE_HEIGHT_M = 1.2
_PAINT_STREAM = 20


@dataclass(frozen=True)
class SurfacePaint:
    """The look of n surface points.

    Attributes
    ----------
    albedo : (n, 3) float32 diffuse reflectance, linear Rec. 709, relative to a perfect
        white diffuser.
    gloss : (n,) float32 strength of the specular lobe; 1 reflects 4 % at normal incidence.
    roughness : (n,) float32 GGX α of that lobe.
    """

    albedo: NDArray[np.float32]
    gloss: NDArray[np.float32]
    roughness: NDArray[np.float32]


class Paint(Protocol):
    """Anything that says how points of each material look."""

    def at(self, points: NDArray[np.float64], material: NDArray[np.uint8]) -> SurfacePaint:
        """The look of points (n, 3) in the subject's local frame with materials (n,)."""


@dataclass(frozen=True)
class WeatheredPaint:
    """Worn paint on stone for the object, mottled metal for its support, cloth around.

    Attributes
    ----------
    palette : (zones, 3) linear RGB, or (0, 3) for bare stone.
    scale : size of the patterns relative to those of a figure of 1.2 m.
    height : of the object, metres.
    base_top : local height below which the stone is bare.
    seed : which pattern; below 2³⁰.
    """

    palette: NDArray[np.float64]
    scale: float
    height: float
    base_top: float
    seed: int

    @classmethod
    def of(cls, scene: Scene, options: SurfaceOptions, seed: int) -> WeatheredPaint:
        """The paint of a scene; only a statue is painted, the rest is bare weathered stone."""
        figure = scene.name == "statue"
        own = scene.surface.vertices[scene.material == OBJECT]
        height = float(own[:, 2].max()) if figure else 1.0
        scale = 1.0 if figure else max(1.0, float(np.ptp(own, axis=0).max()) / _FIGURE_HEIGHT_M)
        palette = np.zeros((0, 3))
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_PAINT_STREAM,)))
        batch = np.exp(rng.normal(0.0, 0.06, (kernel.ZONES, 3)))
        if figure and options.paint == "painted":
            palette = batch * np.array([_PALETTE[zone] for zone in range(kernel.ZONES)])
        return cls(palette, scale, height, _BASE_TOP_M, int(rng.integers(1, 2**30)))

    def at(self, points: NDArray[np.float64], material: NDArray[np.uint8]) -> SurfacePaint:
        """See `Paint.at`."""
        n = len(points)
        albedo = np.zeros((n, 3), np.float32)
        gloss = np.zeros(n, np.float32)
        roughness = np.full(n, 0.6, np.float32)
        for kind in (OBJECT, SUPPORT, SURROUNDINGS):
            rows = np.flatnonzero(material == kind)
            if not len(rows):
                continue
            place = np.ascontiguousarray(points[rows], float)
            if kind == OBJECT:
                albedo[rows], gloss[rows], roughness[rows] = kernel.object_paint(
                    place, self.scale, self.height, self.base_top, self.palette, self.seed
                )
            elif kind == SUPPORT:
                albedo[rows] = kernel.mottled_color(
                    place, _METAL, 0.06, 0.005, 0.22, self.seed + 40
                )
                gloss[rows], roughness[rows] = 3.0, 0.26
            else:
                albedo[rows] = kernel.mottled_color(
                    place, _CLOTH, 0.30, 0.004, 0.16, self.seed + 50
                )
        return SurfacePaint(albedo, gloss, roughness)
