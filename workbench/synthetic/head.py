"""The statue's head: face, hair and beard. Part frame: chin at the origin, facing +y."""

from __future__ import annotations

import numpy as np

from workbench.kernels.implicit_solids import SUBTRACT
from workbench.synthetic.primitives import Group, PrimitiveTable, curve_through


def add_skull(table: PrimitiveTable) -> None:
    """Skull, jaw, cheeks, forehead and ears."""
    table.ellipsoid(Group.HEAD, (0, -0.008, 0.105), (0.060, 0.075, 0.068))
    table.ellipsoid(Group.HEAD, (0, 0.020, 0.070), (0.048, 0.050, 0.066), 0.02)
    table.cone(Group.HEAD, (0, -0.01, 0.05), (0, -0.008, -0.02), (0.039, 0.038), 0.01)
    for x in (-1.0, 1.0):
        table.cone(
            Group.HEAD, (0.034 * x, 0.006, 0.038), (0.008 * x, 0.05, 0.013), (0.016, 0.013), 0.014
        )
        table.ball(Group.HEAD, (0.028 * x, 0.043, 0.061), 0.0195, 0.014)
    table.ball(Group.HEAD, (0, 0.056, 0.0125), 0.0135, 0.01)
    table.ellipsoid(Group.HEAD, (0, 0.028, 0.116), (0.045, 0.041, 0.032), 0.012)
    angle = np.linspace(-0.45 * np.pi, 1.0 * np.pi, 12)
    for x in (-1.0, 1.0):
        table.ellipsoid(Group.HEAD, (0.053 * x, -0.015, 0.066), (0.008, 0.012, 0.019), 0.004)
        rim = np.stack(
            [
                x * (0.0585 + 0.002 * np.cos(angle)),
                -0.016 - 0.011 * np.cos(angle - 0.3),
                0.068 + 0.0195 * np.sin(angle),
            ],
            axis=1,
        )
        table.chain(Group.HEAD, rim, np.linspace(0.0045, 0.0036, 12), 0.003)
        table.ball(Group.HEAD, (0.055 * x, -0.009, 0.051), 0.0058, 0.005)
        table.ball(Group.HEAD, (0.063 * x, -0.011, 0.069), 0.0062, 0.004, SUBTRACT)


def add_face(table: PrimitiveTable) -> None:
    """Brows, eyes with lids and drilled pupils, nose and mouth."""
    for x in (-1.0, 1.0):
        table.ellipsoid(
            Group.HEAD, (0.0225 * x, 0.080, 0.0845), (0.0165, 0.0195, 0.0105), 0.009, SUBTRACT
        )
        brow = np.array(
            [[0.007, 0.0725, 0.0965], [0.018, 0.0735, 0.1005], [0.029, 0.066, 0.0995],
             [0.040, 0.049, 0.093]]
        ) * [x, 1, 1]  # fmt: skip
        table.chain(Group.HEAD, brow, [0.0045, 0.0042, 0.004, 0.0035], 0.007)
    table.cone(Group.HEAD, (0, 0.0695, 0.097), (0, 0.0895, 0.0615), (0.0062, 0.0068), 0.006)
    table.ball(Group.HEAD, (0, 0.0895, 0.0585), 0.0084, 0.004)
    for x in (-1.0, 1.0):
        table.ball(Group.HEAD, (0.0088 * x, 0.0785, 0.0560), 0.0060, 0.007)
        table.ball(Group.HEAD, (0.0046 * x, 0.0835, 0.0495), 0.0029, 0.002, SUBTRACT)
        eye = np.array([0.0225 * x, 0.0555, 0.0840])
        table.ball(Group.HEAD, eye, 0.0138, 0.001)
        turn = np.linspace(-1.15, 1.15, 8)
        for lift, open_height, radius in ((1.0, 0.0062, 0.0024), (-1.0, 0.0046, 0.0018)):
            height = open_height * np.cos(turn * 1.3)
            lid = eye + 0.0146 * np.stack(
                [np.sin(turn), np.cos(turn) * 0.96, lift * height / 0.0146], axis=1
            )
            table.chain(Group.HEAD, lid, radius, 0.0012)
        table.ball(Group.HEAD, eye + np.array([0, 0.0142, 0.0006]), 0.0026, 0.001, SUBTRACT)
    # Muzzle, lips, the line between them, the groove below the nose.
    table.ellipsoid(Group.HEAD, (0, 0.056, 0.036), (0.021, 0.0175, 0.0165), 0.01)
    upper = curve_through(
        [[-0.0185, 0.064, 0.0335], [-0.006, 0.0745, 0.0383], [0, 0.0748, 0.0370],
         [0.006, 0.0745, 0.0383], [0.0185, 0.064, 0.0335]], 9
    )  # fmt: skip
    table.chain(Group.HEAD, upper, [1.5e-3, 3e-3, 4e-3, 4.2e-3, 4e-3, 4.2e-3, 4e-3, 3e-3, 1.5e-3],
                0.0015)  # fmt: skip
    lower = curve_through([[-0.015, 0.065, 0.0300], [0, 0.0745, 0.0275], [0.015, 0.065, 0.0300]], 7)
    table.chain(Group.HEAD, lower, [1.5e-3, 3.2e-3, 4.2e-3, 4.4e-3, 4.2e-3, 3.2e-3, 1.5e-3], 0.002)
    line = curve_through(
        [[-0.0205, 0.066, 0.0322], [0, 0.0805, 0.0335], [0.0205, 0.066, 0.0322]], 7
    )
    table.chain(Group.HEAD, line, 0.0016, 0.001, SUBTRACT)
    table.cone(Group.HEAD, (0, 0.0785, 0.049), (0, 0.0795, 0.0425), (0.0022, 0.0026), 0.002,
               SUBTRACT)  # fmt: skip


def add_hair(table: PrimitiveTable, rng: np.random.Generator) -> None:
    """Wavy strands from the parting over the temples to the back of the head."""
    strands = 10
    for x in (-1.0, 1.0):
        for n in range(strands):
            back = n / (strands - 1)
            start = [
                0.003 * x,
                0.071 - 0.115 * back,
                0.139 + 0.036 * np.sin(np.pi * min(1.0, back + 0.25)),
            ]
            side = [0.052 * x, 0.052 - 0.075 * back, 0.122 + 0.004 * back]
            temple = [(0.062 - 0.006 * back) * x, 0.014 - 0.072 * back, 0.092 - 0.012 * back]
            nape = [(0.022 - 0.012 * back) * x, -0.082, 0.074 - 0.012 * (1 - back)]
            path = curve_through([start, side, temple, nape], 18)
            along = np.linspace(0, 1, 18)
            wave = np.sin(2 * np.pi * (4.2 * along + rng.uniform(0, 0.25) + 0.5 * (n % 2)))
            path[:, 2] += 0.0026 * wave * np.sin(np.pi * along)
            path[:, 1] += 0.0020 * wave * np.sin(np.pi * along)
            path = table.draped(path, 0.0025, [Group.HEAD])
            width = 0.0072 * (1 + 0.12 * rng.standard_normal()) * (1 - 0.25 * along)
            table.chain(Group.HAIR, path, width, 0.0015)
    around = np.linspace(0, 2 * np.pi, 33)
    band = np.stack(
        [0.071 * np.cos(around), -0.008 + 0.084 * np.sin(around), 0.128 + 0.016 * np.sin(around)],
        axis=1,
    )
    band = table.draped(band, 0.001, [Group.HEAD, Group.HAIR])
    table.chain(Group.HAIR, band, 0.0042, 0.001)


def add_bun(table: PrimitiveTable) -> None:
    """A knot of twisted hair at the back of the head."""
    table.ball(Group.HAIR, (0, -0.088, 0.076), 0.026, 0.006)
    turn = np.linspace(0, 5 * np.pi, 34)
    radius = np.linspace(0.027, 0.004, 34)
    spiral = np.stack(
        [radius * np.cos(turn), np.linspace(-0.088, -0.117, 34), 0.076 + radius * np.sin(turn)],
        axis=1,
    )
    table.chain(Group.HAIR, spiral, 0.0062, 0.0012)


def add_beard(table: PrimitiveTable, rng: np.random.Generator) -> None:
    """Curled locks along the jaw, longest at the chin, and a moustache."""
    for row in range(3):
        for angle in np.radians(np.linspace(-78, 78, 15 - 2 * row)):
            root = np.array([0.046 * np.sin(angle), 0.012 + 0.048 * np.cos(angle),
                             0.010 + 0.03 * (1 - np.cos(angle)) + 0.008 * row])  # fmt: skip
            length = (0.018 + 0.026 * np.cos(angle) ** 2) * (1 - 0.25 * row)
            along = np.linspace(0, 1, 6)
            curl = rng.choice([-1.0, 1.0]) * 0.004 * np.sin(2 * np.pi * along * 0.9)
            lock = root + np.stack(
                [curl - 0.3 * root[0] * along, 0.006 * np.sin(np.pi * along) + 0.004 * row,
                 -length * along], axis=1
            )  # fmt: skip
            table.chain(Group.HAIR, lock, np.linspace(0.0062, 0.0026, 6), 0.0015)
    for x in (-1.0, 1.0):
        moustache = np.array(
            [[0.002 * x, 0.0785, 0.0445], [0.013 * x, 0.074, 0.0425], [0.024 * x, 0.061, 0.031],
             [0.028 * x, 0.056, 0.018]]
        )  # fmt: skip
        table.chain(Group.HAIR, moustache, [0.0035, 0.0042, 0.0038, 0.002], 0.0015)
