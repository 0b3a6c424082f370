"""Which numbers of a flash's light are fitted: how they change it, and their bounds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from workbench.color.flash_light import FlashLight, falloff_terms

FlashTerm = Literal["falloff", "roughness", "indirect"]
FALLOFF_COEFFICIENTS = 5
"""The falloff that is fitted is of second degree: a beam with its own axis and widths."""

# Lengths are in median distances of the samples. A flash is held within about half of one, and
# its beam loses about half of its light and points about where the lens does; so wide a guess
# moves nothing that photographs tell, and keeps in bounds what they do not.
_POSITION_SIGMA = 0.5
_FALLOFF_SIGMAS = np.array([0.5, 0.5, 3.0, 3.0, 3.0])
_SQUARED_ROUGHNESS_SIGMA, _INDIRECT_SIGMA = 0.3, 0.3
_DIFFERENCE = 1e-5
_MOST_SQUARED_ROUGHNESS, _MOST_INDIRECT = 1.0, 1.0


@dataclass(frozen=True)
class FlashParameters:
    """A flash's free numbers as a vector: position, falloff, squared roughness, indirect light.

    Attributes
    ----------
    position : whether the flash's place is free.
    terms : what else is.
    """

    position: bool = True
    terms: tuple[FlashTerm, ...] = ()

    @property
    def priors(self) -> NDArray[np.float64]:
        """(k,) inverse variances of the numbers about 0, before anything is seen."""
        return self._stacked(
            np.full(3, _POSITION_SIGMA**-2.0),
            _FALLOFF_SIGMAS**-2.0,
            _SQUARED_ROUGHNESS_SIGMA**-2.0,
            _INDIRECT_SIGMA**-2.0,
        )

    def values(self, light: FlashLight) -> NDArray[np.float64]:
        """The free numbers (k,) of a light."""
        falloff = light.falloff or (0.0,) * FALLOFF_COEFFICIENTS
        return self._stacked(
            light.position_in_camera, np.array(falloff), light.roughness_rad**2, light.indirect
        )

    def moved(self, light: FlashLight, change: NDArray[np.float64]) -> FlashLight:
        """The light with its free numbers changed by (k,)."""
        values = self.values(light) + change
        if self.position:
            light = replace(light, position_in_camera=values[:3])
            values = values[3:]
        if "falloff" in self.terms:
            light = replace(light, falloff=tuple(values[:FALLOFF_COEFFICIENTS].tolist()))
            values = values[FALLOFF_COEFFICIENTS:]
        if "roughness" in self.terms:
            light = replace(light, roughness_rad=float(np.sqrt(max(values[0], 0.0))))
            values = values[1:]
        if "indirect" in self.terms:
            light = replace(light, indirect=float(max(values[0], 0.0)))
        return light

    def leaves(self, values: NDArray[np.float64], step: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(k,) whether a number at its bound would go beyond."""
        low, high = self._bounds()
        return np.asarray(((values <= low) & (step < 0.0)) | ((values >= high) & (step > 0.0)))

    def inside(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """The numbers (k,), those out of bounds moved to their bound."""
        return np.clip(values, *self._bounds())

    def derivatives(
        self, places: NDArray[np.float64], normals: NDArray[np.float64], light: FlashLight
    ) -> NDArray[np.float64]:
        """Derivatives (m, k) of the logarithm of what places (m, 3) receive."""
        least = 1e-12

        def logarithm(of: FlashLight) -> NDArray[np.float64]:
            return np.log(np.maximum(of.received(places, normals), least))

        now = np.maximum(light.received(places, normals), least)
        columns: list[NDArray[np.float64]] = []
        if self.position:
            for shift in _DIFFERENCE * np.eye(3):
                ahead = replace(light, position_in_camera=light.position_in_camera + shift)
                columns.append((logarithm(ahead) - np.log(now)) / _DIFFERENCE)
        if "falloff" in self.terms:
            way = places - light.position_in_camera
            length = np.maximum(np.linalg.norm(way, axis=1), np.finfo(float).tiny)
            direct = np.maximum(now - light.indirect, 0.0) / now
            terms = falloff_terms(way / length[:, None], FALLOFF_COEFFICIENTS)
            columns += list((terms * direct[:, None]).T)
        if "roughness" in self.terms:
            rougher = float(np.sqrt(light.roughness_rad**2 + _DIFFERENCE))
            ahead = replace(light, roughness_rad=rougher)
            columns.append((logarithm(ahead) - np.log(now)) / _DIFFERENCE)
        if "indirect" in self.terms:
            columns.append(1.0 / now)
        return np.stack(columns, axis=1) if columns else np.empty((len(places), 0))

    def _bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        wide, wider = np.full(3, np.inf), np.full(FALLOFF_COEFFICIENTS, np.inf)
        low = self._stacked(-wide, -wider, 0.0, 0.0)
        return low, self._stacked(wide, wider, _MOST_SQUARED_ROUGHNESS, _MOST_INDIRECT)

    def _stacked(
        self,
        position: NDArray[np.float64],
        falloff: NDArray[np.float64],
        squared_roughness: float,
        indirect: float,
    ) -> NDArray[np.float64]:
        parts: list[NDArray[np.float64]] = [position] if self.position else []
        if "falloff" in self.terms:
            parts.append(falloff)
        if "roughness" in self.terms:
            parts.append(np.array([squared_roughness]))
        if "indirect" in self.terms:
            parts.append(np.array([indirect]))
        return np.concatenate(parts) if parts else np.empty(0)
