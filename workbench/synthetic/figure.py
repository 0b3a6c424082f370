"""The body of the statue: torso, arms, hands and feet. It faces +y, z is up, metres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.kernels.implicit_solids import SUBTRACT
from workbench.synthetic.primitives import Group, PrimitiveTable, curve_through

BASE_TOP_M = 0.085


@dataclass(frozen=True)
class Posture:
    """What differs from one carved figure to the next.

    Attributes
    ----------
    free_side : +1 when the leg on the +x side is bent, −1 for the other.
    head_yaw_deg, head_pitch_deg, head_roll_deg : how the head is turned.
    broken_arm : whether the forearm on the +x side is lost.
    bearded : whether the head wears a beard instead of a bun.
    slimness : factor on the widths of the body, about 1.
    """

    free_side: float
    head_yaw_deg: float
    head_pitch_deg: float
    head_roll_deg: float
    broken_arm: bool
    bearded: bool
    slimness: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Posture:
        """A posture at random."""
        return cls(
            free_side=float(rng.choice([-1.0, 1.0])),
            head_yaw_deg=float(rng.uniform(-24, 24)),
            head_pitch_deg=float(rng.uniform(-7, 4)),
            head_roll_deg=float(rng.uniform(-6, 6)),
            broken_arm=bool(rng.random() < 0.5),
            bearded=bool(rng.random() < 0.4),
            slimness=float(rng.uniform(0.94, 1.06)),
        )


def add_body(table: PrimitiveTable, posture: Posture) -> None:
    """Torso, neck and shoulders."""
    w = posture.slimness
    s = posture.free_side
    table.ellipsoid(Group.BODY, (-0.008 * s, 0.0, 0.61), (0.122 * w, 0.092, 0.10))
    table.ellipsoid(Group.BODY, (0.0, 0.0, 0.72), (0.102 * w, 0.077, 0.12), 0.05)
    table.ellipsoid(Group.BODY, (0.0, -0.006, 0.845), (0.128 * w, 0.088, 0.115), 0.05)
    table.cone(
        Group.BODY, (-0.128, -0.012, 0.93), (0.128, -0.012, 0.93 + 0.008 * s), (0.036, 0.036), 0.04
    )
    for x in (-1.0, 1.0):
        table.ball(Group.BODY, (0.056 * x, 0.05, 0.862), 0.043, 0.025)
        table.cone(
            Group.BODY, (0.012 * x, -0.018, 0.985), (0.115 * x, -0.016, 0.945), (0.03, 0.026), 0.03
        )
        # Collar bones.
        table.cone(
            Group.BODY, (0.014 * x, 0.046, 0.937), (0.10 * x, 0.022, 0.957), (0.008, 0.007), 0.014
        )
    table.cone(Group.BODY, (0.0, -0.012, 0.93), (0.0, -0.002, 1.04), (0.05, 0.042), 0.03)
    for x in (-1.0, 1.0):
        # The muscle from behind the ear to the notch between the collar bones.
        table.cone(
            Group.BODY, (0.036 * x, -0.002, 1.025), (0.01 * x, 0.042, 0.942), (0.009, 0.007), 0.012
        )


def add_bent_arm(table: PrimitiveTable) -> None:
    """The arm on the −x side, bent forward; its fist holds a scroll."""
    shoulder, elbow = np.array([-0.152, -0.014, 0.92]), np.array([-0.205, -0.045, 0.752])
    wrist = np.array([-0.178, 0.098, 0.742])
    table.cone(Group.BODY, shoulder, elbow, (0.044, 0.034), 0.03)
    table.cone(Group.BODY, elbow, wrist, (0.034, 0.022), 0.015)
    table.ellipsoid(Group.BODY, (-0.172, 0.127, 0.745), (0.017, 0.028, 0.024), 0.012)
    scroll_low, scroll_high = np.array([-0.158, 0.147, 0.688]), np.array([-0.164, 0.143, 0.815])
    table.cone(Group.BODY, scroll_low, scroll_high, (0.0125, 0.0125), 0.002)
    for end in (scroll_low, scroll_high):
        hollow = end + np.array([0.0, 0.0, 0.01 * np.sign(end[2] - 0.75)])
        table.ball(Group.BODY, hollow, 0.006, 0.002, SUBTRACT)
    angle = np.radians(np.array([185.0, 130.0, 75.0, 20.0, -30.0]))
    for finger, z in enumerate((0.764, 0.752, 0.7395, 0.728)):
        center = scroll_low + (z - scroll_low[2]) / 0.127 * (scroll_high - scroll_low)
        ring = np.stack(
            [0.0185 * np.cos(angle), 0.0185 * np.sin(angle), 0.002 * np.sin(angle)], axis=1
        )
        table.chain(Group.BODY, center + ring, np.linspace(0.0068, 0.0055, 5) - 0.0003 * finger,
                    0.0015)  # fmt: skip
    thumb = np.array([[-0.185, 0.118, 0.768], [-0.176, 0.138, 0.781], [-0.163, 0.155, 0.779]])
    table.chain(Group.BODY, thumb, [0.0085, 0.0075, 0.0062], 0.002)


def add_hanging_arm(table: PrimitiveTable, posture: Posture) -> NDArray[np.float64]:
    """The arm on the +x side; returns the point (3,) where a lost forearm broke off."""
    shoulder, elbow = np.array([0.152, -0.014, 0.92]), np.array([0.205, -0.04, 0.75])
    wrist = np.array([0.214, 0.045, 0.615])
    table.cone(Group.BODY, shoulder, elbow, (0.044, 0.034), 0.03)
    table.cone(Group.BODY, elbow, wrist, (0.034, 0.021), 0.012)
    palm = wrist + np.array([0.0, 0.017, -0.04])
    table.cone(Group.BODY, wrist, palm, (0.019, 0.02), 0.012)
    for n, across in enumerate((-0.018, -0.006, 0.006, 0.017)):
        knuckle = palm + np.array([0.35 * across, across, -0.012 + 0.4 * abs(across)])
        bend = knuckle + np.array([-0.006, 0.008, -0.026])
        tip = bend + np.array([-0.012, 0.003, -0.02 + 0.002 * n])
        table.chain(Group.BODY, np.stack([knuckle, bend, tip]), [0.0078, 0.0068, 0.0055], 0.002)
    thumb = np.stack([wrist, palm, palm]) + np.array(
        [[-0.01, 0.02, -0.015], [-0.012, 0.03, -0.008], [-0.012, 0.03, -0.032]]
    )
    table.chain(Group.BODY, thumb, [0.009, 0.0078, 0.006], 0.003)
    stump: NDArray[np.float64] = elbow + 0.42 * (wrist - elbow)
    if posture.broken_arm:
        beyond = stump + 0.11 * (wrist - elbow) / np.linalg.norm(wrist - elbow)
        table.ball(Group.CUT, beyond, 0.108)
    return stump


def leg_joints(posture: Posture) -> dict[str, NDArray[np.float64]]:
    """Hip, knee and ankle of the ``standing`` and the ``free`` leg, each (3, 3)."""
    s = posture.free_side
    standing = [[-0.058 * s, 0.0, 0.58], [-0.062 * s, 0.006, 0.35], [-0.064 * s, -0.01, 0.12]]
    free = [[0.06 * s, 0.005, 0.58], [0.074 * s, 0.078, 0.355], [0.092 * s, 0.0, 0.125]]
    return {"standing": np.array(standing), "free": np.array(free)}


def add_feet(table: PrimitiveTable, posture: Posture) -> None:
    """Feet with toes that show below the hem."""
    for name, leg in leg_joints(posture).items():
        side = posture.free_side if name == "free" else -posture.free_side
        ankle = leg[2]
        heel = np.array([ankle[0], ankle[1] + 0.02, BASE_TOP_M + 0.03])
        forward = np.array([0.22 * side, 1.0, 0.0]) / np.hypot(0.22, 1.0)
        across = np.array([forward[1], -forward[0], 0.0]) * side
        ball = heel + 0.092 * forward + np.array([0, 0, -0.012])
        table.cone(Group.BODY, ankle, heel, (0.034, 0.03), 0.02)
        table.cone(Group.BODY, heel, ball, (0.028, 0.015), 0.015)
        table.cone(Group.BODY, ball - 0.016 * across, ball + 0.018 * across, (0.014, 0.012), 0.010)
        for toe in range(5):
            root = ball + (0.0135 * (toe - 1.7)) * across + (0.012 - 0.004 * toe) * forward
            tip = root + (0.026 - 0.002 * toe) * forward + np.array([0, 0, -0.006])
            size = 0.0092 if toe == 0 else 0.0072 - 0.0004 * toe
            table.cone(Group.BODY, root, tip, (size, size), 0.002)
        sole = curve_through([heel - 0.03 * forward, heel + 0.05 * forward, ball + 0.03 * forward],
                             5)  # fmt: skip
        sole[:, 2] = BASE_TOP_M + 0.004
        table.chain(Group.BODY, sole, [0.03, 0.027, 0.028, 0.031, 0.024], 0.002)
