"""A mesh or a point cloud and options in, a surfel file and its figures out."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.atomic import replacing
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.point_set import PointSet, joined
from workbench.geometry.textured_mesh import TexturedMesh
from workbench.surfels.candidates import surface_candidates
from workbench.surfels.node_surfels import Candidates, chosen_surfels
from workbench.surfels.node_tree import ItemTree, TreeNode, item_tree
from workbench.surfels.painted_surface import PaintedSurface
from workbench.surfels.point_normals import sound_normals
from workbench.surfels.spacing import nearest_distances
from workbench.surfels.surfel_file import SurfelNode, SurfelWriter, read_node
from workbench.surfels.surfel_layout import NODE, SurfelLayout
from workbench.surfels.surfel_options import SurfelOptions
from workbench.surfels.visible_surfels import seen_from_corners

SurfelSource = TriangleMesh | TexturedMesh | PaintedSurface | PointSet


def export_surfels(
    source: SurfelSource, path: Path, options: SurfelOptions | None = None
) -> dict[str, Any]:
    """Write the surfels of an object; same source and options, same bytes.

    Surfels of a leaf come from its part of the surface, or are points of its part of the cloud;
    those of a node with children from its children's surfels, of which it drops what cannot be
    seen from outside (Brandt 2019, 3.4). Nodes go to the file as they are made and are read
    from there for their parents, so that no more than the nodes at work are in memory.

    Parameters
    ----------
    source
        A mesh, coloured by its attribute ``color`` or its texture, or points.
    path
        The ``.surfels`` file; its folder must exist.
    options
        See `SurfelOptions`.

    Returns
    -------
    ``format`` (``surfels``), ``items`` (surfels of all nodes), ``finest_items`` (of the leaves),
    ``bytes``, ``bits_per_item``, ``nodes``, ``levels``, ``median_distance`` (r_m of the root at
    all its surfels, in the unit of the source), ``radius`` (of discs that cover the object with
    all surfels of the root), ``spacing_prefix`` and ``spacing_distance`` (p_m and r_m of the
    root), ``source_items`` (triangles or points) and ``warnings``, a list of sentences.

    Raises
    ------
    InputError
        A source without surface or points, or with coordinates that are not finite.
    SettingsError
        Options that contradict each other.
    """
    chosen = options or SurfelOptions()
    job = _point_job(source, chosen) if isinstance(source, PointSet) else _mesh_job(source, chosen)
    nodes = np.zeros(len(job.tree.nodes), NODE)
    with replacing(path) as unfinished:
        with open(unfinished, "wb") as file:
            writer = SurfelWriter(file, colored=job.colored, exact=chosen.positions == "float32")
            for level in range(job.tree.nodes[-1].level, -1, -1):
                rows = [i for i, node in enumerate(job.tree.nodes) if node.level == level]
                made = partial(_made, job, chosen, unfinished, writer.flags, nodes)
                for row, surfels in zip(rows, _in_order(made, rows, job.at_once), strict=True):
                    node = job.tree.nodes[row]
                    nodes[row] = writer.add(surfels)
                    nodes[row]["level"], nodes[row]["children"] = level, len(node.children)
                    nodes[row]["first_child"] = node.children.start if node.children else 0
                writer.flush()
            writer.close(nodes)
        root = read_node(unfinished, SurfelLayout(writer.flags, nodes), nodes[0])
    return _figures(path, nodes, root, job, chosen)


@dataclass(frozen=True)
class _Job:
    """What the nodes of a source are made from."""

    tree: ItemTree
    leaf: Callable[[NDArray[np.int64]], Candidates]
    colored: bool
    at_once: int
    opposite: float
    oriented: bool
    warnings: list[str]


def _mesh_job(source: TriangleMesh | TexturedMesh | PaintedSurface, options: SurfelOptions) -> _Job:
    surface = PaintedSurface.of(source)
    corners = surface.mesh.vertices[surface.mesh.triangles]
    most = options.most_triangles()
    opposite = options.opposite_share * float(np.linalg.norm(np.ptp(corners, axis=(0, 1))))
    # Made here, before threads ask for it side by side.
    _ = surface.corner_normals

    def leaf(rows: NDArray[np.int64]) -> Candidates:
        points, gap = surface_candidates(
            surface, options.candidates_resolution, rows, views=options.views
        )
        return Candidates(points, gap, len(rows), opposite)

    at_once = options.nodes_at_once(most, triangles=True)
    tree = item_tree(corners.mean(axis=1), most)
    return _Job(tree, leaf, surface.colored, at_once, opposite, True, [])


def _point_job(source: PointSet, options: SurfelOptions) -> _Job:
    if not len(source) or not np.isfinite(source.points).all():
        raise InputError(
            "The cloud has no points that surfels can be made of.",
            expected="points, all finite",
            found=f"{int((~np.isfinite(source.points)).any(axis=1).sum())} of {len(source)} not",
            fix="Check the file; the program that wrote it may have marked holes so.",
        )
    most = options.most_points()
    opposite = options.opposite_share * float(np.linalg.norm(np.ptp(source.points, axis=0)))
    warnings = []
    if source.normals is None:
        # Their sides are not known: what faces away may be the same side.
        opposite = 0.0
        warnings.append("The points have no normals; they were estimated from their neighbours.")

    def leaf(rows: NDArray[np.int64]) -> Candidates:
        part = source.chosen(rows)
        normals = sound_normals(part.points, part.normals)
        apart = nearest_distances(part.points)
        # Copies say nothing of the gaps between points.
        apart = apart[np.isfinite(apart) & (apart > 0.0)]
        gap = float(np.median(apart)) if len(apart) else 0.0
        return Candidates(
            PointSet(part.points, normals, part.color, None), gap, len(rows), opposite
        )

    at_once = options.nodes_at_once(most, triangles=False)
    tree = item_tree(source.points, most)
    return _Job(
        tree,
        leaf,
        source.color is not None,
        at_once,
        opposite,
        source.normals is not None,
        warnings,
    )


def _made(
    job: _Job,
    options: SurfelOptions,
    unfinished: Path,
    flags: int,
    nodes: NDArray[np.void],
    row: int,
) -> SurfelNode:
    """The surfels of one node; its children are in the file already."""
    node = job.tree.nodes[row]
    seed = int(np.random.SeedSequence([options.seed, row]).generate_state(1)[0])
    if not node.children:
        return chosen_surfels(job.leaf(job.tree.items(node)), options, seed)
    layout = SurfelLayout(flags, nodes)
    candidates = _candidates_of_children(job, node, layout, unfinished, options)
    return chosen_surfels(candidates, options, seed)


def _candidates_of_children(
    job: _Job, node: TreeNode, layout: SurfelLayout, unfinished: Path, options: SurfelOptions
) -> Candidates:
    children = [read_node(unfinished, layout, layout.nodes[row]) for row in node.children]
    surfels = joined([child.prefix(len(child.surfels)) for child in children])
    seen = seen_from_corners(
        surfels, options.candidates_resolution, views=options.views, oriented=job.oriented
    )
    # The surface is farthest from the children's surfels half-way between them, seldom just where
    # these are farthest from their parent's, too.
    gap = 0.5 * max(child.radius for child in children)
    return Candidates(surfels.chosen(seen), gap, node.items, job.opposite)


def _in_order(
    made: Callable[[int], SurfelNode], rows: list[int], at_once: int
) -> Iterator[SurfelNode]:
    """Nodes in the order of their rows, some made ahead."""
    waiting: deque[Future[SurfelNode]] = deque()
    left = iter(rows)
    with ThreadPoolExecutor(at_once) as pool:
        try:
            for row in left:
                waiting.append(pool.submit(made, row))
                if len(waiting) == at_once:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()


def _figures(
    path: Path, nodes: NDArray[np.void], root: SurfelNode, job: _Job, options: SurfelOptions
) -> dict[str, Any]:
    items = int(nodes["surfels"].sum(dtype=np.int64))
    leaves = nodes["children"] == 0
    size = path.stat().st_size
    warnings = list(job.warnings)
    if len(root.surfels) < options.count:
        warnings.append(
            f"The candidates gave {len(root.surfels)} surfels, not {options.count}: raise "
            "candidates_resolution, or take fewer."
        )
    apart = nearest_distances(root.surfels.points)
    median = float(np.median(apart)) if len(apart) > 1 else 0.0
    return {
        "format": "surfels",
        "items": items,
        "finest_items": int(nodes["surfels"][leaves].sum(dtype=np.int64)),
        "bytes": size,
        "bits_per_item": 8.0 * size / items,
        "nodes": len(nodes),
        "levels": int(nodes["level"].max()) + 1,
        "median_distance": median,
        "radius": root.radius,
        "spacing_prefix": root.spacing.prefix,
        "spacing_distance": root.spacing.distance,
        "source_items": int(nodes["items"][0]),
        "warnings": warnings,
    }
