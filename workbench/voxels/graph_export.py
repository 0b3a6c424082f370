"""From voxels to the file of a sparse voxel graph, proven lossless, with figures to report."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.errors import WorkbenchError
from workbench.voxels.dag_colors import packed_colors
from workbench.voxels.dag_decoding import DagWalk
from workbench.voxels.dag_encoding import ENCODINGS, TURNS_OF, EncodedGraph, Encoding, encoded
from workbench.voxels.dag_file import VoxelGraph, write_voxel_graph
from workbench.voxels.dag_reading import dag_of
from workbench.voxels.dag_reduction import VOXELS_AT_ONCE, reduced_parts, subtree_parts
from workbench.voxels.published_encodings import PUBLISHED
from workbench.voxels.symmetric_dag import symmetric_dag
from workbench.voxels.voxel_dag import VoxelDag
from workbench.voxels.voxel_set import VoxelGrid, VoxelSet


@dataclass(frozen=True)
class EncodingFigures:
    """What one encoding makes of the voxels.

    Attributes
    ----------
    encoding : which one.
    nodes : of all depths, as table 5.3 counts them: voxels are no nodes, 2³ leaves are.
    bytes : of nodes, bricks and the index of depths; neither header nor colours.
    bits_per_voxel : the same, for each voxel.
    share_of_svdag : bytes, those of the plain graph of equal subtrees being 1.
    published_bits_per_voxel : by the paper's model, at this resolution, where it tells.
    """

    encoding: Encoding
    nodes: int
    bytes: int
    bits_per_voxel: float
    share_of_svdag: float
    published_bits_per_voxel: dict[str, float]


class _Watched:
    """Parts of a voxel set on their way to be reduced; counts them and takes their colours."""

    def __init__(
        self, parts: Iterable[VoxelSet], grid: VoxelGrid, split: int, at_once: int
    ) -> None:
        self._parts, self._grid, self._split, self._at_once = parts, grid, split, at_once
        self._colors: list[NDArray[np.uint8]] = []
        self.voxels, self.check = 0, 0

    def codes(self) -> Iterator[NDArray[np.uint64]]:
        for part in self._parts:
            self.voxels += len(part)
            self.check = _checked(part.codes, self.check)
            if part.color is not None:
                self._colors.append(part.color)
            yield from subtree_parts(part.codes, self._grid.level, self._split, self._at_once)

    @property
    def colors(self) -> NDArray[np.uint8] | None:
        """(n, 3) of all voxels, or None where not all have one."""
        if not self._colors or sum(map(len, self._colors)) != self.voxels:
            return None
        return np.concatenate(self._colors)


def export_voxel_graph(
    parts: Iterable[VoxelSet],
    grid: VoxelGrid,
    path: Path,
    *,
    encoding: Encoding = "ssvdag",
    part_level: int = 8,
    at_once: int = VOXELS_AT_ONCE,
    compare: bool = False,
) -> dict[str, Any]:
    """Reduce voxels to a graph, write its file, and read the voxels back from it to be sure.

    Memory holds one part and the graph, and three bytes per voxel where there are colours.

    Parameters
    ----------
    parts
        Voxels in Morton order; ``[voxels]`` for a whole set.
    grid
        The cube they are cells of, of level 2 … 21.
    path
        The file to write; `workbench.voxels.dag_file.SUFFIX` is its usual ending.
    encoding
        Which one; ``osvdag`` is the smallest for large models, and the slowest
        to trace.
    part_level
        No two parts have voxels in one aligned cube of 2^part_level voxels a side.
    at_once
        Voxels that are reduced at a time, as far as subtrees of 256³ allow: 10 to 100 bytes each
        beside the graph itself. The file does not depend on it.
    compare
        Also try the other encodings and tell their figures under ``encodings``.

    Returns
    -------
    ``format``, ``resolution``, ``voxels``, ``file_bytes``, ``graph_bytes``, ``color_bytes``,
    ``bits_per_voxel``, ``nodes``, ``octree_nodes``, ``lossless`` and, when asked for,
    ``encodings``, a list of `EncodingFigures` as dicts.

    Raises
    ------
    InputError
        The parts are out of order, the level is out of bounds, or the graph is too large.
    WorkbenchError
        The file does not give back the voxels; it is not written then.
    """
    split = max(0, grid.level - max(2, min(part_level, 8)))
    watched = _Watched(parts, grid, split, at_once)
    dag = reduced_parts(watched.codes(), grid.level, split)
    reduced = reduced_for(dag, encoding)
    graph = encoded(reduced, encoding)
    _prove_lossless(graph, watched, split)
    colors = watched.colors
    packed = None if colors is None else packed_colors(colors)
    file_bytes = write_voxel_graph(path, VoxelGraph(graph, grid, packed))
    octree_nodes = DagWalk(dag).octree_node_count
    summary: dict[str, Any] = {
        "format": encoding,
        "resolution": grid.resolution,
        "voxels": graph.voxels,
        "file_bytes": file_bytes,
        "graph_bytes": graph.nbytes,
        "color_bytes": 0 if packed is None else packed.nbytes,
        "bits_per_voxel": _bits_per_voxel(graph),
        "nodes": octree_nodes if encoding == "svo" else reduced.node_count,
        "octree_nodes": octree_nodes,
        "lossless": True,
    }
    if compare:
        summary["encodings"] = [asdict(f) for f in encoding_figures(dag)]
    return summary


def reduced_for(dag: VoxelDag, encoding: Encoding) -> VoxelDag:
    """A graph of equal subtrees reduced as an encoding asks for."""
    return dag if TURNS_OF[encoding] == 1 else symmetric_dag(dag, TURNS_OF[encoding])


def encoding_figures(dag: VoxelDag) -> list[EncodingFigures]:
    """Tables 5.2 to 5.4 for one model: all encodings of its graph of equal subtrees."""
    plain_bytes = encoded(dag, "svdag").nbytes
    figures = []
    for encoding in ENCODINGS:
        source = reduced_for(dag, encoding)
        graph = encoded(source, encoding)
        nodes = len(graph.nodes) if encoding == "svo" else source.node_count
        published = {m.name: m.bits_per_voxel(encoding, dag.level) for m in PUBLISHED}
        figures.append(
            EncodingFigures(
                encoding,
                nodes,
                graph.nbytes,
                _bits_per_voxel(graph),
                graph.nbytes / plain_bytes,
                {name: bits for name, bits in published.items() if bits is not None},
            )
        )
    return figures


def _bits_per_voxel(graph: EncodedGraph) -> float:
    return 8.0 * graph.nbytes / max(graph.voxels, 1)


def _checked(codes: NDArray[np.uint64], check: int) -> int:
    return zlib.crc32(codes.tobytes(), check)


def _prove_lossless(graph: EncodedGraph, watched: _Watched, split: int) -> None:
    """Decode the words that go into the file and compare what comes with what went in."""
    check, voxels = 0, 0
    for codes in DagWalk(dag_of(graph)).code_parts(split):
        check, voxels = _checked(codes, check), voxels + len(codes)
    if (check, voxels) != (watched.check, watched.voxels):
        raise WorkbenchError(
            "The sparse voxel graph does not give back its voxels.",
            expected=f"{watched.voxels:,} voxels, CRC-32 {watched.check:08x}",
            found=f"{voxels:,} voxels, CRC-32 {check:08x}",
            fix="This is our fault; please report it with the mesh. Another encoding may work.",
        )
