"""The dark metal mount that holds a statue: plate, posts, strap, clamps, rods with pads."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull

from workbench.geometry.mesh import TriangleMesh
from workbench.synthetic import solids
from workbench.synthetic.raycasting import RayCaster
from workbench.synthetic.scene import SUPPORT, painted

_STRAP_HEIGHTS = (0.425, 0.447)
_STRAP_THICKNESS = 0.003
_REAR_POST_Y = -0.27
_PRESS_M = 0.001


def support_mesh(statue: TriangleMesh, rng: np.random.Generator) -> TriangleMesh:
    """Closed bodies that touch the statue where it needs holding.

    Parameters
    ----------
    statue : closed mesh standing at z = 0, facing +y, as ``statue_mesh`` makes it.
    rng : decides how bright each part is.

    Returns
    -------
    Mesh with ``material`` and ``reflectance`` (0.05 to 0.12). Pads and clamps press 1 mm into
    the stone, as padding does; the strap lies on the convex hull of the section it holds.
    """
    caster = RayCaster(statue)
    parts = [*_frame(), *_base_clamps(caster), *_strap(statue)]
    for start, target in _rods():
        parts.extend(_rod_with_pad(caster, start, target))
    return solids.collected(
        [
            painted(
                part, SUPPORT, np.clip(shade + rng.normal(0, 0.004, len(part.vertices)), 0.05, 0.12)
            )
            for part, shade in zip(parts, rng.uniform(0.055, 0.115, len(parts)), strict=True)
        ]
    )


def _frame() -> list[TriangleMesh]:
    """Base plate, rear post with cross bar, two front posts with a bar between them."""
    front = [
        solids.tube([(x, 0.25, 0.0), (x, 0.25, z)], 0.008) for x, z in ((-0.27, 0.70), (0.27, 0.64))
    ]
    return [
        solids.box((-0.36, -0.34, -0.015), (0.36, 0.32, 0.0)),
        solids.box((-0.014, _REAR_POST_Y - 0.014, 0.0), (0.014, _REAR_POST_Y + 0.014, 1.12)),
        solids.tube([(-0.15, _REAR_POST_Y, 0.9), (0.15, _REAR_POST_Y, 0.9)], 0.008),
        *front,
        solids.tube([(-0.27, 0.25, 0.31), (0.27, 0.25, 0.31)], 0.006),
    ]


def _rods() -> list[tuple[tuple[float, float, float], tuple[float, float, float]]]:
    """Where each padded rod starts and the point it is driven towards."""
    return [
        ((-0.09, _REAR_POST_Y, 0.9), (-0.05, 0.0, 0.895)),
        ((0.09, _REAR_POST_Y, 0.9), (0.05, 0.0, 0.895)),
        ((0.0, _REAR_POST_Y, 1.08), (0.0, 0.0, 1.075)),
        ((-0.27, 0.25, 0.68), (-0.16, 0.10, 0.70)),
        ((0.27, 0.25, 0.62), (0.06, 0.02, 0.64)),
        ((0.14, 0.25, 0.31), (0.06, 0.05, 0.30)),
        ((0.27, 0.25, 0.52), (0.0, 0.02, 0.52)),
    ]


def _rod_with_pad(caster: RayCaster, start: ArrayLike, target: ArrayLike) -> list[TriangleMesh]:
    """A thin rod from ``start`` to the stone, a round pad and a clamp where it starts."""
    origin, aim = np.asarray(start, float), np.asarray(target, float)
    way = (aim - origin) / np.linalg.norm(aim - origin)
    reach = float(caster.cast(origin, way[None]).distance[0])
    if not np.isfinite(reach):
        return []
    contact = origin + reach * way
    pad = [contact - 0.007 * way, contact - 0.004 * way, contact + _PRESS_M * way]
    return [
        solids.tube([origin, contact - 0.005 * way], 0.004, 12),
        solids.tube(pad, [0.008, 0.014, 0.014], 20),
        solids.tube([origin - 0.016 * way, origin + 0.016 * way], 0.013, 6),
    ]


def _base_clamps(caster: RayCaster) -> list[TriangleMesh]:
    """Blocks pressed against the four sides of the statue's own base, each with a screw."""
    parts = []
    for x, y in ((-0.1, 0.3), (0.12, 0.3), (-0.33, 0.0), (0.33, 0.03), (-0.08, -0.3), (0.1, -0.3)):
        way = (
            np.array([0.0, -np.sign(y), 0.0]) if abs(y) > 0.2 else np.array([-np.sign(x), 0.0, 0.0])
        )
        origin = np.array([x, y, 0.035])
        contact = origin + float(caster.cast(origin, way[None]).distance[0]) * way
        across = np.abs(np.cross(way, [0.0, 0.0, 1.0])) * 0.022
        inner = contact + _PRESS_M * way
        outer = contact - 0.014 * way
        low = np.minimum(inner, outer) - across - [0, 0, 0.035]
        high = np.maximum(inner, outer) + across + [0, 0, 0.022]
        parts.append(solids.box(low, high))
        parts.append(solids.tube([contact - 0.05 * way, contact - 0.01 * way], 0.005, 10))
    return parts


def _strap(statue: TriangleMesh) -> list[TriangleMesh]:
    """A metal strap round the dress and the stay that ties it to the rear post."""
    low, high = _STRAP_HEIGHTS
    held = (statue.vertices[:, 2] > low) & (statue.vertices[:, 2] < high)
    outline = _rounded_hull(statue.vertices[held, :2])
    back = outline[outline[:, 1].argmin()]
    middle = 0.5 * (low + high)
    stay = [(0.0, _REAR_POST_Y, middle), (back[0], back[1] - 0.5 * _STRAP_THICKNESS, middle)]
    return [solids.band(outline, _STRAP_THICKNESS, low, high), solids.tube(stay, 0.005, 12)]


def _rounded_hull(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convex outline (n, 2) of points, counter-clockwise, with no edge above 8 mm."""
    corners = points[ConvexHull(points).vertices]
    after = np.roll(corners, -1, axis=0)
    pieces = []
    for a, b in zip(corners, after, strict=True):
        count = max(1, int(np.ceil(np.linalg.norm(b - a) / 0.008)))
        pieces.append(a + (b - a) * (np.arange(count) / count)[:, None])
    return np.concatenate(pieces)
