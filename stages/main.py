"""The pipeline, in order, and the command line made from it."""

from __future__ import annotations

import sys

from stages.color import COLOR
from stages.densify import DENSIFY
from stages.develop import DEVELOP
from stages.export import EXPORT
from stages.fuse import FUSE
from stages.infill import INFILL
from stages.ingest import INGEST
from stages.mask import MASK
from stages.orient import ORIENT
from stages.register import REGISTER
from stages.texture import TEXTURE
from stages.verify import VERIFY
from workbench.cli import run_cli
from workbench.pipeline.planner import Pipeline

PIPELINE: Pipeline = (
    INGEST,  # what was brought, checked and in metres
    DEVELOP,  # Jaspe 2018, 3.4.2: RAW photographs to linear, calibrated colour
    MASK,  # Jaspe 2018, 3.4.3: what is not the object is masked away, scans and photographs
    REGISTER,  # Jaspe 2018, 3.4.1: fine registration of the range maps
    DENSIFY,  # Xu and Tao 2019: depth maps of photographs alone, which ORIENT then comes before
    FUSE,  # Jaspe 2018, 3.4.4: one consolidated set of samples
    INFILL,  # Jaspe 2018, 3.4.6: screened Poisson closes what no scan saw
    ORIENT,  # Jaspe 2018, 3.4.2: where the photographs were taken from, against the surface
    COLOR,  # Jaspe 2018, 3.4.5 and 3.4.6: photographs blended onto the surface, without flash
    TEXTURE,  # Arikan et al. 2014: a photograph for every triangle, of each camera and of the whole
    EXPORT,
    VERIFY,
)


def main() -> None:
    """Entry point of ``workbench``."""
    sys.exit(run_cli(PIPELINE))


if __name__ == "__main__":
    main()
