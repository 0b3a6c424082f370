"""What the frames of charts and even targets tell: colour, vignetting, linearity."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from workbench.photos.calibration_notes import CalibrationNotes
from workbench.photos.exif import PhotoFacts
from workbench.photos.vignetting import FlatFrame, NoVignetting, Vignetting, fitted_vignetting

if TYPE_CHECKING:
    from workbench.color.calibration import Calibration, MatrixKind
    from workbench.color.linearity import Linearity, NotChecked
    from workbench.color.spaces import WorkingSpace

Looks = Mapping[str, Mapping[str, Any]]

# A chart whose colours are this far from any matrix is lit by something else than one light.
_MOST_DELTA_E = 10.0


@dataclass(frozen=True)
class FittedChart:
    """The chart that the colours come from.

    Attributes
    ----------
    name : of its photograph.
    calibration : the fit.
    checks : the other charts' names → how well it foretells them.
    """

    name: str
    calibration: Calibration
    checks: Mapping[str, Calibration] = field(default_factory=dict)


@dataclass(frozen=True)
class NoCalibration:
    """Why colours are not calibrated."""

    reason: str

    def __bool__(self) -> bool:
        return False


def facts_of(look: Mapping[str, Any]) -> PhotoFacts:
    """How a photograph was taken."""
    return PhotoFacts(**look["facts"])


def kind_of(look: Mapping[str, Any]) -> tuple[str | None, bool]:
    """What has to agree for one colour matrix to hold: the camera, and RAW or not."""
    return look["facts"]["camera"], look["linearised_from"] is None


def lens_of(look: Mapping[str, Any]) -> tuple[Any, ...]:
    """What has to agree for one vignetting to hold."""
    facts = look["facts"]
    return kind_of(look), facts["lens"], facts["focal_length_mm"]


@dataclass(frozen=True)
class LensLight:
    """What a lens does to the light.

    Attributes
    ----------
    found : the vignetting, or why there is none.
    lens : what it was found for, as `lens_of` gives it.
    """

    found: Vignetting | NoVignetting
    lens: tuple[Any, ...] = ()

    def of(self, look: Mapping[str, Any]) -> Vignetting | None:
        """The vignetting of a photograph; None where it was not found for its lens."""
        known = isinstance(self.found, Vignetting) and lens_of(look) == self.lens
        return self.found if known and isinstance(self.found, Vignetting) else None


def lens_light_of(looks: Looks) -> LensLight:
    """Vignetting from the flat frame that is explained best."""
    found: list[LensLight] = []
    for look in looks.values():
        if "flat" not in look:
            continue
        facts, flat = facts_of(look), look["flat"]
        frame = FlatFrame(**{**flat, "levels": np.array(flat["levels"])})
        # The frame is of half size.
        focal = facts.focal_length_px(2 * max(frame.height, frame.width))
        fired = bool(facts.flash_fired)
        fitted = fitted_vignetting(frame, focal and 0.5 * focal, flash_fired=fired)
        found.append(LensLight(fitted, lens_of(look)))
    nothing = LensLight(NoVignetting("there is no flat frame"))
    return min(found, key=_unexplained, default=nothing)


def _unexplained(light: LensLight) -> float:
    return light.found.residual if isinstance(light.found, Vignetting) else math.inf


def calibration_of(
    looks: Looks,
    light: LensLight,
    space: WorkingSpace,
    kind: MatrixKind,
    sought: str,
) -> FittedChart | NoCalibration:
    """The colour matrix from the largest chart that is fit, tried on all others.

    Parameters
    ----------
    sought : the option: ``auto``, ``none`` or a photograph's name.
    """
    from workbench.color.calibration import calibrated, checked_on
    from workbench.color.patches import ChartPatches

    if sought == "none":
        return NoCalibration("no chart was looked for")
    charts = {name: look for name, look in looks.items() if "chart" in look}
    told = {name: look["no_chart"] for name, look in looks.items() if "no_chart" in look}
    if not charts:
        odd = [f"{name}: {why}" for name, why in told.items() if why != "no chart was found"]
        return NoCalibration("; ".join(odd) or f"no chart was found in {len(told)} photographs")
    fit = {name: look for name, look in charts.items() if look["chart"]["unfit"] is None}
    if not fit:
        return NoCalibration("; ".join(f"{n}: {k['chart']['unfit']}" for n, k in charts.items()))

    def patches(look: Mapping[str, Any]) -> ChartPatches:
        seen = ChartPatches.from_dict(look["chart"]["patches"])
        vignetting = light.of(look)
        if vignetting is None:
            return seen
        width, height = look["half_size"]
        return seen.divided(vignetting.at(seen.places, height, width))

    # The camera that took most photographs, then the chart that has most pixels.
    taken = Counter(kind_of(look) for look in looks.values())
    best = max(fit, key=lambda n: (taken[kind_of(fit[n])], float(fit[n]["chart"]["width_px"])))
    found = calibrated(patches(fit[best]), space, kind)
    if found.mean > _MOST_DELTA_E:
        return NoCalibration(
            f"{best}: the chart's colours fit no matrix (mean ΔE2000 {found.mean:.1f}); "
            "is it a ColorChecker Classic, and lit by one light?"
        )
    alike = [n for n in fit if n != best and kind_of(fit[n]) == kind_of(fit[best])]
    checks = {name: checked_on(found, patches(fit[name]), space) for name in alike}
    return FittedChart(best, found, checks)


def linearity_of(
    looks: Looks, notes: CalibrationNotes, files: Mapping[str, str], gains: Mapping[str, float]
) -> Linearity | NotChecked:
    """Levels against 1/d², at noted distances or at those the chart's size tells.

    Frames that are clipped are left out.

    Parameters
    ----------
    files : name → file name, as the notes have it.
    gains : name → what brings levels to one exposure.
    """
    from workbench.color.chart import WHITE
    from workbench.color.linearity import fitted_linearity

    def white(name: str) -> float | None:
        look = looks[name]
        if "chart" not in look:
            return cast(float | None, look["middle"])
        fit = look["chart"]["unfit"] is None
        return float(look["chart"]["patches"]["means"][WHITE][1]) if fit else None

    levels = {name: level * gains.get(name, 1.0) for name in looks if (level := white(name))}
    noted = {
        name: (notes.distances_m[files[name]], level)
        for name, level in levels.items()
        if files[name] in notes.distances_m
    }
    if noted:
        return fitted_linearity(noted, metric=True)
    # A board looks as large as it is near, whatever the focal length.
    sized = {
        name: (1000.0 / looks[name]["chart"]["width_px"], level)
        for name, level in levels.items()
        if "chart" in looks[name]
    }
    return fitted_linearity(sized, metric=False)
