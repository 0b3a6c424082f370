"""How a flash that moves with the camera lights a surface, and what its colour is without that.

Source: Jaspe, section 3.4.5: the light falls off with the square of the distance from the flash
and with the cosine of its incidence (eq. 3.1), and dividing by both leaves the albedo (eq. 3.2).
Optional terms go beyond: a rough surface (Oren and Nayar 1994), which matters because it shines
back most towards a flash beside the lens; a beam that is brighter in some directions; light from
all around.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workbench.errors import InputError

# Nearer to the flash than this many reference distances the light grows no more.
_NEAREST = 1e-9
# Squares of shorter lengths have no digits left.
_SHORTEST = 1e-150
# Numbers of coefficients of whole polynomials in two unknowns without constant, degrees 0 to 4.
_WHOLE_POLYNOMIALS = (0, 2, 5, 9, 14)
# Cosine of incidence from which a sample is fully trusted: 70°.
_SURE_COSINE = 0.34
# Of the range from black to full: where a value is sure to be above noise, where it begins to
# near saturation, and where it may be saturated.
_ABOVE_NOISE, _NEAR_FULL, _FULL = 0.02, 0.85, 0.98


@dataclass(frozen=True)
class FlashLight:
    """The light of a flash that moves with the camera.

    Attributes
    ----------
    position_in_camera : (3,) middle of the flash, x right, y down, z forward, in the scene's
        unit (metres).
    reference_distance : d₀ of eq. 3.2: where the light on a facing surface counts as 1.
    epsilon : ε of eq. 3.2, in [0, 1]: how much of the light comes whatever the incidence.
    roughness_rad : σ of Oren and Nayar 1994, spread of the facets' slopes; 0 is Lambert.
    falloff : coefficients of a polynomial in u and v, the right and down components of the unit
        direction from the flash: u, v, then u², uv, v², then u³ … to whole degrees up to 4. The
        light is multiplied by the exponential function of it; empty is even light.
    indirect : light from all around that does not depend on the flash's distance or direction,
        as a share of what a facing surface gets at the reference distance.

    Raises
    ------
    InputError : a number is not finite or out of its range.
    """

    position_in_camera: NDArray[np.float64]
    reference_distance: float = 1.0
    epsilon: float = 0.1
    roughness_rad: float = 0.0
    falloff: tuple[float, ...] = ()
    indirect: float = 0.0

    def __post_init__(self) -> None:
        position = np.asarray(self.position_in_camera, np.float64)
        numbers = np.array([*position.ravel(), self.reference_distance, *self.falloff])
        if position.shape != (3,) or not np.isfinite(numbers).all() or numbers[3] <= 0.0:
            raise InputError(
                "a flash needs a finite position and a positive reference distance",
                found=f"{self.position_in_camera}, {self.reference_distance}, {self.falloff}",
            )
        if not (
            0.0 <= self.epsilon <= 1.0
            and 0.0 <= self.roughness_rad <= 0.5 * np.pi
            and 0.0 <= self.indirect < np.inf
        ):
            raise InputError(
                "a term of the flash's light is out of its range",
                expected="epsilon in [0, 1], roughness in [0, π/2], indirect not negative",
                found=f"{self.epsilon}, {self.roughness_rad}, {self.indirect}",
            )
        falloff_degree(len(self.falloff))
        object.__setattr__(self, "position_in_camera", position)

    def document(self) -> dict[str, Any]:
        """As written down, in plain data."""
        return {
            "position_in_camera_m": self.position_in_camera.tolist(),
            "reference_distance_m": self.reference_distance,
            "epsilon": self.epsilon,
            "roughness_deg": float(np.degrees(self.roughness_rad)),
            "falloff": list(self.falloff),
            "indirect": self.indirect,
        }

    @classmethod
    def from_document(cls, told: Mapping[str, Any]) -> FlashLight:
        """The light that `document` wrote down."""
        return cls(
            np.array(told["position_in_camera_m"]),
            told["reference_distance_m"],
            told["epsilon"],
            float(np.radians(told["roughness_deg"])),
            tuple(told["falloff"]),
            told["indirect"],
        )

    def received(
        self, places_in_camera: NDArray[np.float64], normals_in_camera: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """What a perfect white diffuser sends to the camera.

        Parameters
        ----------
        places_in_camera : (n, 3) in the frame and unit of the flash's position.
        normals_in_camera : (n, 3) unit, outwards.

        Returns
        -------
        (n,); 1 is a Lambertian one that faces the flash at the reference distance. Finite
        wherever the input is, and positive where ε or the indirect light is; a surface turned
        away from the flash counts as one at grazing incidence.
        """
        way = self.position_in_camera - np.asarray(places_in_camera, np.float64)
        distance, to_flash = _directed(way)
        light = (self.reference_distance / self._not_too_near(distance)) ** 2
        if self.falloff:
            light *= np.exp(falloff_terms(-to_flash, len(self.falloff)) @ np.array(self.falloff))
        shading = self._shading(to_flash, places_in_camera, normals_in_camera)
        epsilon = self.epsilon
        return np.asarray(light * (epsilon + (1.0 - epsilon) * shading) + self.indirect)

    def incidence(
        self, places_in_camera: NDArray[np.float64], normals_in_camera: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Cosine (n,) between normal and direction to the flash, n·l; negative when turned away.

        At the flash itself, which lies in no direction, it is 0.
        """
        way = self.position_in_camera - np.asarray(places_in_camera, np.float64)
        return _dot(_directed(way)[1], normals_in_camera)

    def _not_too_near(self, distance: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.maximum(distance, _NEAREST * self.reference_distance)

    def _shading(
        self,
        to_flash: NDArray[np.float64],
        places: NDArray[np.float64],
        normals: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """n·l (n,), times what Oren and Nayar's surface reflects relative to Lambert's."""
        cos_l = np.maximum(_dot(to_flash, normals), 0.0)
        if self.roughness_rad == 0.0:
            return np.asarray(cos_l)
        a, b = oren_nayar_factors(self.roughness_rad)
        return np.asarray(a * cos_l + b * oren_nayar_lobe(to_flash, places, normals))


def oren_nayar_factors(roughness_rad: float) -> tuple[float, float]:
    """A and B of the qualitative model of Oren and Nayar (1994, eq. 30)."""
    square = roughness_rad**2
    return 1.0 - 0.5 * square / (square + 0.33), 0.45 * square / (square + 0.09)


def oren_nayar_lobe(
    to_flash: NDArray[np.float64], places: NDArray[np.float64], normals: NDArray[np.float64]
) -> NDArray[np.float64]:
    """What B multiplies in Oren and Nayar's model, times the cosine of incidence: (n,) in [0, 1].

    max(0, cos Δφ) sin α tan β cos θ, written without the angles: no azimuth is needed, which
    has no value at normal incidence, and no tangent, which has none at grazing incidence.
    """
    to_camera = -_directed(places)[1]
    cos_l = np.maximum(_dot(to_flash, normals), 0.0)
    cos_v = np.maximum(_dot(to_camera, normals), 0.0)
    product = np.maximum(_dot(to_flash, to_camera) - cos_l * cos_v, 0.0)
    wider = np.maximum(np.maximum(cos_l, cos_v), np.finfo(float).tiny)
    return np.asarray(product * (cos_l / wider))


def falloff_degree(coefficients: int) -> int:
    """Degree of the falloff's polynomial with so many coefficients."""
    if coefficients not in _WHOLE_POLYNOMIALS:
        raise InputError(
            "the flash's falloff is a polynomial of whole degree",
            expected=", ".join(map(str, _WHOLE_POLYNOMIALS)) + " coefficients",
            found=str(coefficients),
        )
    return _WHOLE_POLYNOMIALS.index(coefficients)


def falloff_terms(directions: NDArray[np.float64], coefficients: int) -> NDArray[np.float64]:
    """Terms (n, coefficients) of the falloff's polynomial: u, v, u², uv, v², u³ and so on.

    Parameters
    ----------
    directions : (n, 3) unit, from the flash, in the camera's frame.
    """
    u, v = directions[:, 0], directions[:, 1]
    degree = falloff_degree(coefficients)
    terms = [u ** (n - k) * v**k for n in range(1, degree + 1) for k in range(n + 1)]
    return np.stack(terms, axis=1) if terms else np.empty((len(directions), 0))


def albedo(
    values: NDArray[np.floating], received: NDArray[np.float64], gain: float
) -> NDArray[np.float64]:
    """Albedo (n, 3) of linear values (n, 3): eq. 3.2.

    Parameters
    ----------
    values : linear light, proportional to what the camera got.
    received : (n,) of `FlashLight.received`.
    gain : value of a perfect white diffuser that receives 1, of `anchored` and of what the
        photograph's own flash was stronger.

    Returns
    -------
    values / (gain · received); NaN where nothing is received.

    Raises
    ------
    InputError : the gain is not a positive number.
    """
    if not 0.0 < gain < np.inf:
        raise InputError("the gain of a photograph must be positive", found=str(gain))
    light = np.where(received > 0.0, gain * received, np.nan)
    return np.asarray(values / light[:, None], np.float64)


def anchored(
    light: FlashLight, chart_place: NDArray[np.float64], chart_normal: NDArray[np.float64]
) -> float:
    """The gain with which a white diffuser at the chart has the value 1.

    Colours calibrated with a chart are such that white at the chart is 1; elsewhere it is as
    much as the light there is stronger.

    Parameters
    ----------
    light : its roughness is the object's and does not touch the chart, which is smooth.
    chart_place, chart_normal : (3,) middle of the chart in the camera's frame, and its unit
        normal towards the camera.

    Raises
    ------
    InputError : the flash does not light the chart.
    """
    smooth = replace(light, roughness_rad=0.0)
    place, normal = np.asarray(chart_place, float)[None], np.asarray(chart_normal, float)[None]
    received = float(smooth.received(place, normal)[0])
    if not (received > 0.0 and smooth.incidence(place, normal)[0] > 0.0):
        raise InputError(
            "the flash does not light the front of the chart",
            found=f"chart at {place[0]}, normal {normal[0]}, flash at {light.position_in_camera}",
            fix="let the chart's normal point towards the camera",
        )
    return 1.0 / received


def incidence_trust(cosine: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far to trust a sample by the cosine (n,) of incidence: smooth from 0 to 1.

    0 when turned away or at 90°, where an error of the normal changes the light manifold; 1 from
    70° on; 0 for NaN.
    """
    return _step(cosine, 0.0, _SURE_COSINE)


def value_trust(
    values: NDArray[np.floating], black: ArrayLike = 0.0, full: ArrayLike = 1.0
) -> NDArray[np.float64]:
    """How far to trust a sample by its linear values (n, 3) or (n,): smooth, in [0, 1].

    0 at black, where noise is all there is, and near saturation; 1 from 2 % to 85 % of the range;
    0 for NaN. The highest channel decides how far above black a sample is — a saturated colour
    is dark in another — and how near to full.

    Parameters
    ----------
    black, full : values of no light and of a full sensor, one or per channel.
    """
    low, high = np.asarray(black, np.float64), np.asarray(full, np.float64)
    part = np.asarray((np.asarray(values, np.float64) - low) / (high - low))
    highest = part if part.ndim == 1 else part.max(axis=1)
    falling = 1.0 - _step(highest, _NEAR_FULL, _FULL)
    return np.asarray(_step(highest, 0.0, _ABOVE_NOISE) * falling)


def trust(
    light: FlashLight,
    places_in_camera: NDArray[np.float64],
    normals_in_camera: NDArray[np.float64],
    values: NDArray[np.floating],
    black: ArrayLike = 0.0,
    full: ArrayLike = 1.0,
) -> NDArray[np.float64]:
    """Weight (n,) of samples in [0, 1]: `incidence_trust` times `value_trust`."""
    cosine = light.incidence(places_in_camera, normals_in_camera)
    return np.asarray(incidence_trust(cosine) * value_trust(values, black, full))


def _directed(
    ways: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lengths (n,) and unit directions (n, 3); what is too short to have one has (0, 0, 0)."""
    lengths = np.sqrt(_dot(ways, ways))
    shares = np.where(lengths < _SHORTEST, 0.0, 1.0 / np.maximum(lengths, _SHORTEST))
    return lengths, ways * shares[:, None]


def _dot(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    # Several times as fast as a sum over three columns.
    return np.asarray(np.einsum("ij,ij->i", one, other))


def _step(values: NDArray[np.float64], low: float, high: float) -> NDArray[np.float64]:
    """0 up to ``low``, 1 from ``high``, a cubic without kinks between; 0 for NaN."""
    part = np.clip(np.nan_to_num((values - low) / (high - low), nan=0.0), 0.0, 1.0)
    return np.asarray(part * part * (3.0 - 2.0 * part))
