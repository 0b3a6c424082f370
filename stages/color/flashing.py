"""The flash of the photographs: given, estimated, or left out, and how strong it was each time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from stages.color.photographs import Photographs
from workbench.pipeline.stage import Job

if TYPE_CHECKING:
    from stages.color.options import ColorOptions
    from workbench.color.flash_estimation import FlashEstimate
    from workbench.color.flash_light import FlashLight

# A flash set by hand varies by a few percent; one that meters, by much more.
_BY_HAND, _LEAST_SPREAD = 0.05, 0.005
# Scatter beside that with strengths alone, at which a flash that no file tells of is one.
_SHOWS = 0.9


@dataclass(frozen=True)
class FoundFlash:
    """The flash, and what is known of it.

    Attributes
    ----------
    light : its light; None where nothing is corrected.
    gains : photograph → relative strength.
    estimate : how it was found; None where it was given or left out.
    way : ``estimated``, ``given``, ``at the lens`` or ``left out``.
    reason : why, where it was not estimated as asked.
    """

    light: FlashLight | None
    gains: Mapping[str, float]
    estimate: FlashEstimate | None
    way: str
    reason: str = ""


def found_flash(
    job: Job[ColorOptions], photos: Photographs, count: Any, *, told: bool
) -> FoundFlash:
    """The flash of photographs that were taken with one.

    Parameters
    ----------
    count : (n,) photographs that see each sample.
    told : whether a file says that a flash fired. Where none does, there is one only if it
        explains what strengths alone leave: daylight is no flash, though one can be fitted to it.
    """
    from workbench.color.flash_light import FlashLight

    options = job.options
    even = dict.fromkeys(photos.names, 1.0)
    if options.flash == "none" or not photos.names:
        reason = "not asked for" if photos.names else "no photograph was taken with a flash"
        return FoundFlash(None, even, None, "left out", reason)
    if options.flash == "given":
        light = FlashLight(np.array(options.flash_position_m))
        return FoundFlash(_as_asked(light, options, _distance(photos)), even, None, "given")
    estimate = _estimated(job, photos, count)
    if isinstance(estimate, str):
        light = _as_asked(FlashLight(np.zeros(3)), options, _distance(photos))
        return FoundFlash(light, even, None, "at the lens", estimate)
    if not told and estimate.scatter_held_out > _SHOWS * estimate.scatter_with_gains:
        reason = (
            "no file tells of a flash, and none shows: colours scatter by "
            f"{100.0 * estimate.scatter_held_out:.2g} % with one and by "
            f"{100.0 * estimate.scatter_with_gains:.2g} % without"
        )
        return FoundFlash(None, even, None, "left out", reason)
    gains = np.where(np.isnan(estimate.gains), 1.0, estimate.gains)
    light = _as_asked(estimate.light, options, estimate.light.reference_distance)
    by_name = {name: float(gains[k]) for k, name in enumerate(photos.names)}
    return FoundFlash(light, by_name, estimate, "estimated")


def with_leveled_gains(flash: FoundFlash, photos: Photographs) -> FoundFlash:
    """Strengths of a flash that was not estimated, from the photographs' overlaps.

    Parameters
    ----------
    photos : in the flash's light, with its shadows known.
    """
    from workbench.color.blending_levels import leveled_gains

    if flash.estimate is not None or not photos.names:
        return flash
    gains = leveled_gains(photos, len(photos.points))
    return replace(flash, gains={n: float(g) for n, g in zip(photos.names, gains, strict=True)})


def _estimated(job: Job[ColorOptions], photos: Photographs, count: Any) -> FlashEstimate | str:
    from workbench.color.flash_estimation import NoFlashEstimate, estimated_flash
    from workbench.geometry.robust import robust_sigma

    if len(photos.names) < 2:
        return "one photograph alone does not tell the flash from the colours"
    seen = photos.for_the_flash(count)
    roughness = job.options.roughness_deg
    asked: dict[str, Any] = {"terms": job.options.flash_terms}
    if roughness != "auto":
        asked["terms"] = [term for term in job.options.flash_terms if term != "roughness"]
        asked["roughness_rad"] = float(np.radians(roughness))
    with job.progress.step("looking for the flash"):
        found = estimated_flash(seen, **asked)
        if isinstance(found, NoFlashEstimate):
            return found.reason
        spread = robust_sigma(np.log(found.gains[np.isfinite(found.gains)]))
        if spread < _BY_HAND:
            # Strengths that hardly vary say that they were meant to be one, which fixes more.
            again = estimated_flash(seen, gain_sigma=max(spread, _LEAST_SPREAD), **asked)
            found = found if isinstance(again, NoFlashEstimate) else again
    return found


def _as_asked(light: FlashLight, options: ColorOptions, distance: float) -> FlashLight:
    """The light with what the options say of it; 1 is a facing surface at the reference."""
    if options.roughness_deg != "auto":
        light = replace(light, roughness_rad=float(np.radians(options.roughness_deg)))
    reference = options.reference_distance_m or distance
    scale = (light.reference_distance / reference) ** 2
    return replace(
        light,
        reference_distance=reference,
        epsilon=options.epsilon,
        # The light from all around is told relative to the flash's at the reference distance.
        indirect=light.indirect / scale if scale > 0.0 else 0.0,
    )


def _distance(photos: Photographs) -> float:
    """Median distance of samples from the cameras that see them."""
    from workbench.geometry.transforms import apply

    found = []
    for name in photos.names:
        places = apply(photos.poses[name], photos.points[photos.observations(name).index])
        if len(places):
            found.append(float(np.median(np.linalg.norm(places, axis=1))))
    return float(np.median(found)) if found else 1.0
