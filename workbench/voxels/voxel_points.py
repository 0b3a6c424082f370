"""Voxels of any of the workbench's voxel files, back as points."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil  # type: ignore[import-untyped]
from numpy.typing import NDArray

from workbench.errors import InputError, SettingsError
from workbench.formats.ply import ListColumn, PlyElement, write_ply
from workbench.kernels.morton import morton_cells, morton_codes
from workbench.voxels.dag_colors import packed_colors
from workbench.voxels.dag_decoding import DagWalk
from workbench.voxels.dag_encoding import encoded
from workbench.voxels.dag_file import SUFFIX, VoxelGraph, read_voxel_graph
from workbench.voxels.dag_reading import dag_of
from workbench.voxels.dag_reduction import reduced_dag
from workbench.voxels.lod_file import LodFile
from workbench.voxels.voxel_dag import COARSEST_LEVEL
from workbench.voxels.voxel_set import VoxelGrid

LOD_SUFFIX = ".vlod"
# A code, and the middle it becomes.
_BYTES_AT_WORK = 64


@dataclass(frozen=True)
class VoxelPoints:
    """Voxels with what a file tells of them, in Morton order.

    Attributes
    ----------
    grid : the cube they are cells of.
    codes : (n,) uint64 Morton codes, ascending.
    normal : (n, 3) float32 unit normals, zero where both sides cancel, or None.
    color : (n, 3) uint8 sRGB, or None.
    """

    grid: VoxelGrid
    codes: NDArray[np.uint64]
    normal: NDArray[np.float32] | None
    color: NDArray[np.uint8] | None

    def __len__(self) -> int:
        return len(self.codes)

    @property
    def centers(self) -> NDArray[np.float64]:
        """(n, 3) middles of the voxels, in the mesh's frame."""
        return self.grid.origin + (morton_cells(self.codes) + 0.5) * self.grid.voxel_size

    def graph(self) -> VoxelGraph:
        """The same voxels as a graph that can be traced.

        Raises
        ------
        InputError
            Fewer than 4 voxels a side.
        """
        if self.grid.level < COARSEST_LEVEL:
            raise InputError(
                "So few voxels make no graph.",
                expected=f"{1 << COARSEST_LEVEL} voxels a side or more",
                found=str(self.grid.resolution),
                fix="Export the surface at a higher resolution.",
            )
        dag = reduced_dag(self.codes, self.grid.level)
        colors = None if self.color is None else packed_colors(self.color)
        return VoxelGraph(encoded(dag, "svdag"), self.grid, colors)


def voxel_points(path: Path, level: int | None = None) -> VoxelPoints:
    """The voxels of a ``.vlod`` or ``.voxgraph`` file.

    Parameters
    ----------
    path
        The file.
    level
        Of a ``.vlod``, the level of 2**level voxels a side; the finest without.

    Raises
    ------
    InputError
        Another kind of file, or a damaged one.
    SettingsError
        A level the file does not have.
    """
    path = Path(path)
    if path.suffix == LOD_SUFFIX:
        return _points_of_level(LodFile(path), level)
    if path.suffix != SUFFIX:
        raise InputError(
            "This kind of file is not read as voxels.",
            file=path,
            expected=f"{LOD_SUFFIX}, {SUFFIX}",
            found=path.suffix or path.name,
            fix="workbench lod makes such files",
        )
    voxels = read_voxel_graph(path)
    _check_level(path, level, (voxels.grid.level,))
    walk = DagWalk(dag_of(voxels.graph))
    # A few nodes may stand for any number of voxels: that is what graphs are for.
    if walk.voxel_count * _BYTES_AT_WORK > psutil.virtual_memory().available:
        raise InputError(
            "The voxels of the graph are more than the memory holds.",
            file=path,
            found=f"{walk.voxel_count:,} voxels",
            fix="draw or trace the graph as it is, or make one of a lower resolution",
        )
    codes = walk.codes()
    colors = None if voxels.colors is None else voxels.colors.all()
    return VoxelPoints(voxels.grid, codes, None, colors)


def traceable_graph(path: Path) -> VoxelGraph:
    """What a ``.vlod`` (its finest level) or ``.voxgraph`` file holds, as a graph.

    Raises
    ------
    InputError
        Another kind of file, or a damaged one.
    """
    path = Path(path)
    return read_voxel_graph(path) if path.suffix == SUFFIX else voxel_points(path).graph()


def write_voxel_points(path: Path, voxels: VoxelPoints) -> None:
    """Write middles of voxels as PLY, with normals and colours where there are any.

    ``x y z`` are double, ``nx ny nz`` float, ``red green blue`` uchar, sRGB; a comment tells the
    side of a voxel.
    """
    columns: dict[str, NDArray[np.generic] | ListColumn] = {}
    values: list[tuple[str, NDArray[np.generic] | None]] = [
        ("x y z", voxels.centers),
        ("nx ny nz", voxels.normal),
        ("red green blue", voxels.color),
    ]
    for names, array in values:
        if array is not None:
            columns |= {name: array[:, k] for k, name in enumerate(names.split())}
    write_ply(
        path,
        [PlyElement("vertex", len(voxels), columns)],
        [f"voxel_size {voxels.grid.voxel_size!r}"],
    )


def _points_of_level(file: LodFile, level: int | None) -> VoxelPoints:
    _check_level(file.path, level, tuple(np.unique(file.nodes["level"]).tolist()))
    chosen = file.grid.level if level is None else level
    cells, normals, colors = [], [], []
    for row in np.flatnonzero(file.nodes["level"] == chosen):
        chunk = file.chunk(int(row))
        corner = file.nodes["place"][row].astype(np.int64) << file.chunk_level
        cells.append(chunk.cells + corner)
        normals.append(chunk.normal)
        colors += [] if chunk.color is None else [chunk.color]
    codes = morton_codes(np.concatenate(cells))
    color = np.concatenate(colors) if colors else None
    return VoxelPoints(file.grid.at_level(chosen), codes, np.concatenate(normals), color)


def _check_level(path: Path, level: int | None, there: tuple[int, ...]) -> None:
    if level is not None and level not in there:
        raise SettingsError(
            "The file does not have this level.",
            file=path,
            expected=", ".join(map(str, there)),
            found=str(level),
            fix="leave --level out for the finest",
        )
