"""What `develop` leaves beside its pictures: inventory, calibration, metrics, warnings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stages.develop.calibrating import FittedChart, Looks, NoCalibration, facts_of
from workbench.metrics import Metric
from workbench.photos.exposure import Exposures, odd_brightness, odd_settings
from workbench.photos.vignetting import NoVignetting, Vignetting
from workbench.pipeline.stage import StageResult

if TYPE_CHECKING:
    from workbench.color.calibration import Calibration, ColorMatrix
    from workbench.color.linearity import Linearity, NotChecked
    from workbench.color.spaces import WorkingSpace

# Of what is lit in a photograph, the chart's part from which on it is a photograph of the chart.
_CHART_FILLS = 0.5


@dataclass(frozen=True)
class Recipe:
    """What is done to one photograph.

    Attributes
    ----------
    color : the matrix to the working space.
    rests_on : in words, what it rests on; ``chart`` for a calibrated one.
    gain : to the common exposure.
    lens : the vignetting to even out; None where it is not known.
    """

    color: ColorMatrix
    rests_on: str
    gain: float
    lens: Vignetting | None

    @property
    def reach(self) -> float:
        """The largest value that the photograph can come to."""
        dimmest = float(self.lens.relative_light(64, 64).min()) if self.lens else 1.0
        return self.color.largest * self.gain / dimmest

    def as_dict(self) -> dict[str, Any]:
        """Plain data for `stages.develop.items.develop_photo`."""
        return {
            "color": self.color.as_dict(),
            "gain": self.gain,
            "vignetting": self.lens.coefficients if self.lens else None,
        }


def photo_entries(
    photos: Mapping[str, Path],
    looks: Looks,
    developed: Looks,
    recipes: Mapping[str, Recipe],
    exposures: Exposures,
) -> list[dict[str, Any]]:
    """All that is known of each photograph."""
    charts = {
        name
        for name in photos
        if "chart" in looks[name] and looks[name]["chart"]["fills"] > _CHART_FILLS
    }
    subjects = {name: facts_of(looks[name]) for name in photos if name not in charts}
    settings = odd_settings(subjects)
    levels = {name: looks[name]["bright_level"] * recipes[name].gain for name in subjects}
    brightness = odd_brightness(levels)
    entries = []
    for name, path in photos.items():
        look = looks[name]
        entries.append(
            {
                "name": name,
                "file": path.name,
                **look["facts"],
                "size": developed[name]["size"],
                "relative_exposure": exposures.relative[name],
                "gain": recipes[name].gain,
                "color": recipes[name].rests_on,
                "vignetting": recipes[name].lens is not None,
                "linearised_from": look["linearised_from"],
                "black_level": look["black_level"],
                "white_level": look["white_level"],
                "is_chart": name in charts,
                "clipped": developed[name]["clipped"],
                "beyond_range": developed[name]["beyond"],
                "odd_settings": settings.get(name),
                "odd_brightness_stops": brightness.get(name),
            }
        )
    return entries


def calibration_document(
    chart: FittedChart | NoCalibration,
    looks: Looks,
    vignetting: Vignetting | NoVignetting,
    linearity: Linearity | NotChecked,
    space: WorkingSpace,
) -> dict[str, Any]:
    """Where the colours come from, and how good they are."""
    from workbench.color.linearity import Linearity

    told: dict[str, Any] = {
        "space": space.name,
        "vignetting": asdict(vignetting) if vignetting else None,
        "no_vignetting": None if isinstance(vignetting, Vignetting) else vignetting.reason,
        "linearity": None,
        "no_linearity": None if isinstance(linearity, Linearity) else linearity.reason,
        "calibrated": isinstance(chart, FittedChart),
    }
    if isinstance(linearity, Linearity):
        told["linearity"] = asdict(linearity) | {
            "distances": linearity.distances.tolist(),
            "levels": linearity.levels.tolist(),
            "names": list(linearity.names),
        }
    if isinstance(chart, NoCalibration):
        return told | {"reason": chart.reason}
    found = chart.calibration
    return told | {
        "chart": chart.name,
        "corners_px": looks[chart.name]["chart"]["corners_px"],
        "found_by": looks[chart.name]["chart"]["by"],
        "edition": found.edition,
        **found.color.as_dict(),
        "shading": list(found.shading),
        "patches": _patches(found),
        "mean_delta_e2000": found.mean,
        "worst_delta_e2000": found.worst,
        "left_out_mean_delta_e2000": found.left_out_mean,
        "checks": {
            name: {"mean_delta_e2000": check.mean, "worst_delta_e2000": check.worst}
            for name, check in chart.checks.items()
        },
    }


def _patches(calibration: Calibration) -> list[dict[str, Any]]:
    from workbench.color.calibration import described

    return described(calibration)


def result_of(
    entries: list[dict[str, Any]],
    document: Mapping[str, Any],
    exposures: Exposures,
    seconds: list[float],
) -> StageResult:
    """Metrics and warnings."""
    warnings = _warnings(entries, document, exposures)
    return StageResult(_metrics(entries, document, seconds), warnings)


def _metrics(
    entries: list[dict[str, Any]], document: Mapping[str, Any], seconds: list[float]
) -> tuple[Metric, ...]:
    gains = [entry["gain"] for entry in entries]
    metrics = [
        Metric("photographs", len(entries), "", "Photographs developed."),
        Metric(
            "photographs_not_raw",
            sum(entry["linearised_from"] is not None for entry in entries),
            "",
            "Photographs that are not RAW and were linearised from their profile.",
        ),
        Metric(
            "clipped",
            100.0 * float(np.mean([entry["clipped"] for entry in entries])),
            "%",
            "Pixels where the sensor was full.",
        ),
        Metric(
            "beyond_range",
            100.0 * float(np.mean([entry["beyond_range"] for entry in entries])),
            "%",
            "Values that the working space does not hold, clipped.",
        ),
        Metric(
            "exposure_spread",
            float(np.log2(max(gains) / min(gains))),
            "stops",
            "How far exposures were brought together.",
        ),
        Metric(
            "odd_photographs",
            sum(_odd(entry) is not None for entry in entries),
            "",
            "Photographs taken otherwise than the others.",
        ),
        Metric(
            "colour_calibrated", document["calibrated"], "", "Whether a chart gave the colours."
        ),
        Metric("seconds_per_photograph", float(np.median(seconds)), "s", "Development, median."),
    ]
    if document["calibrated"]:
        metrics += [
            Metric(
                "chart_delta_e2000",
                document["mean_delta_e2000"],
                "ΔE2000",
                "Mean colour difference of the chart's patches.",
            ),
            Metric(
                "chart_worst_delta_e2000",
                document["worst_delta_e2000"],
                "ΔE2000",
                "Largest colour difference of a patch.",
            ),
            Metric(
                "chart_left_out_delta_e2000",
                document["left_out_mean_delta_e2000"],
                "ΔE2000",
                "Mean colour difference of patches that were not fitted, each left out in turn.",
            ),
        ]
    if document.get("checks"):
        worst = max(check["mean_delta_e2000"] for check in document["checks"].values())
        metrics.append(
            Metric(
                "other_charts_delta_e2000",
                worst,
                "ΔE2000",
                "Mean colour difference on a photograph of the chart that was not fitted; the "
                "worst of them.",
            )
        )
    if document["vignetting"]:
        corner = 1.0 + sum(document["vignetting"]["coefficients"])
        metrics.append(
            Metric("corner_light", 100.0 * corner, "%", "Light in the corners, from a flat frame.")
        )
    if document["linearity"]:
        told = document["linearity"]
        metrics += [
            Metric(
                "linearity_residual",
                100.0 * told["residual"],
                "%",
                "RMS difference of levels from 1/d² (Jaspe 2018, fig. 3.8).",
            ),
            Metric(
                "linearity_exponent",
                told["exponent"],
                "",
                "Power of distance that fits best; −2 for a linear sensor.",
            ),
        ]
    return tuple(metrics)


def _warnings(
    entries: list[dict[str, Any]], document: Mapping[str, Any], exposures: Exposures
) -> tuple[str, ...]:
    warnings = []
    if not document["calibrated"]:
        warnings.append(f"not colour calibrated: {document['reason']}")
    else:
        others = [e["name"] for e in entries if e["color"] != "chart"]
        if others:
            warnings.append(
                f"not colour calibrated, for the chart was photographed with another camera or "
                f"in another format: {_listed(others)}"
            )
    plain = [entry["name"] for entry in entries if entry["linearised_from"] is not None]
    if plain:
        warnings.append(f"not RAW, linearised from their profile: {_listed(plain)}")
    uneven = [entry["name"] for entry in entries if not entry["vignetting"]]
    if document["vignetting"] and uneven:
        warnings.append(
            "vignetting not evened out, for the flat frame was taken with another lens, camera or "
            f"focal length: {_listed(uneven)}"
        )
    names = {entry["name"] for entry in entries}
    unknown = [name for name in exposures.unknown if name in names]
    if unknown and len(entries) > 1:
        warnings.append(f"exposure not told, taken for that of the others: {_listed(unknown)}")
    warnings += [f"{entry['name']}: {odd}" for entry in entries if (odd := _odd(entry))]
    return tuple(warnings)


def _odd(entry: Mapping[str, Any]) -> str | None:
    parts = [entry["odd_settings"]] if entry["odd_settings"] else []
    stops = entry["odd_brightness_stops"]
    if stops is not None:
        way = "brighter" if stops > 0 else "darker"
        parts.append(f"{abs(stops):.1f} stops {way} than the others")
    return "; ".join(parts) or None


def _listed(names: list[str], most: int = 5) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
