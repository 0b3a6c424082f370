"""A draped standing figure on its own base, carved in bright stone and weathered."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from workbench.geometry import transforms
from workbench.geometry.mesh import TriangleMesh
from workbench.kernels.gradient_noise import noise_at
from workbench.kernels.implicit_solids import GROUPS, SUBTRACT
from workbench.synthetic import drapery, figure, head
from workbench.synthetic.carving import Solid, carved_mesh
from workbench.synthetic.figure import BASE_TOP_M, Posture
from workbench.synthetic.primitives import GROUP_BLEND_M, Group, PrimitiveTable

# Strokes of the inscription in letter boxes of 1 × 1, first to last point of each line.
_LETTERS = (
    ((0, 0, 0.5, 1), (0.5, 1, 1, 0), (0.25, 0.42, 0.75, 0.42)),
    ((0, 0, 0, 1), (0, 1, 1, 0), (1, 0, 1, 1)),
    ((0.5, 0, 0.5, 1),),
    ((0, 0, 0, 1), (0, 0.5, 0.9, 1), (0, 0.5, 0.9, 0)),
    ((0, 0, 0, 1), (0, 1, 0.9, 1), (0, 0.5, 0.7, 0.5), (0, 0, 0.9, 0)),
    ((0.5, 0, 0.5, 1), (0, 1, 1, 1)),
    ((0, 0, 0, 1), (0, 1, 1, 1), (1, 1, 1, 0)),
)


def statue_solid(rng: np.random.Generator) -> Solid:
    """The carved solid of one statue: a different figure for every state of ``rng``."""
    posture = Posture.drawn(rng)
    table = PrimitiveTable()
    # Cloth follows what is there when it is laid: the arms come after the dress.
    figure.add_body(table, posture)
    drapery.add_dress(table, posture, rng)
    drapery.add_bodice(table, rng)
    drapery.add_mantle(table, rng)
    figure.add_bent_arm(table)
    stump = figure.add_hanging_arm(table, posture)
    drapery.add_sleeves(table, rng)
    drapery.add_fall(table, rng)
    figure.add_feet(table, posture)
    _add_head(table, posture, rng)
    _add_base(table, rng)
    _add_damage(table, rng)
    detail = np.zeros((GROUPS, 3))
    detail[Group.BODY] = 0.6, 0.5, 0.15
    detail[Group.HEAD] = 0.25, 0.22, 0.0
    detail[Group.HAIR] = 0.35, 0.3, 0.0
    detail[Group.CLOTH] = 0.6, 0.6, 0.35
    detail[Group.FOLDS] = 0.6, 0.5, 0.25
    detail[Group.BASE] = 1.1, 1.0, 1.0
    return Solid(
        table.array(),
        GROUP_BLEND_M,
        detail,
        _cracks(rng, stump),
        seed=int(rng.integers(1, 2**20)),
        low=np.array([-0.31, -0.23, -0.02]),
        high=np.array([0.31, 0.26, 1.26]),
        interior=np.array([0.0, 0.02, 0.036]),
    )


def statue_mesh(rng: np.random.Generator, spacing_m: float) -> TriangleMesh:
    """One closed mesh, about 1.2 m high, standing at z = 0 and facing +y.

    Parameters
    ----------
    rng : decides posture, folds and damage.
    spacing_m : lattice spacing; finer detail is left out.

    Returns
    -------
    Mesh with ``reflectance`` (n,) float32 in [0.55, 0.8].
    """
    solid = statue_solid(rng)
    mesh = carved_mesh(solid, spacing_m)
    return mesh.with_attributes(reflectance=_patina(solid, mesh.vertices, spacing_m))


def _patina(solid: Solid, points: NDArray[np.float64], spacing_m: float) -> NDArray[np.float32]:
    """Reflectance (n,) of weathered stone: clouds, rain streaks, dirt in the grooves."""
    groove = -solid.smooth_distances(points, spacing_m)
    value = 0.69 + 0.07 * noise_at(points, 0.22, solid.seed + 200)
    value += 0.045 * noise_at(points, 0.045, solid.seed + 201)
    value += 0.02 * noise_at(points, 0.009, solid.seed + 202)
    value += 0.045 * noise_at(points, (0.03, 0.03, 0.35), solid.seed + 203)
    value -= 25.0 * np.clip(groove, 0.0, 0.003)
    return np.clip(value, 0.55, 0.8).astype(np.float32)


def _add_head(table: PrimitiveTable, posture: Posture, rng: np.random.Generator) -> None:
    turn = Rotation.from_euler(
        "zxy", [posture.head_yaw_deg, posture.head_pitch_deg, posture.head_roll_deg], degrees=True
    )
    neck = np.array([0.0, -0.006, 1.0])
    pivot = np.array([0.0, -0.01, 0.0])
    table.solid_from_part = transforms.rigid(turn.as_matrix(), neck - turn.apply(pivot))
    head.add_skull(table)
    head.add_face(table)
    head.add_hair(table, rng)
    if posture.bearded:
        head.add_beard(table, rng)
    else:
        head.add_bun(table)
    table.solid_from_part = np.eye(4)


def _add_base(table: PrimitiveTable, rng: np.random.Generator) -> None:
    """A moulded block with an inscription on its front."""
    table.box(Group.BASE, (0, 0.02, 0.036), (0.205, 0.165, 0.036), 0.004)
    table.box(Group.BASE, (0, 0.02, BASE_TOP_M - 0.009), (0.188, 0.148, 0.009), 0.004, 0.003)
    letters = rng.permutation(len(_LETTERS))
    width = 0.34 / len(letters)
    for place, letter in enumerate(letters):
        left = 0.17 - width * (place + 0.14)
        for x0, z0, x1, z1 in _LETTERS[letter]:
            start = (left - 0.72 * width * x0, 0.185, 0.020 + 0.034 * z0)
            end = (left - 0.72 * width * x1, 0.185, 0.020 + 0.034 * z1)
            table.cone(Group.BASE, start, end, (0.0032, 0.0032), 0.001, SUBTRACT)


def _add_damage(table: PrimitiveTable, rng: np.random.Generator) -> None:
    """Knocked-off corners, a chipped hem and chips along the base."""
    for x in (-1.0, 1.0):
        for y in (-0.145, 0.185):
            if rng.random() < 0.6:
                corner = np.array([0.205 * x, y, rng.uniform(0.0, 0.075)])
                table.ball(Group.CUT, corner + rng.normal(0, 0.008, 3), rng.uniform(0.016, 0.034))
    for _ in range(7):
        x = rng.uniform(-0.19, 0.19)
        edge = 0.185 if rng.random() < 0.6 else -0.145
        table.ball(Group.CUT, (x, edge + 0.006 * np.sign(edge), 0.076), rng.uniform(0.008, 0.016))
    for _ in range(3):
        azimuth = rng.uniform(0, 2 * np.pi)
        center = (0.165 * np.cos(azimuth), 0.135 * np.sin(azimuth), rng.uniform(0.12, 0.5))
        table.ball(Group.CUT, center, rng.uniform(0.012, 0.022))


def _cracks(rng: np.random.Generator, stump: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows of plane normal, offset, half width, centre and reach: (5, 9)."""
    rows = []
    centers = [
        [0.02, 0.06, 0.93],
        [rng.uniform(-0.1, 0.1), 0.08, rng.uniform(0.2, 0.5)],
        [rng.uniform(-0.1, 0.1), -0.08, rng.uniform(0.3, 0.8)],
        [rng.uniform(-0.15, 0.15), 0.17, 0.05],
        list(stump + np.array([-0.01, -0.02, 0.06])),
    ]
    for center in centers:
        normal = rng.standard_normal(3)
        normal[2] += np.sign(normal[2]) * 1.2
        normal /= np.linalg.norm(normal)
        half_width = rng.uniform(0.0010, 0.0017)
        reach = rng.uniform(0.07, 0.2)
        rows.append([*normal, normal @ center, half_width, *center, reach])
    return np.array(rows)
