"""Whether photographs can be compared: exposure, gains to one exposure, and outliers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.photos.exif import PhotoFacts

# Settings are engraved as rounded numbers: f/5.6 is f/5.657.
_SAME_WITHIN_STOPS = 0.1
# A photograph this far from the others in brightness is named, whatever their own spread is.
_LEAST_ODD_STOPS = 1.0
_ODD_SIGMAS = 4.5
_SIGMA_PER_MAD = 1.4826
_FEWEST_TO_JUDGE = 5


@dataclass(frozen=True)
class Exposures:
    """The exposures of a set of photographs.

    Attributes
    ----------
    relative : name → exposure in the set's own unit; None where the file does not tell it.
    gains : name → what brings the photograph's values to the reference's exposure; 1 where the
        exposure is not known.
    differ : whether settings differ, by more than their rounding.
    unknown : names of photographs that do not tell their exposure.
    """

    relative: Mapping[str, float | None]
    gains: Mapping[str, float]
    differ: bool
    unknown: tuple[str, ...]


def relative_exposure(facts: PhotoFacts) -> float | None:
    """Values a surface gives at these settings, but for a factor common to all photographs.

    Time × sensitivity / f-number² (ISO 12232). A flash is shorter than any shutter time, so
    where it fired in the dark the time has no part: sensitivity / f-number² × 1/250 s.
    """
    if not (facts.f_number and facts.iso):
        return None
    if facts.flash_fired:
        return facts.iso / facts.f_number**2 / 250.0
    if not facts.exposure_time_s:
        return None
    return facts.exposure_time_s * facts.iso / facts.f_number**2


def compared_exposures(photos: Mapping[str, PhotoFacts], reference: str | None = None) -> Exposures:
    """Gains that bring photographs to one exposure.

    Parameters
    ----------
    photos : name → facts.
    reference : the photograph whose exposure is the common one; else the most frequent.
    """
    relative = {name: relative_exposure(facts) for name, facts in photos.items()}
    known = {name: value for name, value in relative.items() if value}
    chosen = known.get(reference) if reference is not None else None
    if chosen is None and known:
        counts = Counter(round(3 * float(np.log2(value))) for value in known.values())
        common = counts.most_common(1)[0][0]
        chosen = min(v for v in known.values() if round(3 * float(np.log2(v))) == common)
    gains = {name: chosen / value if chosen and value else 1.0 for name, value in relative.items()}
    stops = np.log2(list(known.values())) if known else np.zeros(1)
    # Rounded settings are no reason to change values that were taken alike.
    gains = {n: 1.0 if abs(np.log2(g)) < _SAME_WITHIN_STOPS else g for n, g in gains.items()}
    unknown = tuple(name for name, value in relative.items() if not value)
    return Exposures(relative, gains, bool(np.ptp(stops) > _SAME_WITHIN_STOPS), unknown)


def bright_level(values: NDArray[np.float32]) -> float:
    """How bright a photograph's lit surfaces are: the mean green of its brightest tenth.

    In a dark room most of a photograph may be black, so a mean over all would tell how large
    the object is.
    """
    green = np.sort(values[..., 1].ravel()[:: max(1, values[..., 1].size // 100_000)])
    return float(green[-max(1, len(green) // 10) :].mean())


def odd_settings(photos: Mapping[str, PhotoFacts]) -> dict[str, str]:
    """Photographs taken otherwise than most: name → in what, for people."""
    named = {
        "camera": "camera",
        "lens": "lens",
        "focal_length_mm": "focal length",
        "f_number": "f-number",
        "iso": "ISO",
        "flash_fired": "flash",
    }
    if not all(facts.flash_fired for facts in photos.values()):
        named["exposure_time_s"] = "exposure time"
    told: dict[str, list[str]] = {}
    for field, label in named.items():
        values = {name: getattr(facts, field) for name, facts in photos.items()}
        common, count = Counter(values.values()).most_common(1)[0]
        if count <= len(values) / 2:
            continue  # no one setting is the usual one
        for name, value in values.items():
            if value != common:
                told.setdefault(name, []).append(
                    f"{label} {_shown(value)} (most: {_shown(common)})"
                )
    return {name: "; ".join(parts) for name, parts in told.items()}


def odd_brightness(levels: Mapping[str, float]) -> dict[str, float]:
    """Photographs much brighter or darker than the others: name → by how many stops.

    Parameters
    ----------
    levels : name → `bright_level`, brought to one exposure.

    Notes
    -----
    By the median and the median absolute deviation, which one photograph in three cannot move.
    """
    if len(levels) < _FEWEST_TO_JUDGE:
        return {}
    stops = np.log2(np.maximum(list(levels.values()), 1e-6))
    apart = stops - np.median(stops)
    spread = _SIGMA_PER_MAD * float(np.median(np.abs(apart)))
    limit = max(_LEAST_ODD_STOPS, _ODD_SIGMAS * spread)
    return {name: float(by) for name, by in zip(levels, apart, strict=True) if abs(by) > limit}


def _shown(value: object) -> str:
    if value is None:
        return "not told"
    if isinstance(value, bool):
        return "fired" if value else "did not fire"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
