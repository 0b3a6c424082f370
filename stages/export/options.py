"""Options of ``export``."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from workbench.project.settings import StageOptions


class ExportOptions(StageOptions):
    """Options of ``export``."""

    ply: bool = Field(True, description="Write exports/surface.ply with every attribute.")
    obj: bool = Field(True, description="Write exports/surface.obj.")
    glb: bool = Field(True, description="Write exports/surface.glb.")
    textured_glb: bool = Field(
        True, description="Write exports/textured.glb, where photographs texture the surface."
    )
    textured_obj: bool = Field(
        True, description="Write exports/textured/textured.obj with its materials and pictures."
    )
    pictures: Literal["jpeg", "png"] = Field(
        "jpeg", description="Pictures inside textured.glb; those of the OBJ are PNG, without loss."
    )
    picture_quality: int = Field(95, ge=1, le=100, description="Quality of JPEG.")
    voxels: Literal["none", "voxels", "svdag", "ssvdag", "osvdag"] = Field(
        "none",
        description="Write exports/voxels.vlod, levels of detail, or a sparse voxel graph, "
        "exports/voxels.voxgraph.",
    )
    voxel_resolution: Literal[64, 128, 256, 512, 1024, 2048, 4096, 8192, 16384] = Field(
        1024, description="Voxels along the side of the cube around the surface."
    )
    surfels: int = Field(
        0,
        ge=0,
        le=20_000_000,
        description="Write exports/surfels.surfels with at most so many surfels in each node of "
        "its tree (Brandt et al. 2019); 0 leaves them out.",
    )
    surfel_candidates_px: int = Field(
        1024,
        ge=8,
        le=8192,
        description="Side of the pictures that surfels are chosen from (Brandt et al. 2019, 3.1).",
    )
    clouds: tuple[Literal["laz", "las", "copc", "potree", "e57", "ply"], ...] = Field(
        (),
        description="Write the consolidated samples of the scans as exports/points.* in these "
        "formats, coloured by the photographs; potree is a folder.",
    )
    cells: Literal["none", "ci", "eci", "context"] = Field(
        "none",
        description="Write exports/points.pcube, the cells that the surface fills, coded as "
        "Mallón et al. 2003 do or, smallest, by contexts.",
    )
    cell_resolution: Literal[64, 128, 256, 512, 1024, 2048, 4096, 8192] = Field(
        1024, description="Cells along the side of the cube around the surface."
    )
