"""What photographs add where scans have nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from stages.fuse.options import FuseOptions
from stages.fuse.placing import PlacedSources
from workbench.metrics import Metric
from workbench.pipeline.shape_sources import ShapeSource
from workbench.pipeline.stage import Job

if TYPE_CHECKING:
    from workbench.cloud.filling import Missed
    from workbench.cloud.sample_source import SampleSource
    from workbench.geometry.samples import Samples

# Depth maps that are further off the scans make a step one can see, in distances of samples.
_STEP_SPACINGS = 3.0
# More of the depths beyond what was scanned are of something else, or cameras of another frame.
_MOST_BEYOND = 0.5


@dataclass(frozen=True)
class Filled:
    """Samples of photographs where the scans have none, and what there is to say of them."""

    samples: tuple[Samples, ...] = ()
    metrics: tuple[Metric, ...] = ()
    warnings: tuple[str, ...] = ()

    def __len__(self) -> int:
        return sum(map(len, self.samples))


def filled_by(
    job: Job[FuseOptions],
    scanned: SampleSource,
    spacing_m: float,
    sources: Sequence[ShapeSource],
    cell_m: float,
) -> Filled:
    """What depth maps hold that lies on no scanned surface.

    Parameters
    ----------
    scanned, spacing_m : samples of all scans, and their distance.
    sources, cell_m : depth maps of photographs, and in which cells their samples are merged.
    """
    from workbench.cloud.filling import ScannedSurface
    from workbench.cloud.fusion import joined, merged

    if not sources:
        return Filled()
    placed = PlacedSources(job.products, sources, colored=False)
    surface = ScannedSurface.of(scanned, spacing_m, job.options.memory_samples)
    found: dict[str, Missed] = {}
    with job.progress.step("what scans missed", len(sources)) as step:
        for source, samples in zip(sources, placed, strict=True):
            found[source.name] = surface.missed(samples)
            step.advance()
    kept = merged(joined([one.samples for one in found.values()]), cell_m)
    return Filled((kept,), _metrics(found, len(kept)), _warnings(found, surface.apart_m))


def _metrics(found: Mapping[str, Missed], kept: int) -> tuple[Metric, ...]:
    given, beyond = _given_and_beyond(found)
    scanned = sum(one.scanned for one in found.values())
    offsets = [abs(one.offset_m) for one in found.values() if np.isfinite(one.offset_m)]
    within = max(given - beyond, 1)
    metrics = [
        Metric("photographed_samples", kept, "", "Samples of photographs where scans have none."),
        Metric("scans_hold", 100.0 * scanned / within, "%",
               "Share of what photographs agree on that the scans hold."),
        Metric("photographed_beyond", beyond, "",
               "Depths left out for they lie beyond what was scanned by a tenth of its size."),
    ]  # fmt: skip
    if offsets:
        metrics.append(
            Metric("photographs_off", float(np.median(offsets)), "m",
                   "Median of how far photographs' depths lie before or behind the scans.")
        )  # fmt: skip
    return tuple(metrics)


def _warnings(found: Mapping[str, Missed], spacing_m: float) -> tuple[str, ...]:
    warnings = []
    given, beyond = _given_and_beyond(found)
    if beyond > _MOST_BEYOND * given:
        warnings.append(
            f"{100.0 * beyond / given:.0f} % of what photographs agree on lies beyond what was "
            "scanned: mask what is not of the object, or check that the cameras are in the scans' "
            "frame"
        )
    if given > beyond and not any(np.isfinite(one.offset_m) for one in found.values()):
        warnings.append(
            "no depth map shows anything that was scanned: nothing proves that the photographs are "
            "in the scans' frame"
        )
    return (*warnings, *_steps(found, spacing_m))


def _given_and_beyond(found: Mapping[str, Missed]) -> tuple[int, int]:
    """How many depths there were, and how many lie too far off to be of the object."""
    return sum(one.given for one in found.values()), sum(one.beyond for one in found.values())


def _steps(found: Mapping[str, Missed], spacing_m: float) -> tuple[str, ...]:
    off = {
        name: one.offset_m
        for name, one in found.items()
        if abs(one.offset_m) > _STEP_SPACINGS * spacing_m
    }
    if not off:
        return ()
    worst = max(off, key=lambda name: abs(off[name]))
    return (
        f"{len(off)} of {len(found)} depth maps lie off the scans by more than "
        f"{1e3 * _STEP_SPACINGS * spacing_m:.3g} mm ({worst} by {1e3 * off[worst]:.3g}): where "
        "photographs fill, the surface has a step; check the given cameras, or the places picked "
        "in alignment.toml",
    )
