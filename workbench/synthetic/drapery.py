"""What the statue wears: a pleated dress, a mantle rolled round the waist and over one arm."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from workbench.geometry import transforms
from workbench.synthetic.figure import BASE_TOP_M, Posture, leg_joints
from workbench.synthetic.primitives import Group, PrimitiveTable, curve_through, relaxed

_DRESSED = (Group.BODY, Group.CLOTH)


def add_dress(table: PrimitiveTable, posture: Posture, rng: np.random.Generator) -> None:
    """The cloth over the legs with its hanging folds."""
    s = posture.free_side
    legs = leg_joints(posture)
    for x in (-1.0, 1.0):
        table.cone(
            Group.CLOTH, (0.044 * x, -0.012, 0.58), (0.074 * x, -0.016, 0.15), (0.082, 0.09), 0.035
        )
    # Cloth spans the hollow between the shins.
    table.cone(Group.CLOTH, (0.0, 0.02, 0.52), (0.016 * s, 0.034, 0.14), (0.07, 0.078), 0.03)
    for name, radii in (("standing", (0.084, 0.06, 0.04)), ("free", (0.084, 0.058, 0.036))):
        table.cone(Group.CLOTH, legs[name][0], legs[name][1], (radii[0], radii[1]), 0.035)
        table.cone(Group.CLOTH, legs[name][1], legs[name][2], (radii[1], radii[2]), 0.03)
    _add_hanging_folds(table, posture, rng)
    _add_swags(table, posture, rng)


def _add_hanging_folds(table: PrimitiveTable, posture: Posture, rng: np.random.Generator) -> None:
    """Tubular folds from the waist to the hem; over the bent thigh they start below the knee."""
    count = int(rng.integers(36, 43))
    azimuths = 2 * np.pi * (np.arange(count) + rng.uniform(-0.3, 0.3, count)) / count
    knee = leg_joints(posture)["free"][1]
    thigh = np.arctan2(knee[1], knee[0]) + posture.free_side * np.radians(8)
    for azimuth in azimuths:
        off_thigh = abs((azimuth - thigh + np.pi) % (2 * np.pi) - np.pi)
        bare = off_thigh < np.radians(40)
        top = 0.31 - rng.uniform(0, 0.09) if bare else rng.uniform(0.61, 0.655)
        along = np.linspace(0, 1, 13)
        z = top + (BASE_TOP_M + 0.010 - top) * along
        sway = rng.uniform(-0.06, 0.06) * np.sin(np.pi * along * rng.uniform(0.7, 1.6))
        turn = azimuth + sway
        path = np.stack([0.21 * np.cos(turn), 0.17 * np.sin(turn), z], axis=1)
        lift = rng.uniform(-0.003, 0.003) + 0.006 * along**2
        path = relaxed(table.draped(path, lift, [Group.CLOTH]))
        path[:, 2] = np.maximum(path[:, 2], BASE_TOP_M + 0.008)
        girth = rng.uniform(0.75, 1.3)
        size = girth * (0.006 + 0.0065 * along) * np.minimum(1.0, 0.35 + 5 * along)
        table.chain(Group.FOLDS, path, size, 0.007)


def _add_swags(table: PrimitiveTable, posture: Posture, rng: np.random.Generator) -> None:
    """Shallow folds that sag over the bent thigh."""
    s = posture.free_side
    for n in range(5):
        high = 0.595 - 0.042 * n + rng.uniform(-0.008, 0.008)
        path = curve_through(
            [
                [0.15 * s, 0.05 + 0.01 * n, high],
                [0.115 * s, 0.14, high - 0.055],
                [0.05 * s, 0.18, high - 0.09 + rng.uniform(-0.006, 0.006)],
                [-0.005 * s, 0.17, high - 0.085],
            ],
            14,
        )
        path = relaxed(table.draped(path, -0.003, [Group.CLOTH]), 3)
        swell = np.sin(np.linspace(0.1, np.pi - 0.1, 14))
        table.chain(Group.FOLDS, path, 0.002 + rng.uniform(0.005, 0.008) * swell, 0.010)


def add_bodice(table: PrimitiveTable, rng: np.random.Generator) -> None:
    """Folds from the shoulders to the waist, before and behind."""
    for x in (-1.0, 1.0):
        for n in range(9):
            t = n / 8
            front = [
                [x * (0.055 + 0.07 * t), 0.035, 0.962 - 0.006 * t],
                [x * (0.018 + 0.115 * t), 0.10 - 0.02 * t, 0.885 - 0.01 * t],
                [x * (0.006 + 0.125 * t), 0.10 - 0.05 * t, 0.79],
                [x * (0.004 + 0.12 * t), 0.09 - 0.05 * t, 0.68],
            ]
            back = [
                [x * (0.055 + 0.08 * t), -0.06, 0.955],
                [x * (0.03 + 0.105 * t), -0.11 + 0.02 * t, 0.86],
                [x * (0.01 + 0.11 * t), -0.10 + 0.03 * t, 0.68],
            ]
            for control in (front, back):
                path = curve_through(control, 14)
                path[:, 0] += 0.004 * np.sin(np.linspace(0, 6, 14) + rng.uniform(0, 6))
                path = relaxed(table.draped(path, -0.0005, [Group.BODY]), 1)
                size = rng.uniform(0.0042, 0.0075) * (0.75 + 0.35 * np.linspace(1, 0, 14))
                table.chain(Group.FOLDS, path, size, 0.006)


def add_sleeves(table: PrimitiveTable, rng: np.random.Generator) -> None:
    """Short sleeves with slanting creases and a hem."""
    for x in (-1.0, 1.0):
        shoulder = np.array([x * 0.150, -0.014, 0.923])
        cuff = np.array([x * 0.189, -0.032, 0.805])
        table.cone(Group.CLOTH, shoulder, cuff, (0.046, 0.044), 0.02)
        axis = cuff - shoulder
        for n in range(6):
            slant = rng.uniform(0.010, 0.024)
            start = rng.uniform(0, 2 * np.pi)
            turn = start + np.linspace(0, rng.uniform(0.8, 1.5) * np.pi, 12)
            center = shoulder + (0.22 + 0.14 * n) * axis
            arc = center + np.stack(
                [0.055 * np.cos(turn), 0.055 * np.sin(turn), slant * np.cos(turn - start)], axis=1
            )
            arc = relaxed(table.draped(arc, -0.002, [Group.CLOTH]))
            swell = np.sin(np.linspace(0.1, np.pi - 0.1, 12))
            table.chain(Group.FOLDS, arc, 0.002 + rng.uniform(0.003, 0.0045) * swell, 0.008)
        turn = np.linspace(0, 2 * np.pi, 17)
        ripple = 0.046 + 0.0025 * np.sin(6 * turn + rng.uniform(0, 6))
        hem = cuff + np.stack(
            [ripple * np.cos(turn), ripple * np.sin(turn), 0.33 * x * ripple * np.cos(turn)],
            axis=1,
        )
        table.chain(Group.FOLDS, hem, 0.0046, 0.004)


def add_mantle(table: PrimitiveTable, rng: np.random.Generator) -> None:
    """The roll round the waist and the sash over the shoulder of the bent arm."""
    around = np.linspace(0, 2 * np.pi, 40)
    tilt = rng.uniform(-0.5, 0.5)
    for n in range(5):
        phase, wobble = rng.uniform(0, 6, 2)
        height = 0.632 + 0.0155 * n - 0.03 * np.cos(around - tilt)
        height += 0.005 * np.sin(3 * around + phase)
        path = np.stack([0.17 * np.cos(around), 0.15 * np.sin(around), height], axis=1)
        lift = 0.006 + 0.004 * np.sin(n * np.pi / 4)
        path = table.draped(path, lift, _DRESSED)
        size = 0.0105 * (1 + 0.2 * np.sin(2 * around + wobble))
        table.chain(Group.FOLDS, path, size, 0.003)
    for n in range(7):
        t = n / 6
        front = [
            [-0.075 - 0.055 * t, -0.03, 0.975],
            [-0.07 - 0.05 * t, 0.06, 0.935],
            [-0.055 - 0.05 * t, 0.12, 0.83],
            [-0.06 - 0.055 * t, 0.12 - 0.03 * t, 0.66],
        ]
        back = [
            [-0.075 - 0.055 * t, -0.035, 0.975],
            [-0.03 - 0.05 * t, -0.12, 0.88 - 0.03 * t],
            [0.05 - 0.05 * t, -0.12, 0.77 - 0.04 * t],
            [0.11 - 0.04 * t, -0.09, 0.665 - 0.01 * t],
        ]
        for control in (front, back):
            path = relaxed(table.draped(curve_through(control, 14), 0.006, _DRESSED), 1)
            table.chain(Group.FOLDS, path, rng.uniform(0.006, 0.0095), 0.002)


def add_fall(table: PrimitiveTable, rng: np.random.Generator) -> None:
    """Cloth over the bent forearm, hanging down in folds with a zigzag edge."""
    turn = Rotation.from_euler("z", 14.0, degrees=True).as_matrix()
    table.solid_from_part = transforms.rigid(turn, [-0.192, 0.012, 0.755])
    count = 8
    ends = []
    for n in range(count):
        t = n / (count - 1)
        side = -1.0 if n % 2 else 1.0
        top = np.array([0.010 * side, -0.055 + 0.115 * t, 0.0])
        length = 0.42 - 0.10 * t + 0.022 * side
        along = np.linspace(0, 1, 10)
        drift = rng.uniform(-0.008, 0.008)
        path = top + np.stack(
            [
                0.004 * side * along + 0.006 * np.sin(4 * along + rng.uniform(0, 6)) * along,
                drift * along + 0.018 * (t - 0.5) * along,
                -length * along,
            ],
            axis=1,
        )
        table.chain(Group.FOLDS, path, 0.0095 + 0.004 * along, 0.008)
        ends.append(path[-1])
    # The cloth between the folds: one slab, narrower than the folds are deep.
    for first, second in pairwise(ends):
        middle = 0.5 * (first + second)
        half = 0.5 * abs(middle[2]) - 0.004
        table.box(Group.FOLDS, (0.0, middle[1], -half), (0.0105, 0.014, half), 0.006, 0.008)
    for n in range(6):
        t = n / 5
        arc = np.linspace(-0.35, np.pi + 0.35, 9)
        center = np.array([0.0, -0.052 + 0.108 * t, -0.006])
        path = center + np.stack(
            [0.034 * np.cos(arc), rng.uniform(-0.006, 0.006) * np.sin(2 * arc),
             0.033 * np.sin(arc)], axis=1
        )  # fmt: skip
        table.chain(Group.FOLDS, path, rng.uniform(0.008, 0.011), 0.005)
    table.solid_from_part = np.eye(4)
