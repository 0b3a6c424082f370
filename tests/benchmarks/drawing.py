"""Error against run time as a drawing on disk."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from workbench.verification.figures import TradeoffPoint, tradeoff_figure


def draw_tradeoff(
    out: Path, name: str, points: Sequence[TradeoffPoint], error: str, chosen: str
) -> None:
    """Write ``name.svg`` to ``out`` and, where a renderer of SVG is at hand, ``name.png``."""
    out.mkdir(parents=True, exist_ok=True)
    drawing = out / f"{name}.svg"
    svg = tradeoff_figure(points, "run time (s)", error, chosen)
    drawing.write_text(svg, encoding="utf-8")
    renderer = shutil.which("rsvg-convert")
    if renderer:
        command = [renderer, "-z", "3", "-o", drawing.with_suffix(".png"), drawing]
        subprocess.run(command, check=True)
