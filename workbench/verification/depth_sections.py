"""What a report shows of the depth maps that photographs alone gave."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import NDArray

from workbench.geometry.rangemap import RangeMap
from workbench.verification.photo_sections import matted
from workbench.verification.quantities import shown_unit
from workbench.verification.report_content import (
    Block,
    Column,
    Paragraph,
    Picture,
    PictureRow,
    Section,
    Table,
)

_SIDE_PX = 420
_NOTHING = 245
_FILLING = "What photographs tell where scans have nothing."


@dataclass(frozen=True)
class ShownDepths:
    """A photograph's depth map, as it is shown."""

    name: str
    range_map: RangeMap


def depth_section(inventory: Mapping[str, Any], shown: Sequence[ShownDepths]) -> Section:
    """The chapter on depth maps.

    Parameters
    ----------
    inventory : as the stage ``densify`` leaves it.
    shown : some of the depth maps.
    """
    maps = inventory["scans"]
    why_own = inventory.get("why_own_matcher")
    matcher = (
        f"Compared by PatchMatch on the processor; COLMAP’s was left out: {why_own}."
        if why_own
        else "Compared by COLMAP’s PatchMatch on a graphics card."
    )
    coverage = inventory.get("coverage")
    blocks: list[Block] = [] if coverage is None else [_coverage(coverage, len(maps))]
    if not maps:
        return Section("Depth maps", _FILLING, tuple(blocks))
    blocks += [
        Paragraph(
            f"{len(maps)} photographs were compared with their neighbours, pixel by pixel. Kept is "
            "what the depth maps of several photographs agree on; its deviation along the ray is "
            f"what the photographs differ by, or what the match leaves open. {matcher}"
        ),
        Table(
            (
                Column("Photograph", style="code"),
                Column("Depths", "", 0),
                Column("Of the object", "%", 1),
                Column("Others that agree", "", 1),
                Column("Deviation", shown_unit("mm"), 3),
            ),
            tuple(
                (
                    one["name"],
                    one["samples"],
                    100.0 * one["samples"] / max(one["usable"], 1),
                    one["mean_views"],
                    1e3 * one["sigma_m"],
                )
                for one in maps
            ),
        ),
    ]
    if shown:
        drawn = matted([depth_picture(one.range_map) for one in shown])
        pictures = tuple(
            Picture(pixels, one.name, f"Depth map of {one.name}", True)
            for pixels, one in zip(drawn, shown, strict=True)
        )
        told = "Depth from near (dark) to far (light); grey where photographs agree on none."
        blocks.append(PictureRow(pictures, told))
    told = _FILLING if coverage is not None else "The shape as photographs alone tell it."
    return Section("Depth maps", told, tuple(blocks))


def _coverage(shares: Mapping[str, float | None], matched: int) -> Paragraph:
    """Which photographs there was a use for, by the share of their points that scans hold."""
    known = {name: share for name, share in shares.items() if share is not None}
    text = "Photographs were asked to fill what the scans missed. "
    if known:
        least = min(known, key=lambda name: known[name])
        text += (
            f"The scans hold {100 * float(np.mean(list(known.values()))):.1f} % of the points that "
            f"photographs share (mean; least, {100 * known[least]:.1f} %, in {least}). "
        )
    else:
        text += "They came without points that would tell what the scans hold. "
    spared = len(shares) - matched
    if spared > 0:
        text += f"{spared} of {len(shares)} were left out: the scans hold what they show."
    return Paragraph(text.rstrip())


def depth_picture(scan: RangeMap) -> NDArray[np.uint8]:
    """The depths of a range map, small, (h, w, 3) uint8: near is dark, holes are grey."""
    assert scan.grid is not None
    step = max(1, max(scan.grid.shape) // _SIDE_PX)
    grid = scan.grid[::step, ::step]
    picture = np.full((*grid.shape, 3), _NOTHING, np.uint8)
    held = grid >= 0
    if held.any():
        depth = scan.points_in_scan[grid[held], 2]
        near, far = np.percentile(depth, [1.0, 99.0])
        level = np.clip((depth - near) / max(far - near, 1e-12), 0.0, 1.0)
        picture[held] = 255.0 * matplotlib.colormaps["viridis"](level)[:, :3]
    return picture
